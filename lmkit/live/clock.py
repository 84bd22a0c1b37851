"""The loop's clock: Unix time at the start, monotonic from there on, so that no jump of the system's clock reaches
the filter."""

from __future__ import annotations

import time
from collections.abc import Callable

JUMP_S = 0.2


class LoopClock:
    """Unix time in seconds that never jumps, and the jumps of the system's clock since the start.

    Attributes:
        offset_s: to be added to the loop's time for the system's time of now.
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
        """The loop's time of a time of the monotonic clock, as drivers give it."""
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

    A stamp near its arrival is used unchanged.  For another clock (or after a jump of it), the smallest delay so far
    is assumed to be the difference of both clocks.
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
