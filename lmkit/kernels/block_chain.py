"""Block tridiagonal matrices of chains of states: Cholesky factor, substitution, and borders.

A factor of N blocks of d rows is stored by rows, (N d, 2 d): row i starts at the first column of the previous block.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.load import address, addresses, contiguous, function

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
    """Multiply ``right`` (N d,w) by the inverse of the factor, in place.

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
    """Multiply ``right`` (N d,w) by the inverse of the transposed factor, in place.

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
    """Columns of a matrix (n,m) that are not all zero.

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
    matrix, columns = contiguous(matrix, (rows, wide)), _numbers(columns, wide)
    if taken.shape != (rows, len(columns)):
        raise ValueError(f"an array of shape {taken.shape} for {len(columns)} columns of {matrix.shape}")
    _require_rows(taken)
    kernels = _kernels()
    if kernels is None:
        return take_columns_numpy(matrix, columns, taken)
    stride = taken.strides[0] // 8
    kernels[4](rows, wide, address(matrix), len(columns), address(columns), stride, taken.ctypes.data)
    return None


def take_columns_numpy(matrix: Array, columns: NDArray[np.int64], taken: Array) -> None:
    """Definition of :func:`take_columns`."""
    taken[...] = matrix[:, columns]


def put_blocks(values: Array, states: NDArray[np.int64], places: NDArray[np.int64], into: Array) -> None:
    """Copy blocks ``values`` (B,d,g) into ``into`` (n d,c), a block of a larger array's columns, in place.

    Args:
        states, places: (B,) the block goes to rows from d times the state, and columns from g times the place.

    Raises:
        ValueError: a shape or kind differs, or a number is out of range.
    """
    count, size, wide = values.shape
    values = contiguous(values, (count, size, wide))
    rows, columns = into.shape
    if rows % size or columns % wide:
        raise ValueError(f"blocks of shape {values.shape[1:]} into an array of shape {into.shape}")
    _require_rows(into)
    states, places = _numbers(states, rows // size), _numbers(places, columns // wide)
    if not len(states) == len(places) == count:
        raise ValueError(f"{len(states)} states and {len(places)} places for {count} blocks")
    kernels = _kernels()
    if kernels is None:
        return put_blocks_numpy(values, states, places, into)
    kernels[6](
        count, size, wide, address(values), address(states), address(places), into.strides[0] // 8, into.ctypes.data
    )
    return None


def put_blocks_numpy(values: Array, states: NDArray[np.int64], places: NDArray[np.int64], into: Array) -> None:
    """Definition of :func:`put_blocks`."""
    size, wide = values.shape[1:]
    rows, columns = size * states[:, None] + np.arange(size), wide * places[:, None] + np.arange(wide)
    into[rows[:, :, None], columns[:, None]] = values


@dataclass(frozen=True, eq=False)
class Cuts:
    """Normal equations of the cut states between eliminated pieces of a chain, and of the shared unknowns.

    All are contiguous arrays of 64-bit floats: diagonal (K,d,d), following (K-1,d,d), gradient (K,d), border (K,d,m),
    corner (m,m) and shared_gradient (m,).
    """

    diagonal: Array
    following: Array
    gradient: Array
    border: Array
    corner: Array
    shared_gradient: Array

    def __post_init__(self) -> None:
        """Raises:
        ValueError: a shape or kind differs.
        """
        (count, size), m = self.gradient.shape, len(self.shared_gradient)
        shapes = ((count, size, size), (max(count - 1, 0), size, size), (count, size), (count, size, m), (m, m), (m,))
        for array, shape in zip(self.arrays, shapes, strict=True):
            _require(array, shape)

    @property
    def arrays(self) -> tuple[Array, ...]:
        """In the order of the class."""
        return self.diagonal, self.following, self.gradient, self.border, self.corner, self.shared_gradient


def subtract_piece(product: Array, first: int, between: int, columns: NDArray[np.int64], cuts: Cuts) -> None:
    """Subtract the Schur complement of an eliminated piece from the equations of the cuts, in place.

    Args:
        product: (l d+c+1,l d+c+1) of the piece's border (l cuts, what is shared) and gradient with themselves.
        first, between: number of the first cut that it touches, and how many: at most two.
        columns: (c,) the shared unknowns, each at most once.

    Raises:
        ValueError: a shape or kind differs, or a number is out of range.
    """
    size, wide = cuts.gradient.shape[1], len(cuts.shared_gradient)
    columns, inner = _numbers(columns, wide), size * between
    _require(product, (inner + len(columns) + 1,) * 2)
    if between > 2 or not 0 <= first <= len(cuts.gradient) - between:
        raise ValueError(f"{between} cuts from {first} on, of {len(cuts.gradient)}")
    kernels = _kernels()
    if kernels is None:
        return subtract_piece_numpy(product, first, between, columns, cuts)
    diagonal, following, gradient, border, corner, shared_gradient = addresses(*cuts.arrays)
    square = 8 * size * size * first
    kernels[5](
        size, inner, wide, len(columns), address(columns), address(product), diagonal + square, following + square,
        gradient + 8 * size * first, border + 8 * size * wide * first, corner, shared_gradient,
    )  # fmt: skip
    return None


def subtract_piece_numpy(product: Array, first: int, between: int, columns: NDArray[np.int64], cuts: Cuts) -> None:
    """Definition of :func:`subtract_piece`."""
    size = cuts.gradient.shape[1]
    inner = size * between
    for number in range(between):
        rows = slice(size * number, size * (number + 1))
        cuts.diagonal[first + number] -= product[rows, rows]
        cuts.gradient[first + number] -= product[rows, -1]
        cuts.border[first + number][:, columns] -= product[rows, inner:-1]
    if between == 2:
        cuts.following[first] -= product[:size, size:inner]
    cuts.corner[np.ix_(columns, columns)] -= product[inner:-1, inner:-1]
    cuts.shared_gradient[columns] -= product[inner:-1, -1]


def _numbers(numbers: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    numbers = contiguous(numbers, (-1,), np.int64)
    if len(numbers) and not 0 <= numbers.min() <= numbers.max() < count:
        raise ValueError(f"numbers outside 0..{count - 1}")
    return numbers


def _require_rows(block: Array) -> None:
    if block.dtype != np.float64 or (block.size and (block.strides[1] != 8 or block.strides[0] % 8)):
        raise ValueError("rows that are not contiguous 64-bit floats")


def _require(matrix: Array, shape: tuple[int, ...]) -> None:
    if matrix.shape != shape or matrix.dtype != np.float64 or not matrix.flags.c_contiguous:
        raise ValueError(f"a matrix of shape {matrix.shape}, expected contiguous 64-bit floats of shape {shape}")


@lru_cache(maxsize=1)
def _kernels() -> tuple[Any, ...] | None:
    count, pointer = ctypes.c_int64, ctypes.c_void_p
    factor = function("lmkit_factor_chain", count, count, pointer, pointer, pointer)
    forward = function("lmkit_forward_chain", count, count, pointer, count, pointer)
    backward = function("lmkit_backward_chain", count, count, pointer, count, pointer)
    used = function("lmkit_used_columns", count, count, pointer, pointer)
    take = function("lmkit_take_columns", count, count, pointer, count, pointer, count, pointer)
    subtract = function("lmkit_subtract_piece", *[count] * 4, *[pointer] * 8)
    put = function("lmkit_put_blocks", count, count, count, pointer, pointer, pointer, count, pointer)
    return None if factor is None else (factor, forward, backward, used, take, subtract, put)
