"""Annotated copies of images and videos, written one by one."""

from __future__ import annotations

import os
import tempfile
from itertools import pairwise
from pathlib import Path
from types import TracebackType

import cv2

from lmkit.arrays import ByteArray
from lmkit.errors import InputError
from lmkit.io.files import check_writable, write_file
from lmkit.io.image_sources import VIDEO_SUFFIXES
from lmkit.io.images import SUFFIXES
from lmkit.visualization.overlay import encode_jpeg

OTHERS = frozenset(
    {".csv", ".json", ".yaml", ".yml", ".html", ".pdf", ".svg", ".tum"}
)  # suffixes of the other outputs
FPS = 15.0  # of videos that do not state their rate
FASTEST_FPS = 120.0
VARIES = 1.25  # longest interval over the interval of the stated rate
RATE_FRAMES = 100  # first frames of a video, whose times give its highest rate


def require_folder_name(folder: Path, videos: bool) -> None:
    """Refuse a folder with the name of a file.

    Args:
        videos: the name may also be the file name of a single output video.

    Raises:
        InputError: it has the suffix of another output, of an image, or of an unsupported video format.
    """
    written = {".mp4"} if videos else set()
    if folder.suffix.lower() in (SUFFIXES | VIDEO_SUFFIXES | OTHERS) - written and not folder.is_dir():
        raise InputError(
            "not_a_folder",
            f"--annotate {folder} must name a folder, not a file",
            f"give --annotate {folder.with_suffix('')}; files in it are named after the images",
        )


class AnnotatedFolder:
    """Writes ``NAME.jpg`` for images, and ``NAME.mp4`` for the frames of a video; a context manager.

    A video is moved into place when it is complete, and removed after an error. It has a constant rate: if the times
    of the source's frames vary, a frame is repeated until the time of the next frame.

    Args:
        folder: output folder; for a single video also a file name with suffix .mp4.
        force: overwrite existing files.
        videos: sources may be videos.
    """

    def __init__(self, folder: Path, force: bool, videos: bool = True) -> None:
        require_folder_name(folder, videos)
        is_file = folder.suffix.lower() == ".mp4" and not folder.is_dir()
        self._file = folder if is_file else None
        self._folder, self._force = folder.parent if is_file else folder, force
        self._written: list[Path] = []
        self._video: cv2.VideoWriter | None = None
        self._shown: ByteArray | None = None  # the last frame, repeated until the time of the next one
        self._rate, self._first_s, self._count = FPS, 0.0, 0
        self._source = ""
        self._partial = self._target = Path()

    def __enter__(self) -> AnnotatedFolder:
        return self

    def __exit__(self, kind: type[BaseException] | None, _: object, __: TracebackType | None) -> None:
        self._end_video(complete=kind is None)

    def add(self, name: str, image: ByteArray, time_s: float | None = None) -> None:
        """Write one annotated image.

        Args:
            name: path of the image, or ``VIDEO#N`` for frame N of a video.
            time_s: time of the frame in its video.

        Raises:
            InputError: the file exists or cannot be written.
        """
        source, mark, number = name.rpartition("#")
        if mark and Path(source).suffix.lower() in VIDEO_SUFFIXES and number.isdecimal():
            self._add_frame(source, image, time_s)
            return
        self._end_video(complete=True)
        self._require_room_for(name)
        path = Path(name.replace("#", "-").replace(":", "-"))
        target = self._folder / f"{path.name if mark or not path.suffix else path.stem}.jpg"
        if target in self._written:
            target = self._folder / f"{path.name}.jpg"
        if path.exists() and target.exists() and target.samefile(path):
            raise InputError(
                "would_overwrite_source",
                f"--annotate {self._folder}: {target.name} would replace the image itself",
                "give another folder",
            )
        write_file(target, encode_jpeg(image), self._force)
        self._written.append(target)

    def _require_room_for(self, source: str) -> None:
        """Refuse images and a second video if the output is a single video file."""
        if self._file is None or (Path(source).suffix.lower() in VIDEO_SUFFIXES and not self._written):
            return
        raise InputError(
            "not_a_folder",
            f"--annotate {self._file} is one video, and {source} would be another file",
            f"give a folder, such as --annotate {self._file.with_suffix('')}",
        )

    def _add_frame(self, source: str, image: ByteArray, time_s: float | None) -> None:
        if source != self._source:
            self._end_video(complete=True)
            self._start_video(source, image)
            self._first_s = time_s or 0.0
        elif self._shown is not None:
            due = self._count + 1 if time_s is None else round((time_s - self._first_s) * self._rate)
            self._show(max(1, due - self._count))
        self._shown = image

    def _show(self, times: int) -> None:
        assert self._video is not None
        assert self._shown is not None
        for _ in range(times):
            self._video.write(self._shown)
        self._count += times

    def _start_video(self, source: str, image: ByteArray) -> None:
        self._require_room_for(source)
        self._target = self._file or self._folder / f"{Path(source).stem}.mp4"
        if self._target in self._written:
            self._target = self._folder / f"{Path(source).name}.mp4"
        if self._target.exists() and Path(source).exists() and self._target.samefile(source):
            hint = "give another file or folder"
            raise InputError(
                "would_overwrite_source", f"--annotate {self._target} would replace the video itself", hint
            )
        check_writable(self._target, self._force)
        self._folder.mkdir(parents=True, exist_ok=True)
        handle, partial = tempfile.mkstemp(prefix=".", suffix=".mp4", dir=self._folder)
        os.close(handle)
        self._source, self._partial = source, Path(partial)
        self._rate, self._count = _highest_rate(source), 0
        height, width = image.shape[:2]
        code = cv2.VideoWriter.fourcc(*"mp4v")
        self._video = cv2.VideoWriter(partial, code, self._rate, (width, height))
        if not self._video.isOpened():
            self._end_video(complete=False)
            hint = "annotate single frames, or install the full OpenCV package"
            raise InputError("no_video_writer", f"cannot write {self._target}: this OpenCV writes no MP4", hint)

    def _end_video(self, complete: bool) -> None:
        if self._video is None:
            return
        if complete and self._shown is not None:
            self._show(1)
        self._video.release()
        self._video, self._shown, self._source = None, None, ""
        if not complete:
            self._partial.unlink(missing_ok=True)
            return
        umask = os.umask(0)
        os.umask(umask)
        self._partial.chmod(0o666 & ~umask)
        self._partial.replace(self._target)
        self._written.append(self._target)


def _highest_rate(source: str) -> float:
    """Frames per second of a video; if its frame times vary, the rate of the shortest interval."""
    capture = cv2.VideoCapture(source)
    stated = capture.get(cv2.CAP_PROP_FPS)
    stated = stated if stated > 0 else FPS
    times: list[float] = []
    while len(times) < RATE_FRAMES and capture.grab():
        times.append(capture.get(cv2.CAP_PROP_POS_MSEC) / 1000)
    capture.release()
    apart = [b - a for a, b in pairwise(times) if b - a >= 1 / FASTEST_FPS]
    if not apart or max(apart) * stated < VARIES:
        return stated
    return max(stated, 1 / min(apart))
