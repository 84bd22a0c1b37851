"""Many rotations at once."""

from __future__ import annotations

import numpy as np

from lmkit.arrays import FloatArray


def turns(vectors: FloatArray) -> FloatArray:
    """(H,3,3) rotation matrices of (H,3) rotation vectors (Rodrigues)."""
    angle = np.sqrt((vectors**2).sum(axis=1))[:, None, None]
    W = np.zeros((len(vectors), 3, 3))
    W[:, 0, 1], W[:, 0, 2], W[:, 1, 2] = -vectors[:, 2], vectors[:, 1], -vectors[:, 0]
    W -= W.transpose(0, 2, 1)
    small = angle < 1e-8
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 1.0, np.sin(safe) / safe)
    b = np.where(small, 0.5, (1 - np.cos(safe)) / safe**2)
    return np.asarray(np.eye(3) + a * W + b * (W @ W))
