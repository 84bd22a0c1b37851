"""Statements of the user before a calibration: baseline, field of view, known lenses and their uncertainty."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lmkit.cli.parsing import parse_meters
from lmkit.errors import InputError

if TYPE_CHECKING:
    from lmkit.arrays import FloatArray
    from lmkit.calibration.sanity_checks import Declared
    from lmkit.geometry.rig import MountedCamera

STATED = "stated"
MOST_PX = 1000.0


def parse_declared(
    baseline: str | None, fov: float | None, intrinsics: list[Path] | None = None, sigma: str | None = None
) -> Declared:
    """Nominal baseline and field of view, to check a calibration against, and known cameras of one or two files."""
    from lmkit.calibration.sanity_checks import Declared
    from lmkit.io.known_cameras import read_two_cameras

    if fov is not None and not 0 < fov < 360:
        raise InputError(
            "bad_fov", f"--fov {fov:g} is out of range", "give the horizontal angle in degrees, such as 69"
        )
    if sigma is not None and not intrinsics:
        raise InputError("only_intrinsics", "--intrinsics-sigma needs --intrinsics", "give the file of the lenses")
    baseline_m = None if baseline is None else parse_meters(baseline, "--baseline")
    if not intrinsics:
        return Declared(baseline_m, fov)
    left, right = read_two_cameras(intrinsics)
    if sigma is None:
        return Declared(baseline_m, fov, (left.model, right.model))
    # Cameras of one file were fitted together, but the file does not contain their correlations.
    together = 2 if len(intrinsics) == 1 else 1
    covariances = _covariance(left, sigma, together), _covariance(right, sigma, together)
    return Declared(baseline_m, fov, (left.model, right.model), covariances)


def _covariance(camera: MountedCamera, text: str, together: int) -> FloatArray:
    from lmkit.calibration.intrinsics import LEAST_PX, sigma_of_pixels, stated_covariance

    if text == STATED:
        if camera.intrinsics_sigma is None:
            raise InputError(
                "no_stated_sigma",
                f"--intrinsics-sigma stated: the file of the {camera.name} camera states none",
                "give pixels, such as --intrinsics-sigma 2px",
            )
        return stated_covariance(camera.intrinsics_sigma, camera.intrinsics_correlation, together)
    match = re.fullmatch(r"([0-9]+(?:\.[0-9]*)?|\.[0-9]+) ?px", text)
    if match is None or not LEAST_PX <= float(match[1]) <= MOST_PX:
        raise InputError(
            "bad_sigma", f"--intrinsics-sigma {text} is not a deviation", "write 'stated', or such as 2px"
        )
    return np.diag(sigma_of_pixels(camera.model, float(match[1])) ** 2)
