"""Windows of an image around squares that are expected, and images without color."""

from __future__ import annotations

import math

import numpy as np

from lmkit.arrays import ByteArray, FloatArray, IntArray
from lmkit.detection.pixel_sampling import mean_side

WINDOW_ROOM = 0.5  # of the side, around a square that is expected
LEAST_ROOM_PX = 16.0
LEAST_WINDOW_PX = 24


def window_around(quad: FloatArray, image: ByteArray) -> tuple[IntArray, IntArray]:
    """First pixel (x, y) and the one beyond the last of the window around a (4,2) square, within the image."""
    room = max(WINDOW_ROOM * mean_side(quad), LEAST_ROOM_PX)
    low, high = [], []
    for along, size in zip(quad.T.tolist(), (image.shape[1], image.shape[0]), strict=True):
        low.append(int(min(max(math.floor(min(along) - room), 0), size)))
        high.append(int(max(min(math.ceil(max(along) + room), size), 0)))
    return np.array(low), np.array(high)


def clockwise(quad: FloatArray) -> FloatArray:
    """The (4,2) quad in the order that runs clockwise as seen."""
    (ax, ay), (bx, by), (cx, cy), (dx, dy) = quad.tolist()
    # Twice the area, as the product of the diagonals.
    return quad if (cx - ax) * (dy - by) > (cy - ay) * (dx - bx) else quad[::-1]


def is_colorless(image: ByteArray) -> bool:
    """All three channels the same: a gray image, in which red and blue cannot be distinguished."""
    return bool(np.array_equal(image[:, :, 0], image[:, :, 1]) and np.array_equal(image[:, :, 1], image[:, :, 2]))
