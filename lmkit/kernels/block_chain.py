"""Block tridiagonal matrices, as chains of states have them: Cholesky factor, substitution, and their borders.

A factor of N blocks of d rows is stored by rows, (N d, 2 d): row i from the first column of the block before its own.
"""

from __future__ import annotations

import ctypes
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.load import address, contiguous, function

Array = NDArray[np.floating[Any]]


def factor_chain(diagonal: Array, following: Array) -> Array:
    """(N d,2 d) Cholesky factor of a matrix with blocks ``diagonal`` (N,d,d) and, right of them, ``following``.

    Args:
        following: (N-1,d,d) between block k (rows) and k + 1 (columns).

    Raises:
        ValueError: a shape differs.
        numpy.linalg.LinAlgError: the matrix is not positive definite.
    """
    count, size = diagonal.shape[:2]
    diagonal = contiguous(diagonal, (count, size, size))
    following = contiguous(following, (max(count - 1, 0), size, size))
    kernels = _kernels()
    if kernels is None:
        return factor_chain_numpy(diagonal, following)
    factor = np.empty((count * size, 2 * size))
    if kernels[0](count, size, address(diagonal), address(following), address(factor)):
        raise np.linalg.LinAlgError("the matrix of a chain is not positive definite")
    return factor


def factor_chain_numpy(diagonal: Array, following: Array) -> Array:
    """Definition of :func:`factor_chain`."""
    count, size = diagonal.shape[:2]
    factor = np.zeros((count, size, 2, size))
    for k in range(count):
        left = following[k - 1].T if k else np.zeros((size, size))
        if k:
            left = np.linalg.solve(factor[k - 1, :, 1], left.T).T
        factor[k, :, 0], factor[k, :, 1] = left, np.linalg.cholesky(diagonal[k] - left @ left.T)
    return factor.reshape(count * size, 2 * size)


def forward_chain(factor: Array, right: Array) -> None:
    """Replace ``right`` (N d,w) by the inverse of the factor on it, in place.

    Raises:
        ValueError: a shape or kind differs.
    """
    rows, size = len(factor), factor.shape[1] // 2
    _require(right, (rows, right.shape[1]))
    factor = contiguous(factor, (rows, 2 * size))
    kernels = _kernels()
    if kernels is None:
        return forward_chain_numpy(factor, right)
    kernels[1](rows // max(size, 1), size, address(factor), right.shape[1], address(right))
    return None


def forward_chain_numpy(factor: Array, right: Array) -> None:
    """Definition of :func:`forward_chain`."""
    size = factor.shape[1] // 2
    for first in range(0, len(factor), size):
        own = slice(first, first + size)
        if first:
            right[own] -= factor[own, :size] @ right[first - size : first]
        right[own] = np.linalg.solve(factor[own, size:], right[own])


def backward_chain(factor: Array, right: Array) -> None:
    """Replace ``right`` (N d,w) by the inverse of the transposed factor on it, in place.

    Raises:
        ValueError: a shape or kind differs.
    """
    rows, size = len(factor), factor.shape[1] // 2
    _require(right, (rows, right.shape[1]))
    factor = contiguous(factor, (rows, 2 * size))
    kernels = _kernels()
    if kernels is None:
        return backward_chain_numpy(factor, right)
    kernels[2](rows // max(size, 1), size, address(factor), right.shape[1], address(right))
    return None


def backward_chain_numpy(factor: Array, right: Array) -> None:
    """Definition of :func:`backward_chain`."""
    size = factor.shape[1] // 2
    for first in range(len(factor) - size, -1, -size):
        own = slice(first, first + size)
        right[own] = np.linalg.solve(factor[own, size:].T, right[own])
        if first:
            right[first - size : first] -= factor[own, :size].T @ right[own]


def used_columns(matrix: Array) -> NDArray[np.int64]:
    """Columns of a matrix (n,m) with a number other than zero in them.

    Raises:
        ValueError: a shape differs.
    """
    rows, wide = matrix.shape
    matrix = contiguous(matrix, (rows, wide))
    kernels = _kernels()
    if kernels is None:
        return used_columns_numpy(matrix)
    used = np.empty(wide, dtype=np.bool_)
    kernels[3](rows, wide, address(matrix), address(used))
    return np.flatnonzero(used)


def used_columns_numpy(matrix: Array) -> NDArray[np.int64]:
    """Definition of :func:`used_columns`."""
    return np.flatnonzero((matrix != 0).any(axis=0))


def take_columns(matrix: Array, columns: NDArray[np.int64], taken: Array) -> None:
    """Copy columns of a matrix (n,m) into ``taken`` (n,c), a block of a larger array's columns, in place.

    Raises:
        ValueError: a shape or kind differs, or a column is out of range.
    """
    rows, wide = matrix.shape
    matrix, columns = contiguous(matrix, (rows, wide)), _columns(columns, wide)
    if taken.shape != (rows, len(columns)) or taken.dtype != np.float64 or (taken.size and taken.strides[1] != 8):
        raise ValueError(f"an array of shape {taken.shape} for {len(columns)} columns of {matrix.shape}")
    kernels = _kernels()
    if kernels is None:
        return take_columns_numpy(matrix, columns, taken)
    stride = taken.strides[0] // 8
    kernels[4](rows, wide, address(matrix), len(columns), address(columns), stride, taken.ctypes.data)
    return None


def take_columns_numpy(matrix: Array, columns: NDArray[np.int64], taken: Array) -> None:
    """Definition of :func:`take_columns`."""
    taken[...] = matrix[:, columns]


def subtract_at(matrix: Array, columns: NDArray[np.int64], values: Array) -> None:
    """Subtract ``values`` (c,c) from those rows and columns of ``matrix`` (m,m), in place.

    Args:
        columns: (c,) each at most once.
        values: a contiguous array, or a block of one.

    Raises:
        ValueError: a shape or kind differs, or a column is out of range.
    """
    wide = len(matrix)
    columns = _columns(columns, wide)
    count = len(columns)
    _require(matrix, (wide, wide))
    if values.shape != (count, count):
        raise ValueError(f"values of shape {values.shape}, expected {(count, count)}")
    kernels = _kernels()
    if kernels is None:
        return subtract_at_numpy(matrix, columns, values)
    if values.dtype != np.float64 or values.strides[1] != 8 or values.strides[0] % 8 or values.strides[0] < 0:
        values = np.ascontiguousarray(values, dtype=np.float64)
    kernels[5](wide, count, address(columns), values.strides[0] // 8, values.ctypes.data, address(matrix))
    return None


def subtract_at_numpy(matrix: Array, columns: NDArray[np.int64], values: Array) -> None:
    """Definition of :func:`subtract_at`."""
    matrix[np.ix_(columns, columns)] -= values


def _columns(columns: NDArray[np.int64], wide: int) -> NDArray[np.int64]:
    columns = contiguous(columns, (-1,), np.int64)
    if len(columns) and not 0 <= columns.min() <= columns.max() < wide:
        raise ValueError(f"columns outside 0..{wide - 1}")
    return columns


def _require(matrix: Array, shape: tuple[int, int]) -> None:
    if matrix.shape != shape or matrix.dtype != np.float64 or not matrix.flags.c_contiguous:
        raise ValueError(f"a matrix of shape {matrix.shape}, expected contiguous 64-bit floats of shape {shape}")


@lru_cache(maxsize=1)
def _kernels() -> tuple[Any, Any, Any, Any, Any, Any] | None:
    count, pointer = ctypes.c_int64, ctypes.c_void_p
    factor = function("lmkit_factor_chain", count, count, pointer, pointer, pointer)
    forward = function("lmkit_forward_chain", count, count, pointer, count, pointer)
    backward = function("lmkit_backward_chain", count, count, pointer, count, pointer)
    used = function("lmkit_used_columns", count, count, pointer, pointer)
    take = function("lmkit_take_columns", count, count, pointer, count, pointer, count, pointer)
    subtract = function("lmkit_subtract_at", count, count, pointer, count, pointer, pointer)
    return None if factor is None else (factor, forward, backward, used, take, subtract)
