"""Queue of readings between a library's thread and an input's thread; when it is full, the newest are lost."""

from __future__ import annotations

import contextlib
import queue
from collections.abc import Sequence

from lmkit.live.inputs.base import Reading

MOST_WAITING = 1000


class WaitingReadings:
    """A bounded queue of readings."""

    def __init__(self) -> None:
        self._queue: queue.Queue[Reading] = queue.Queue(MOST_WAITING)

    def put(self, reading: Reading) -> None:
        """Add a reading, or drop it if too many wait; never blocks."""
        with contextlib.suppress(queue.Full):
            self._queue.put_nowait(reading)

    def take(self, timeout_s: float) -> Sequence[Reading]:
        """All waiting readings; waits for the first one for at most ``timeout_s``.

        Examples:
            >>> waiting = WaitingReadings()
            >>> waiting.put(Reading("gyro", 1.0, (0.3,)))
            >>> len(waiting.take(0.1)), waiting.take(0.0)
            (1, ())
        """
        try:
            found = [self._queue.get(timeout=timeout_s)]
        except queue.Empty:
            return ()
        while not self._queue.empty():
            found.append(self._queue.get_nowait())
        return found
