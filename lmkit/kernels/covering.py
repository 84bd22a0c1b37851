"""Whether another code, partly hidden by an object, explains a landmark as well as the code that was read.

An object in front of a landmark hides pixels of any color: an object of the ground's color on a ring looks like a
gap, but usually covers more.  Both explanations are therefore compared, each with its best object:
the code that was read with an object or none, and any other code with one.  An object is a rectangle of cells of a
grid, rotated in steps of 15 deg; its pixels have one color, or any colors at a cost, and are no evidence for gaps.
The kernel is part of `lmkit_fit_covering`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.occlusion import OcclusionRules, rectangles_numpy

FloatArray = NDArray[np.floating[Any]]

GRIDS = 6


class CoveringRules(NamedTuple):
    """Parameters of the search.

    Attributes:
        reach: half side of the grids, relative to that of the landmark.
        price: cost of an object, chi2: objects are rare, and the best of many is used.
    """

    reach: float
    price: float


class Covering(NamedTuple):
    """Chi2 by which a code explains the pixels better than any other code, with an object or without."""

    behind_object: float
    alone: float


def covering_numpy(
    points: FloatArray,
    values: FloatArray,
    off: FloatArray,
    usual: FloatArray,
    coverage: FloatArray,
    contrast: FloatArray,
    is_open: FloatArray,
    others: FloatArray,
    half_mm: float,
    occlusion: OcclusionRules,
    rules: CoveringRules,
) -> Covering:
    """The code, with or without an object, compared with all others.

    Args:
        points: (N,2) mm.
        values, off: (N,3) of the pixels, and what the code leaves of them; ``usual``: (N,) variance of that.
        coverage: (N,G) of the gap positions; ``contrast``: (3,) white less ground.
        is_open: (G,) 1 where the code has a gap, else 0; ``others``: (K,G) where other codes differ.
        half_mm: half side of the landmark.
    """
    weight, limit = 1 / usual, occlusion.foreign_limit
    unexplained = np.minimum(np.sum(off**2, axis=1) * weight, limit)
    moved = off[:, None] - ((2 * is_open - 1) * coverage)[:, :, None] * contrast
    evidence = np.minimum(np.sum(moved**2, axis=2) * weight[:, None], limit) - unexplained[:, None]
    colors = weight[:, None] * values
    energy = np.sum(colors * values, axis=1)
    sums = np.column_stack([np.ones(len(points)), weight, colors, unexplained, energy, evidence])
    total = evidence.sum(axis=0)
    nothing, most = limit * len(points), 0.0
    least = alone = float(np.min(others @ np.maximum(total, 0), initial=nothing))
    for turn in range(GRIDS):
        s = rectangles_numpy(_turned(points, np.pi / 2 / GRIDS * turn), sums, rules.reach * half_mm)
        s = s[s[:, 0] >= occlusion.foreign_pixels]
        own = np.maximum(s[:, 6] - np.sum(s[:, 2:5] ** 2, axis=1) / s[:, 1], 0)
        gain = s[:, 5] - np.minimum(own, occlusion.foreign_pixel * s[:, 0])
        outside = np.min(others @ np.maximum(total - s[:, 7:], 0).T, axis=0, initial=nothing)
        least = min(least, float(np.min(outside - gain + rules.price, initial=nothing)))
        most = max(most, float(np.max(gain, initial=0)))
    return Covering(least + max(most - rules.price, 0), alone)


def _turned(points: FloatArray, turn: float) -> FloatArray:
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    return np.asarray(points @ rotation)
