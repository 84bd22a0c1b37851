"""Open image sources: cameras, streams and commands; each read returns a stamp and one or two images."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from lmkit.arrays import ByteArray
from lmkit.live.clock import LoopClock
from lmkit.live.source_address import SourceAddress

OPEN_MS, READ_MS = 5000, 3000
CHUNK = 1 << 16
MOST_BYTES = 32 << 20
START, END = b"\xff\xd8", b"\xff\xd9"  # of a JPEG file
NEAR_S = 5.0  # a driver's stamp this close to the current time is of the monotonic clock


class SourceLost(Exception):
    """A source gives no more images; the message has the reason."""


class SourceEnded(Exception):
    """A source has delivered its last image, as expected: it is not opened again."""


class Capture(Protocol):
    """Interface of an open source."""

    def read(self) -> tuple[float, tuple[ByteArray, ...]]:
        """Stamp in the loop's time, and the images, (H,W,3) BGR.

        Raises:
            SourceLost: there are no more, until it is opened again.
            SourceEnded: there will be no more.
        """

    def close(self) -> None:
        """Release the device or end the process."""


class VideoCapture:
    """A camera or a network stream, through OpenCV."""

    def __init__(self, address: SourceAddress, clock: LoopClock) -> None:
        self._clock, self._latency_s, self._name = clock, address.latency_s, address.text
        if address.kind == "camera":
            target = int(address.target) if address.target.isdecimal() else address.target
            self._video = cv2.VideoCapture(target)
            self._set_up(address)
        else:
            limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, OPEN_MS, cv2.CAP_PROP_READ_TIMEOUT_MSEC, READ_MS]
            self._video = cv2.VideoCapture(address.target, cv2.CAP_FFMPEG, limits)
        if not self._video.isOpened():
            raise SourceLost("no such camera, or it is in use" if address.kind == "camera" else "no connection")
        self._has_stamps = address.kind == "camera"

    def _set_up(self, address: SourceAddress) -> None:
        # Buffer one frame; otherwise slow processing reads increasingly stale frames.
        self._video.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        if "fourcc" in address.options:
            self._video.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*address.options["fourcc"][:4].ljust(4)))
        if address.size is not None:
            self._video.set(cv2.CAP_PROP_FRAME_WIDTH, address.size[0])
            self._video.set(cv2.CAP_PROP_FRAME_HEIGHT, address.size[1])
        if "fps" in address.options:
            self._video.set(cv2.CAP_PROP_FPS, address.number("fps", 30))
        if "exposure" in address.options:
            self._video.set(cv2.CAP_PROP_AUTO_EXPOSURE, 1)  # manual exposure in Video4Linux
            self._video.set(cv2.CAP_PROP_EXPOSURE, address.number("exposure", 100))

    def read(self) -> tuple[float, tuple[ByteArray, ...]]:
        """See `Capture`; the stamp is the driver's if available."""
        more, image = self._video.read()
        if not more or image is None:
            raise SourceLost("no more images")
        arrival = self._clock.now()
        if self._has_stamps:
            driver = self._clock.of_monotonic(self._video.get(cv2.CAP_PROP_POS_MSEC) / 1000)
            if 0 <= arrival - driver < NEAR_S:
                return driver, (np.asarray(image, dtype=np.uint8),)
        return arrival - self._latency_s, (np.asarray(image, dtype=np.uint8),)

    def close(self) -> None:
        """Release the device."""
        self._video.release()


class PipeCapture:
    """JPEG images one after the other (MJPEG) on the standard output of a command."""

    def __init__(self, address: SourceAddress, clock: LoopClock) -> None:
        self._clock, self._latency_s = clock, address.latency_s
        try:
            words = shlex.split(address.target)
            # A separate process group, so that child processes end with the command.
            self._process = subprocess.Popen(
                words,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                stdin=subprocess.DEVNULL,
                start_new_session=True,
            )
        except (OSError, ValueError) as error:
            raise SourceLost(f"the command does not start: {error}") from None
        self._bytes = bytearray()

    def read(self) -> tuple[float, tuple[ByteArray, ...]]:
        """See `Capture`."""
        assert self._process.stdout is not None
        while True:
            data = take_jpeg(self._bytes)
            if data is not None:
                arrival = self._clock.now()
                image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
                if image is not None:
                    return arrival - self._latency_s, (np.asarray(image, dtype=np.uint8),)
                continue
            chunk = os.read(self._process.stdout.fileno(), CHUNK)
            if not chunk:
                raise SourceLost(f"the command ended with code {self._process.wait()}")
            self._bytes += chunk
            if len(self._bytes) > MOST_BYTES:
                raise SourceLost("the command writes no MJPEG")

    def close(self) -> None:
        """End the command and its child processes."""
        try:
            if hasattr(os, "killpg"):
                os.killpg(self._process.pid, signal.SIGTERM)
            else:
                self._process.terminate()
            self._process.wait(2)
        except (ProcessLookupError, PermissionError):
            pass
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()


def take_jpeg(stream: bytearray) -> bytes | None:
    """Remove the first complete JPEG file from a stream, and return it; None if there is none yet."""
    start = stream.find(START)
    if start < 0:
        del stream[:-1]
        return None
    end = stream.find(END, start + 2)
    if end < 0:
        del stream[:start]
        return None
    data = bytes(stream[start : end + 2])
    del stream[: end + 2]
    return data


class SplitCapture:
    """The left and the right half of each image of another source."""

    def __init__(self, inner: Capture) -> None:
        self._inner = inner
        self.close: Callable[[], None] = inner.close

    def read(self) -> tuple[float, tuple[ByteArray, ...]]:
        """See `Capture`."""
        stamp, (image, *_) = self._inner.read()
        half = image.shape[1] // 2
        return stamp, (np.ascontiguousarray(image[:, :half]), np.ascontiguousarray(image[:, half : 2 * half]))


def list_cameras(most: int = 10) -> list[tuple[str, str]]:
    """Addresses of the cameras of this machine, with the known properties of each."""
    found: list[tuple[str, str]] = []
    devices = sorted(Path("/dev/v4l/by-id").glob("*")) if Path("/dev/v4l/by-id").is_dir() else []
    named = {path.resolve(): path for path in devices}
    numbers = (
        [int(p.name.removeprefix("video")) for p in Path("/dev").glob("video*") if p.name[5:].isdecimal()]
        if Path("/dev").is_dir()
        else list(range(most))
    )
    for number in sorted(numbers)[:most]:
        video = cv2.VideoCapture(number)
        try:
            more, image = video.read() if video.isOpened() else (False, None)
            if not more or image is None:
                found.append((f"camera:{number}", "gives no image: in use, or not a camera"))
                continue
            size = f"{image.shape[1]}x{image.shape[0]}, {video.get(cv2.CAP_PROP_FPS):.0f} images a second"
            by_id = named.get(Path(f"/dev/video{number}").resolve())
            found.append((f"camera:{number}", size + (f", camera:{by_id}" if by_id else "")))
        finally:
            video.release()
    return found
