"""Wheel odometry of a driving robot for filters: the last rows, and the motion that they predict.

The state is x, y, heading and the errors of the odometry (`motion.PARAMETERS`), including its delay: the same
motions at a slightly later time lead to another pose.  Rows are kept as long as a delay may need them.
"""

from __future__ import annotations

import math
from array import array

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.model.recording import Gyro, Odometry
from lmkit.odometry.wheel_odometry import PARAMETERS, Increments, MotionModel, MotionNoise, Rows

STATES = 3 + len(PARAMETERS)
LONGEST_DELAY_S = 1.5
AHEAD_S = 0.3
DRIFT = np.array([1e-3, 1e-3, 1e-5, 1e-3, 1e-3, 3e-3])  # of the parameters, per root of a second
STILL = np.eye(STATES)
DRIFTS = np.diag(np.append(np.zeros(3), DRIFT**2))


class Wheels:
    """Rows of odometry and gyro, and the step they predict."""

    def __init__(self, noise: MotionNoise | None = None) -> None:
        self._noise = noise
        # Columns: numpy takes them much faster than rows.
        self._rows = (array("d"), array("d"), array("d"))
        self._gyro = (array("d"), array("d"))
        self._sound = True  # rows are finite and in the order of time
        self._known: tuple[float, float, tuple[float, ...], Increments] | None = None  # of the rows so far

    def add_odometry(self, time_s: float, forward_m: float, turn_rad: float) -> None:
        """Add the distance and the turn since the previous row."""
        times = self._rows[0]
        follows = not times or time_s > times[-1]
        self._sound = self._sound and follows and math.isfinite(time_s + forward_m + turn_rad)
        for column, value in zip(self._rows, (time_s, forward_m, turn_rad), strict=True):
            column.append(value)
        self._known = None

    def add_gyro(self, time_s: float, rate_radps: float) -> None:
        """The rate of turn."""
        for column, value in zip(self._gyro, (time_s, rate_radps), strict=True):
            column.append(value)
        self._known = None

    def forget(self, before_s: float) -> None:
        """Drop rows that no delay needs any more."""
        for columns in (self._rows, self._gyro):
            times, old = columns[0], 0
            while len(times) - old > 2 and times[old + 1] < before_s - LONGEST_DELAY_S:
                old += 1
            for column in columns:
                del column[:old]

    def predict(self, x: FloatArray, P: FloatArray, before_s: float, time_s: float) -> tuple[FloatArray, FloatArray]:
        """The (9,) state and its (9,9) covariance a little later."""
        later, F, Q = self.step(x, before_s, time_s)
        return later, F @ P @ F.T + Q

    def step(self, x: FloatArray, before_s: float, time_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The (9,) state a little later, its (9,9) derivatives with the state ``x`` before, and the noise between."""
        increments = self._increments(before_s, time_s, x[3:])
        forward, left, turned = increments.motions[0].tolist()
        heading = float(x[2])
        c, s = math.cos(heading), math.sin(heading)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        F = STILL.copy()
        F[0, 2], F[1, 2] = -s * forward - c * left, c * forward - s * left
        F[:3, 3:] = turn @ increments.by_parameters[0]
        later = x.copy()
        later[:3] += (c * forward - s * left, s * forward + c * left, turned)
        Q = DRIFTS * (time_s - before_s)
        Q[:3, :3] = (turn * increments.sigmas[0] ** 2) @ turn.T
        return later, F, Q

    def _increments(self, before_s: float, time_s: float, parameters: FloatArray) -> Increments:
        """The motion between two times; asked twice for the same, it is computed once."""
        asked = (before_s, time_s, tuple(parameters.tolist()))
        if self._known is None or self._known[:3] != asked:
            self._known = (*asked, self.model(before_s).increments(np.array([before_s, time_s]), parameters))
        return self._known[3]

    def model(self, time_s: float) -> MotionModel:
        """Motion model of the rows so far; without rows, the robot stands still around ``time_s``."""
        if len(self._rows[0]) < 2:
            outside = Odometry(np.array([time_s - 9e3, time_s - 8e3]), np.zeros(2), np.zeros(2))
            return MotionModel(outside, None, self._noise)
        # For times after the last row, the robot continues with its last velocity.
        times, forwards, turns = self._rows
        share = AHEAD_S / max(times[-1] - times[-2], 1e-3)
        ahead = (times[-1] + AHEAD_S, share * forwards[-1], share * turns[-1])
        columns = (np.array(c + array("d", [a])) for c, a in zip(self._rows, ahead, strict=True))
        odometry = Rows(*columns) if self._sound else Odometry(*columns)
        gyro = Gyro(*map(np.array, self._gyro)) if len(self._gyro[0]) > 1 else None
        return MotionModel(odometry, gyro, self._noise)
