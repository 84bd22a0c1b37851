"""`lmkit locate --readings`: a planar pose of the sensor for every moment of a readings file."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from lmkit.cli.output import print_json, print_line
from lmkit.errors import InputError, NegativeAnswer

if TYPE_CHECKING:
    from lmkit.localization.range_bearing import PlanarEstimate
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
    from lmkit.cli.parsing import parse_noise
    from lmkit.io.readings import read_readings
    from lmkit.localization.range_bearing import locate_planar, planar_dict

    if not math.isfinite(time_offset):
        raise InputError("bad_offset", f"--time-offset {time_offset:g} is no time", "give seconds, such as 0.2")
    moments = read_readings(path, landmarks.families)
    noise = parse_noise(range_sigma, bearing_sigma)
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


def _sentence(estimate: PlanarEstimate) -> str:
    from lmkit.model.landmark_id import ids_text

    if estimate.pose is None:
        return estimate.status
    pose, codes = estimate.pose, ids_text(estimate.inliers)
    off = ids_text(estimate.outliers)
    heading = "unknown" if pose.heading_rad is None else f"{math.degrees(pose.heading_rad):.2f} deg"
    return f"{estimate.status}, x {pose.x_m:.3f} y {pose.y_m:.3f} m, heading {heading}, codes {codes}" + (
        f", not explained: {off}" if off else ""
    )
