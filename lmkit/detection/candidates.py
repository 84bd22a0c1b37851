"""Where might a landmark be?  Dark squares on white, found in several channels and scales.

Colour alone loses dim, warm and noisy pictures (docs/landmark.md, section 6), so the squares come
from brightness (white margin against red and blue), from the darkest channel (white against any
colour) and from red (white and red against blue), each with local thresholds at two scales.  What
is found is only a place to look: loose tests here, strict ones after reading.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np

from lmkit.arrays import AnyArray, ByteArray, FloatArray

MIN_SIDE_PX = 8.0
COMPLETED_SIDE = 2.5  # times that, from which squares with a hidden part are completed
STRAIGHT = 0.012  # of the outline's length, how far a straight stretch may bend
MOST_STRETCHES = 16


@dataclass(frozen=True)
class Source:
    """One way of making a binary picture.

    Attributes:
        channel: ``grey``, ``darkest`` (of red, green, blue) or ``red``.
        enlarge: factor of enlargement before the threshold.
        window: side of the window for the local mean, pixels of the enlarged picture.
        darker: share by which a pixel must lie under its local mean.  A ratio and not grey levels,
            so that dim and bright rooms are treated alike.
    """

    channel: str
    enlarge: int
    window: int
    darker: float


# Chosen greedily by what each adds (docs/decisions/0004-candidates.md).
SOURCES = (
    Source("grey", 2, 31, 0.04),
    Source("grey", 1, 15, 0.10),
    Source("grey", 2, 15, 0.04),
    Source("grey", 2, 61, 0.04),
    Source("red", 1, 31, 0.10),
    Source("darkest", 1, 15, 0.10),
)
# Those that need no enlarged picture.
FAST_SOURCES = tuple(source for source in SOURCES if source.enlarge == 1)


def find_candidates(image: ByteArray, sources: tuple[Source, ...] = SOURCES) -> FloatArray:
    """Quadrilaterals that may be the outline of a landmark.

    Args:
        image: (H,W,3) BGR, 8 bit.

    Returns:
        (N,4,2) corners in pixels, clockwise as seen, many of them nothing or the same square twice.
    """
    blue, green, red = cv2.split(image)
    channels = {
        "grey": cv2.cvtColor(image, cv2.COLOR_BGR2GRAY),
        "darkest": cv2.min(cv2.min(blue, green), red),
        "red": red,
    }
    found = []
    for source in sources:
        plane = channels[source.channel]
        if source.enlarge > 1:
            size = (plane.shape[1] * source.enlarge, plane.shape[0] * source.enlarge)
            plane = np.asarray(cv2.resize(plane, size, interpolation=cv2.INTER_LINEAR))
        quads = _dark_quads(
            np.asarray(plane, dtype=np.uint8), source.window, source.darker, MIN_SIDE_PX * source.enlarge
        )
        # Pixel centres: enlarged pixel u lies at (u + 0.5) / s - 0.5 of the original.
        found.append((quads + 0.5) / source.enlarge - 0.5)
    return np.concatenate(found)


def _dark_quads(plane: ByteArray, window: int, darker: float, min_side: float) -> FloatArray:
    """Outlines of regions darker than their surroundings that are roughly quadrilaterals."""
    mean = cv2.blur(plane, (window, window))
    mask = cv2.compare(plane, cv2.convertScaleAbs(mean, alpha=1 - darker, beta=-0.5), cv2.CMP_LT)
    contours, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    quads = []
    for contour in contours:
        if len(contour) < 3.2 * min_side:
            continue
        hull = cv2.convexHull(contour)
        hull_area = cv2.contourArea(hull)
        if len(hull) < 4 or hull_area < min_side * min_side * 0.7:
            continue
        quad = cv2.approxPolyN(hull.astype(np.float32), 4, None, -1.0, True)
        if quad is not None and quad.shape[1] == 4 and hull_area >= 0.8 * cv2.contourArea(quad):
            quads.append(quad[0])
            if hull_area > 0.95 * cv2.contourArea(quad):
                continue
        if hull_area > COMPLETED_SIDE**2 * min_side**2:
            quads += _completed(contour)
    if not quads:
        return np.zeros((0, 4, 2))
    return _clockwise(np.array(quads, dtype=np.float64))


def _completed(contour: AnyArray) -> list[FloatArray]:
    """Quadrilaterals of the outline's longest straight stretches, for squares of which a part is hidden.

    What covers a corner or sticks in over a side adds stretches of its own; the square's are among
    the longest.
    """
    length = cv2.arcLength(contour, True)
    polygon = cv2.approxPolyDP(contour, STRAIGHT * length, True)[:, 0].astype(np.float64)
    if not 4 <= len(polygon) <= MOST_STRETCHES:
        return []
    edges = np.roll(polygon, -1, axis=0) - polygon
    lengths = np.linalg.norm(edges, axis=1)
    longest = np.argsort(-lengths, kind="stable")[:6]
    found = []
    for chosen in combinations(sorted(longest.tolist()), 4):
        if lengths[list(chosen)].sum() < 0.45 * length:
            continue
        start, along = polygon[list(chosen)], edges[list(chosen)]
        following, way = np.roll(start, -1, axis=0), np.roll(along, -1, axis=0)
        cross = along[:, 0] * way[:, 1] - along[:, 1] * way[:, 0]
        if (np.abs(cross) < 0.2 * lengths[list(chosen)] * np.roll(lengths[list(chosen)], -1)).any():
            continue
        off = following - start
        t = (off[:, 0] * way[:, 1] - off[:, 1] * way[:, 0]) / cross
        quad = start + t[:, None] * along
        if cv2.isContourConvex(quad.astype(np.float32)[:, None]) and np.ptp(quad, axis=0).max() < length:
            found.append(quad.astype(np.float32))
    return found


def _clockwise(quads: FloatArray) -> FloatArray:
    x, y = quads[:, :, 0], quads[:, :, 1]
    area = np.sum(x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1), axis=1)
    return np.where((area < 0)[:, None, None], quads[:, ::-1], quads)
