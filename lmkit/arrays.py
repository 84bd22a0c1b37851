"""Array types used throughout, and the read-only copies that frozen dataclasses hold."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.floating[Any]]
Float32Array = NDArray[np.float32]
ByteArray = NDArray[np.uint8]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
AnyArray = NDArray[Any]


def frozen(values: ArrayLike, shape: tuple[int, ...], what: str) -> FloatArray:
    """A read-only float64 copy of ``values``; -1 in ``shape`` means any length.

    Raises:
        ValueError: the shape differs, or a value is no number or not finite.
    """
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{what} is not an array of numbers of one shape") from None
    have = array.shape
    fits = have == shape or (len(have) == len(shape) and all(a in (-1, b) for a, b in zip(shape, have, strict=True)))
    if not fits:
        raise ValueError(f"{what} has shape {have}, expected {shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{what} holds values that are not finite")
    array.setflags(write=False)
    return array


def is_covariance(matrix: FloatArray) -> bool:
    """Symmetric, and not negative in any direction, to rounding."""
    scale = max(float(np.abs(matrix).max()), 1e-300)
    symmetric = bool(np.allclose(matrix, matrix.T, rtol=0, atol=1e-9 * scale))
    return symmetric and bool(np.linalg.eigvalsh(matrix).min() >= -1e-9 * scale)


def covariance_root(matrix: FloatArray) -> FloatArray:
    """(N,N) whose product with its transpose is the covariance, which may be singular."""
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
