"""Products of a grid's cells, border, margin and surroundings with each other and with the values of pixels."""

from __future__ import annotations

import ctypes
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.grid_pattern import GridDrawing, cell_coverage_numpy
from lmkit.kernels.load import addresses, contiguous, function
from lmkit.kernels.plane import STATE, View, light_numpy, plane_numpy
from lmkit.kernels.registration import Samples

FloatArray = NDArray[np.floating[Any]]

LANES = 16  # of the compiled code; its scratch is aligned to this number of floats
OTHERS = 3  # border, margin, surroundings


def grid_moments(
    drawing: GridDrawing, border: int, view: View, samples: Samples, state: FloatArray
) -> NDArray[np.float64]:
    """(K+6,K+6) products, weighted by the samples: K cells inside, border, margin, surroundings, three values.

    Args:
        drawing: the drawing; its darkness is not used.
        border: width of the border, cells.
    """
    kernel = _kernel()
    if kernel is None:
        return grid_moments_numpy(drawing, border, view, samples, state)
    rows = (len(drawing.darkness) - 2 * border) ** 2 + OTHERS + 3
    flat, seen, state = drawing.flat, view.flat, contiguous(state, (STATE,))
    room = np.empty((rows * (rows + 1) // 2 + 1) * LANES, np.float32)
    start = -(room.ctypes.data // 4) % LANES
    sums = np.empty((rows, rows))
    arrays = addresses(seen, *samples, state, room[start:], sums)
    kernel(len(samples.variance), *addresses(flat), border, *arrays)
    return sums


def grid_moments_numpy(
    drawing: GridDrawing, border: int, view: View, samples: Samples, state: FloatArray
) -> NDArray[np.float64]:
    """Definition of :func:`grid_moments`."""
    points, spread, _, _ = plane_numpy(view, state, samples.at.T.astype(np.float64))
    side = len(drawing.darkness)
    cells = cell_coverage_numpy(drawing, points, spread)
    paper = cell_coverage_numpy(GridDrawing(0.0, drawing.paper, np.ones((1, 1))), points, spread)[0]
    face = cells.sum(axis=0)
    inside = cells.reshape(side, side, -1)[border : side - border, border : side - border].reshape(-1, len(points))
    columns = np.vstack([inside, face - inside.sum(axis=0), paper - face, 1 - paper]) * light_numpy(
        view, state, points
    )
    rows = np.vstack([columns, samples.values]) / np.sqrt(samples.variance)
    return np.asarray(rows @ rows.T)


@lru_cache(maxsize=1)
def _kernel() -> Any:
    p, n = ctypes.c_void_p, ctypes.c_int64
    return function("lmkit_grid_moments", n, p, n, *[p] * 7)
