"""Rows of odometry and gyro for the loop: checked, ordered, bounded."""

from __future__ import annotations

import math
import threading
from collections import deque
from dataclasses import dataclass

import numpy as np

from lmkit.geometry.planar import wrap_heading
from lmkit.geometry.pose import Pose
from lmkit.geometry.rotations import rotation_angle
from lmkit.live.events import Event

MOST_WAITING = 5000
FASTEST_MPS, FASTEST_RADPS = 10.0, 12.0
LONGEST_ROW_S = 2.0  # a row after a longer gap starts again
WHEELS, GYRO, POSE = "wheels", "gyro", "pose"


@dataclass(frozen=True, eq=False)
class MotionRow:
    """One row of odometry or gyro.

    Attributes:
        kind: ``wheels`` (forward m and turn rad since the previous row), ``gyro`` (rad/s), or ``pose``.
        time_s: in the loop's time.
        values: values of a row of wheels or gyro.
        T_odometry_base: pose in the odometry's own frame, if any.
        T_smooth_base: the same pose with jumps removed, for the filter.
    """

    kind: str
    time_s: float
    values: tuple[float, ...] = ()
    T_odometry_base: Pose | None = None
    T_smooth_base: Pose | None = None


class MotionInbox:
    """Rows from other threads until the loop takes them; impossible values are refused and reported."""

    def __init__(self) -> None:
        self._rows: deque[MotionRow] = deque(maxlen=MOST_WAITING)
        self._events: deque[Event] = deque(maxlen=50)
        self._named: dict[str, float] = {}
        self._last: dict[str, float] = {}
        self._place: tuple[float, float, float, float] | None = None
        self._pose: tuple[float, Pose, Pose] | None = None  # time, received pose, and smooth pose
        self._lock = threading.Lock()

    def add(self, row: MotionRow) -> None:
        """Add a row, or refuse it."""
        problem = self._problem(row)
        with self._lock:
            if problem is None:
                self._last[row.kind] = row.time_s
                self._rows.append(row)
                return
            code, message = problem
            # Reported once in ten seconds.
            if row.time_s - self._named.get(code, -math.inf) > 10 or not math.isfinite(row.time_s):
                self._named[code] = row.time_s if math.isfinite(row.time_s) else 0.0
                self._events.append(Event(code, message, self._last.get(row.kind, 0.0)))

    def add_planar(self, time_s: float, x: float, y: float, heading: float, pose: Pose | None = None) -> None:
        """Add a pose of wheel odometry as the motion since the previous pose."""
        if not all(map(math.isfinite, (time_s, x, y, heading))):
            self.add(MotionRow(WHEELS, time_s, (math.nan, math.nan)))
            return
        before, self._place = self._place, (time_s, x, y, heading)
        if before is None or not 0 < time_s - before[0] < LONGEST_ROW_S:
            return
        turn = wrap_heading(heading - before[3])
        middle = before[3] + turn / 2
        forward = (x - before[1]) * math.cos(middle) + (y - before[2]) * math.sin(middle)
        self.add(MotionRow(WHEELS, time_s, (forward, turn), pose))

    def add_pose(self, time_s: float, T_odometry_base: Pose) -> None:
        """Add a 3D pose of odometry; at a jump, the robot is assumed to be stationary."""
        before = self._pose
        smooth = T_odometry_base
        if before is not None:
            moved = before[1].inverse() @ T_odometry_base
            seconds = max(time_s - before[0], 1e-3)
            far = float(np.linalg.norm(moved.t))
            if time_s > before[0] and (
                far > FASTEST_MPS * seconds + 0.1 or rotation_angle(moved.R) > FASTEST_RADPS * seconds + 0.1
            ):
                message = f"odometry jumped by {far:.2f} m in {seconds:.2f} s: taken as standing"
                with self._lock:
                    self._events.append(Event("pose_jump", message, time_s))
                smooth = before[2]
            else:
                smooth = before[2] @ moved
        self._pose = (time_s, T_odometry_base, smooth)
        self.add(MotionRow(POSE, time_s, (), T_odometry_base, smooth))

    def _problem(self, row: MotionRow) -> tuple[str, str] | None:
        if not all(map(math.isfinite, (row.time_s, *row.values))):
            return f"{row.kind}_not_finite", f"a row of {row.kind} is not finite: left out"
        last = self._last.get(row.kind)
        if last is not None and row.time_s <= last:
            return f"{row.kind}_out_of_order", f"a row of {row.kind} is {last - row.time_s:.3f} s old: left out"
        seconds = max(row.time_s - last if last is not None else 0.1, 1e-3)
        if row.kind == WHEELS:
            too_far = abs(row.values[0]) > FASTEST_MPS * seconds + 0.1
            if too_far or abs(row.values[1]) > FASTEST_RADPS * seconds + 0.1:
                self._last[row.kind] = row.time_s
                what = f"{row.values[0]:.2f} m and {row.values[1]:.2f} rad in {seconds:.2f} s"
                return "wheels_jump", f"odometry jumped by {what}: left out"
        if row.kind == GYRO and abs(row.values[0]) > 10 * FASTEST_RADPS:
            return "gyro_jump", f"the gyro says {row.values[0]:.1f} rad/s: left out"
        return None

    def take(self) -> tuple[tuple[MotionRow, ...], tuple[Event, ...]]:
        """All rows in the order of time, and events about refused rows."""
        with self._lock:
            rows = tuple(sorted(self._rows, key=lambda row: row.time_s))
            events = tuple(self._events)
            self._rows.clear()
            self._events.clear()
        return rows, events
