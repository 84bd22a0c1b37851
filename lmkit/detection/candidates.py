"""Candidates: dark squares on white, found in several channels of the halved image.

Color alone loses dim, warm and noisy images (docs/landmark.md, section 6), so the squares come
from brightness (white margin against red and blue) and from red (white and red against blue), each with
a local threshold.  Candidates are only places to examine: loose tests here, strict ones after decoding.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from lmkit.arrays import ByteArray, FloatArray
from lmkit.kernels.quad_rules import QuadRules
from lmkit.kernels.quads import Contrast, dark_quads, where_to_look
from lmkit.kernels.workspace import Workspace

MIN_SIDE_PX = 8.0
LEAST_SIDE_IN_LEVEL_PX = 4.0  # of a halved image
COMPLETED_SIDE = 2.5  # multiple of the least side, from which partly hidden squares are completed
STRAIGHT = 0.012  # largest deviation of a straight segment, as a share of the outline's length
STEP_PER_CHANGE, STEP_LIMITS = 3.0, (2.0, 12.0)  # usual change between neighbors; gray levels: outlines begin there
LONGEST = 8.0  # times height plus width: longer outlines are clutter
OFFSET, OFFSET_PER_SIGMA = 6.0, 4.0  # added to code values before their logarithm, against noise
GROUND_TO_FACE = 90 / 80  # the region that is dark in red is the ground; the face is larger by this factor

_WORKSPACE = Workspace()


@dataclass(frozen=True)
class Source:
    """One way of making a binary image.

    Attributes:
        channel: ``gray`` or ``red``.
        halvings: number of halvings of the image before.
        window: side of the window for the local mean, pixels of that image.
        darker: share by which a pixel must be below its local mean or, if negative, by which it may be above
            it.  It is a ratio, not gray levels, so that the brightness of the room has no effect.
    """

    channel: str
    halvings: int
    window: int
    darker: float


@dataclass(frozen=True)
class WhereToLook:
    """Parts of an image that are searched.

    Attributes:
        ratio, luma: least range of the logarithms of red over blue and of brightness around a cell of 8 px.
        dilated: include neighboring cells.
        fine_ratio, fine_luma: both in the full image, whose outlines take the most time; at least the others.
    """

    ratio: float = 0.15
    luma: float = 0.2
    dilated: bool = False
    fine_ratio: float = 0.0
    fine_luma: float = 0.0

    @property
    def contrast(self) -> Contrast:
        """Least contrast in the form for the kernel."""
        return Contrast(self.ratio, self.luma, max(self.ratio, self.fine_ratio), max(self.luma, self.fine_luma))


def find_candidates(
    levels: Sequence[ByteArray], sources: Sequence[Source], where: WhereToLook, noise: float
) -> FloatArray:
    """Quadrilaterals that may be the outline of a landmark.

    Args:
        levels: (H,W,3) BGR, 8 bit: the image and its halvings.
        noise: standard deviation of the code values over 255.

    Returns:
        (N,4,2) corners in pixels, clockwise as seen; many are not landmarks, or the same square twice.
    """
    half = min(1, len(levels) - 1)
    offset = OFFSET + OFFSET_PER_SIGMA * 255 * noise / 2**half
    cells = where_to_look(levels[half], offset, where.contrast, where.dilated)
    fine = np.where(cells > 1, cells, 0)
    found = []
    for source in sources:
        level = min(source.halvings, len(levels) - 1)
        plane = _channel_of(levels[level], source.channel)
        least = max(MIN_SIDE_PX / 2**level, LEAST_SIDE_IN_LEVEL_PX)
        longest = int(LONGEST * sum(plane.shape))
        completed = COMPLETED_SIDE * least
        rules = QuadRules(least, source.darker, longest, completed, STRAIGHT, STEP_PER_CHANGE, *STEP_LIMITS)
        quads = dark_quads(plane, fine if source.halvings == 0 else cells, source.window, rules, level - half, level)
        found += [quads, grown(quads, GROUND_TO_FACE)] if source.channel == "red" else [quads]
    return np.concatenate(found) if found else np.zeros((0, 4, 2))


def _channel_of(image: ByteArray, channel: str) -> ByteArray:
    """(H,W) gray or red of (H,W,3) BGR, in memory that the next call writes to."""
    plane = _WORKSPACE.bytes("plane", image.shape[:2])
    if channel == "gray":
        cv2.cvtColor(image, cv2.COLOR_BGR2GRAY, dst=plane)
    else:
        cv2.extractChannel(image, 2, dst=plane)
    return plane


def grown(quads: FloatArray, factor: float) -> FloatArray:
    """(N,4,2) quads enlarged by a factor about the centers of their squares, in perspective.

    With the center m (the intersection of the diagonals) and a corner c, the point at ``factor`` times the corner's
    distance on the diagonal from m follows from the diagonal's vanishing point.
    """
    if len(quads) == 0:
        return quads
    a, b, c, d = (quads[:, k] for k in range(4))
    across = c - a
    other, off = d - b, b - a
    det = across[:, 0] * other[:, 1] - across[:, 1] * other[:, 0]
    det = np.where(np.abs(det) < 1e-9, 1e-9, det)
    s = ((off[:, 0] * other[:, 1] - off[:, 1] * other[:, 0]) / det)[:, None]
    middle = a + s * across
    found = np.empty_like(quads)
    for k in range(4):
        near, far = quads[:, k] - middle, quads[:, (k + 2) % 4] - middle
        p, q = (np.linalg.norm(v, axis=1, keepdims=True) for v in (near, far))
        # On the diagonal, corners at -1 and 1 appear at -q and p: x(u) = 2 p q u / ((p + q) + (q - p) u).
        scale = 2 * q * factor / np.maximum((p + q) + (q - p) * factor, 1e-6)
        found[:, k] = middle + near * scale
    return found
