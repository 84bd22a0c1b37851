"""Frames without motion in a video: the few frames that are worth a slow search."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from lmkit.arrays import Float32Array
from lmkit.io.image_sources import Frame

LOOK_S = 0.2
SMALL_PX = 160  # width of the images whose change is measured


@dataclass(frozen=True)
class StillFrames:
    """Frames of all cameras that belong together.

    Attributes:
        number: of the frame in its video, from 0.
        frames: one per camera.
        before: the previous frames; None at the start, and for sources without times.
    """

    number: int
    frames: tuple[Frame, ...]
    before: tuple[Frame, ...] | None = None


def still_frames(groups: Iterable[tuple[Frame, ...]]) -> Iterator[StillFrames]:
    """In every 0.2 s, the frames that differ least from the previous frames; without times, all frames.

    Raises:
        InputError: a frame cannot be read.
    """
    best: tuple[float, StillFrames] | None = None
    window: float | None = None
    before: tuple[Frame, ...] | None = None
    small_before: list[Float32Array] = []
    for number, frames in enumerate(groups):
        time_s = frames[0].time_s
        if time_s is None:
            yield StillFrames(number, frames)
            continue
        small = [_small(frame) for frame in frames]
        change = _change(small_before, small)
        if window is None or time_s // LOOK_S != window:
            if best is not None:
                yield best[1]
            best, window = None, time_s // LOOK_S
        if best is None or change < best[0]:
            best = change, StillFrames(number, frames, before)
        before, small_before = frames, small
    if best is not None:
        yield best[1]


def _small(frame: Frame) -> Float32Array:
    image = frame.pixels
    scale = SMALL_PX / image.shape[1]
    gray = cv2.cvtColor(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2GRAY)
    return np.asarray(gray, dtype=np.float32)


def _change(before: list[Float32Array], now: list[Float32Array]) -> float:
    """Mean difference of brightness of the camera that changes most; infinite at the start."""
    if not before:
        return np.inf
    return max(
        float(np.abs(a - b).mean()) if a.shape == b.shape else np.inf for a, b in zip(before, now, strict=True)
    )
