"""One thread per source that keeps the newest image, and opens the source again when it is lost."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable

import numpy as np

from lmkit.arrays import ByteArray
from lmkit.live.captures import Capture, SourceEnded, SourceLost
from lmkit.live.events import Event, Health

FIRST_WAIT_S, LONGEST_WAIT_S = 0.5, 5.0
STALLS_S = 4.0
RATE_S = 3.0
FROZEN_S = 0.5  # no camera repeats the same noise for this time
SPARSE = 7  # one of this number of pixels is compared
MOST_ABANDONED = 3


class Rate:
    """Events per second, over the last seconds."""

    def __init__(self, over_s: float = RATE_S) -> None:
        self._over_s = over_s
        self._times: deque[float] = deque(maxlen=1000)

    def add(self, time_s: float) -> None:
        """One event."""
        self._times.append(time_s)

    def value(self, now_s: float) -> float:
        """Events per second until now."""
        while self._times and self._times[0] < now_s - self._over_s:
            self._times.popleft()
        if len(self._times) < 2:
            return 0.0
        return (len(self._times) - 1) / max(self._times[-1] - self._times[0], 1e-6)


class Reader:
    """Reads a source in its own thread; `take` returns the newest images.

    Args:
        name: name of the source in messages.
        open_: function that opens the source; raises `SourceLost`.
        news: condition that is notified with every image.
    """

    def __init__(
        self, name: str, open_: Callable[[], Capture], now: Callable[[], float], news: threading.Condition
    ) -> None:
        self.name, self._open, self._now, self._news = name, open_, now, news
        self._newest: tuple[float, tuple[ByteArray, ...]] | None = None
        self._count = self._dropped = self._generation = 0
        self._problem = "not open yet"
        self._lost = self._ended = False
        self._last = time.monotonic()
        self._rate = Rate()
        self._events: deque[Event] = deque(maxlen=50)
        self._stop = threading.Event()
        self._abandoned: list[threading.Thread] = []
        self._shown: ByteArray | None = None  # some pixels of the last image, and the time of their last change
        self._changed = time.monotonic()
        self._thread = self._start()

    def _start(self) -> threading.Thread:
        thread = threading.Thread(
            target=self._run, args=(self._generation,), name=f"lmkit-{self.name[:20]}", daemon=True
        )
        thread.start()
        return thread

    def _run(self, generation: int) -> None:
        wait = FIRST_WAIT_S
        while not self._stop.is_set() and generation == self._generation:
            capture: Capture | None = None
            try:
                capture = self._open()
                while not self._stop.is_set() and generation == self._generation:
                    self._put(generation, *capture.read())
                    wait = FIRST_WAIT_S
            except SourceEnded:
                self._end(generation)
                return
            except SourceLost as lost:
                self._fail(generation, str(lost))
            except Exception as error:  # a driver's own error must not end the run
                self._fail(generation, f"{type(error).__name__}: {error}")
            finally:
                if capture is not None:
                    capture.close()
            self._stop.wait(wait)
            wait = min(2 * wait, LONGEST_WAIT_S)

    def _put(self, generation: int, stamp: float, images: tuple[ByteArray, ...]) -> None:
        with self._news:
            if generation != self._generation:
                return
            self._last = time.monotonic()
            if self._is_frozen(images):
                return
            if self._lost:
                self._events.append(Event("camera_back", f"{self.name} gives images again", self._now()))
            self._lost, self._problem = False, ""
            self._dropped += self._newest is not None
            self._newest = (stamp, images)
            self._count += 1
            self._rate.add(self._last)
            self._news.notify_all()

    def _is_frozen(self, images: tuple[ByteArray, ...]) -> bool:
        """Whether a driver repeats its last image for long; reported once.  A black image is not a repetition."""
        shown = images[0][::SPARSE, ::SPARSE]
        if self._shown is None or not np.array_equal(shown, self._shown) or not shown.any():
            self._shown, self._changed = shown.copy(), self._last
        if self._last - self._changed < FROZEN_S:
            return False
        self._problem = f"the same image for {FROZEN_S:g} s"
        if not self._lost:
            self._lost = True
            self._events.append(Event("camera_frozen", f"{self.name}: {self._problem}; not used", self._now()))
        self._news.notify_all()
        return True

    def _fail(self, generation: int, problem: str) -> None:
        with self._news:
            if generation != self._generation or self._stop.is_set():
                return
            self._problem = problem
            if not self._lost:
                self._lost = True
                self._events.append(Event("camera_lost", f"{self.name}: {problem}; opening it again", self._now()))
            self._news.notify_all()

    def _end(self, generation: int) -> None:
        with self._news:
            if generation == self._generation:
                self._ended, self._problem = True, "ended"
                self._news.notify_all()

    def peek(self) -> float | None:
        """Stamp of the newest images that were not yet taken; call with ``news`` held."""
        return None if self._newest is None else self._newest[0]

    def take(self) -> tuple[float, tuple[ByteArray, ...]] | None:
        """The newest images; call with ``news`` held."""
        newest, self._newest = self._newest, None
        return newest

    def watch(self) -> None:
        """Abandon a thread whose source stalls, and open the source in a new thread; call with ``news`` held."""
        if self._lost or self._ended or time.monotonic() - self._last < STALLS_S or self._count == 0:
            return
        self._abandoned = [thread for thread in self._abandoned if thread.is_alive()]
        self._lost, self._problem = True, f"no image for {STALLS_S:g} s"
        self._events.append(Event("camera_stalls", f"{self.name}: {self._problem}; opening it again", self._now()))
        if len(self._abandoned) < MOST_ABANDONED:
            self._abandoned.append(self._thread)
            self._generation += 1
            self._thread = self._start()

    @property
    def works(self) -> bool:
        """Whether the source gives images now."""
        return not self._lost and not self._ended and self._count > 0

    @property
    def has_ended(self) -> bool:
        """Whether the source gives no more images, except those that were not yet taken; call with ``news`` held."""
        return self._ended

    def events(self) -> tuple[Event, ...]:
        """Events since the last call."""
        events = tuple(self._events)
        self._events.clear()
        return events

    def health(self) -> Health:
        """Condition of the source."""
        rate = self._rate.value(time.monotonic())
        return Health(self.name, self.works, rate, self._count, self._dropped, self._problem)

    def close(self) -> None:
        """End the thread."""
        self._stop.set()
        self._thread.join(2.0)
