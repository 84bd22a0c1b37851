"""A straight edge between two lights, from pixels on both sides of it."""

from __future__ import annotations

import ctypes
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.load import address, addresses, contiguous, function
from lmkit.kernels.workspace import Workspace

FloatArray = NDArray[np.floating[Any]]

BINS = 256  # along a direction: fewer than a pixel each on all but the largest landmarks
SHARE = 1e-9  # of the weight: less of it on a side counts as nothing

_WORKSPACE = Workspace()


class Split(NamedTuple):
    """An edge: index of its direction, its place along it, and the mean value before and behind."""

    direction: int
    offset: float
    before: float
    behind: float

    @classmethod
    def of(cls, numbers: FloatArray) -> Split:
        """From the numbers of the kernel."""
        direction, offset, before, behind = numbers[:4].tolist()
        return cls(int(direction), offset, before, behind)


def shadow_edge(at: FloatArray, values: FloatArray, weights: FloatArray, normals: FloatArray) -> Split:
    """The edge that separates the values best (Otsu 1979), its direction by places counted in bins.

    Args:
        at: (N,2) positions, at least two.
        values, weights: (N,), weights positive.
        normals: (D,2) unit vectors.
    """
    at, normals = contiguous(at, (-1, 2)), contiguous(normals, (-1, 2))
    values, weights = contiguous(values, (len(at),)), contiguous(weights, (len(at),))
    kernel = _kernel()
    if kernel is None:
        return shadow_edge_numpy(at, values, weights, normals)
    edge, room = np.empty(4), _WORKSPACE.floats("room", 2 * room_for_edge(len(at)))
    if kernel(len(at), *addresses(at, values, weights), len(normals), address(normals), BINS, room, address(edge)):
        raise ValueError(f"an edge among {len(at)} positions")
    return Split.of(edge)


def shadow_edge_numpy(at: FloatArray, values: FloatArray, weights: FloatArray, normals: FloatArray) -> Split:
    """Definition of :func:`shadow_edge`."""
    best = []
    for normal in normals:
        along = at @ normal
        span = float(np.ptp(along))
        bins = ((along - along.min()) * ((BINS - 1e-6) / span if span > 0 else 0.0)).astype(np.int64)
        sums = np.bincount(bins, weights, BINS), np.bincount(bins, weights * values, BINS)
        best.append(_between(*sums).max())
    direction = int(np.argmax(best))
    along = at @ normals[direction]
    order = along.argsort(kind="stable")
    weight, total = weights[order], (weights * values)[order]
    k = int(_between(weight, total).argmax())
    means = [float(total[part].sum() / weight[part].sum()) for part in (slice(k + 1), slice(k + 1, None))]
    return Split(direction, float(along[order[k : k + 2]].mean()), *means)


def _between(weight: NDArray[Any], total: NDArray[Any]) -> FloatArray:
    """(N-1,) variance between both sides of every split, up to terms independent of the split; -1 for no split."""
    before, sums = weight.cumsum()[:-1], total.cumsum()[:-1]
    behind, rest = weight.sum() - before, total.sum() - sums
    is_split = (before > 0) & (behind > SHARE * weight.sum())
    with np.errstate(all="ignore"):
        return np.where(is_split, sums**2 / before + rest**2 / behind, -1.0)


def room_for_edge(positions: int) -> int:
    """Length of the kernel's workspace for this number of positions, in double precision."""
    return 2 * BINS + 3 * positions


@lru_cache(maxsize=1)
def _kernel() -> Any:
    p, n = ctypes.c_void_p, ctypes.c_int64
    return function("lmkit_shadow_edge", n, p, p, p, n, p, n, p, p)
