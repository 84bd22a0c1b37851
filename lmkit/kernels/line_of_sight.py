"""Straight lines through an occupancy grid, sampled at half a cell."""

from __future__ import annotations

import ctypes
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.load import address, contiguous, function

Array = NDArray[np.floating[Any]]
Flags = NDArray[np.bool_]


def clear_lines(
    free: Flags, cell_m: float, origin: tuple[float, float], near_m: float, start: Array, end: Array
) -> Flags:
    """(N,) True if the line from ``start`` (N,2) to ``near_m`` before ``end`` (N,2) is in free cells only.

    Args:
        free: (rows, columns), row 0 at the lowest y; outside nothing is free.
        origin: lower left corner of the first cell, meters.

    Raises:
        ValueError: a shape differs.
    """
    start = contiguous(start, (-1, 2))
    end = contiguous(end, (len(start), 2))
    free = contiguous(free, (-1, -1), np.bool_)
    kernel = _kernel()
    if kernel is None:
        return clear_lines_numpy(free, cell_m, origin, near_m, start, end)
    clear = np.empty(len(start), dtype=np.bool_)
    kernel(address(free), *free.shape, cell_m, *origin, near_m, len(start), *map(address, (start, end, clear)))
    return clear


def clear_lines_numpy(
    free: Flags, cell_m: float, origin: tuple[float, float], near_m: float, start: Array, end: Array
) -> Flags:
    """Definition of :func:`clear_lines`."""
    with np.errstate(invalid="ignore"):
        way = end - start
        length = np.sqrt((way**2).sum(axis=1))
        share = np.maximum(length - near_m, 0.0) / np.maximum(length, 1e-9)
        clear = 2 * length / cell_m < 1e9
        steps = np.where(clear, np.ceil(2 * np.where(clear, length, 0.0) / cell_m), 0)
    rows, k = np.flatnonzero(clear), 0
    while len(rows):
        at = share[rows] * (k / np.maximum(steps[rows], 1))
        cells = np.floor((start[rows] + at[:, None] * way[rows] - np.array(origin)) / cell_m)
        inside = ((cells >= 0) & (cells < free.shape[::-1])).all(axis=1)
        column, row = np.where(inside[:, None], cells, 0).astype(np.int64).T
        clear[rows] = inside & (free[row, column] if free.size else False)
        k += 1
        rows = rows[clear[rows] & (k <= steps[rows])]
    return np.asarray(clear)


@lru_cache(maxsize=1)
def _kernel() -> Any:
    pointer, count, number = ctypes.c_void_p, ctypes.c_int64, ctypes.c_double
    return function("lmkit_clear_lines", pointer, count, count, number, number, number, number, count, *[pointer] * 3)
