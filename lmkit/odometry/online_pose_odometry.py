"""Poses of odometry for filters: the last rows, and the motion between two times.

The motion equals that of `pose_odometry.py`, but uses only the few rows around two times: each row is
converted to a rotation once, when it arrives, and a step interpolates two poses.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import deque
from dataclasses import dataclass

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.geometry.pose import Pose
from lmkit.geometry.rotations import orthonormal, rotation_exp, rotation_log
from lmkit.odometry.motion_model import LONGEST_STEP_S
from lmkit.odometry.online_wheel_odometry import AHEAD_S
from lmkit.odometry.pose_odometry import PoseNoise, pose_variances

KEPT_S = 1.0  # duration for which rows are kept before the last frame


@dataclass(frozen=True, eq=False)
class _Row:
    """A pose of odometry.

    Attributes:
        time_s, R, p: (3,3), (3,) the pose in odometry's frame.
        turn: (3,) rotation vector from the row before, in its frame.
        totals: distance (m), rotation (rad) and time without poses (s) up to here.
    """

    time_s: float
    R: FloatArray
    p: FloatArray
    turn: FloatArray
    totals: tuple[float, float, float]

    def next(self, time_s: float, R: FloatArray, p: FloatArray) -> _Row:
        """The row after this one."""
        turn, step, seconds = rotation_log(self.R.T @ R), p - self.p, time_s - self.time_s
        way, turned, gap = self.totals
        gap += seconds if seconds > LONGEST_STEP_S else 0.0
        return _Row(time_s, R, p, turn, (way + float(step @ step) ** 0.5, turned + float(turn @ turn) ** 0.5, gap))


class PoseRows:
    """Rows of odometry, and the motions that they predict."""

    def __init__(self, noise: PoseNoise | None = None) -> None:
        self._noise = noise or PoseNoise()
        self._rows: deque[_Row] = deque()
        self._path: tuple[list[float], list[_Row]] | None = None  # of the rows so far, and one ahead of them

    @property
    def unknown(self) -> bool:
        """Whether the motion is unknown."""
        return len(self._rows) < 2

    def add(self, time_s: float, T_odometry_base: Pose) -> None:
        """Add a pose of odometry, in its own frame that drifts."""
        R, p = orthonormal(T_odometry_base.R), T_odometry_base.t
        first = _Row(time_s, R, p, np.zeros(3), (0.0, 0.0, 0.0))
        self._rows.append(self._rows[-1].next(time_s, R, p) if self._rows else first)
        self._path = None

    def forget(self, before_s: float) -> None:
        """Drop rows that no step needs any more."""
        while len(self._rows) > 2 and self._rows[1].time_s < before_s - KEPT_S:
            self._rows.popleft()
            self._path = None

    def at(self, time_s: float) -> tuple[FloatArray, FloatArray]:
        """(3,3), (3,) the pose of odometry at a time; constant where it is unknown."""
        if self.unknown:
            return np.eye(3), np.zeros(3)
        before, after, share = self._between_rows(time_s)
        return before.R @ rotation_exp(share * after.turn), before.p * (1 - share) + after.p * share

    def sigmas(self, before_s: float, time_s: float) -> FloatArray:
        """(6,) standard deviations of the motion (m) and turn (rad) between two times."""
        seconds, gap, way, turned = time_s - before_s, time_s - before_s, 0.0, 0.0
        if not self.unknown:
            times = self._all()[0]
            way, turned, gap = (b - a for a, b in zip(self._totals(before_s), self._totals(time_s), strict=True))
            gap += min(time_s, times[0]) - min(before_s, times[0]) + max(time_s, times[-1]) - max(before_s, times[-1])
        place, turn = (math.sqrt(value) for value in pose_variances(self._noise, seconds, way, turned, gap))
        return np.array([place, place, place, turn, turn, turn])

    def _all(self) -> tuple[list[float], list[_Row]]:
        """Times and rows, and one extrapolated row with the last velocity."""
        if self._path is None:
            last, seconds = self._rows[-1], self._rows[-1].time_s - self._rows[-2].time_s
            share = AHEAD_S / seconds
            R = last.R @ rotation_exp(share * last.turn)
            p = last.p + last.R @ (share * (self._rows[-2].R.T @ (last.p - self._rows[-2].p)))
            rows = [*self._rows, last.next(last.time_s + AHEAD_S, R, p)]
            self._path = [row.time_s for row in rows], rows
        return self._path

    def _between_rows(self, time_s: float) -> tuple[_Row, _Row, float]:
        """Rows before and after a time, and its fraction between both; at the ends, the end row."""
        times, rows = self._all()
        own = min(max(time_s, times[0]), times[-1])
        after = min(max(bisect_left(times, own), 1), len(times) - 1)
        return rows[after - 1], rows[after], (own - times[after - 1]) / (times[after] - times[after - 1])

    def _totals(self, time_s: float) -> list[float]:
        before, after, share = self._between_rows(time_s)
        return [a + share * (b - a) for a, b in zip(before.totals, after.totals, strict=True)]
