"""Array types used throughout, and the read-only copies that frozen dataclasses hold."""

from __future__ import annotations

import math
from collections.abc import Sequence
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
        raise ValueError(f"{what} contains values that are not finite")
    array.setflags(write=False)
    return array


def stacked(parts: Sequence[FloatArray], shape: tuple[int, ...]) -> FloatArray:
    """(N, ...) of N arrays of a shape, which may be none."""
    return np.concatenate(parts).reshape(-1, *shape) if len(parts) else np.zeros((0, *shape))


def is_covariance(matrix: FloatArray) -> bool:
    """Symmetric, and not negative in any direction, to rounding."""
    scale = max(float(np.abs(matrix).max()), 1e-300)
    symmetric = bool(np.allclose(matrix, matrix.T, rtol=0, atol=1e-9 * scale))
    return symmetric and bool(np.linalg.eigvalsh(matrix).min() >= -1e-9 * scale)


def widest_sigma(covariance: FloatArray, enough: float) -> float:
    """Standard deviation of (3,3) along the direction known least, or an upper bound below ``enough``."""
    # The trace holds the largest eigenvalue, and mostly decides.
    bound = covariance.item(0) + covariance.item(4) + covariance.item(8)
    if bound < enough**2:
        return math.sqrt(max(bound, 0.0))
    return math.sqrt(max(float(np.linalg.eigvalsh(covariance)[-1]), 0.0))


def covariance_root(matrix: FloatArray) -> FloatArray:
    """(N,N) whose product with its transpose is the covariance, which may be singular."""
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
