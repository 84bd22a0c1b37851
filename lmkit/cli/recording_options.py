"""What `lmkit survey` and `lmkit track` read alike: odometry, gyro, pictures or recorded detections."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from lmkit.cli.output import progress, require_no
from lmkit.errors import InputError

if TYPE_CHECKING:
    from lmkit.geometry.stereo_rig import StereoRig
    from lmkit.model.recording import Gyro, Odometry, StereoFrame
    from lmkit.model.trajectory import Trajectory
    from lmkit.odometry.motion_model import Motion

POSES = (".tum", ".txt")  # suffixes of odometry in space


def read_any_odometry(
    odometry: Path | None, gyro: Path | None, wheel_track: str | None
) -> Trajectory | tuple[Odometry, Gyro | None] | None:
    """Poses of a TUM file, or wheels and gyro; None without odometry.

    Raises:
        InputError: not readable, or a gyro without wheels.
    """
    from lmkit.io.trajectory import read_trajectory

    if odometry is not None and odometry.suffix.lower() in POSES:
        require_no(f"--odometry {odometry}", {"--gyro": gyro, "--wheel-track": wheel_track})
        return read_trajectory(odometry)
    return read_wheels(odometry, gyro, wheel_track)


def motion_of(odometry: Trajectory | tuple[Odometry, Gyro | None] | None) -> Motion | None:
    """What it carries a rig by."""
    from lmkit.model.trajectory import Trajectory
    from lmkit.odometry.pose_odometry import PoseMotion
    from lmkit.odometry.wheel_odometry import MotionModel

    if odometry is None:
        return None
    return PoseMotion(odometry) if isinstance(odometry, Trajectory) else MotionModel(*odometry)


def read_wheels(
    odometry: Path | None, gyro: Path | None, wheel_track: str | None
) -> tuple[Odometry, Gyro | None] | None:
    """Odometry and gyro as given; None without odometry.

    Raises:
        InputError: not readable, or a gyro without odometry.
    """
    from lmkit.io.recording_tables import read_gyro, read_odometry
    from lmkit.units import parse_length_mm

    if odometry is None:
        for name, value in (("--gyro", gyro), ("--wheel-track", wheel_track)):
            if value is not None:
                raise InputError("no_odometry", f"{name} needs odometry beside it", "give --odometry FILE.csv")
        return None
    if odometry.suffix.lower() in POSES:
        raise InputError(
            "poses_in_space", f"{odometry} holds poses in space, wheels are needed here", "give --odometry FILE.csv"
        )
    track_m = None if wheel_track is None else parse_length_mm(wheel_track, "--wheel-track") / 1000
    return read_odometry(odometry, track_m), None if gyro is None else read_gyro(gyro)


def read_moments(
    left: str | None, right: str | None, detections: Path | None, rig: StereoRig, family: str, hz: float | None
) -> list[StereoFrame]:
    """What both eyes saw, from pictures or a detections file.

    Raises:
        InputError: neither or both are given, or they cannot be read.
    """
    from lmkit.io.recording_tables import read_detections
    from lmkit.model.landmark import families_named
    from lmkit.pipelines.detect_recording import see_drive

    if detections is not None:
        require_no("--detections", {"LEFT": left, "--hz": hz})
        return read_detections(detections, family.split(","))
    if left is None or right is None:
        raise InputError("no_pictures", "LEFT and RIGHT, or --detections, are needed", "give two folders of pictures")
    if hz is not None and not 0 < hz < 1e4:
        raise InputError("bad_rate", f"--hz {hz:g} is no rate", "give pairs a second, such as 5")
    return list(progress(see_drive(left, right, rig, families_named(family), hz), None, "detecting"))
