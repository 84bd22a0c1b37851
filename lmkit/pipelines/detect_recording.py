"""Recordings from files: detections of all cameras with their times, odometry and gyro."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from lmkit.detection.config import DetectOptions
from lmkit.detection.detector import detect_landmarks
from lmkit.errors import InputError
from lmkit.geometry.rig import AnyRig, mounted_cameras
from lmkit.io.image_groups import are_files, frame_groups, list_groups, require_image_of_each
from lmkit.io.image_names import time_of
from lmkit.io.image_sources import Frame, frame_count
from lmkit.io.images import read_image
from lmkit.io.readings import read_readings
from lmkit.io.recording_tables import PAIR, read_detections, read_gyro, read_odometry
from lmkit.io.trajectory import read_trajectory
from lmkit.model.families import MarkerFamily, family_named
from lmkit.model.recording import Odometry, Recording, RigFrame
from lmkit.model.trajectory import Trajectory
from lmkit.parallel import map_in_processes

TOGETHER_S = 1e-3  # stamps with smaller differences are the same time, rounded


def see_drive(
    sources: Sequence[str], rig: AnyRig, families: Sequence[MarkerFamily], hz: float | None
) -> Iterator[RigFrame]:
    """Every frame of folders, globs or videos, one source per camera, in the order of their names.

    Args:
        hz: frames per second; None: the names end in seconds, or the videos have times.

    Raises:
        InputError: the sources do not go together, an image cannot be read, or times are missing or do not increase.
    """
    require_image_of_each([camera.name for camera in mounted_cameras(rig)], sources)
    if not are_files(sources):
        last: float | None = None
        for k, frames in enumerate(frame_groups(sources)):
            last = _next_time(k, frames[0].name, frames[0].time_s, hz, last)
            stamps = _stamps([frame.time_s for frame in frames], hz)
            yield replace(_detected(last, frames, rig, tuple(families)), stamps_s=stamps)
        return
    times: list[float] = []
    groups = list_groups(sources)
    for k, files in enumerate(groups):
        times.append(_next_time(k, str(files[0]), time_of(files[0].name), hz, times[-1] if times else None))
    work = partial(_see, rig=rig, families=tuple(families))
    jobs = [(time, tuple(map(str, files))) for time, files in zip(times, groups, strict=True)]
    for frame, files in zip(map_in_processes(work, jobs), groups, strict=True):
        yield replace(frame, stamps_s=_stamps([time_of(file.name) for file in files], hz))


def _stamps(times_s: Sequence[float | None], hz: float | None) -> tuple[float, ...]:
    """Times of the images of all cameras if every image has one and they differ; else none."""
    known = [time_s for time_s in times_s if time_s is not None]
    if hz or len(known) < len(times_s) or max(known) - min(known) < TOGETHER_S:
        return ()
    return tuple(known)


def _next_time(k: int, name: str, time_s: float | None, hz: float | None, last: float | None) -> float:
    time = k / hz if hz else time_s
    if time is None:
        raise InputError(
            "no_times",
            f"{name} has no time in its name",
            "give the number of frames per second, such as hz=5 (--hz 5)",
        )
    if last is not None and time <= last:
        raise InputError("time_not_increasing", f"{name}: time does not increase", "name images in their order")
    return time


def _see(job: tuple[float, tuple[str, ...]], rig: AnyRig, families: tuple[MarkerFamily, ...]) -> RigFrame:
    time_s, names = job
    return _detected(time_s, [Frame(name, read_image(Path(name))) for name in names], rig, families)


def _detected(time_s: float, frames: Sequence[Frame], rig: AnyRig, families: tuple[MarkerFamily, ...]) -> RigFrame:
    seen = []
    for frame, camera in zip(frames, mounted_cameras(rig), strict=True):
        image = frame.pixels
        camera.model.require_size(frame.name, (image.shape[1], image.shape[0]))
        seen.append(tuple(detect_landmarks(image, DetectOptions(families, camera=camera.model))))
    return RigFrame(time_s, tuple(seen), Path(frames[0].name).stem)


POSES = (".tum", ".txt")  # suffixes of odometry in space


@dataclass(frozen=True, eq=False)
class OpenRecording:
    """A recording whose frames are detected one by one during iteration.

    Attributes:
        frames: in the order of time; can be iterated once.
        total: number of frames; 0 if unknown.
        rest: readings, odometry and gyro.
    """

    frames: Iterator[RigFrame]
    total: int
    rest: Recording

    def read(self, on_frame: Callable[[int, int], None] = lambda done, total: None) -> Recording:
        """The whole recording.

        Args:
            on_frame: called with the number of finished frames and of all frames.

        Raises:
            InputError: a file cannot be read.
        """
        frames = []
        for frame in self.frames:
            frames.append(frame)
            on_frame(len(frames), self.total)
        return replace(self.rest, frames=tuple(frames))


def open_recording(
    sources: Sequence[str] = (),
    rig: AnyRig | None = None,
    detections: Path | None = None,
    readings: Path | None = None,
    odometry: Path | None = None,
    gyro: Path | None = None,
    wheel_track_m: float | None = None,
    families: Sequence[str] = (),
    hz: float | None = None,
) -> OpenRecording:
    """A recording from its files: images, or saved detections, or readings; odometry and gyro.

    Args:
        families: names; for images only families that lmkit detects, for saved detections and readings any.

    Raises:
        InputError: not exactly one of images, detections and readings is given; images without a rig; a gyro without
            wheel odometry; wheel odometry and a rig without T_base_left; a file cannot be read.
    """
    given = [
        name for name, value in (("images", sources), ("detections", detections), ("readings", readings)) if value
    ]
    if len(given) != 1:
        what = " and ".join(given) or "none of images, detections and readings"
        raise InputError("bad_recording", f"{what} given", "give one: images, or detections, or readings")
    own: Odometry | Trajectory | None = None
    if odometry is not None:
        poses = odometry.suffix.lower() in POSES
        own = read_trajectory(odometry) if poses else read_odometry(odometry, wheel_track_m)
    if gyro is not None and not isinstance(own, Odometry):
        raise InputError("no_odometry", "a gyro needs wheel odometry", "give odometry as CSV")
    rate = None if gyro is None else read_gyro(gyro)
    if isinstance(own, Odometry) and rig is not None and rig.T_base_left is None:
        raise InputError(
            "no_base", "wheel odometry needs the camera's pose on the robot, and the rig has no T_base_left",
            "add T_base_left to the rig file",
        )  # fmt: skip
    names = [name.strip() for name in families]
    if readings is not None:
        seen = tuple((time_s, tuple(some)) for time_s, some in sorted(read_readings(readings, names).items()))
        return OpenRecording(iter(()), 0, Recording(readings=seen, odometry=own, gyro=rate))
    rest = Recording(odometry=own, gyro=rate)
    if detections is not None:
        cameras = PAIR if rig is None else [camera.name for camera in mounted_cameras(rig)]
        frames = read_detections(detections, names, cameras)
        return OpenRecording(iter(frames), len(frames), rest)
    if rig is None:
        raise InputError("no_rig", "images need a rig", "give rig")
    detected = see_drive(sources, rig, [family_named(name) for name in names], hz)
    return OpenRecording(detected, frame_count(sources[:1]) or 0, rest)
