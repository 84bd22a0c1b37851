"""Samples of a rectified print in linear light, for any drawing: cells, inks relative to white, and edges.

The print is sampled on a grid in its own plane.  Cells well inside one ink give its color, and
their scatter the unevenness; the edges of the border give straightness and sharpness.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from lmkit.arrays import AnyArray, BoolArray, ByteArray, FloatArray
from lmkit.geometry.homography import homography_from_points, transform_points
from lmkit.model.palette import SRGB_TO_LINEAR

CELLS = 240  # across face and white margin
PURE = 0.985  # least coverage of a cell that shows one ink only
NEARLY_PURE = 0.9  # used if blur leaves fewer than LEAST_CELLS pure cells
LEAST_CELLS = 400
FINE_SIDE_PX = 120.0  # in smaller images, fine lines of the print are not visible
EDGE_STEPS = 41
FINE_EDGE_STEPS = 161  # to localize an edge
EDGE_REACH = 0.045  # of the side, on both sides of the border's outer edge
EDGE_POINTS = 48  # along each side of the border
BEYOND = 1.3  # largest extrapolated light outside the white cells, over the light inside
WHITE_ENOUGH = 0.7
GLARE_SHARE = 0.45  # of the difference from an ink to white
SQUARE = np.array([[-1.0, 1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]])
NORMALS = ((0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0))  # of the sides: top, right, bottom, left


def points_of_plane(reach_mm: float) -> FloatArray:
    """(CELLS^2,2) mm, row by row from the top left: middles of the cells, as far as ``reach_mm`` from the center."""
    ticks = (np.arange(CELLS) + 0.5) / CELLS * 2 * reach_mm - reach_mm
    x, y = np.meshgrid(ticks, -ticks)
    return np.column_stack([x.ravel(), y.ravel()])


def margin_share(relative: FloatArray, points: FloatArray, half_mm: float, margin_mm: float) -> float:
    """Share of the white margin around the border that is white."""
    square = np.abs(points).max(axis=1)
    margin = (square > half_mm + 0.15 * margin_mm) & (square < half_mm + 0.9 * margin_mm)
    return float((relative[margin].min(axis=1) > WHITE_ENOUGH).mean())


def pure_cells(coverage: FloatArray, on_face: BoolArray) -> BoolArray:
    """Cells of the face that show one ink only, or nearly."""
    pure = on_face & (coverage > PURE)
    return pure if pure.sum() >= LEAST_CELLS else np.asarray(on_face & (coverage > NEARLY_PURE))


def light_at(image: ByteArray, H: FloatArray, points: FloatArray, side_px: float) -> FloatArray:
    """(N,3) RGB in linear light at points of the landmark's plane, averaged over a cell's width."""
    at = transform_points(H, points).astype(np.float32)
    linear: AnyArray = SRGB_TO_LINEAR[image]
    if (cell_px := side_px / CELLS) > 1.5:
        size = 2 * round(cell_px / 2) + 1
        linear = cv2.blur(linear, (size, size))
    # remap accepts images of less than 2^15 rows.
    seen = [cv2.remap(linear, some[:, :1], some[:, 1:], cv2.INTER_LINEAR) for some in np.array_split(at, 8)]
    return np.concatenate(seen).reshape(-1, 3)[:, ::-1].astype(np.float64)


def white_everywhere(points: FloatArray, colors: FloatArray, white: BoolArray) -> FloatArray:
    """(N,3) appearance of white everywhere: a curved surface through the cells that show only white."""
    x, y = points.T / 90
    terms = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    weights = white.astype(np.float64)
    fitted = np.zeros_like(colors)
    for _ in range(4):
        root = np.sqrt(weights)[:, None]
        coefficients = np.linalg.lstsq(terms * root, colors * root, rcond=None)[0]
        fitted = terms @ coefficients
        off = np.abs(colors - fitted).mean(axis=1) / np.maximum(fitted.mean(axis=1), 1e-3)
        # Glare and dirt do not show the light.
        weights = white / (1 + (off / 0.05) ** 2)
    # If blur leaves white only in the rings, the surface diverges outside them.
    low, high = np.percentile(colors[white], [5, 95], axis=0)
    return np.clip(fitted, np.maximum(low / BEYOND, 1e-3), high * BEYOND)


def brightness(colors: FloatArray) -> FloatArray:
    """(N,) of (N,3) RGB in linear light."""
    return np.asarray(colors @ np.array([0.2126, 0.7152, 0.0722]))


def contrast_of(relative: FloatArray, ink: BoolArray) -> float:
    """1 - brightness of an ink over the brightness of the white around it."""
    return float(1 - np.median(brightness(relative[ink])))


def unevenness_of(relative: FloatArray, points: FloatArray, inks: Sequence[BoolArray]) -> float:
    """Largest scatter over contrast of an ink, of cells averaged over 3 x 3, without the fitted light."""
    worst = 0.0
    x, y = points.T / 90
    terms = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    smooth = cv2.blur(brightness(relative).reshape(CELLS, CELLS), (3, 3)).ravel()
    for ink in inks:
        inner = cv2.erode(ink.reshape(CELLS, CELLS).astype(np.uint8), np.ones((3, 3), np.uint8)).ravel() > 0
        if inner.sum() < 200:
            continue
        coefficients = np.linalg.lstsq(terms[inner], smooth[inner], rcond=None)[0]
        off = smooth[inner] - terms[inner] @ coefficients
        contrast = max(1 - float(np.median(smooth[inner])), 0.05)
        # Between the 2nd and the 98th percentile: streaks are rare, grain is everywhere.
        low, high = np.percentile(off, [2, 98])
        worst = max(worst, float(high - low) / contrast)
    return worst


def glare_share(relative: FloatArray, inks: Sequence[BoolArray]) -> float:
    """Share of the inked cells that shine like white."""
    shining = 0
    for ink in inks:
        seen = brightness(relative[ink])
        middle = float(np.median(seen))
        shining += int((seen > middle + GLARE_SHARE * (1 - middle)).sum())
    return shining / sum(int(ink.sum()) for ink in inks)


def corners_of_border(image: ByteArray, corners: FloatArray, half_mm: float) -> FloatArray:
    """(4,2) corners of a dark border on white, px: intersections of lines along its outer edges.

    Args:
        corners: (4,2) with errors up to 0.02 of the side, px, clockwise.
        half_mm: half of the side between the corners.
    """
    H = homography_from_points(half_mm * SQUARE, corners)
    lines = []
    for normal in NORMALS:
        edge = _edge(image, H, half_mm, normal, FINE_EDGE_STEPS)
        # Outside a narrow margin the image may be dark again.
        rising = np.maximum.accumulate(edge.step, axis=1)
        place = _places(rising, edge.across)[edge.is_fair]
        along = edge.along[edge.is_fair]
        for _ in range(3):
            slope, offset = np.polyfit(along, place, 1)
            off = np.abs(place - offset - slope * along)
            kept = off <= max(3 * float(np.median(off)), 1e-3)
            along, place = along[kept], place[kept]
        n, t = np.array(normal), np.array([normal[1], -normal[0]])
        lines.append((n - slope * t, half_mm + offset))
    # Top, right, bottom, left; the corners begin at the top left.
    pairs = ((lines[k - 1], lines[k]) for k in range(4))
    met = np.array([np.linalg.solve([a[0], b[0]], [a[1], b[1]]) for a, b in pairs])
    return transform_points(H, met)


class _Edge(NamedTuple):
    """Profiles across one side of the border.

    Attributes:
        along, across: (EDGE_POINTS,), (steps,) mm: along the side, and outward from its nominal place.
        place: (EDGE_POINTS,) position of the edge, mm outward.
        step: (EDGE_POINTS,steps) brightness, 0 in the border, 1 on the white.
        is_fair: (EDGE_POINTS,) profiles with enough contrast.
    """

    along: FloatArray
    across: FloatArray
    place: FloatArray
    step: FloatArray
    is_fair: BoolArray


def _edge(image: ByteArray, H: FloatArray, half: float, normal: tuple[float, float], steps: int) -> _Edge:
    along = np.linspace(-0.9, 0.9, EDGE_POINTS) * half
    across = np.linspace(-EDGE_REACH, EDGE_REACH, steps) * 2 * half
    n, t = np.array(normal), np.array([normal[1], -normal[0]])
    grid = (half + across)[None, :, None] * n + along[:, None, None] * t
    at = transform_points(H, grid.reshape(-1, 2)).astype(np.float32)
    low, high = np.floor(at.min(axis=0)).astype(int) - 1, np.ceil(at.max(axis=0)).astype(int) + 2
    low = np.clip(low, 0, np.array(image.shape[1::-1]) - 1)
    green = SRGB_TO_LINEAR[image[low[1] : max(high[1], low[1] + 1), low[0] : max(high[0], low[0] + 1), 1]]
    x, y = (at - low.astype(np.float32)).T
    seen = cv2.remap(green, x[:, None], y[:, None], cv2.INTER_LINEAR).reshape(EDGE_POINTS, steps)
    dark, bright = np.percentile(seen, 5, axis=1), np.percentile(seen, 95, axis=1)
    fair = bright - dark > 0.4 * np.median(bright - dark)
    step = (seen - dark[:, None]) / np.maximum(bright - dark, 1e-6)[:, None]
    return _Edge(along, across, _places(step, across), step, fair)


def _places(step: FloatArray, across: FloatArray) -> FloatArray:
    """(N,) positions of the edges of (N,steps) profiles, from the areas under the profiles."""
    level = np.clip(step, 0, 1)
    area = (level.sum(axis=1) - (level[:, 0] + level[:, -1]) / 2) / (len(across) - 1)
    return np.asarray(across[-1] - area * (across[-1] - across[0]))


def bow_and_blur(image: ByteArray, H: FloatArray, half: float) -> tuple[float, float]:
    """(bow, blur) of the border's outer edge, over the side; in the green channel, where red and black are dark."""
    places, sigmas = [], []
    for normal in NORMALS:
        edge = _edge(image, H, half, normal, EDGE_STEPS)
        fair = edge.is_fair
        place = edge.place - np.median(edge.place[fair])
        slope = np.polyfit(edge.along[fair], place[fair], 1)
        places.append((place - np.polyval(slope, edge.along))[fair])
        rising = np.maximum.accumulate(np.median(edge.step[fair], axis=0))
        low, high = (float(np.interp(level, rising, edge.across)) for level in (0.16, 0.84))
        sigmas.append((high - low) / 2)
    bow = float(np.sqrt(np.mean([np.mean(np.clip(p, -0.05 * half, 0.05 * half) ** 2) for p in places]))) / (2 * half)
    return bow, float(np.median(sigmas)) / (2 * half)
