"""Where pictures come from: files, folders, globs, videos and standard input, as one stream."""

from __future__ import annotations

import glob
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lmkit.arrays import ByteArray
from lmkit.errors import InputError
from lmkit.formats.images import SUFFIXES, decode_image, read_image

CAMERA = "camera:"
VIDEO_SUFFIXES = frozenset({".mp4", ".avi", ".mov", ".mkv", ".webm", ".m4v"})


@dataclass(frozen=True)
class Frame:
    """One picture of a stream, or the reason why it could not be read.

    Attributes:
        name: path, or ``VIDEO#N`` for frame N of a video.
        image: (H,W,3) BGR, or None.
        error: set when image is None.
    """

    name: str
    image: ByteArray | None
    error: InputError | None = None


def list_pictures(where: str) -> list[Path]:
    """The picture files of a folder or glob, or the one file, sorted by name.

    Raises:
        InputError: there is none.
    """
    path = Path(where)
    if path.is_dir():
        found = sorted(p for p in path.iterdir() if p.suffix.lower() in SUFFIXES and not p.name.startswith("."))
        if not found:
            raise InputError(
                "no_pictures", f"folder {where} holds no pictures", f"kinds: {', '.join(sorted(SUFFIXES))}"
            )
        return found
    if path.exists():
        return [path]
    found = sorted(Path(p) for p in glob.glob(where, recursive=True) if Path(p).is_file())
    if not found:
        raise InputError("no_such_file", f"there is no file, folder or match for {where}", "check the path")
    return found


def picture_files(sources: Sequence[str]) -> list[Path] | None:
    """All files of the sources, where every one of them is a single picture; None where one is not."""
    if any(source.startswith(CAMERA) for source in sources):
        return None
    try:
        files = [path for source in sources if source != "-" for path in list_pictures(source)]
    except InputError:
        return None
    only_pictures = "-" not in sources and all(path.suffix.lower() not in VIDEO_SUFFIXES for path in files)
    return files if only_pictures else None


def frames(sources: list[str]) -> Iterator[Frame]:
    """All pictures of all sources, one at a time; what cannot be read comes as a Frame with its error."""
    for source in sources:
        if source == "-":
            yield _frame("-", sys.stdin.buffer.read())
            continue
        if source.startswith(CAMERA):
            yield from _video_frames(source)
            continue
        try:
            paths = list_pictures(source)
        except InputError as error:
            yield Frame(source, None, error)
            continue
        for path in paths:
            if path.suffix.lower() in VIDEO_SUFFIXES:
                yield from _video_frames(str(path))
                continue
            try:
                yield Frame(str(path), read_image(path))
            except InputError as error:
                yield Frame(str(path), None, error)


def _frame(name: str, data: bytes) -> Frame:
    try:
        return Frame(name, decode_image(data, name))
    except InputError as error:
        return Frame(name, None, error)


def _video_frames(source: str) -> Iterator[Frame]:
    """The frames of a video file, or of camera N for ``camera:N`` until it is unplugged or interrupted."""
    import cv2

    number = source.removeprefix(CAMERA)
    if source.startswith(CAMERA) and not number.isdecimal():
        yield Frame(source, None, InputError("bad_camera", f"{source}: no camera number", "write camera:0"))
        return
    video = cv2.VideoCapture(int(number)) if source.startswith(CAMERA) else cv2.VideoCapture(source)
    count = 0
    try:
        while video.isOpened():
            more, image = video.read()
            if not more:
                break
            yield Frame(f"{source}#{count}", np.asarray(image, dtype=np.uint8))
            count += 1
    finally:
        video.release()
    if count == 0:
        yield Frame(
            source,
            None,
            InputError("bad_video", f"{source}: no frame can be read", "give MP4, AVI, MOV, MKV, WebM or camera:0"),
        )
