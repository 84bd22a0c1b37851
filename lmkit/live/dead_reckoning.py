"""Where odometry alone puts the robot, in a frame of its own: no image can pull it."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from lmkit.geometry.planar import follow, planar_pose
from lmkit.geometry.pose import Pose
from lmkit.live.motion import GYRO, POSE, WHEELS, MotionRow

KEPT_S = 2.0
FRESH_S = 0.2  # a gyro's rate is compared with the wheels for so long


class DeadReckoning:
    """Poses of the base by rows of motion.

    Of the wheels' turn only what the gyro confirms counts, so that neither a gyro's bias nor a wheel that slips turns
    a robot that stands.
    """

    def __init__(self) -> None:
        self._state = np.zeros(3)
        self._poses: deque[tuple[float, Pose]] = deque()
        self._gyro = (-math.inf, 0.0)

    def add(self, row: MotionRow) -> None:
        """Take a row of wheels, gyro or poses, in the order of time."""
        if row.kind == GYRO:
            self._gyro = (row.time_s, row.values[0])
            return
        pose = row.T_smooth_base or row.T_odometry_base
        if row.kind == WHEELS:
            forward, turn = row.values
            self._state = follow(self._state, np.array([[forward, 0.0, self._confirmed(row.time_s, turn)]]))[1]
            pose = planar_pose(self._state)
        elif row.kind != POSE:
            pose = None
        if pose is None:
            return
        self._poses.append((row.time_s, pose))
        while len(self._poses) > 1 and self._poses[1][0] < row.time_s - KEPT_S:
            self._poses.popleft()

    def at(self, time_s: float) -> Pose | None:
        """Pose of the last row up to a time; None before the first."""
        if not self._poses:
            return None
        for time, pose in reversed(self._poses):
            if time <= time_s:
                return pose
        return self._poses[0][1]

    def _confirmed(self, time_s: float, turn: float) -> float:
        """The smaller of both turns; nothing where they contradict."""
        at, rate = self._gyro
        if time_s - at > FRESH_S or not self._poses:
            return turn
        by_gyro = rate * (time_s - self._poses[-1][0])
        return math.copysign(min(abs(turn), abs(by_gyro)), turn) if turn * by_gyro > 0 else 0.0
