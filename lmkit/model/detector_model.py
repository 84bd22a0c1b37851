"""Model of the detector: probability of reading a landmark, and its corner noise, by size and tilt.

Measured curves, for planning and for simulated corners.  Recognition of ring landmarks: rendered rooms and drives,
benchmarks/README.md (about 6 of 10 at 15 to 20 px, 9 of 10 at 20 to 25, all but one in fifty above 30).  Square
markers are read by the size of their cells: simulated images, `benchmarks/tags.py --law`.
Corners: `benchmarks/corners.py`.
"""

from __future__ import annotations

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.model.families import ALL_FAMILIES
from lmkit.model.square_marker import SquareMarkerFamily

HALF_READ_PX, PER_PX = 16.5, 1 / 2.2  # side at which half are read, and how steeply that rises
HALF_READ_CELL_PX = 1.75  # the same of a square marker's cells
BEST = 0.98
HALF_READ_TILT, PER_TILT = np.deg2rad(79.0), 1 / np.deg2rad(3.0)
CORNER_PX, CORNER_PX3 = 0.09, 45.0
SMALLEST_PX = 10.0  # below this nothing is read


def half_read_px(family: str) -> float:
    """Side at which half of a family's landmarks are read, px; that of ring landmarks for an unknown family."""
    known = ALL_FAMILIES.get(family)
    return HALF_READ_CELL_PX * known.cells if isinstance(known, SquareMarkerFamily) else HALF_READ_PX


def recognized(side_px: FloatArray, tilt_rad: FloatArray, half_px: FloatArray | float = HALF_READ_PX) -> FloatArray:
    """Probability that a landmark wholly in the image is read.

    Args:
        side_px: mean side in the image.
        tilt_rad: between its normal and the line to the camera.
        half_px: see :func:`half_read_px`.
    """
    by_side = 1 / (1 + np.exp(-(side_px - half_px) * PER_PX))
    by_tilt = 1 / (1 + np.exp((tilt_rad - HALF_READ_TILT) * PER_TILT))
    return np.asarray(np.where(side_px < SMALLEST_PX, 0.0, BEST * by_side * by_tilt))


def corner_sigma_px(side_px: FloatArray) -> FloatArray:
    """Standard deviation of a corner's coordinate: a part that any image has, and one that small ones add."""
    return np.asarray(np.hypot(CORNER_PX, CORNER_PX3 / np.maximum(side_px, 1.0) ** 2))
