"""Outputs of a live run: each in its own thread, with a short queue, opened again when it fails."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Protocol

from lmkit.live.events import Event, Health
from lmkit.live.reader import Rate
from lmkit.live.state import LiveState

FIRST_WAIT_S, LONGEST_WAIT_S = 0.5, 5.0
LONGEST_QUEUE = 32
LONGEST_HOLD_S = 60.0  # for recorded input, which does not become stale


class OutputLost(Exception):
    """An output cannot be written to; the message has the reason."""


class Output(Protocol):
    """Interface of an open output."""

    def send(self, state: LiveState) -> bool:
        """Write one step; False if this output sends nothing for it.

        Raises:
            OutputLost: its peer or its file is no longer available.
        """

    def close(self) -> None:
        """Flush and release the output."""


class OutputRunner:
    """Sends steps to an output without blocking the loop.

    Args:
        name: name of the output in messages.
        open_: function that opens the output; raises `OutputLost`.
        keeps_all: block the loop instead of dropping steps, if images do not become stale.
    """

    def __init__(
        self, name: str, open_: Callable[[], Output], now: Callable[[], float], keeps_all: bool = False
    ) -> None:
        self.name, self._open, self._now, self._keeps_all = name, open_, now, keeps_all
        self._queue: deque[LiveState] = deque()
        self._ready = threading.Condition()
        self._stop = False
        self._count = self._dropped = 0
        self._problem = "not open yet"
        self._failed = self._behind = False
        self._rate = Rate()
        self._events: deque[Event] = deque(maxlen=50)
        self._thread = threading.Thread(target=self._run, name=f"lmkit-{name[:20]}", daemon=True)
        self._thread.start()

    def put(self, state: LiveState) -> None:
        """Queue a step."""
        with self._ready:
            if self._keeps_all:
                self._ready.wait_for(lambda: len(self._queue) < LONGEST_QUEUE or self._failed, LONGEST_HOLD_S)
            if len(self._queue) >= LONGEST_QUEUE:
                self._queue.popleft()
                self._dropped += 1
                if not self._failed and not self._behind:
                    self._behind = True
                    self._events.append(
                        Event("output_behind", f"{self.name} is slow: steps are left out", self._now())
                    )
            self._queue.append(state)
            self._ready.notify_all()

    def _run(self) -> None:
        wait = FIRST_WAIT_S
        while not self._stop:
            output: Output | None = None
            try:
                output = self._open()
                self._works()
                wait = FIRST_WAIT_S
                self._send_all(output)
            except OutputLost as lost:
                self._fail(str(lost))
            except Exception as error:  # a library's own error must not end the run
                self._fail(f"{type(error).__name__}: {error}")
            finally:
                if output is not None:
                    try:
                        output.close()
                    except Exception as error:
                        self._fail(f"{type(error).__name__}: {error}")
            with self._ready:
                self._ready.wait_for(lambda: self._stop, wait)
            wait = min(2 * wait, LONGEST_WAIT_S)

    def _send_all(self, output: Output) -> None:
        while True:
            with self._ready:
                self._ready.wait_for(lambda: self._queue or self._stop)
                if not self._queue:
                    return
                state = self._queue.popleft()
                self._ready.notify_all()
            if output.send(state):
                self._count += 1
                self._rate.add(time.monotonic())

    def _works(self) -> None:
        with self._ready:
            if self._failed:
                self._events.append(Event("output_back", f"{self.name} works again", self._now()))
            self._failed, self._problem = False, ""

    def _fail(self, problem: str) -> None:
        with self._ready:
            self._problem = problem
            if not self._failed:
                self._events.append(Event("output_lost", f"{self.name}: {problem}; trying again", self._now()))
            self._failed = True
            self._ready.notify_all()

    def events(self) -> tuple[Event, ...]:
        """Events since the last call."""
        with self._ready:
            events = tuple(self._events)
            self._events.clear()
        return events

    def health(self) -> Health:
        """Condition of the output."""
        rate = self._rate.value(time.monotonic())
        return Health(self.name, not self._problem, rate, self._count, self._dropped, self._problem)

    def close(self, timeout_s: float = 3.0) -> None:
        """Send the queued steps, and end the thread."""
        with self._ready:
            self._stop = True
            self._ready.notify_all()
        self._thread.join(timeout_s)
