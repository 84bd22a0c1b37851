"""Videos of several cameras, frame by frame: matched by number at equal rates, by time at unequal rates."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from lmkit.errors import InputWarning, warn_caller
from lmkit.io.image_sources import Frame, video_frames

SAME_RATE = 0.01  # relative; stated rates of cameras that are triggered together may be rounded by this


@dataclass(frozen=True)
class _Timing:
    """Frames per second, and the number of frames, from the file; 0 if unknown."""

    rate: float
    count: int


def video_groups(videos: Sequence[str]) -> Iterator[tuple[Frame, ...]]:
    """Matching frames of all videos, in the order of the first one.

    Videos with equal numbers of frames and equal rates are matched by number. Others are matched by time: each frame
    of the first video with the nearest one of every other video, if each is the nearest of the other and both are no
    further apart than half a step of the slowest video. Frames without a partner are skipped, as is the end of a
    longer video.

    Warns:
        InputWarning: rates or counts differ, so that frames are joined by their times.
    """
    timings = [_timing(video) for video in videos]
    streams = [video_frames(video) for video in videos]
    if _in_step(timings):
        yield from zip(*streams, strict=False)
        return
    rates = [timing.rate for timing in timings]
    if max(rates) > (1 + SAME_RATE) * min(rates):
        stated = ", ".join(f"{Path(video).name} {rate:.4g}" for video, rate in zip(videos, rates, strict=True))
        text = (
            f"videos have different rates (frames a second: {stated}); frames are joined by their times, "
            f"at most {500 / min(rates):.0f} ms apart"
        )
        warn_caller(InputWarning(text))
    yield from _by_time(streams, 1 / (2 * min(rates)))


def _timing(video: str) -> _Timing:
    import cv2

    capture = cv2.VideoCapture(video)
    rate, count = capture.get(cv2.CAP_PROP_FPS), int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    capture.release()
    return _Timing(max(rate, 0.0), max(count, 0))


def _in_step(timings: Sequence[_Timing]) -> bool:
    """Whether the videos have equal rates and numbers of frames, or no times."""
    rates, counts = [timing.rate for timing in timings], [timing.count for timing in timings]
    if min(rates) == 0:
        return True
    return max(rates) <= (1 + SAME_RATE) * min(rates) and min(counts) == max(counts)


def _by_time(streams: Sequence[Iterator[Frame]], most_apart_s: float) -> Iterator[tuple[Frame, ...]]:
    first, *others = (_Looker(stream) for stream in streams)
    before: float | None = None
    while first.here is not None:
        frame, time_s = first.here, _time(first.here)
        for other in others:
            other.go_nearest(time_s)
        partners = [other.here for other in others]
        if any(partner is None for partner in partners):
            return
        after = None if first.following is None else _time(first.following)
        known = [partner for partner in partners if partner is not None]
        if all(_belong(time_s, _time(partner), before, after, most_apart_s) for partner in known):
            yield (frame, *known)
        before = time_s
        first.go_on()


def _belong(time_s: float, partner_s: float, before: float | None, after: float | None, most_apart_s: float) -> bool:
    """Whether the frame at time_s is the nearest of its video to the partner (or the earlier of two), and near."""
    apart = abs(partner_s - time_s)
    nearer_than_before = before is None or apart < abs(partner_s - before)
    as_near_as_after = after is None or apart <= abs(partner_s - after)
    return nearer_than_before and as_near_as_after and apart <= most_apart_s * (1 + SAME_RATE)


def _time(frame: Frame) -> float:
    """Time of a frame.

    Raises:
        InputError: it could not be read.
    """
    if frame.time_s is None:
        _ = frame.pixels
    return frame.time_s or 0.0


class _Looker:
    """A video's frame, and the one that follows it; None after the end."""

    def __init__(self, frames: Iterator[Frame]) -> None:
        self._frames = frames
        self.here = next(frames, None)
        self.following = next(frames, None)

    def go_on(self) -> None:
        """Advance by one frame."""
        self.here, self.following = self.following, next(self._frames, None)

    def go_nearest(self, time_s: float) -> None:
        """Advance to the frame nearest to a time; times increase from call to call."""
        while self.here is not None and self.following is not None:
            if abs(_time(self.following) - time_s) > abs(_time(self.here) - time_s):
                return
            self.go_on()
