"""Options of laser scanners, shared by `lmkit locate` and `lmkit track`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lmkit.errors import InputError

if TYPE_CHECKING:
    from lmkit.localization.pole_association import PosePriorPlanar
    from lmkit.model.landmark_map import LandmarkMap
    from lmkit.model.scan import ScannerMount
    from lmkit.model.tracked_trajectory import TrackedTrajectory
    from lmkit.pipelines.locate_scans import ScanSettings

ScansFile = Annotated[
    Path | None,
    typer.Option("--scans", help="Laser scans, instead of images: CSV, ROS bag or MCAP. Needs a map of poles."),
]
ScanTopic = Annotated[
    str | None, typer.Option("--scan-topic", help="Topic of the scans in a bag, if it has several.")
]
Scanner = Annotated[
    str | None,
    typer.Option(
        "--scanner",
        help="Pose of the scanner on the robot: forward, left and degrees to the left, such as 0.16m,7mm,0.",
    ),
]
Near = Annotated[
    str | None,
    typer.Option(
        "--near",
        help="Rough pose of the robot: x,y,degrees, or with standard deviations, such as 1.2m,0.5m,90,0.5m,15.",
    ),
]
Bright = Annotated[float | None, typer.Option("--bright", help="Least intensity of the echo of a reflector.")]
ScanSigma = Annotated[
    str | None, typer.Option("--range-sigma", help="Standard deviation of the scanner's ranges. Default: 10mm.")
]
NEAR_M, NEAR_DEG = 0.5, 15.0


def scan_settings(
    scanner: str | None, near: str | None, bright: float | None, range_sigma: str | None
) -> ScanSettings:
    """The settings as given on the command line.

    Raises:
        InputError: an option's value is not valid.
    """
    from dataclasses import replace

    from lmkit.cli.parsing import parse_meters
    from lmkit.detection.scan_poles import ScanNoise
    from lmkit.pipelines.locate_scans import ScanSettings

    noise = ScanNoise(bright_from=bright)
    if range_sigma is not None:
        noise = replace(noise, range_m=parse_meters(range_sigma, "--range-sigma"))
        if not 0 < noise.range_m < 1:
            raise InputError(
                "bad_sigma", f"--range-sigma {range_sigma} is out of range", "give a length, such as 10mm"
            )
    settings = ScanSettings(noise=noise)
    if scanner is not None:
        settings = replace(settings, mount=_mount(scanner))
    return settings if near is None else replace(settings, rough=_rough(near))


def _mount(text: str) -> ScannerMount:
    from lmkit.model.scan import ScannerMount

    hint = "give forward, left and degrees to the left, such as 0.16m,7mm,0"
    (x_m, y_m, angle), _ = _planar_pose(text, "--scanner", (2, 3), hint)
    return ScannerMount(x_m, y_m, angle)


def _rough(text: str) -> PosePriorPlanar:
    import numpy as np

    from lmkit.cli.parsing import parse_meters
    from lmkit.localization.pole_association import PosePriorPlanar

    hint = "give x, y, degrees, and optionally standard deviations: 1.2m,-0.5m,90,0.5m,15"
    pose, deviations = _planar_pose(text, "--near", (3, 5), hint)
    sigma_m, sigma_rad = NEAR_M, math.radians(NEAR_DEG)
    if deviations:
        sigma_m, sigma_rad = parse_meters(deviations[0], "--near"), _angle(deviations[1], "--near", hint)
    if sigma_m <= 0 or sigma_rad <= 0:
        raise InputError("bad_near", f"--near {text!r}: standard deviations must be positive", hint)
    return PosePriorPlanar(np.array(pose), np.diag([sigma_m, sigma_m, sigma_rad]) ** 2)


def _planar_pose(
    text: str, name: str, counts: tuple[int, ...], hint: str
) -> tuple[tuple[float, float, float], list[str]]:
    """x, y (meters) and angle (radians, 0 if not given) of a list of values, and the values after them."""
    words = [word.strip() for word in text.split(",")]
    if len(words) not in counts:
        raise InputError(f"bad_{name[2:]}", f"{name} {text!r} has the wrong number of values: {len(words)}", hint)
    x_m, y_m = (_coordinate(word, name) for word in words[:2])
    return (x_m, y_m, _angle(words[2] if len(words) > 2 else "0", name, hint)), words[3:]


def _coordinate(word: str, name: str) -> float:
    """Meters of a length with a sign; zero needs no unit."""
    from lmkit.cli.parsing import parse_meters

    digits = word.lstrip("+-")
    if not digits.strip("0.mc ") and "0" in digits:
        return 0.0
    return math.copysign(parse_meters(digits, name), -1.0 if word.startswith("-") else 1.0)


def _angle(word: str, name: str, hint: str) -> float:
    try:
        degrees = float(word)
    except ValueError:
        degrees = math.nan
    if not abs(degrees) <= 360:
        raise InputError("bad_angle", f"{name}: {word!r} is not an angle in degrees", hint)
    return math.radians(degrees)


def track_scan_file(
    scans: Path,
    topic: str | None,
    settings: ScanSettings,
    landmarks: LandmarkMap,
    odometry: Path | None,
    gyro: Path | None,
    wheel_track: str | None,
    live: bool,
) -> TrackedTrajectory:
    """Trajectory by the scans of a file and wheel odometry.

    Raises:
        InputError: there is no wheel odometry, or a file cannot be read.
    """
    from lmkit.cli.parsing import parse_meters
    from lmkit.io.recording_tables import read_gyro, read_odometry
    from lmkit.io.scans import read_scans
    from lmkit.odometry.plausibility import require_plausible_gyro, require_plausible_odometry
    from lmkit.tracking.laser_scans import track_scans

    if odometry is None or odometry.suffix.lower() in (".tum", ".txt"):
        hint = "add --odometry FILE.csv; for single poses use lmkit locate --scans"
        raise InputError("no_odometry", "--scans needs wheel odometry", hint)
    track_m = None if wheel_track is None else parse_meters(wheel_track, "--wheel-track")
    rate = None if gyro is None else read_gyro(gyro)
    own = read_odometry(odometry, track_m)
    require_plausible_odometry(own)
    if rate is not None:
        require_plausible_gyro(rate, own)
    return track_scans(read_scans(scans, topic), own, rate, landmarks, settings, live)
