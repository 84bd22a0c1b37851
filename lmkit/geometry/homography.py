"""Plane-to-plane projective maps."""

from __future__ import annotations

import numpy as np

from lmkit.arrays import FloatArray


def homography_from_points(source: FloatArray, target: FloatArray) -> FloatArray:
    """(3,3) homography that takes four points to four points exactly, with H[2,2] = 1.

    Args:
        source, target: (4,2) points, no three on a line.

    Raises:
        numpy.linalg.LinAlgError: three points lie on a line.
    """
    return np.asarray(homographies_from_points(source, target[None])[0])


def homographies_from_points(source: FloatArray, targets: FloatArray) -> FloatArray:
    """(N,3,3) homographies from (4,2) ``source`` to each of (N,4,2) ``targets``.

    Raises:
        numpy.linalg.LinAlgError: three points of a target lie on a line.
    """
    n = len(targets)
    x, y = source[:, 0], source[:, 1]
    A = np.zeros((n, 8, 8))
    A[:, 0::2, 0], A[:, 0::2, 1], A[:, 0::2, 2] = x, y, 1
    A[:, 1::2, 3], A[:, 1::2, 4], A[:, 1::2, 5] = x, y, 1
    A[:, 0::2, 6], A[:, 0::2, 7] = -x * targets[:, :, 0], -y * targets[:, :, 0]
    A[:, 1::2, 6], A[:, 1::2, 7] = -x * targets[:, :, 1], -y * targets[:, :, 1]
    h = np.linalg.solve(A, targets.reshape(n, 8, 1))[:, :, 0]
    return np.concatenate([h, np.ones((n, 1))], axis=1).reshape(n, 3, 3)


def transform_points(H: FloatArray, points: FloatArray) -> FloatArray:
    """(..., 2) ``points`` mapped by a (3,3) homography."""
    mapped = points @ H[:, :2].T + H[:, 2]
    return np.asarray(mapped[..., :2] / mapped[..., 2:])


def crossing(a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray) -> FloatArray:
    """(2,) where the line through a, b meets the line through c, d."""
    u, v, w = b - a, d - c, c - a
    scale = (w[0] * v[1] - w[1] * v[0]) / (u[0] * v[1] - u[1] * v[0])
    return np.asarray(a + scale * u)
