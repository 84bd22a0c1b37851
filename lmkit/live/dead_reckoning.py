"""The robot's pose from odometry alone, in its own frame, independent of images."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from lmkit.geometry.planar import planar_pose
from lmkit.geometry.pose import Pose
from lmkit.live.motion import GYRO, WHEELS, MotionRow

KEPT_S = 2.0
FRESH_S = 0.2  # longest time for which a gyro's rate is compared with the wheels


class DeadReckoning:
    """Poses of the base from rows of motion.

    Only rotation that both wheels and gyro measure is used, so that neither a gyro's bias nor a slipping wheel
    rotates a stationary robot.
    """

    def __init__(self) -> None:
        self._x = self._y = self._heading = 0.0
        self._rows: deque[tuple[float, Pose | tuple[float, float, float]]] = deque()
        self._gyro = (-math.inf, 0.0)

    def add(self, row: MotionRow) -> None:
        """Add a row of wheels, gyro or poses, in the order of time."""
        if row.kind == GYRO:
            self._gyro = (row.time_s, row.values[0])
            return
        if row.kind == WHEELS:
            forward, turn = row.values
            self._x += forward * math.cos(self._heading)
            self._y += forward * math.sin(self._heading)
            self._heading += self._confirmed(row.time_s, turn)
            self._rows.append((row.time_s, (self._x, self._y, self._heading)))
        else:
            pose = row.T_smooth_base or row.T_odometry_base
            if pose is not None:
                self._rows.append((row.time_s, pose))
        while len(self._rows) > 1 and self._rows[1][0] < row.time_s - KEPT_S:
            self._rows.popleft()

    def at(self, time_s: float) -> Pose | None:
        """Pose of the last row up to a time; None before the first."""
        if not self._rows:
            return None
        found = next((pose for time, pose in reversed(self._rows) if time <= time_s), self._rows[0][1])
        return found if isinstance(found, Pose) else planar_pose(np.array(found))

    def _confirmed(self, time_s: float, turn: float) -> float:
        """The smaller of both rotations; zero if they contradict."""
        at, rate = self._gyro
        if time_s - at > FRESH_S or not self._rows:
            return turn
        by_gyro = rate * (time_s - self._rows[-1][0])
        return math.copysign(min(abs(turn), abs(by_gyro)), turn) if turn * by_gyro > 0 else 0.0
