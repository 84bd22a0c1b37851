"""Landmarks of many images in a steady stream: images on all cores, videos frame by frame."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from lmkit.arrays import ByteArray
from lmkit.detection.config import DetectOptions
from lmkit.detection.detector import detect_landmarks
from lmkit.detection.windows import is_colorless
from lmkit.errors import InputError
from lmkit.io.image_sources import Frame, frames, image_files
from lmkit.model.observation import Detection
from lmkit.parallel import map_in_processes


@dataclass(frozen=True)
class Detected:
    """The landmarks of one image, or the reason why it could not be read.

    Attributes:
        name: path, or ``VIDEO#N`` for frame N of a video.
        size: (width, height), or None if the image could not be read.
        colorless: a gray image; landmarks are distinguished from other squares by their colors.
        image: the pixels of video frames and of ``-``, if requested.
        time_s: time in its video, or the time that its file name ends in.
    """

    name: str
    size: tuple[int, int] | None
    landmarks: tuple[Detection, ...] = ()
    error: InputError | None = None
    colorless: bool = False
    image: ByteArray | None = None
    time_s: float | None = None


def detect_in_sources(
    sources: Sequence[str], options: DetectOptions | None = None, with_images: bool = False
) -> Iterator[Detected]:
    """Every image of files, folders, globs, videos and ``-``, in order; one at a time in memory.

    Args:
        with_images: keep the pixels of video frames and of ``-`` beside their detections (files can be read again).
    """
    options = options or DetectOptions()
    files = image_files(sources)
    if files is not None:
        for answers in map_in_processes(partial(_detect_file, options), [str(file) for file in files]):
            yield from answers
        return
    yield from map(partial(_detect_frame, options, with_images), frames(list(sources)))


def _detect_file(options: DetectOptions, path: str) -> list[Detected]:
    return [_detect_frame(options, False, frame) for frame in frames([path])]


def _detect_frame(options: DetectOptions, with_images: bool, frame: Frame) -> Detected:
    if frame.image is None:
        return Detected(frame.name, None, error=frame.error)
    height, width = frame.image.shape[:2]
    return Detected(
        frame.name,
        (width, height),
        tuple(detect_landmarks(frame.image, options)),
        colorless=is_colorless(frame.image),
        image=frame.image if with_images else None,
        time_s=frame.time_s,
    )


def detected_dict(answer: Detected) -> dict[str, Any]:
    """The JSON result of one image (docs/formats.md)."""
    if answer.size is None:
        assert answer.error is not None
        return {"image": answer.name, "error": answer.error.as_dict()}
    width, height = answer.size
    detections = [detection.to_dict() for detection in answer.landmarks]
    result = {"image": answer.name, "width": width, "height": height, "time_s": answer.time_s}
    return result | {"detections": detections}


def detected_line(answer: Detected) -> str:
    """The result of one image as a line of text."""
    codes = ", ".join(f"{d.code} ({d.confidence:.2f})" for d in answer.landmarks) or "none"
    return f"{answer.name}: {codes}"


DETECTION_COLUMNS = "image,time_s,family,code,x0_px,y0_px,x1_px,y1_px,x2_px,y2_px,x3_px,y3_px,confidence,margin"


def detected_rows(answer: Detected) -> list[str]:
    """Lines of a CSV table with `DETECTION_COLUMNS`, one per detection."""
    name = quoted_cell(answer.name)
    time_s = "" if answer.time_s is None else f"{answer.time_s:.6f}"
    return [
        f"{name},{time_s},{d.family},{d.code},{','.join(f'{v:.4f}' for v in d.corners.ravel())},"
        f"{d.confidence:.4f},{d.margin:.4f}"
        for d in answer.landmarks
    ]


def quoted_cell(text: str) -> str:
    """A cell of a CSV table, quoted if necessary."""
    return '"' + text.replace('"', '""') + '"' if any(c in text for c in ',"\n') else text
