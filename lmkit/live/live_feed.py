"""The newest images of all cameras, grouped by time."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence

from lmkit.arrays import ByteArray
from lmkit.live.captures import Capture
from lmkit.live.events import Event, Health
from lmkit.live.exposures import MOST_APART_S, TOGETHER_S
from lmkit.live.frame_group import EndOfFeed, FrameGroup
from lmkit.live.inputs.base import InputRunner
from lmkit.live.motion import MotionInbox
from lmkit.live.reader import Reader

PATIENCE_S = 0.05  # for the other cameras' images


class LiveFeed:
    """Images of live sources.

    Args:
        sources: name, function that opens it, and number of cameras of each.
        inbox: rows of odometry and gyro.
        inputs: inputs of odometry and gyro, which write into the inbox.
    """

    is_live = True

    def __init__(
        self,
        sources: Sequence[tuple[str, Callable[[], Capture], int]],
        inbox: MotionInbox,
        now: Callable[[], float],
        inputs: Sequence[InputRunner] = (),
    ) -> None:
        self._news = threading.Condition()
        self._counts = [count for *_, count in sources]
        self._inbox, self._now, self._inputs = inbox, now, tuple(inputs)
        self._last = float("-inf")
        self._readers = [Reader(name, open_, now, self._news) for name, open_, _ in sources]

    def next(self, timeout_s: float) -> FrameGroup | None:
        """See `Feed`."""
        end = time.monotonic() + timeout_s
        with self._news:
            while not self._ready():
                if self._has_ended():
                    break
                left = end - time.monotonic()
                if left <= 0:
                    break
                self._news.wait(min(left, 0.01 if self._any() else left))
            for reader in self._readers:
                reader.watch()
            if not self._any():
                if self._has_ended():
                    raise EndOfFeed
                return None
            return self._group()

    def _any(self) -> bool:
        return any(reader.peek() is not None for reader in self._readers)

    def _has_ended(self) -> bool:
        return all(reader.has_ended for reader in self._readers)

    def _ready(self) -> bool:
        """Whether all working cameras have images of the same time, or the waiting time is over."""
        stamps = [reader.peek() for reader in self._readers if reader.works]
        known = [stamp for stamp in stamps if stamp is not None]
        if not known:
            return False
        if len(known) == len(stamps) and max(known) - min(known) < TOGETHER_S:
            return True
        return self._now() - max(known) > PATIENCE_S

    def _group(self) -> FrameGroup:
        newest = max(stamp for reader in self._readers if (stamp := reader.peek()) is not None)
        images: list[ByteArray | None] = []
        stamps: list[float] = []
        events: list[Event] = [event for source in self._inputs for event in source.events()]
        for reader, count in zip(self._readers, self._counts, strict=True):
            taken = reader.take()
            events += reader.events()
            # An image of another time is from another pose.
            if taken is None or newest - taken[0] > MOST_APART_S or len(taken[1]) != count:
                images += [None] * count
                stamps += [newest] * count
                continue
            images += taken[1]
            stamps += [taken[0]] * count
        rows, refused = self._inbox.take()
        events += refused
        if newest <= self._last:
            events.append(Event("image_out_of_order", "an image is older than the one before: left out", newest))
            return FrameGroup(self._last, (None,) * len(images), tuple(stamps), rows, events=tuple(events))
        self._last = newest
        return FrameGroup(newest, tuple(images), tuple(stamps), rows, events=tuple(events))

    def quiet_events(self) -> tuple[Event, ...]:
        """Events while there is no image."""
        with self._news:
            return tuple(event for reader in self._readers for event in reader.events())

    def health(self) -> tuple[Health, ...]:
        """See `Feed`."""
        return tuple([reader.health() for reader in self._readers] + [source.health() for source in self._inputs])

    def close(self) -> None:
        """See `Feed`."""
        for reader in self._readers:
            reader.close()
        for source in self._inputs:
            source.close()
