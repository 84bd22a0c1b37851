"""The sheet around a landmark from its four edges, for backgrounds that no threshold separates from the sheet.

The landmark gives the plane, so the sheet's edges run along its axes at unknown distances.  Steps in
brightness are searched along lines on each side of the landmark; four of them that form a known sheet
are fitted to the image, and must be visible over their whole length, with white paper inside.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np

from lmkit.arrays import FloatArray
from lmkit.geometry.homography import transform_points

OUTWARDS = np.array([[-1.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])  # left, right, top, bottom
ROWS = 40
FARTHEST = 5.0  # sides of the landmark, from its center
SLOPES = np.tan(np.deg2rad(np.arange(-1.8, 1.81, 0.3)))
STEP_PX = 3  # on both sides of an edge
FULL_STEP = 0.15  # of white: larger steps get no more support
LEAST_SUPPORT = 0.25
EDGES, QUADS = 10, 16
PARALLEL = np.tan(np.deg2rad(1.0))
WHITE = (0.55, 1.6)  # of the white beside the border, for uneven light
WHITE_SHARE = 0.8  # of the strip inside a side, where rulers and texts may be printed
RIM_PX = (2.0, 2.75, 3.5)  # on both sides of an edge
LEAST_STEP = 0.08  # of white, from the paper to the background
OTHER_SHARE = 0.75  # least visible share of a side; a ruler covers up to 0.7


@dataclass(frozen=True)
class _Edge:
    """A straight step at a distance from the landmark's center (mm), with its slope and support 0..1."""

    at: float
    slope: float
    support: float


def sheet_quads(
    light: FloatArray, to_px: FloatArray, half_mm: float, sheets_mm: Sequence[tuple[float, float]], off: float
) -> Iterator[FloatArray]:
    """(4,2) px outlines that may be one of the sheets, likeliest first, clockwise from the top left.

    Args:
        light: (H,W) linear brightness.
        to_px: (3,3) from the landmark's plane, mm, to the image.
        sheets_mm: (width, height) of the sheets looked for.
        off: largest relative error of a print's scale.
    """
    white = _white(light, to_px, half_mm)
    left, right, top, bottom = (_edges(light, to_px, half_mm, n, white) for n in OUTWARDS)
    found: list[tuple[float, FloatArray]] = []
    upright = [p for p in product(left, right) if abs(p[0].slope - p[1].slope) < PARALLEL]
    level = [p for p in product(top, bottom) if abs(p[0].slope - p[1].slope) < PARALLEL]
    for (a, b), (c, d) in product(upright, level):
        width, height = a.at + b.at, c.at + d.at
        if any(
            abs(w / width - 1) < off and abs(h / height - 1) < off and abs(w * height / (h * width) - 1) < 0.03
            for w, h in sheets_mm
        ):
            found.append((a.support + b.support + c.support + d.support, _corners(a, b, c, d)))
    found.sort(key=lambda item: -item[0])
    for _, mm in found[:QUADS]:
        yield transform_points(to_px, mm)


def is_sheet(light: FloatArray, to_px: FloatArray, half_mm: float, quad: FloatArray) -> bool:
    """Whether a quad (px) has paper as white as around the border just inside all four sides, and no paper outside.

    Lines printed along the sheet, such as rulers and crop marks, have paper on both sides.
    """
    white = _white(light, to_px, half_mm)
    along = np.linspace(0.04, 0.96, 80)[:, None]
    for a, b in zip(quad, np.roll(quad, -1, axis=0), strict=True):
        side, inward = a + along * (b - a), np.array([a[1] - b[1], b[0] - a[0]]) / np.linalg.norm(b - a)
        inside, outside = (
            np.median([_sample(light, side + sign * s * inward) for s in RIM_PX], axis=0) for sign in (1, -1)
        )
        if np.mean((inside > WHITE[0] * white) & (inside < WHITE[1] * white)) < WHITE_SHARE:
            return False
        seen = outside >= 0
        if np.mean(seen & (np.abs(outside - inside) > LEAST_STEP * white)) < OTHER_SHARE * seen.mean():
            return False
    return True


def _sample(light: FloatArray, at: FloatArray) -> FloatArray:
    at = at.astype(np.float32)
    seen = cv2.remap(
        light, at[..., :1], at[..., 1:], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=-1
    )
    return np.asarray(seen.reshape(at.shape[:-1]), dtype=np.float64)


def _white(light: FloatArray, to_px: FloatArray, half_mm: float) -> float:
    """Brightness of the white margin around the border."""
    ring = np.linspace(-1, 1, 60)[:, None] * half_mm
    reach = half_mm * 1.06
    points = np.concatenate([np.hstack([ring, np.full_like(ring, s * reach)]) for s in (-1, 1)])
    points = np.concatenate([points, points[:, ::-1]])
    return float(np.median(_sample(light, transform_points(to_px, points))))


def _edges(light: FloatArray, to_px: FloatArray, half: float, n: FloatArray, white: float) -> list[_Edge]:
    """Steps outside one side of the landmark, best first."""
    t = np.array([-n[1], n[0]])
    rim = transform_points(to_px, np.array([n * half, n * half * 1.02]))
    per_mm = float(np.linalg.norm(rim[1] - rim[0])) / (0.02 * half)
    # Perspective changes the size of pixels with distance; steps of half a pixel here are fine enough farther out.
    distances = np.arange(half * 1.05, FARTHEST * 2 * half, 0.5 / per_mm)
    rows = np.linspace(-0.95, 0.95, ROWS) * half
    points = distances[None, :, None] * n + rows[:, None, None] * t
    seen = _sample(light, transform_points(to_px, points.reshape(-1, 2)).reshape(points.shape))
    inside = (seen >= 0).mean(axis=0) > 0.8
    if inside.sum() < 8 * STEP_PX:
        return []
    seen, distances = seen[:, inside], distances[inside]
    step = 2 * STEP_PX
    sums = np.cumsum(np.pad(seen, ((0, 0), (1, 0))), axis=1)
    means = (sums[:, step:] - sums[:, :-step]) / step
    change = np.abs(means[:, step:] - means[:, :-step]) / white
    # Support: half for a step, half for its height; the highest step is the edge.
    response = (np.clip(change / FULL_STEP, 0, 1) + np.clip(change, 0, 1)) / 2
    at = distances[step - 1 : step - 1 + response.shape[1]] + 0.25 / per_mm
    pitch = 0.5 / per_mm
    best = np.zeros(response.shape[1])
    slopes = np.zeros(response.shape[1])
    columns = np.arange(response.shape[1])
    for slope in SLOPES:
        moved = columns[None, :] + np.round(slope * rows / pitch).astype(int)[:, None]
        support = np.take_along_axis(response, np.clip(moved, 0, response.shape[1] - 1), axis=1).mean(axis=0)
        better = support > best
        best[better], slopes[better] = support[better], slope
    edges: list[_Edge] = []
    for k in np.argsort(-best):
        if best[k] < LEAST_SUPPORT or len(edges) == EDGES:
            break
        if all(abs(edge.at - at[k]) > 2 * step * pitch for edge in edges):
            edges.append(_Edge(float(at[k]), float(slopes[k]), float(best[k])))
    return edges


def _corners(left: _Edge, right: _Edge, top: _Edge, bottom: _Edge) -> FloatArray:
    """(4,2) mm, from the top left clockwise, where the four lines meet."""
    lines = []
    for edge, n in zip((left, right, top, bottom), OUTWARDS, strict=True):
        t = np.array([-n[1], n[0]])
        lines.append((n - edge.slope * t, edge.at))
    order = ((0, 2), (1, 2), (1, 3), (0, 3))
    return np.array([np.linalg.solve([lines[i][0], lines[j][0]], [lines[i][1], lines[j][1]]) for i, j in order])
