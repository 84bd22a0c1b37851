"""Fast screening of squares before registration: white must surround a dark border most of the way around.

Twenty pairs of points, one in the white margin and one in the adjacent border, are compared in linear light.  The
points of a pair are so close that they have the same light, so a shadow across the marker affects only the few pairs
on its edge. The border must also be about equally dark everywhere.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from lmkit.arrays import BoolArray, ByteArray, FloatArray
from lmkit.detection.shadows import ShadowEdge
from lmkit.geometry.homography import homographies_from_points
from lmkit.model.palette import SRGB_TO_LINEAR
from lmkit.model.square_marker import SquareMarkerFamily

ALONG = (-0.8, -0.4, 0.0, 0.4, 0.8)  # of half a side
DENSELY = tuple(np.linspace(-1, 1, 41).tolist())
FULL_DETAIL_SIDE_PX = 40.0  # one halving for every doubling of the side beyond this
FLOOR = 0.005  # of full scale, added to dark values against their noise
# Chosen on the kinds of cameras and the photographs of training (benchmarks/camera_scenes.py): every marker has a
# square that shows more, and more than half of the squares of photographs show less.
LEAST_MEDIAN, PAIR, LEAST_SHARE = 0.3, 0.15, 0.85  # log ratios, and share of the pairs
MOST_UNEVEN = 0.33  # root mean square of the border's points from their median, over white minus black
LEAST_SIDE_PX, LEAST_SINE = 8.0, 0.05  # of the angles at corners
LEAST_STEP = 1.3  # of the light at a shadow's edge; less moves corners by a tenth of a pixel at most
# Of the light on either side of a shadow's edge: median of the absolute log ratios, and that over the edge's own.
MOST_SCATTER, SCATTER_OVER_STEP = 0.15, 0.2
LINEAR = SRGB_TO_LINEAR.astype(np.float32)
AT_ONCE = 30_000  # rows that OpenCV's remap takes


class Looks(NamedTuple):
    """Screening results of squares.

    Attributes:
        promising: (N,) white surrounds a dark border.
        step: (N,) bright over dark light of that white, 0 where it is not promising.
    """

    promising: BoolArray
    step: FloatArray


def look_at(levels: tuple[ByteArray, ...], quads: FloatArray, family: SquareMarkerFamily) -> Looks:
    """Screen (N,4,2) squares, px, for white around a dark border.

    Args:
        levels: (H,W,3) BGR, 8 bit: the image and its halvings.
    """
    clear = _well_shaped(quads) & (_sides(quads) > LEAST_SIDE_PX)
    step = np.zeros(len(quads))
    if not clear.any():
        return Looks(clear, step)
    _, seen = _light(levels, quads[clear], family, ALONG)
    count = seen.shape[1] // 2
    margin, border = seen[:, :count], seen[:, count:]
    ratio = np.log((margin + FLOOR) / (border + FLOOR))
    shown = (np.median(ratio, axis=1) > LEAST_MEDIAN) & ((ratio > PAIR).mean(axis=1) >= LEAST_SHARE)
    dark, bright = np.percentile(margin + FLOOR, (10, 90), axis=1)
    step[clear] = bright / dark
    clear[clear] = shown & (_unevenness(margin, border) < MOST_UNEVEN)
    return Looks(clear, np.where(clear, step, 0.0))


def shadow_on(levels: tuple[ByteArray, ...], quad: FloatArray, family: SquareMarkerFamily) -> ShadowEdge | None:
    """The straight edge of a shadow across the white around a (4,2) square, px; None if there is none."""
    at, seen = _light(levels, quad[None], family, DENSELY)
    count = seen.shape[1] // 2
    white = np.maximum(seen[0, :count], FLOOR)
    edge = ShadowEdge.fit(at[0, :count], white, np.ones(count))
    dark, bright = sorted(edge.lights)
    if bright < LEAST_STEP * dark:
        return None
    light = np.where(at[0, :count] @ edge.normal > edge.offset, edge.lights[1], edge.lights[0])
    scatter = np.median(np.abs(np.log(white / light)))
    return edge if scatter < min(MOST_SCATTER, SCATTER_OVER_STEP * np.log(bright / dark)) else None


def _unevenness(margin: FloatArray, border: FloatArray) -> FloatArray:
    """(N,) root mean square of the border's (N,20) points from their median, over the contrast to the margin.

    In a shadow's lit part that is the margin beside the point, where black is brighter than in the shade as well.
    """
    black = np.median(border, axis=1, keepdims=True)
    white = np.maximum(margin, np.median(margin, axis=1, keepdims=True))
    off = np.clip((border - black) / np.maximum(white - black, 1e-3), -0.5, 1.5)
    return np.asarray(np.sqrt(np.mean(off**2, axis=1)))


def _sides(quads: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(np.roll(quads, -1, axis=1) - quads, axis=2).mean(axis=1))


def _well_shaped(quads: FloatArray) -> BoolArray:
    """(N,) True of convex quads whose corners run clockwise and are no needles."""
    edges = np.roll(quads, -1, axis=1) - quads
    after = np.roll(edges, -1, axis=1)
    turn = edges[:, :, 0] * after[:, :, 1] - edges[:, :, 1] * after[:, :, 0]
    length = np.linalg.norm(edges, axis=2)
    return np.asarray((turn > LEAST_SINE * length * np.linalg.norm(after, axis=2)).all(axis=1))


def _pairs(family: SquareMarkerFamily, along_side: tuple[float, ...]) -> FloatArray:
    """(8 * along,2) mm: points half a cell outside of the border's outer edge, then as many as far inside."""
    points = []
    for reach in (family.half_mm + family.cell_mm / 2, family.half_mm - family.cell_mm / 2):
        along = np.array(along_side) * family.half_mm
        for side in (-reach, reach):
            points += [(side, a) for a in along] + [(a, side) for a in along]
    return np.array(points)


def _light(
    levels: tuple[ByteArray, ...], quads: FloatArray, family: SquareMarkerFamily, along_side: tuple[float, ...]
) -> tuple[FloatArray, FloatArray]:
    """(N,K,2) px and (N,K) linear light at the points of the pairs, from an image in which the square is small."""
    points = _pairs(family, along_side)
    H = homographies_from_points(family.corners_mm, quads)
    mapped = np.einsum("nij,kj->nki", H, np.column_stack([points, np.ones(len(points))]))
    at = mapped[:, :, :2] / mapped[:, :, 2:]
    halvings = np.log2(np.maximum(_sides(quads) / FULL_DETAIL_SIDE_PX, 1.0)).astype(int).clip(0, len(levels) - 1)
    seen = np.zeros(at.shape[:2])
    for level in np.unique(halvings):
        light = cv2.LUT(cv2.cvtColor(levels[level], cv2.COLOR_BGR2GRAY), LINEAR)
        for rows in np.array_split(np.flatnonzero(halvings == level), 1 + len(quads) // AT_ONCE):
            where = ((at[rows] + 0.5) / 2.0**level - 0.5).astype(np.float32)
            x, y = np.ascontiguousarray(where[:, :, 0]), np.ascontiguousarray(where[:, :, 1])
            seen[rows] = cv2.remap(light, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return at, seen
