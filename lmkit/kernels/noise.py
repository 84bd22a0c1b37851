"""Standard deviation of an image's noise, from its smoothest half (Immerkaer 1996)."""

from __future__ import annotations

import ctypes
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.load import addresses, contiguous, function
from lmkit.kernels.workspace import Workspace

ByteArray = NDArray[np.uint8]

BANDS = 24  # of three rows each
MOST = 4096  # larger responses are clipped to this value
# Median of a normal distribution's absolute value; norm of the filter; of the gray (B + 2 G + R) / 4.
SCALE = 0.6745 * 6 * 4

_WORKSPACE = Workspace()


def noise(image: ByteArray) -> float:
    """Standard deviation of the noise of (H,W,3) BGR in code values; 0 for less than three rows or columns."""
    image = contiguous(image, (-1, -1, 3), np.uint8)
    kernel = _kernel()
    if kernel is None or min(image.shape[:2]) < 3:
        return noise_numpy(image)
    width, rows = image.shape[1], _rows(image.shape[0])
    median = np.zeros(1, np.int64)
    room = _WORKSPACE.floats("column", width // 2 + 1), _WORKSPACE.floats("histogram", MOST + 1)
    kernel(width, *addresses(image), len(rows), *addresses(rows), *room, *addresses(median))
    return float(median[0]) / SCALE


def noise_numpy(image: ByteArray) -> float:
    """Definition of :func:`noise`."""
    if min(image.shape[:2]) < 3:
        return 0.0
    gray = image.astype(np.int64) @ np.array([1, 2, 1])
    rows = _rows(len(image))
    across = gray[rows] - 2 * gray[rows + 1] + gray[rows + 2]
    response = np.abs(across[:, :-2] - 2 * across[:, 1:-1] + across[:, 2:]).ravel()
    counts = np.bincount(np.minimum(response, MOST)).cumsum()
    return float(np.searchsorted(counts, (counts[-1] + 1) // 2)) / SCALE


@lru_cache(maxsize=64)
def _rows(height: int) -> NDArray[np.int64]:
    # Not np.unique, which would load numpy.ma.
    return np.array(sorted(set(np.linspace(0, height - 3, min(BANDS, height - 2)).astype(np.int64).tolist())))


@lru_cache(maxsize=1)
def _kernel() -> Any:
    p, n = ctypes.c_void_p, ctypes.c_int64
    return function("lmkit_noise", n, p, n, p, p, p, p)
