"""Images of all cameras at one time, with the motion rows up to this time; and the interface of feeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from lmkit.arrays import ByteArray
from lmkit.geometry.pose import Pose
from lmkit.live.events import Event, Health
from lmkit.live.motion import MotionRow
from lmkit.model.observation import Detection


class EndOfFeed(Exception):
    """A recording has ended."""


@dataclass(frozen=True, eq=False)
class FrameGroup:
    """Input of one step of the loop.

    Attributes:
        time_s: of the step, in the loop's time.
        images: (H,W,3) BGR of every camera, in the order of the rig; None without an image.
        stamps_s: of the images.
        motion: rows since the previous group.
        seen: earlier detections, instead of images.
        profile: profile of the detector, if a recording has it.
        truth: true pose of the base, of a simulation.
        events: events of the sources.
    """

    time_s: float
    images: tuple[ByteArray | None, ...]
    stamps_s: tuple[float, ...]
    motion: tuple[MotionRow, ...] = ()
    seen: tuple[Sequence[Detection], ...] | None = None
    profile: str | None = None
    truth: Pose | None = None
    events: tuple[Event, ...] = ()


class Feed(Protocol):
    """Interface of a source of frames for the loop.

    Attributes:
        is_live: images arrive in real time and become stale; else each is kept until it is requested.
    """

    is_live: bool

    def next(self, timeout_s: float) -> FrameGroup | None:
        """The newest (live) or the next (recorded) group; None if there is none in time.

        Raises:
            EndOfFeed: there are no more groups.
        """

    def health(self) -> tuple[Health, ...]:
        """Condition of every source."""

    def close(self) -> None:
        """End threads and processes."""
