"""Landmarks of many images in a steady stream: images on all cores, videos frame by frame."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

from lmkit.detection.config import DetectOptions
from lmkit.detection.detector import detect_landmarks, is_colourless
from lmkit.errors import InputError
from lmkit.io.image_sources import Frame, frames, picture_files
from lmkit.model.observation import Detection
from lmkit.parallel import map_in_processes

# Below this the processes' start costs more than they bring.
WORTH_PROCESSES = 6


@dataclass(frozen=True)
class Detected:
    """The landmarks of one image, or why it could not be read.

    Attributes:
        name: path, or ``VIDEO#N`` for frame N of a video.
        size: (width, height), or None where it could not be read.
        colourless: a grey image; landmarks are told from other squares by their colours.
    """

    name: str
    size: tuple[int, int] | None
    landmarks: tuple[Detection, ...] = ()
    error: InputError | None = None
    colourless: bool = False


def detect_in_sources(sources: Sequence[str], options: DetectOptions | None = None) -> Iterator[Detected]:
    """Every image of files, folders, globs, videos and ``-``, in order; one at a time in memory."""
    options = options or DetectOptions()
    files = picture_files(sources)
    if files is not None and len(files) >= WORTH_PROCESSES:
        for answers in map_in_processes(partial(_detect_file, options), [str(file) for file in files]):
            yield from answers
        return
    for frame in frames(list(sources)):
        yield _detect_frame(options, frame)


def _detect_file(options: DetectOptions, path: str) -> list[Detected]:
    return [_detect_frame(options, frame) for frame in frames([path])]


def _detect_frame(options: DetectOptions, frame: Frame) -> Detected:
    if frame.image is None:
        return Detected(frame.name, None, error=frame.error)
    height, width = frame.image.shape[:2]
    landmarks = tuple(detect_landmarks(frame.image, options))
    return Detected(frame.name, (width, height), landmarks, colourless=is_colourless(frame.image))
