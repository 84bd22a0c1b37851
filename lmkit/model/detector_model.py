"""Model of the detector: probability of reading a landmark, and its corner noise, by size and tilt.

Measured curves, for planning and for simulated corners.  Recognition: rendered rooms and drives, benchmarks/README.md
(about 6 of 10 at 15 to 20 px, 9 of 10 at 20 to 25, all but one in fifty above 30).  Corners: `benchmarks/corners.py`.
"""

from __future__ import annotations

import numpy as np

from lmkit.arrays import FloatArray

HALF_READ_PX, PER_PX = 16.5, 1 / 2.2  # side at which half are read, and how steeply that rises
BEST = 0.98
HALF_READ_TILT, PER_TILT = np.deg2rad(79.0), 1 / np.deg2rad(3.0)
CORNER_PX, CORNER_PX3 = 0.09, 45.0
SMALLEST_PX = 10.0  # below this nothing is read


def recognized(side_px: FloatArray, tilt_rad: FloatArray) -> FloatArray:
    """Probability that a landmark wholly in the image is read.

    Args:
        side_px: mean side in the image.
        tilt_rad: between its normal and the line to the camera.
    """
    by_side = 1 / (1 + np.exp(-(side_px - HALF_READ_PX) * PER_PX))
    by_tilt = 1 / (1 + np.exp((tilt_rad - HALF_READ_TILT) * PER_TILT))
    return np.asarray(np.where(side_px < SMALLEST_PX, 0.0, BEST * by_side * by_tilt))


def corner_sigma_px(side_px: FloatArray) -> FloatArray:
    """Standard deviation of a corner's coordinate: a part that any image has, and one that small ones add."""
    return np.asarray(np.hypot(CORNER_PX, CORNER_PX3 / np.maximum(side_px, 1.0) ** 2))
