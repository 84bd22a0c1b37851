"""Sources of images: files, folders, globs, videos and standard input, as one stream."""

from __future__ import annotations

import glob
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lmkit.arrays import ByteArray
from lmkit.errors import InputError
from lmkit.io.image_names import in_order, time_of
from lmkit.io.images import SUFFIXES, decode_image, read_image

CAMERA = "camera:"
LARGEST_SEARCHED = 1 << 28  # bytes of a video that is searched for its index
VIDEO_SUFFIXES = frozenset({".mp4", ".avi", ".mov", ".mkv", ".webm", ".m4v"})


@dataclass(frozen=True)
class Frame:
    """One image of a stream, or the reason why it could not be read.

    Attributes:
        name: path, or ``VIDEO#N`` for frame N of a video.
        image: (H,W,3) BGR, or None.
        error: set when image is None.
        time_s: time in its video, or the time that its file name ends in; None if neither is known.
    """

    name: str
    image: ByteArray | None
    error: InputError | None = None
    time_s: float | None = None

    @property
    def pixels(self) -> ByteArray:
        """The image.

        Raises:
            InputError: it could not be read.
        """
        if self.image is None:
            assert self.error is not None
            raise self.error
        return self.image


def list_images(where: str) -> list[Path]:
    """The image files of a folder or glob, or the one file, sorted by name.

    Raises:
        InputError: there is none.
    """
    path = Path(where)
    if not where:
        raise InputError(
            "no_such_file", "the name of an image is empty", "give a file, folder or glob; . is this folder"
        )
    if path.is_dir():
        found = in_order([p for p in path.iterdir() if p.suffix.lower() in SUFFIXES and not p.name.startswith(".")])
        if not found:
            kinds = ", ".join(sorted(SUFFIXES))
            raise InputError("no_images", f"folder {where} contains no images", f"kinds: {kinds}")
        return found
    if path.exists():
        return [path]
    found = in_order([Path(p) for p in glob.glob(where, recursive=True) if Path(p).is_file()])
    if not found:
        raise InputError("no_such_file", f"no file, folder or match for {where}", "check the path")
    return found


def image_files(sources: Sequence[str]) -> list[Path] | None:
    """All files of the sources if every source consists of image files; else None."""
    if any(source.startswith(CAMERA) for source in sources):
        return None
    try:
        files = [path for source in sources if source != "-" for path in list_images(source)]
    except InputError:
        return None
    only_images = "-" not in sources and all(path.suffix.lower() not in VIDEO_SUFFIXES for path in files)
    return files if only_images else None


def frames(sources: list[str]) -> Iterator[Frame]:
    """All images of all sources, one at a time; an unreadable image is a Frame with an error."""
    for source in sources:
        if source == "-":
            yield _frame("-", sys.stdin.buffer.read())
            continue
        if source.startswith(CAMERA):
            yield from video_frames(source)
            continue
        try:
            paths = list_images(source)
        except InputError as error:
            yield Frame(source, None, error)
            continue
        for path in paths:
            if path.suffix.lower() in VIDEO_SUFFIXES:
                yield from video_frames(str(path))
                continue
            try:
                yield file_frame(path)
            except InputError as error:
                yield Frame(str(path), None, error)


def file_frame(path: Path) -> Frame:
    """The image of a file.

    Raises:
        InputError: it cannot be read.
    """
    return Frame(str(path), read_image(path), None, time_of(path.name))


def _frame(name: str, data: bytes) -> Frame:
    try:
        return Frame(name, decode_image(data, name))
    except InputError as error:
        return Frame(name, None, error)


def video_frames(source: str) -> Iterator[Frame]:
    """The frames of a video file, or of camera N for ``camera:N`` until it is unplugged or interrupted."""
    import cv2

    try:
        video = cv2.VideoCapture(camera_number(source) if source.startswith(CAMERA) else source)
    except InputError as error:
        yield Frame(source, None, error)
        return
    count = 0
    try:
        while video.isOpened():
            more, image = video.read()
            if not more:
                break
            time_s = video.get(cv2.CAP_PROP_POS_MSEC) / 1000
            # Some containers have no times; then the frame rate gives them.
            if time_s <= 0 < count:
                rate = video.get(cv2.CAP_PROP_FPS)
                time_s = count / rate if rate > 0 else math.nan
            known = math.isfinite(time_s) and not source.startswith(CAMERA)
            yield Frame(f"{source}#{count}", np.asarray(image, dtype=np.uint8), None, time_s if known else None)
            count += 1
    finally:
        video.release()
    if count == 0:
        hint = _how_to_give_video(source)
        if source.startswith(CAMERA):
            hint = "check the number and the cable, and close other programs that use the camera"
        yield Frame(source, None, InputError("bad_video", f"{source}: no frame can be read", hint))


def _how_to_give_video(source: str) -> str:
    """Advice for a file without a frame; the index of MP4 and MOV is written last."""
    try:
        data = Path(source).read_bytes() if Path(source).stat().st_size < LARGEST_SEARCHED else b"moov"
    except (OSError, ValueError):
        data = b"moov"
    if not data:
        return "the file is empty: copy or record it again"
    if data[4:8] == b"ftyp" and b"moov" not in data:
        return "the recording was cut off, or the copy is not complete: its index (moov) is missing"
    return "give MP4, AVI, MOV, MKV or WebM"


def camera_number(source: str) -> int:
    """N of ``camera:N``.

    Raises:
        InputError: it is not a number.
    """
    number = source.removeprefix(CAMERA)
    if not number.isdecimal():
        raise InputError(
            "bad_camera",
            f"{source}: no camera number",
            "check the number, such as camera:0, and close other programs",
        )
    return int(number)


def frame_count(sources: Sequence[str]) -> int | None:
    """Number of images of all sources, for progress; None if it is not known beforehand (cameras, ``-``)."""
    import cv2

    total = 0
    for source in sources:
        if source == "-" or source.startswith(CAMERA):
            return None
        try:
            paths = list_images(source)
        except InputError:
            paths = [Path(source)]
        for path in paths:
            if path.suffix.lower() not in VIDEO_SUFFIXES:
                total += 1
                continue
            video = cv2.VideoCapture(str(path))
            frames_of = int(video.get(cv2.CAP_PROP_FRAME_COUNT))
            video.release()
            if frames_of <= 0:
                return None
            total += frames_of
    return total


def are_moving(source: str) -> bool:
    """Whether the images of a source are consecutive frames, as in a video or from a camera."""
    return source.startswith(CAMERA) or Path(source).suffix.lower() in VIDEO_SUFFIXES
