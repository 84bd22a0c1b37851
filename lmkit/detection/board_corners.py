"""Corners where four squares meet, to a few hundredths of a pixel: weighted mean of three localizers.

The detector's corners, OpenCV's gradient-based ones and the saddle of a fitted quadratic have different errors.  A
lens distorts a flat board smoothly, so the residual of a localizer's corners after fitting a homography and a
polynomial of low degree is its noise in this image; the weights follow from this noise
(docs/decisions/0005-board-corners.md).
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from lmkit.arrays import ByteArray, Float32Array, FloatArray
from lmkit.geometry.homography import transform_points

GRADIENT_WINDOW = 0.4  # half width of the windows, in sides of the smallest square
SADDLE_WINDOW = 0.3
HALF_PX = (2, 12)
SADDLE_STEPS = 8
SLIP = 0.15  # of a square (and half a pixel): with a larger distance, a localizer has found another corner
_GRADIENT_STOP = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 60, 1e-4)


def refine_corners(
    gray: ByteArray, corners: FloatArray, board_points: FloatArray, square: float, clear: float = 0.5
) -> tuple[FloatArray, float]:
    """(N,2) corners refined, and the standard deviation of one coordinate, px.

    Args:
        gray: (H,W) image.
        corners: (N,2) as detected, px.
        board_points: (N,2) the same on the board.
        square: side of the board's squares, in the unit of ``board_points``.
        clear: radius around a corner in which only its four squares are drawn, in sides of a square.
    """
    side_px = _smallest_side(corners, board_points, square)
    gradient = _by_gradients(gray, corners, _half_window(min(GRADIENT_WINDOW, clear) * side_px))
    saddle = _by_saddles(gray, corners, _half_window(min(SADDLE_WINDOW, clear) * side_px))
    seen = [corners]
    for other in (gradient, saddle):
        slipped = np.linalg.norm(other - corners, axis=1, keepdims=True) > SLIP * side_px + 0.5
        seen.append(np.where(slipped, corners, other))
    noise = np.array([corner_noise(points, board_points) for points in seen])
    weights = 1 / np.maximum(noise, 1e-3) ** 2
    fused = np.tensordot(weights / weights.sum(), np.array(seen), 1)
    return fused, corner_noise(fused, board_points)


def corner_noise(corners: FloatArray, board_points: FloatArray) -> float:
    """Standard deviation, px, of residuals of (N,2) corners of a flat board to a homography and a polynomial."""
    H, _ = cv2.findHomography(board_points, corners, 0)
    if H is None:
        return np.inf
    left = corners - transform_points(np.asarray(H, dtype=np.float64), board_points)
    spread = board_points - board_points.mean(axis=0)
    x, y = (spread / np.abs(spread).max()).T
    # As many terms as the corners determine.
    degree = 3 if len(corners) >= 30 else 2 if len(corners) >= 16 else 0
    terms = np.column_stack([x**a * y**b for a in range(degree + 1) for b in range(degree + 1 - a)])
    left = left - terms @ np.linalg.lstsq(terms, left, rcond=None)[0]
    # Of the polynomial's numbers, all but the second degree's are the homography's too.
    unknowns = max(2 * terms.shape[1], 8)
    return float(np.sqrt((left**2).sum() / max(left.size - unknowns, 1)))


def _smallest_side(corners: FloatArray, board_points: FloatArray, square: float) -> float:
    """The least distance in the image of corners that are neighbors on the board, px."""
    apart = np.linalg.norm(board_points[:, None] - board_points[None], axis=2)
    a, b = np.nonzero(np.triu(np.abs(apart / square - 1) < 0.01))
    return float(np.linalg.norm(corners[a] - corners[b], axis=1).min()) if len(a) else 0.0


def _half_window(px: float) -> int:
    return int(np.clip(px, *HALF_PX))


def _by_gradients(gray: ByteArray, corners: FloatArray, half: int) -> FloatArray:
    """The point to which all gradients around it are perpendicular (Foerstner and Guelch 1987)."""
    refined = np.ascontiguousarray(corners, dtype=np.float32).reshape(-1, 1, 2)
    cv2.cornerSubPix(gray, refined, (half, half), (-1, -1), _GRADIENT_STOP)
    return refined.reshape(-1, 2).astype(np.float64)


def _by_saddles(gray: ByteArray, corners: FloatArray, half: int) -> FloatArray:
    """The saddle of the quadratic that fits the smoothed image around each corner (Lucchese and Mitra 2002)."""
    smooth: Float32Array = cv2.GaussianBlur(gray.astype(np.float32), (0, 0), max(0.7, half / 3)).astype(np.float32)
    y, x = np.mgrid[-half : half + 1, -half : half + 1].reshape(2, -1)
    fit = _quadratic_fit(half)
    points = corners.copy()
    for _ in range(SADDLE_STEPS):
        at_x, at_y = (points[:, :1] + x).astype(np.float32), (points[:, 1:] + y).astype(np.float32)
        seen = cv2.remap(smooth, at_x, at_y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        xx, xy, yy, gx, gy, _ = (seen @ fit.T).T.astype(np.float64)
        curvature = 4 * xx * yy - xy**2
        is_saddle = curvature < 0
        step = np.column_stack([xy * gy - 2 * yy * gx, xy * gx - 2 * xx * gy])
        step = np.where(is_saddle[:, None], step / np.where(is_saddle, curvature, 1)[:, None], 0)
        points += np.clip(step, -1, 1)
        if np.abs(step).max() < 1e-3:
            break
    return points


@lru_cache(maxsize=16)
def _quadratic_fit(half: int) -> FloatArray:
    """(6,W) matrix from a window's pixels to x^2, xy, y^2, x, y, 1 of the quadratic, near pixels weighing more."""
    y, x = np.mgrid[-half : half + 1, -half : half + 1].reshape(2, -1).astype(np.float64)
    root = np.exp(-(x**2 + y**2) / (half / 1.5) ** 2 / 4)
    terms = np.column_stack([x**2, x * y, y**2, x, y, np.ones_like(x)])
    return np.asarray(np.linalg.pinv(terms * root[:, None]) * root)
