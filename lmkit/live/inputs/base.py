"""Odometry and gyro of a live run: each input in its own thread, opened again when it is lost."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from lmkit.errors import InputError
from lmkit.geometry.pose import Pose
from lmkit.live.clock import StampGuard
from lmkit.live.events import Event, Health
from lmkit.live.motion import GYRO, POSE, WHEELS, MotionInbox, MotionRow
from lmkit.live.reader import Rate

FIRST_WAIT_S, LONGEST_WAIT_S = 0.5, 5.0
READ_S = 0.2


class InputLost(Exception):
    """An input is lost; the message has the reason."""


@dataclass(frozen=True)
class Reading:
    """One reading of odometry or gyro.

    Attributes:
        kind: ``pose`` (x y z m, quaternion x y z w, in the odometry's own frame), ``wheels`` (forward m and turn rad
            since the previous reading), or ``gyro`` (rad/s about the robot's upward axis).
        time_s: stamp of the sender; None if it has none.
        values: numbers of the reading.
        notice: one sentence about the sensor, which becomes an event; usually empty.
    """

    kind: str
    time_s: float | None
    values: tuple[float, ...]
    notice: str = ""


class MotionInput(Protocol):
    """Interface of an open input."""

    def read(self, timeout_s: float) -> Sequence[Reading]:
        """Received readings, after at most ``timeout_s``.

        Raises:
            InputLost: there are no more readings.
        """

    def close(self) -> None:
        """Release it."""


class InputRunner:
    """Reads an input into the inbox of the loop.

    Args:
        name: name of the input in messages.
        open_: function that opens the input; raises `InputLost`.
        motion: ``wheels`` or ``pose``: use of odometry's poses.
        kinds: accepted readings, ``odometry`` and ``gyro``.
    """

    def __init__(
        self,
        name: str,
        open_: Callable[[], MotionInput],
        inbox: MotionInbox,
        now: Callable[[], float],
        motion: str,
        kinds: frozenset[str] = frozenset({"odometry", "gyro"}),
    ) -> None:
        self.name, self._open, self._inbox, self._now = name, open_, inbox, now
        self._motion, self._kinds = motion, kinds
        self._guards = {kind: StampGuard() for kind in (POSE, WHEELS, GYRO)}
        self._events: deque[Event] = deque(maxlen=50)
        self._problem, self._failed = "not open yet", False
        self._rate, self._count = Rate(), 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"lmkit-{name[:20]}", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        wait = FIRST_WAIT_S
        while not self._stop.is_set():
            source: MotionInput | None = None
            try:
                source = self._open()
                while not self._stop.is_set():
                    readings = source.read(READ_S)
                    if readings:
                        self._works()
                        wait = FIRST_WAIT_S
                    for reading in readings:
                        self.take(reading)
            except InputLost as lost:
                self._fail(str(lost))
            except Exception as error:  # a library's own error must not end the run
                self._fail(f"{type(error).__name__}: {error}")
            finally:
                if source is not None:
                    source.close()
            self._stop.wait(wait)
            wait = min(2 * wait, LONGEST_WAIT_S)

    def take(self, reading: Reading) -> None:
        """Pass a reading to the loop, with its stamp in the loop's time."""
        if ("gyro" if reading.kind == GYRO else "odometry") not in self._kinds:
            return
        self._count += 1
        self._rate.add(time.monotonic())
        arrival = self._now()
        if reading.notice:
            self._events.append(Event("imu_axes", f"{self.name}: {reading.notice}", arrival))
        stamp = arrival if reading.time_s is None else reading.time_s
        if not math.isfinite(stamp):
            self._inbox.add(MotionRow(reading.kind, math.nan))
            return
        guard = self._guards[reading.kind]
        jumps = guard.jumps
        time_s = guard.to_loop(stamp, arrival)
        if guard.jumps > jumps:
            self._events.append(Event("input_clock_jump", f"the clock of {self.name} jumped", time_s))
        if reading.kind != POSE:
            self._inbox.add(MotionRow(reading.kind, time_s, reading.values))
            return
        pose = pose_or_none(reading.values)
        if pose is None:
            kind = WHEELS if self._motion == WHEELS else POSE
            self._inbox.add(MotionRow(kind, time_s, (math.nan, math.nan)))
        elif self._motion == WHEELS:
            heading = math.atan2(pose.R[1, 0], pose.R[0, 0])
            self._inbox.add_planar(time_s, float(pose.t[0]), float(pose.t[1]), heading, pose)
        else:
            self._inbox.add_pose(time_s, pose)

    def _works(self) -> None:
        if self._failed:
            self._events.append(Event("input_back", f"{self.name} works again", self._now()))
        self._failed, self._problem = False, ""

    def _fail(self, problem: str) -> None:
        if self._stop.is_set():
            return
        self._problem = problem
        if not self._failed:
            self._events.append(Event("input_lost", f"{self.name}: {problem}; opening it again", self._now()))
        self._failed = True

    def events(self) -> tuple[Event, ...]:
        """Events since the last call."""
        events = []
        while self._events:
            events.append(self._events.popleft())
        return tuple(events)

    def health(self) -> Health:
        """Condition of the input."""
        rate = self._rate.value(time.monotonic())
        return Health(self.name, not self._problem, rate, self._count, 0, self._problem)

    def close(self) -> None:
        """End the thread."""
        self._stop.set()
        self._thread.join(2.0)


def pose_or_none(values: Sequence[float]) -> Pose | None:
    """T_odometry_base of x y z qx qy qz qw; None if this is not a pose.

    Examples:
        >>> pose_or_none([0, 0, 0, 0, 0, 0, 0]) is None
        True
    """
    if len(values) != 7 or not all(map(math.isfinite, values)) or math.hypot(*values[3:]) < 0.5:
        return None
    try:
        return Pose.from_quaternion("odometry", "base", values[:3], values[3:])
    except (InputError, ValueError):
        return None
