"""Listeners of the live loop: callbacks, and a mailbox that keeps the newest step only."""

from __future__ import annotations

import threading
from collections.abc import Callable

from lmkit.live.state import LiveState

Listener = Callable[[LiveState], None]


class Mailbox:
    """A listener that keeps the newest step until `take` is called; never blocks the loop.

    A page or another thread calls `take`; a newer step replaces a step that was not taken.

    Examples:
        >>> from lmkit.live.listeners import Mailbox
        >>> mailbox = Mailbox()
        >>> mailbox.take(timeout_s=0.01) is None
        True
    """

    def __init__(self) -> None:
        self._newest: LiveState | None = None
        self._ready = threading.Condition()
        self.dropped = 0

    def __call__(self, state: LiveState) -> None:
        """Put a step in."""
        with self._ready:
            self.dropped += self._newest is not None
            self._newest = state
            self._ready.notify_all()

    def take(self, timeout_s: float | None = None) -> LiveState | None:
        """The newest step that was not taken yet; None after ``timeout_s`` without one."""
        with self._ready:
            self._ready.wait_for(lambda: self._newest is not None, timeout_s)
            state, self._newest = self._newest, None
            return state
