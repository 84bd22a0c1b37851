"""Landmark corners through a lens: rays without distortion, derivatives of pixels, and whitening of errors.

Lens models are OpenCV's: ``rational`` with up to 14 coefficients (pinhole is its special case) and ``fisheye``
(equidistant).  The inverse agrees with OpenCV's: a fixed-point iteration, and Newton's method near the solution;
Newton's method alone for fisheye lenses.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.load import address, contiguous, function

Array = NDArray[np.floating[Any]]

ITERATIONS, PRECISION = 100, 1e-12
NEAR_PX = 1.0  # Newton's method from this error on
UNREACHED = -1e6  # ray of a pixel outside the range of the lens model


class _LensStruct(ctypes.Structure):
    _fields_ = (
        ("fisheye", ctypes.c_int64),
        *((name, ctypes.c_double) for name in ("fx", "fy", "cx", "cy")),
        ("k", ctypes.c_double * 14),
        ("tilt", ctypes.c_double * 9),
        ("tilt_back", ctypes.c_double * 9),
    )


@dataclass(frozen=True, eq=False)
class Lens:
    """A camera in the form for kernels.

    Attributes:
        K: (3,3) camera matrix; its skew is ignored, as in OpenCV.
        distortion: coefficients in OpenCV's order, at most 14.
        fisheye: the equidistant model, with 4 coefficients.
    """

    K: Array
    distortion: Array
    fisheye: bool
    k: Array = field(init=False)
    tilt: Array = field(init=False)
    struct: _LensStruct = field(init=False, repr=False)

    def __post_init__(self) -> None:
        k = np.zeros(14)
        k[: len(self.distortion)] = self.distortion
        tilt = _tilt(*k[12:])
        object.__setattr__(self, "k", k)
        object.__setattr__(self, "tilt", tilt)
        numbers = (ctypes.c_double * 14)(*k), (ctypes.c_double * 9)(*tilt.ravel())
        back = (ctypes.c_double * 9)(*np.linalg.inv(tilt).ravel())
        focal = (self.K[0, 0], self.K[1, 1], self.K[0, 2], self.K[1, 2])
        object.__setattr__(self, "struct", _LensStruct(int(self.fisheye), *focal, *numbers, back))


def corners_through_lens(
    lens: Lens, corners: Array, covariance: Array | None, floor_px: float, reached_px: float
) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Rays of (N,4,2) corners in pixels.

    Args:
        covariance: (N,8,8) of the corners, pixels squared, or None.
        floor_px: standard deviation added to each coordinate.
        reached_px: largest reprojection error of a ray.

    Returns:
        Rays x/z, y/z (N,4,2), derivatives of pixels by rays (N,4,2,2), (N,8,8) from errors of rays to standard
        deviations, and (N,) whether the lens model reaches all four corners.

    Raises:
        ValueError: a shape differs.
        numpy.linalg.LinAlgError: a covariance is not positive definite, even with the floor.
    """
    return corners_through_lenses([lens], [len(corners)], corners, covariance, floor_px, reached_px)


def corners_through_lenses(
    lenses: Sequence[Lens],
    counts: Sequence[int],
    corners: Array,
    covariance: Array | None,
    floor_px: float,
    reached_px: float,
) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Rays of corners in the images of several cameras; see :func:`corners_through_lens`.

    Args:
        counts: number of the N landmarks of each camera; those of the first camera come first.

    Raises:
        ValueError: a shape differs.
        numpy.linalg.LinAlgError: a covariance is not positive definite, even with the floor.
    """
    corners = contiguous(corners, (sum(counts), 4, 2))
    count = len(corners)
    if covariance is not None:
        covariance = contiguous(covariance, (count, 8, 8))
    kernel = _kernel()
    ends = list(accumulate(counts, initial=0))
    if kernel is None:
        parts = [
            corners_through_lens_numpy(
                lens, corners[a:b], None if covariance is None else covariance[a:b], floor_px, reached_px
            )
            for lens, a, b in zip(lenses, ends[:-1], ends[1:], strict=True)
        ]
        rays, by_ray, whitener, reached = (np.concatenate(column) for column in zip(*parts, strict=True))
        return rays, by_ray, whitener, reached
    rays, by_ray, whitener = np.empty((count, 4, 2)), np.empty((count, 4, 2, 2)), np.empty((count, 8, 8))
    reached = np.empty(count, dtype=np.bool_)
    arrays = [(corners, 64), (rays, 64), (by_ray, 128), (whitener, 512), (reached, 1)]
    into, *out = [(address(array), size) for array, size in arrays]
    spread = 0 if covariance is None else address(covariance)
    for lens, start, own in zip(lenses, ends, counts, strict=False):
        status = kernel(
            lens.struct, own, into[0] + into[1] * start, None if covariance is None else spread + 512 * start,
            floor_px, reached_px, *[first + size * start for first, size in out],
        )  # fmt: skip
        if status:
            raise np.linalg.LinAlgError("a covariance of corners is not positive definite")
    return rays, by_ray, whitener, reached


def corners_through_lens_numpy(
    lens: Lens, corners: Array, covariance: Array | None, floor_px: float, reached_px: float
) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Definition of :func:`corners_through_lens`."""
    pixels = corners.reshape(-1, 2)
    with np.errstate(all="ignore"):
        rays = np.nan_to_num(unproject(lens, pixels), posinf=0.0, neginf=0.0)
        back, J = project(lens, rays)
        reached = (((back - pixels) ** 2).sum(axis=1) < reached_px**2).reshape(-1, 4).all(axis=1)
    by_ray = J.reshape(-1, 4, 2, 2)
    C = (0.0 if covariance is None else covariance) + floor_px**2 * np.eye(8)
    inverse = np.linalg.inv(np.linalg.cholesky(np.broadcast_to(C, (len(corners), 8, 8))))
    whitener = (inverse.reshape(-1, 8, 4, 1, 2) @ by_ray[:, None]).reshape(-1, 8, 8)
    return rays.reshape(-1, 4, 2), by_ray, whitener, reached


def project(lens: Lens, rays: Array) -> tuple[Array, Array]:
    """Pixels (N,2) of rays (N,2), and their derivatives (N,2,2)."""
    return (_project_fisheye if lens.fisheye else _project_rational)(lens, rays)


def unproject(lens: Lens, pixels: Array) -> Array:
    """Rays (N,2) of pixels (N,2)."""
    return (_unproject_fisheye if lens.fisheye else _unproject_rational)(lens, pixels)


def _focal(lens: Lens) -> tuple[Array, Array]:
    return lens.K[[0, 1], [0, 1]], lens.K[:2, 2]


def _project_rational(lens: Lens, rays: Array) -> tuple[Array, Array]:
    k, (a, b), (f, c) = lens.k, rays.T, _focal(lens)
    r2 = a * a + b * b
    under = 1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
    radial = (1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))) / under
    d_over, d_under = k[0] + r2 * (2 * k[1] + r2 * 3 * k[4]), k[5] + r2 * (2 * k[6] + r2 * 3 * k[7])
    change = (d_over - radial * d_under) / under
    x = a * radial + 2 * k[2] * a * b + k[3] * (r2 + 2 * a * a) + r2 * (k[8] + r2 * k[9])
    y = b * radial + k[2] * (r2 + 2 * b * b) + 2 * k[3] * a * b + r2 * (k[10] + r2 * k[11])
    prism_x, prism_y = k[8] + 2 * k[9] * r2, k[10] + 2 * k[11] * r2
    mixed = 2 * a * b * change + 2 * k[2] * a + 2 * k[3] * b
    distorted = _matrices(
        radial + 2 * a * a * change + 2 * k[2] * b + 6 * k[3] * a + 2 * a * prism_x,
        mixed + 2 * b * prism_x,
        mixed + 2 * a * prism_y,
        radial + 2 * b * b * change + 6 * k[2] * b + 2 * k[3] * a + 2 * b * prism_y,
    )
    tilted = np.stack([x, y, np.ones_like(x)], axis=1) @ lens.tilt.T
    depth = np.where(tilted[:, 2:] == 0, 1.0, tilted[:, 2:])
    uv = tilted[:, :2] / depth
    by_tilt = (lens.tilt[:2, :2] - uv[:, :, None] * lens.tilt[2, :2]) / depth[:, :, None]
    return np.asarray(uv * f + c), np.asarray(f[:, None] * (by_tilt @ distorted))


def _project_fisheye(lens: Lens, rays: Array) -> tuple[Array, Array]:
    (a, b), (f, c) = rays.T, _focal(lens)
    r = np.sqrt(a * a + b * b)
    distorted, slope = _equidistant(lens.k, np.arctan(r))
    scale = np.where(r > 1e-8, distorted / r, 1.0)
    change = np.where(r > 1e-8, (slope / (1 + r * r) - scale) / (r * r), 0.0)
    J = _matrices(scale + change * a * a, change * a * b, change * a * b, scale + change * b * b)
    return f * scale[:, None] * rays + c, f[:, None] * J


def _equidistant(k: Array, theta: Array) -> tuple[Array, Array]:
    """Image radius of an angle from the axis, and the derivative."""
    t2 = theta * theta
    distorted = theta * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))))
    return distorted, 1 + t2 * (3 * k[0] + t2 * (5 * k[1] + t2 * (7 * k[2] + t2 * 9 * k[3])))


def _unproject_rational(lens: Lens, pixels: Array) -> Array:
    k, (f, c) = lens.k, _focal(lens)
    uv = (pixels - c) / f
    straight = np.column_stack([uv, np.ones(len(uv))]) @ np.linalg.inv(lens.tilt).T
    start = straight[:, :2] / np.where(straight[:, 2:] == 0, 1.0, straight[:, 2:])
    rays, running = start.copy(), np.ones(len(uv), dtype=bool)
    error, nearing = np.full(len(uv), np.inf), running.copy()
    there, J = pixels, np.zeros((len(uv), 2, 2))
    for _ in range(ITERATIONS):
        x, y = rays.T
        r2 = x * x + y * y
        back = (1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))) / (1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4])))
        dx = 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x) + r2 * (k[8] + r2 * k[9])
        dy = k[2] * (r2 + 2 * y * y) + 2 * k[3] * x * y + r2 * (k[10] + r2 * k[11])
        moved = (start - np.column_stack([dx, dy])) * back[:, None]
        moved[back < 0] = uv[back < 0]
        stepping = running & nearing & (error < NEAR_PX)
        moved[stepping] = rays[stepping] + _newton(J[stepping], (pixels - there)[stepping])
        back[stepping] = 1.0
        now, by_ray = _project_rational(lens, moved)
        off = np.linalg.norm(now - pixels, axis=1)
        # A step that does not reduce the error is not used, and ends the iteration.
        nearing &= ~stepping | (off < error)
        taken = running & (~stepping | nearing)
        rays = np.where(taken[:, None], moved, rays)
        error, there = np.where(taken, off, error), np.where(taken[:, None], now, there)
        J = np.where(taken[:, None, None], by_ray, J)
        running &= ~(back < 0) & ~(error < PRECISION)
        if not running.any():
            break
    return np.asarray(rays)


def _newton(J: Array, off: Array) -> Array:
    """Steps (N,2) that cancel errors (N,2) with derivatives (N,2,2)."""
    (a, b), (c, d) = J.transpose(1, 2, 0)
    u, v = off.T
    return np.asarray(np.stack([d * u - b * v, a * v - c * u], axis=1) / (a * d - b * c)[:, None])


def _unproject_fisheye(lens: Lens, pixels: Array) -> Array:
    f, c = _focal(lens)
    uv = (pixels - c) / f
    distorted = np.minimum(np.linalg.norm(uv, axis=1), np.pi / 2)
    theta, converged = distorted.copy(), distorted <= 1e-8
    for _ in range(ITERATIONS):
        value, slope = _equidistant(lens.k, theta)
        step = np.where(converged, 0.0, (value - distorted) / slope)
        theta = theta - step
        converged |= np.abs(step) < PRECISION
        if converged.all():
            break
    scale = np.where(distorted > 1e-8, np.tan(theta) / np.where(distorted > 1e-8, distorted, 1.0), 1.0)
    return np.where((converged & (theta >= 0))[:, None], uv * scale[:, None], UNREACHED)


def _matrices(a: Array, b: Array, c: Array, d: Array) -> Array:
    return np.stack([a, b, c, d], axis=1).reshape(-1, 2, 2)


def _tilt(x: float, y: float) -> Array:
    """(3,3) of a sensor tilted about two axes (Scheimpflug), as in OpenCV."""
    (cx, sx), (cy, sy) = (np.cos(x), np.sin(x)), (np.cos(y), np.sin(y))
    R = np.array([[cy, 0, -sy], [0, 1, 0], [sy, 0, cy]]) @ np.array([[1, 0, 0], [0, cx, sx], [0, -sx, cx]])
    return np.asarray(np.array([[R[2, 2], 0, -R[0, 2]], [0, R[2, 2], -R[1, 2]], [0, 0, 1]]) @ R)


@lru_cache(maxsize=1)
def _kernel() -> Any:
    pointer, number = ctypes.c_void_p, ctypes.c_double
    return function(
        "lmkit_corners_through_lens", ctypes.POINTER(_LensStruct), ctypes.c_int64, pointer, pointer, number, number,
        *[pointer] * 4,
    )  # fmt: skip
