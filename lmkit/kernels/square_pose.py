"""Both poses of a square seen by one camera, in closed form.

Collins and Bartoli, "Infinitesimal plane-based pose estimation", IJCV 2014: the homography near the square's center
gives its rotation up to a reflection.
"""

from __future__ import annotations

import ctypes
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.load import address, contiguous, function

Array = NDArray[np.floating[Any]]


def square_poses(rays: Array, sizes: Array) -> tuple[Array, Array, Array]:
    """Rotations (N,2,3,3), shifts (N,2,3) and root mean square errors of the rays (N,2), the better pose first.

    Args:
        rays: (N,4,2) corners as x/z, y/z: top left, then clockwise as the square stands.
        sizes: (N,) sides, meters.

    Returns:
        x_camera = R x_square + t, with the corners in the square's frame at (-s/2, s/2, 0), (s/2, s/2, 0), ...

    Raises:
        ValueError: a shape differs.
    """
    rays = contiguous(rays, (-1, 4, 2))
    count = len(rays)
    sizes = contiguous(sizes, (count,))
    kernel = _kernel()
    if kernel is None:
        return square_poses_numpy(rays, sizes)
    R, t, errors = np.empty((count, 2, 3, 3)), np.empty((count, 2, 3)), np.empty((count, 2))
    kernel(count, address(rays), address(sizes), address(R), address(t), address(errors))
    return R, t, errors


def square_poses_numpy(rays: Array, sizes: Array) -> tuple[Array, Array, Array]:
    """Definition of :func:`square_poses`."""
    with np.errstate(all="ignore"):
        center, J = _center(rays, sizes)
        V = _to_ray(center)
        B = V[:, :2, :2] - center[:, :, None] * V[:, None, 2, :2]
        determinant = B[:, 0, 0] * B[:, 1, 1] - B[:, 0, 1] * B[:, 1, 0]
        back = np.stack([B[:, 1, 1], -B[:, 0, 1], -B[:, 1, 0], B[:, 0, 0]], axis=1) / determinant[:, None]
        A = back.reshape(-1, 2, 2) @ J
        AA = A @ A.transpose(0, 2, 1)
        apart = np.sqrt((AA[:, 0, 0] - AA[:, 1, 1]) ** 2 + 4 * AA[:, 0, 1] ** 2)
        r = A / np.sqrt((AA[:, 0, 0] + AA[:, 1, 1] + apart) / 2)[:, None, None]
        c = 1 - (r**2).sum(axis=1)
        c = np.where(c > 0, np.sqrt(np.where(c > 0, c, 0.0)), 0.0)
        c[:, 1] *= np.where(-(r[:, :, 0] * r[:, :, 1]).sum(axis=1) < 0, -1, 1)
        both = np.stack([c, -c], axis=1)  # (N,2,2)
        top = np.broadcast_to(r[:, None], (len(r), 2, 2, 2))
        columns = np.concatenate([top, both[:, :, None]], axis=2)  # (N,2,3,2)
        turned = np.concatenate([columns, np.cross(columns[..., 0], columns[..., 1])[..., None]], axis=3)
        R = V[:, None] @ turned
        t, errors = _fit_shift(R, rays, sizes)
    swapped = errors[:, 1] < errors[:, 0]
    order = np.where(swapped[:, None], [1, 0], [0, 1])
    rows = np.arange(len(rays))[:, None]
    return R[rows, order], t[rows, order], errors[rows, order]


def _center(rays: Array, sizes: Array) -> tuple[Array, Array]:
    """(N,2) ray of the square's center, and (N,2,2) its derivative by the position on the square (Heckbert 1989)."""
    q0, q1, q2, q3 = rays.transpose(1, 0, 2)
    d1, d2, s = q1 - q2, q3 - q2, q0 - q1 + q2 - q3
    determinant = d1[:, 0] * d2[:, 1] - d2[:, 0] * d1[:, 1]
    g = ((s[:, 0] * d2[:, 1] - d2[:, 0] * s[:, 1]) / determinant)[:, None]
    h = ((d1[:, 0] * s[:, 1] - s[:, 0] * d1[:, 1]) / determinant)[:, None]
    by_u, by_v, w = q1 - q0 + g * q1, q3 - q0 + h * q3, 1 + (g + h) / 2
    center = (by_u / 2 + by_v / 2 + q0) / w
    J = np.stack([(by_u - center * g) / w, -(by_v - center * h) / w], axis=2) / sizes[:, None, None]
    return center, J


def _to_ray(center: Array) -> Array:
    """(N,3,3) rotations from the optical axis to rays."""
    n = np.sqrt((center**2).sum(axis=1) + 1)
    x, y, z = center[:, 0] / n, center[:, 1] / n, 1 / n
    k = 1 / (1 + z)
    return np.stack([1 - x * x * k, -x * y * k, x, -x * y * k, 1 - y * y * k, y, -x, -y, z], axis=1).reshape(-1, 3, 3)


def _fit_shift(R: Array, rays: Array, sizes: Array) -> tuple[Array, Array]:
    """Shifts (N,2,3) that fit the rays best, by least squares, and the root mean square errors (N,2)."""
    square = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]]) * sizes[:, None, None]
    P = square[:, None] @ R[..., :2].swapaxes(-1, -2)  # (N,2,4,3)
    off = rays[:, None] * P[..., 2:] - P[..., :2]
    b, b2 = off.sum(axis=2), -(rays[:, None] * off).sum(axis=(2, 3))
    total, squares = rays.sum(axis=1)[:, None], (rays**2).sum(axis=(1, 2))[:, None]
    z = (b2 + (total * b).sum(axis=2) / 4) / (squares - (total**2).sum(axis=2) / 4)
    t = np.concatenate([(b + total * z[..., None]) / 4, z[..., None]], axis=2)
    seen = P + t[:, :, None]
    error = seen[..., :2] / seen[..., 2:] - rays[:, None]
    return t, np.sqrt((error**2).sum(axis=(2, 3)) / 8)


@lru_cache(maxsize=1)
def _kernel() -> Any:
    return function("lmkit_square_poses", ctypes.c_int64, *[ctypes.c_void_p] * 5)
