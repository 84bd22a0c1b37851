"""Sums of small matrices into rows and columns of a large one, as eliminating a piece of a chain leaves them."""

from __future__ import annotations

import ctypes
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.load import address, contiguous, function

Array = NDArray[np.floating[Any]]


def subtract_at(matrix: Array, columns: NDArray[np.int64], values: Array) -> None:
    """Subtract ``values`` (c,c) from those rows and columns of ``matrix`` (m,m), in place.

    Args:
        columns: (c,) each at most once.
        values: a contiguous array, or a block of one.

    Raises:
        ValueError: a shape or kind differs, or a column is out of range.
    """
    columns = contiguous(columns, (-1,), np.int64)
    count, wide = len(columns), len(matrix)
    if matrix.shape != (wide, wide) or matrix.dtype != np.float64 or not matrix.flags.c_contiguous:
        raise ValueError(f"a matrix of shape {matrix.shape}, expected a square one of contiguous doubles")
    if values.shape != (count, count):
        raise ValueError(f"values of shape {values.shape}, expected {(count, count)}")
    if count and not 0 <= columns.min() <= columns.max() < wide:
        raise ValueError(f"columns outside 0..{wide - 1}")
    kernel = _kernel()
    if kernel is None:
        return subtract_at_numpy(matrix, columns, values)
    if values.dtype != np.float64 or values.strides[1] != 8 or values.strides[0] % 8 or values.strides[0] < 0:
        values = np.ascontiguousarray(values, dtype=np.float64)
    kernel(wide, count, address(columns), values.strides[0] // 8, values.ctypes.data, address(matrix))
    return None


def subtract_at_numpy(matrix: Array, columns: NDArray[np.int64], values: Array) -> None:
    """Definition of :func:`subtract_at`."""
    matrix[np.ix_(columns, columns)] -= values


@lru_cache(maxsize=1)
def _kernel() -> Any:
    count, pointer = ctypes.c_int64, ctypes.c_void_p
    return function("lmkit_subtract_at", count, count, pointer, count, pointer, pointer)
