"""A live run: the feed, the loop, the outputs and the listeners, until it is stopped."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from lmkit.geometry.pose import Pose
from lmkit.live.clock import LoopClock
from lmkit.live.events import Event
from lmkit.live.frame_group import EndOfFeed, Feed, FrameGroup
from lmkit.live.listeners import Listener
from lmkit.live.loop import LiveLoop
from lmkit.live.outputs.base import OutputRunner
from lmkit.live.state import LiveState
from lmkit.model.pose_status import PoseStatus

WAIT_S = 0.25
HEALTH_EVERY_S = 0.5


@dataclass
class RunSummary:
    """Counts of a run.

    Attributes:
        steps: of the loop.
        statuses: number of steps by status.
        events: number of events by code.
        seconds: of wall time.
    """

    steps: int = 0
    statuses: Counter[str] = field(default_factory=Counter)
    events: Counter[str] = field(default_factory=Counter)
    seconds: float = 0.0


class LiveRun:
    """Runs the loop over a feed; listeners and outputs get every step.

    Args:
        rate_hz: largest number of steps per second; None: one per image.
        truth: true pose at a time, of a simulation.
        stop_at_end: end with the feed (recordings).

    Examples:
        >>> from lmkit.live.open_run import open_run
        >>> from lmkit.live.run_settings import RunFile, RunSettings
        >>> states = []
        >>> run = open_run(RunSettings(RunFile(sources=["sim:?seconds=2&speed=max&images=no"])))
        >>> run.listeners.append(states.append)
        >>> run.run().steps
        60
        >>> states[-1].T_map_base is not None or bool(states[-1].reason)
        True
    """

    def __init__(
        self,
        loop: LiveLoop,
        feed: Feed,
        outputs: Sequence[OutputRunner] = (),
        clock: LoopClock | None = None,
        rate_hz: float | None = None,
        truth: Callable[[float], Pose] | None = None,
    ) -> None:
        self.loop, self.feed, self.outputs = loop, feed, list(outputs)
        self.clock = clock or LoopClock()
        self.listeners: list[Listener] = []
        self._events: deque[Event] = deque(maxlen=100)
        self._period_s = None if rate_hz is None else 1 / rate_hz
        self._truth = truth
        self._stop = threading.Event()
        self.newest: LiveState | None = None
        self.newest_at = float("-inf")
        self.summary = RunSummary()

    def stop(self) -> None:
        """End the run after the current step; may be called from a signal handler."""
        self._stop.set()

    def run(self) -> RunSummary:
        """Steps until the feed ends or `stop` is called; then everything is closed."""
        start = next_at = time.monotonic()
        try:
            while not self._stop.is_set():
                try:
                    group = self.feed.next(WAIT_S)
                except EndOfFeed:
                    break
                if group is None:
                    self._quiet()
                    continue
                self._step(group)
                if self._period_s is not None and self.feed.is_live:
                    next_at = max(next_at + self._period_s, time.monotonic() - self._period_s)
                    self._stop.wait(max(0.0, next_at - time.monotonic()))
        finally:
            self.feed.close()
            for output in self.outputs:
                output.close()
        self.summary.seconds = time.monotonic() - start
        return self.summary

    def _step(self, group: FrameGroup) -> None:
        state = self.loop.step(group, self.feed.is_live)
        if state is not None:
            self._publish(state)

    def _publish(self, state: LiveState) -> None:
        jump = self.clock.check() if self.feed.is_live else None
        events = [*state.events, *self._gathered()]
        if jump is not None:
            events.append(Event("clock_jump", f"the system's clock jumped by {jump:+.2f} s", state.time_s))
        state = replace(
            state,
            time_s=state.time_s + (self.clock.offset_s if self.feed.is_live else 0.0),
            events=tuple(events),
            sources=self.feed.health(),
            outputs=tuple(output.health() for output in self.outputs),
            truth=state.truth if self._truth is None else self._truth(state.time_s),
        )
        self.newest, self.newest_at = state, time.monotonic()
        self.summary.steps += 1
        self.summary.statuses[str(state.status)] += 1
        self.summary.events.update(event.code for event in events)
        for output in self.outputs:
            output.put(state)
        for listener in self.listeners:
            try:
                listener(state)
            except Exception as error:  # an error in a listener must not end the run
                self._events.append(Event("listener_failed", f"{type(error).__name__}: {error}", state.time_s))

    def _gathered(self) -> list[Event]:
        events = [event for output in self.outputs for event in output.events()]
        while self._events:
            events.append(self._events.popleft())
        return events

    def _quiet(self) -> None:
        """Report that no image has come, with the events of the sources."""
        quiet = getattr(self.feed, "quiet_events", None)
        events = tuple(quiet()) if quiet is not None else ()
        since = time.monotonic() - self.newest_at
        if not events and (since < HEALTH_EVERY_S or (self.newest is None and self.summary.steps)):
            return
        now = self.clock.now()
        problems = "; ".join(f"{h.name}: {h.problem}" for h in self.feed.health() if not h.good)
        number = self.newest.number if self.newest is not None else 0
        state = LiveState(
            number,
            now,
            PoseStatus.LOST,
            None,
            None,
            (),
            reason=f"no images ({problems})" if problems else "no images",
            events=events,
            resets=self.newest.resets if self.newest is not None else 0,
        )
        self._publish(state)
