"""`lmkit locate --readings` and `--scans`: planar poses from ranges and bearings, and from poles in laser scans."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from lmkit.cli.output import print_json, print_line, warn
from lmkit.errors import InputError, NegativeAnswer

if TYPE_CHECKING:
    from lmkit.model.landmark_map import LandmarkMap
    from lmkit.pipelines.locate_scans import ScanSettings


def locate_readings(
    path: Path,
    landmarks: LandmarkMap,
    as_json: bool,
    range_sigma: str | None,
    bearing_sigma: float | None,
    time_offset: float,
) -> None:
    """Locate the sensor at every time of the file.

    Args:
        range_sigma, bearing_sigma: noise as given on the command line; None: the defaults.
        time_offset: seconds by which the readings' clock is ahead.

    Raises:
        NegativeAnswer: there is no pose at any time.
    """
    from lmkit.cli.parsing import parse_noise
    from lmkit.io.readings import read_readings
    from lmkit.localization.range_bearing import locate_planar, planar_dict, planar_line
    from lmkit.localization.readings_contradiction import find_readings_cause

    if not abs(time_offset) < 1e12:
        raise InputError("bad_offset", f"--time-offset {time_offset:g} is not a time", "give seconds, such as 0.2")
    noise = parse_noise(range_sigma, bearing_sigma)
    frames = read_readings(path, landmarks.families)
    located = 0
    for time_s, seen in frames.items():
        estimate = locate_planar(seen, landmarks, noise)
        located += estimate.pose is not None
        if as_json:
            print_json(planar_dict(estimate, path, time_s - time_offset))
        else:
            print_line(f"{time_s - time_offset:g} s: {planar_line(estimate)}")
    cause = find_readings_cause(list(frames.values()), landmarks, noise)
    if located == 0:
        landmarks.require_any(reading.id for seen in frames.values() for reading in seen)
        hint = "two landmarks of the map are needed at once" if cause is None else str(cause)
        raise NegativeAnswer("not_located", f"no pose at any of {len(frames)} times of {path}", hint)
    if cause is not None:
        warn(f"{path}: {cause}")


def locate_scans(
    path: Path, topic: str | None, landmarks: LandmarkMap, settings: ScanSettings, as_json: bool
) -> None:
    """Locate the robot in every scan of the file.

    Raises:
        NegativeAnswer: there is no pose in any scan.
    """
    from lmkit.io.scans import read_scans
    from lmkit.localization.range_bearing import planar_dict, planar_line
    from lmkit.pipelines.locate_scans import locate_in_scans

    scans = read_scans(path, topic)
    located = most = 0
    for scan, found in zip(scans, locate_in_scans(scans, landmarks, settings), strict=True):
        located += found.estimate.pose is not None
        most = max(most, found.scanned)
        if as_json:
            print_json(planar_dict(found.estimate, path, scan.time_s, "scans") | {"poles_scanned": found.scanned})
        else:
            print_line(f"{scan.time_s:g} s: {planar_line(found.estimate)} ({found.scanned} like poles)")
    if located == 0:
        hint = "give a rough pose with --near, or check the diameters (size_m) and --range-sigma"
        what = f"at most {most} objects of the poles' size in any of {len(scans)} scans of {path}"
        raise NegativeAnswer("not_located", f"no pose: {what}", hint)
