"""``sim:``, a simulated robot as source: at the rate of a camera, or as fast as the loop takes it."""

from __future__ import annotations

import time
from collections.abc import Iterator

from lmkit.arrays import ByteArray
from lmkit.errors import InputError
from lmkit.geometry.rig import mounted_cameras
from lmkit.live.captures import SourceLost
from lmkit.live.clock import LoopClock
from lmkit.live.frame_group import FrameGroup
from lmkit.live.motion import GYRO, WHEELS, MotionInbox, MotionRow
from lmkit.live.source_address import SourceAddress, parse_size
from lmkit.model.families import family_named
from lmkit.simulation.recording import WheelErrors
from lmkit.simulation.robot_course import RobotCourse

FIRST_S = 1.0  # before, the late wheels have nothing to say


class SimulatedRun:
    """A robot's course and how it is shown.

    Attributes:
        course: the robot's.
        fps: images a second.
        with_images: rendered; else corners alone.
        shift_s: from the course's time to the time of the groups.
    """

    def __init__(self, address: SourceAddress) -> None:
        seconds = address.number("seconds", 3600.0)
        self.fps = address.number("fps", 30.0) or 30.0
        self.with_images = address.options.get("images", "yes") != "no"
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
        self.course = RobotCourse(seed, seconds + FIRST_S, count, size, cameras, errors, family)
        self.shift_s = 0.0

    @property
    def cameras(self) -> int:
        """Number of cameras."""
        return len(mounted_cameras(self.course.rig))

    def rows(self, after_s: float, until_s: float) -> list[MotionRow]:
        """Motion rows later than a time of the course, up to another."""
        wheels, gyro = self.course.motion(after_s, until_s)
        rows = [MotionRow(WHEELS, t + self.shift_s, (f, w)) for t, f, w in wheels.tolist()]
        rows += [MotionRow(GYRO, t + self.shift_s, (rate,)) for t, rate in gyro.tolist()]
        return sorted(rows, key=lambda row: row.time_s)

    def groups(self) -> Iterator[FrameGroup]:
        """All frames, as fast as they are asked for."""
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
    """Images of a `SimulatedRun` at their times; frames that cannot be rendered in time are left out."""

    def __init__(self, run: SimulatedRun, inbox: MotionInbox, clock: LoopClock, first: list[float]) -> None:
        self._run, self._inbox, self._clock = run, inbox, clock
        # A source that is opened again goes on where the robot is by now.
        if not first:
            first.append(clock.now() - FIRST_S)
        run.shift_s = first[0]
        self._sent = max(0.0, clock.now() - first[0] - 1.0) if self._later() else 0.0

    def _later(self) -> bool:
        return self._clock.now() - self._run.shift_s > FIRST_S + 1.0

    def read(self) -> tuple[float, tuple[ByteArray, ...]]:
        """See `Capture`."""
        run = self._run
        period = 1 / run.fps
        ahead = self._clock.now() - run.shift_s
        time_s = (int(ahead / period) + 1) * period
        if time_s > run.course.seconds:
            raise SourceLost("the simulated course has ended")
        images = run.course.images(run.course.T_map_base(time_s))
        # Rendered too late: the image would be older than a camera's.
        late = self._clock.now() - run.shift_s - time_s
        if late > 0:
            time_s += (int(late / period) + 1) * period
            images = run.course.images(run.course.T_map_base(time_s))
        time.sleep(max(0.0, run.shift_s + time_s - self._clock.now()))
        for row in run.rows(self._sent, time_s):
            self._inbox.add(row)
        self._sent = time_s
        return run.shift_s + time_s, images

    def close(self) -> None:
        """See `Capture`."""
