"""Recordings from files: detections of both cameras with their times, odometry and gyro."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

from lmkit.detection.config import DetectOptions
from lmkit.detection.detector import detect_landmarks
from lmkit.errors import InputError
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.io.image_sources import list_pairs, time_of
from lmkit.io.images import read_image
from lmkit.io.readings import read_readings
from lmkit.io.recording_tables import read_detections, read_gyro, read_odometry
from lmkit.io.trajectory import read_trajectory
from lmkit.model.landmark import LM8, LandmarkFamily, family_named
from lmkit.model.recording import Odometry, Recording, StereoFrame
from lmkit.model.trajectory import Trajectory
from lmkit.parallel import map_in_processes


def see_drive(
    left: str, right: str, rig: StereoRig, families: Sequence[LandmarkFamily], hz: float | None
) -> Iterator[StereoFrame]:
    """Every pair of two folders or globs, in the order of their names.

    Args:
        hz: pairs a second; None: the names end in seconds.

    Raises:
        InputError: the sources make no pairs, an image cannot be read, or times are missing or do not increase.
    """
    pairs = list_pairs(left, right)
    times: list[float] = []
    for k, (a, _) in enumerate(pairs):
        time = k / hz if hz else time_of(a.name)
        if time is None:
            raise InputError(
                "no_times", f"{a} has no time in its name", "give the number of pairs per second, such as --hz 5"
            )
        if times and time <= times[-1]:
            raise InputError("time_not_increasing", f"{a}: time does not increase", "name images in their order")
        times.append(time)
    work = partial(_see, rig=rig, families=tuple(families))
    yield from map_in_processes(work, [(time, str(a), str(b)) for time, (a, b) in zip(times, pairs, strict=True)])


def _see(job: tuple[float, str, str], rig: StereoRig, families: tuple[LandmarkFamily, ...]) -> StereoFrame:
    time_s, *names = job
    seen = []
    for name, camera in zip(names, (rig.left, rig.right), strict=True):
        picture = read_image(Path(name))
        camera.require_size(name, (picture.shape[1], picture.shape[0]))
        seen.append(tuple(detect_landmarks(picture, DetectOptions(families, camera=camera))))
    return StereoFrame(time_s, seen[0], seen[1], Path(names[0]).stem)


POSES = (".tum", ".txt")  # suffixes of odometry in space


def read_recording(
    left: str | None = None,
    right: str | None = None,
    rig: StereoRig | None = None,
    detections: Path | None = None,
    readings: Path | None = None,
    odometry: Path | None = None,
    gyro: Path | None = None,
    wheel_track_m: float | None = None,
    families: Sequence[str] = (LM8.name,),
    hz: float | None = None,
    on_frame: Callable[[int, int], None] = lambda done, total: None,
) -> Recording:
    """A recording from its files: images, or saved detections, or readings; odometry and gyro.

    Args:
        families: names; of images those that lmkit detects, of saved detections and readings any.
        on_frame: called with the number of image pairs done, and of how many.

    Raises:
        InputError: not exactly one of images, detections and readings is given; images without a rig; a gyro without
            wheel odometry; wheel odometry and a rig without T_base_left; a file cannot be read.
    """
    given = [name for name, value in (("images", left), ("detections", detections), ("readings", readings)) if value]
    if len(given) != 1:
        what = " and ".join(given) or "none of images, detections and readings"
        raise InputError("bad_recording", f"{what} given", "give one: left and right, or detections, or readings")
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
        return Recording(readings=seen, odometry=own, gyro=rate)
    if detections is not None:
        return Recording(tuple(read_detections(detections, names)), odometry=own, gyro=rate)
    if left is None or right is None or rig is None:
        raise InputError("no_images", "images of both cameras and the rig are needed", "give left, right and rig")
    total = len(list_pairs(left, right))
    frames = []
    for frame in see_drive(left, right, rig, [family_named(name) for name in names], hz):
        frames.append(frame)
        on_frame(len(frames), total)
    return Recording(tuple(frames), odometry=own, gyro=rate)
