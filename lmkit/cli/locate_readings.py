"""`lmkit locate --readings`: a planar pose of the sensor for every moment of a readings file."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lmkit.cli.common import print_json, print_line
from lmkit.errors import InputError, NegativeAnswer

if TYPE_CHECKING:
    from lmkit.locate.range_bearing import PlanarEstimate, ReadingNoise
    from lmkit.model.landmark_map import LandmarkMap


def locate_readings(
    path: Path,
    landmarks: LandmarkMap,
    as_json: bool,
    range_sigma: str | None,
    bearing_sigma: float | None,
    time_offset: float,
) -> None:
    """Locate every moment.

    Args:
        range_sigma, bearing_sigma: scatter as the user has it; None: as of a usual camera.
        time_offset: by how many seconds the readings' clock is ahead.

    Raises:
        NegativeAnswer: not one moment gave a pose.
    """
    from lmkit.formats.readings import read_readings
    from lmkit.locate.range_bearing import locate_planar

    if not math.isfinite(time_offset):
        raise InputError("bad_offset", f"--time-offset {time_offset:g} is no time", "give seconds, such as 0.2")
    moments = read_readings(path)
    noise = _noise(range_sigma, bearing_sigma)
    located = 0
    for time_s, seen in moments.items():
        estimate = locate_planar(seen, landmarks, noise)
        located += estimate.pose is not None
        if as_json:
            print_json(planar_dict(estimate, path, time_s - time_offset))
        else:
            print_line(f"{time_s - time_offset:g} s: {_sentence(estimate)}")
    if located == 0:
        raise NegativeAnswer(
            "not_located", f"no pose from {len(moments)} moments of {path}", "two landmarks of the map are needed"
        )


def _noise(range_sigma: str | None, bearing_sigma: float | None) -> ReadingNoise:
    """As given, else as of a usual camera."""
    from dataclasses import replace

    from lmkit.locate.range_bearing import ReadingNoise
    from lmkit.units import parse_length_mm

    if bearing_sigma is not None and not 0 < bearing_sigma < 90:
        raise InputError("bad_sigma", f"--bearing-sigma {bearing_sigma:g} is no angle", "give degrees, such as 1.0")
    noise = ReadingNoise()
    if range_sigma is not None and range_sigma.endswith("%"):
        noise = replace(noise, range_m=0.0, range_share=_percent(range_sigma))
    elif range_sigma is not None:
        noise = replace(noise, range_m=parse_length_mm(range_sigma, "--range-sigma") / 1000, range_share=0.0)
    return noise if bearing_sigma is None else replace(noise, bearing_rad=math.radians(bearing_sigma))


def _percent(text: str) -> float:
    try:
        share = float(text[:-1]) / 100
    except ValueError:
        share = 0.0
    if not 0 < share < 1:
        raise InputError(
            "bad_sigma", f"--range-sigma {text} is no share", "give a length or a share, such as 0.1m or 3%"
        )
    return share


def _sentence(estimate: PlanarEstimate) -> str:
    if estimate.pose is None:
        return estimate.status
    pose, codes = estimate.pose, ", ".join(map(str, estimate.inlier_codes))
    off = ", ".join(map(str, estimate.outlier_codes))
    heading = "unknown" if pose.heading_rad is None else f"{math.degrees(pose.heading_rad):.2f} deg"
    return f"{estimate.status}, x {pose.x_m:.3f} y {pose.y_m:.3f} m, heading {heading}, codes {codes}" + (
        f", not explained: {off}" if off else ""
    )


def planar_dict(estimate: PlanarEstimate, path: Path, time_s: float) -> dict[str, Any]:
    """One planar answer as docs/formats.md has it."""
    pose, covariance = estimate.pose, estimate.covariance
    result: dict[str, Any] = {
        "readings": str(path),
        "time_s": time_s,
        "status": estimate.status,
        "position": None,
        "heading_rad": None,
        "covariance": None if covariance is None else covariance.tolist(),
        "codes": list(estimate.inlier_codes),
        "outlier_codes": list(estimate.outlier_codes),
        "alternatives": [
            {"position": [other.x_m, other.y_m], "heading_rad": other.heading_rad, "log_likelihood_ratio": ratio}
            for other, ratio in estimate.alternatives
        ],
    }
    if pose is not None:
        result["position"] = [pose.x_m, pose.y_m]
        result["heading_rad"] = pose.heading_rad
    return result
