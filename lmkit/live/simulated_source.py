"""``sim:``, a simulated robot as source: at the rate of a camera, or as fast as the loop.

With ``images=before`` all images are rendered to JPEG before the first step; each is decoded at its time, like a
camera's MJPEG, so that rendering does not slow the loop.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import cv2
import numpy as np

from lmkit.arrays import ByteArray
from lmkit.errors import InputError
from lmkit.geometry.rig import mounted_cameras
from lmkit.live.captures import SourceEnded
from lmkit.live.clock import LoopClock
from lmkit.live.frame_group import FrameGroup
from lmkit.live.motion import GYRO, WHEELS, MotionInbox, MotionRow
from lmkit.live.source_address import SourceAddress, parse_size
from lmkit.model.families import family_named
from lmkit.simulation.lens_errors import with_lens_errors
from lmkit.simulation.recording import WheelErrors
from lmkit.simulation.robot_course import RobotCourse

FIRST_S = 1.0  # before this time, the delayed wheels have no data
MOST_BEFORE = 6000  # frames rendered in advance; 0.6 GB for two cameras with 640x480
JPEG = [cv2.IMWRITE_JPEG_QUALITY, 95, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]


class SimulatedRun:
    """A robot's course, and the settings of its images.

    Attributes:
        course: the robot's.
        rig: rig of the loop; its lenses differ from the course's by the errors of ``lens``.
        fps: images per second.
        with_images: whether images are rendered; else only corners.
        before: whether all images are rendered in advance, by `render`.
        shift_s: from the course's time to the time of the groups.
    """

    def __init__(self, address: SourceAddress) -> None:
        seconds = address.number("seconds", 3600.0)
        self.fps = address.number("fps", 30.0) or 30.0
        images = address.options.get("images", "yes")
        self.with_images, self.before = images != "no", images == "before"
        size = parse_size(address.options.get("size", "640x480"), address.text)
        cameras = int(address.number("cameras", 2))
        count = int(address.number("landmarks", 6))
        if cameras not in (1, 2) or not 1 <= count <= 64 or not 1 <= seconds <= 24 * 3600:
            raise InputError(
                "bad_source",
                f"{address.text}: out of range",
                "cameras 1 or 2, landmarks 1 to 64, seconds 1 to 86400",
            )
        errors = WheelErrors(slips=int(address.number("slips", 0)))
        seed = int(address.number("seed", 1))
        family = family_named(address.options.get("family", "lm8"))
        if images not in ("yes", "no", "before"):
            raise InputError("bad_source", f"{address.text}: images={images}", "write images=yes, no or before")
        if self.before and seconds * self.fps > MOST_BEFORE:
            raise InputError(
                "bad_source",
                f"{address.text}: {seconds * self.fps:.0f} images of a camera are too many to render before",
                f"give seconds={MOST_BEFORE / self.fps:.0f} or less",
            )
        self.course = RobotCourse(seed, seconds + FIRST_S, count, size, cameras, errors, family)
        self.rig = with_lens_errors(self.course.rig, address.number("lens", 0.0), seed)
        self.shift_s = 0.0
        self._frames: list[tuple[ByteArray, ...]] = []  # as JPEG

    @property
    def cameras(self) -> int:
        """Number of cameras."""
        return len(mounted_cameras(self.course.rig))

    def render(self) -> None:
        """Render all images of the course, for `images`."""
        for k in range(int(self.course.seconds * self.fps) + 1):
            images = self.course.images(self.course.T_map_base(k / self.fps))
            self._frames.append(tuple(np.asarray(cv2.imencode(".jpg", i, JPEG)[1], np.uint8) for i in images))

    def images(self, number: int) -> tuple[ByteArray, ...]:
        """(H,W,3) BGR of every camera, of a frame counted from the course's start."""
        if not self._frames:
            return self.course.images(self.course.T_map_base(number / self.fps))
        return tuple(np.asarray(cv2.imdecode(i, cv2.IMREAD_COLOR), np.uint8) for i in self._frames[number])

    def rows(self, after_s: float, until_s: float) -> list[MotionRow]:
        """Motion rows later than a time of the course, up to another."""
        wheels, gyro = self.course.motion(after_s, until_s)
        rows = [MotionRow(WHEELS, t + self.shift_s, (f, w)) for t, f, w in wheels.tolist()]
        rows += [MotionRow(GYRO, t + self.shift_s, (rate,)) for t, rate in gyro.tolist()]
        return sorted(rows, key=lambda row: row.time_s)

    def groups(self) -> Iterator[FrameGroup]:
        """All frames, as fast as they are requested."""
        last, count = 0.0, self.cameras
        for k in range(int((self.course.seconds - FIRST_S) * self.fps)):
            time_s = FIRST_S + k / self.fps
            T = self.course.T_map_base(time_s)
            rows = tuple(self.rows(last, time_s))
            last = time_s
            at = time_s + self.shift_s
            if self.with_images:
                yield FrameGroup(at, self.course.images(T), (at,) * count, rows, truth=T)
            else:
                yield FrameGroup(at, (None,) * count, (at,) * count, rows, seen=self.course.corners(T), truth=T)


class SimulatedCapture:
    """Images of a `SimulatedRun` at their times; frames that cannot be rendered in time are skipped."""

    def __init__(self, run: SimulatedRun, inbox: MotionInbox, clock: LoopClock, first: list[float]) -> None:
        self._run, self._inbox, self._clock = run, inbox, clock
        # A source that is opened again continues at the robot's current place.
        if not first:
            first.append(clock.now() - FIRST_S)
        run.shift_s = first[0]
        self._sent = max(0.0, clock.now() - first[0] - 1.0) if self._later() else 0.0

    def _later(self) -> bool:
        return self._clock.now() - self._run.shift_s > FIRST_S + 1.0

    def read(self) -> tuple[float, tuple[ByteArray, ...]]:
        """See `Capture`."""
        run = self._run
        number = self._next()
        if run.before:
            self._wait_for(number)
        images = run.images(number)
        if not run.before and self._next() > number:  # rendered too late: older than a camera's image
            number = self._next()
            images = run.images(number)
        self._wait_for(number)
        time_s = number / run.fps
        for row in run.rows(self._sent, time_s):
            self._inbox.add(row)
        self._sent = time_s
        return run.shift_s + time_s, images

    def _next(self) -> int:
        """Number of the first future frame."""
        number = int((self._clock.now() - self._run.shift_s) * self._run.fps) + 1
        if number > self._run.course.seconds * self._run.fps:
            raise SourceEnded
        return number

    def _wait_for(self, number: int) -> None:
        time.sleep(max(0.0, self._run.shift_s + number / self._run.fps - self._clock.now()))

    def close(self) -> None:
        """See `Capture`."""
