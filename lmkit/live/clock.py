"""The loop's clock: Unix time at the start, then monotonic, so that jumps of the system's clock do not affect
the filter."""

from __future__ import annotations

import time
from collections.abc import Callable

JUMP_S = 0.2


class LoopClock:
    """Unix time in seconds that never jumps, and the jumps of the system's clock since the start.

    Attributes:
        offset_s: current system time minus the loop's time.
    """

    def __init__(
        self, wall: Callable[[], float] = time.time, monotonic: Callable[[], float] = time.monotonic
    ) -> None:
        self._wall, self._monotonic = wall, monotonic
        self._start = wall() - monotonic()
        self.offset_s = 0.0

    def now(self) -> float:
        """The loop's time."""
        return self._start + self._monotonic()

    def of_monotonic(self, seconds: float) -> float:
        """The loop's time for a time of the monotonic clock, as given by drivers."""
        return self._start + seconds

    def check(self) -> float | None:
        """Seconds by which the system's clock jumped since the last call; None if it did not."""
        offset = self._wall() - self.now()
        jump = offset - self.offset_s
        if abs(jump) < JUMP_S:
            return None
        self.offset_s = offset
        return jump


class StampGuard:
    """Conversion of stamps of another clock to the loop's time.

    A stamp near its arrival is used unchanged.  For another clock (or after its jump), the smallest delay so far
    is the assumed difference of both clocks.
    """

    def __init__(self, near_s: float = 0.5) -> None:
        self._near_s = near_s
        self._shift: float | None = None
        self.jumps = 0

    def to_loop(self, stamp_s: float, arrival_s: float) -> float:
        """The stamp in the loop's time."""
        delay = arrival_s - stamp_s
        if self._shift is None:
            self._shift = 0.0 if abs(delay) < self._near_s else delay
        elif abs(delay - self._shift) > self._near_s:
            self._shift = 0.0 if abs(delay) < self._near_s else delay
            self.jumps += 1
        elif self._shift != 0.0:
            self._shift = min(self._shift, delay)
        return min(stamp_s + self._shift, arrival_s)
