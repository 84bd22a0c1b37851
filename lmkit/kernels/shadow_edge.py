"""Direction of a straight edge between two lights, from pixels on both sides of it."""

from __future__ import annotations

import ctypes
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.load import address, addresses, contiguous, function
from lmkit.kernels.workspace import Workspace

FloatArray = NDArray[np.floating[Any]]

BINS = 256  # along a direction: fewer than a pixel each on all but the largest landmarks

_WORKSPACE = Workspace()


def shadow_direction(at: FloatArray, values: FloatArray, weights: FloatArray, normals: FloatArray) -> int:
    """Index of the direction across which an edge separates the values best (Otsu 1979).

    Args:
        at: (N,2) positions.
        values, weights: (N,), weights positive.
        normals: (D,2) unit vectors.
    """
    at, normals = contiguous(at, (-1, 2)), contiguous(normals, (-1, 2))
    values, weights = contiguous(values, (len(at),)), contiguous(weights, (len(at),))
    kernel = _kernel()
    if kernel is None:
        return shadow_direction_numpy(at, values, weights, normals)
    found, sums = np.zeros(1, np.int64), _WORKSPACE.floats("sums", 4 * BINS)
    kernel(len(at), *addresses(at, values, weights), len(normals), address(normals), BINS, sums, address(found))
    return int(found[0])


def shadow_direction_numpy(at: FloatArray, values: FloatArray, weights: FloatArray, normals: FloatArray) -> int:
    """Definition of :func:`shadow_direction`."""
    best = []
    for normal in normals:
        along = at @ normal
        span = float(np.ptp(along))
        bins = ((along - along.min()) * ((BINS - 1e-6) / span if span > 0 else 0.0)).astype(np.int64)
        weight = np.bincount(bins, weights, BINS)
        total = np.bincount(bins, weights * values, BINS)
        before, behind = weight.cumsum()[:-1], weight.sum() - weight.cumsum()[:-1]
        sums, whole = total.cumsum()[:-1], total.sum()
        used = (before > 0) & (behind > 1e-9 * weight.sum())
        # Between-class variance, up to terms independent of the split.
        between = sums[used] ** 2 / before[used] + (whole - sums[used]) ** 2 / behind[used]
        best.append(between.max(initial=-1.0))
    return int(np.argmax(best))


@lru_cache(maxsize=1)
def _kernel() -> Any:
    p, n = ctypes.c_void_p, ctypes.c_int64
    return function("lmkit_shadow_direction", n, p, p, p, n, p, n, p, p)
