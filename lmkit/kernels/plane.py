"""From pixels to the landmark's plane: homography of four corners, unknown lens, point spread, light.

A state is (15,): four corners x0 y0 x1 y1 ... (px), covariance of the point spread xx xy yy (px^2), radial
distortion, relative change of the light from the center to the right and to the upper edge, mixed-pixel bias.
`plane.h` has the same for the kernels.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating[Any]]

STATE = 15
DISTORT_STEPS = 6  # of Newton


class _View(NamedTuple):
    """See `View`.

    Attributes:
        origin: (2,) px, whole numbers near the landmark; pixel positions are relative to it.
        center: (2,) px, about which the radial distortion is.
        half_width: distance from the center, px, that normalizes the distortion.
        half_mm: half side of the landmark's face.
        pixel_variance: of a pixel's box, px^2.
    """

    origin: FloatArray
    center: FloatArray
    half_width: float
    half_mm: float
    pixel_variance: float = 1 / 12


class View(_View):
    """The image's geometry for a registration: origin, center, half width, half side and pixel, as in `_View`."""

    @cached_property
    def flat(self) -> FloatArray:
        """The data in the order of `plane.h`."""
        return np.array([*self.origin, *self.center, self.half_width, self.half_mm, self.pixel_variance])


def homography_numpy(corners: FloatArray, half: float) -> FloatArray:
    """(3,3) homography from the landmark's plane to (4,2) corners (Heckbert 1989)."""
    (x0, y0), (x1, y1), (x2, y2), (x3, y3) = corners
    dx1, dx2, sx = x1 - x2, x3 - x2, x0 - x1 + x2 - x3
    dy1, dy2, sy = y1 - y2, y3 - y2, y0 - y1 + y2 - y3
    det = dx1 * dy2 - dx2 * dy1
    g, h = (sx * dy2 - sy * dx2) / det, (dx1 * sy - dy1 * sx) / det
    M = np.array([[x1 - x0 + g * x1, x3 - x0 + h * x3, x0], [y1 - y0 + g * y1, y3 - y0 + h * y3, y0], [g, h, 1]])
    return np.asarray(M @ np.array([[0.5 / half, 0, 0.5], [0, -0.5 / half, 0.5], [0, 0, 1]]))


def plane_numpy(
    view: View, state: FloatArray, at: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """(N,2) positions in the landmark's plane, (N,3) point spread there, (N,2,2) d plane / d pixel, (N,2)
    distortion's direction, for (N,2) pixels relative to the view's origin."""
    inverse = np.linalg.inv(homography_numpy(state[:8].reshape(4, 2) - view.origin, view.half_mm))
    displacement, radial, _ = displaced_numpy(view, state[11], at)
    h = (at + displacement) @ inverse[:, :2].T + inverse[:, 2]
    points = h[:, :2] / h[:, 2:]
    A = (inverse[None, :2, :2] - points[:, :, None] * inverse[None, 2:, :2]) / h[:, 2, None, None]
    spread = spread_in_plane(A, state[8] + view.pixel_variance, state[9], state[10] + view.pixel_variance)
    return points, spread, A, radial


def displaced_numpy(view: View, distortion: float, at: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(N,2) displacement of (N,2) pixels, relative to the view's origin, from the image to one without distortion.

    The lens is ``o (k r^2 + k^2 r^4)`` about the image's center, o from there and r = 1 at half the width, the first
    terms of the division model ``o / (1 - k r^2)`` (Fitzgibbon 2001).  Its affine part at the origin is omitted: it
    would move the corners by many pixels when k moves, so that a few steps of a fit could not follow.

    Returns:
        The displacement, its (N,2) slope with the distortion and its (N,2,2) slopes with the pixels.
    """
    center, scale = view.origin - view.center, 1 / view.half_width**2
    r2 = center @ center * scale
    near = np.sum(at**2, axis=1, keepdims=True) * scale
    grown = near + 2 * scale * (at @ center)[:, None]
    more_near, more = distortion * (grown**2 + 2 * r2 * near), distortion * (grown**2 + 2 * r2 * grown)
    displacement = distortion * (center * (near + more_near) + at * (grown + more))
    by_distortion = center * (near + 2 * more_near) + at * (grown + 2 * more)
    d_near, d_grown = 2 * scale * at, 2 * scale * (center + at)
    by_near = d_near + 2 * distortion * (grown * d_grown + r2 * d_near)
    by_grown = d_grown + 2 * distortion * (grown + r2) * d_grown
    by_at = center[:, None] * by_near[:, None, :] + at[:, :, None] * by_grown[:, None, :]
    return displacement, by_distortion, distortion * (by_at + (grown + more)[:, :, None] * np.eye(2))


def distorted_numpy(view: View, distortion: float, flat: FloatArray) -> FloatArray:
    """(N,2) pixels of the image from those without distortion: the inverse of ``x + displacement``."""
    if distortion == 0.0:
        return flat
    start = flat - view.origin
    at = start
    for _ in range(DISTORT_STEPS):
        displacement, _, by_at = displaced_numpy(view, distortion, at)
        J = np.eye(2) + by_at
        det = np.maximum(J[:, 0, 0] * J[:, 1, 1] - J[:, 0, 1] * J[:, 1, 0], 0.05)
        x, y = (at + displacement - start).T
        step = (J[:, 1, 1] * x - J[:, 0, 1] * y, J[:, 0, 0] * y - J[:, 1, 0] * x)
        at = at - np.stack(step / det, axis=1)
    return np.asarray(at + view.origin)


def light_numpy(view: View, state: FloatArray, points: FloatArray) -> FloatArray:
    """(N,) relative light at points of the landmark's plane."""
    return np.asarray(np.maximum(1 + points / view.half_mm @ state[12:14], 0.1))


def spread_in_plane(A: FloatArray, xx: float, xy: float, yy: float) -> FloatArray:
    """(N,3) covariance in the landmark's plane, mm^2, of one in px^2, from (N,2,2) d plane / d pixel."""
    a, b, c, d = A[:, 0, 0], A[:, 0, 1], A[:, 1, 0], A[:, 1, 1]
    sxx = a * a * xx + 2 * a * b * xy + b * b * yy
    sxy = a * c * xx + (a * d + b * c) * xy + b * d * yy
    syy = c * c * xx + 2 * c * d * xy + d * d * yy
    return np.column_stack([sxx, sxy, syy])
