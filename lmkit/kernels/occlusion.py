"""Detection of an object in front of a decoded landmark, from the pixels that its code does not explain.

A pixel shows the landmark or something else.  Its chi2 is therefore limited in the evidence for a code
(a mixture of two explanations): a covered gap of any color is then no evidence.
An object's one color, or any colors at a cost, explain a region that the landmark does not explain: the
rectangle with the largest gain is searched, as in a spatial scan statistic (Kulldorff 1997).  The kernel is part of
`lmkit_decode`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating[Any]]

CELLS = 8


class OcclusionRules(NamedTuple):
    """Parameters of the search.

    Attributes:
        model_share: share of the contrast that no model of blur and print explains.
        usual_quantile: quantile of the residuals over their expected variance that defines the usual ratio.
        code_limit: a pixel's chi2 counts up to this for a code.
        foreign_limit: a pixel's chi2 counts up to this for an object.
        foreign_pixel: cost of a pixel of an object of many colors, chi2.
        foreign_pixels: least number of pixels of an object.
        foreign_reach: half side of the grid of cells, relative to that of the landmark.
    """

    model_share: float
    usual_quantile: float
    code_limit: float
    foreign_limit: float
    foreign_pixel: float
    foreign_pixels: float
    foreign_reach: float


def usual_variance_numpy(
    off: FloatArray, variance: FloatArray, contrast: FloatArray, rules: OcclusionRules
) -> FloatArray:
    """(N,) usual variance of residuals (N,3): the expected one times the usual ratio of most of them, and at least
    the share of the contrast (3,) that no model explains."""
    common = float(np.quantile(np.mean(off**2, axis=1) / variance, rules.usual_quantile))
    return np.asarray(np.maximum(variance * max(common, 1.0), np.mean((rules.model_share * contrast) ** 2)))


def code_evidence_numpy(
    off: FloatArray,
    usual: FloatArray,
    coverage: FloatArray,
    contrast: FloatArray,
    is_open: FloatArray,
    others: FloatArray,
    rules: OcclusionRules,
) -> float:
    """The least chi2 in favor of the code, compared with another one.

    Args:
        off: (N,3) residuals of the code.
        usual: (N,) their variance.
        coverage: (N,G) of the gap positions.
        contrast: (3,) white less ground.
        is_open: (G,) 1 where the code has a gap, else 0.
        others: (K,G) where other codes differ.
    """
    base = np.minimum(np.sum(off**2, axis=1) / usual, rules.code_limit)
    evidence = np.zeros(len(is_open))
    for gap, sign in enumerate(2 * is_open - 1):
        other = off - sign * coverage[:, gap : gap + 1] * contrast
        evidence[gap] = np.sum(np.minimum(np.sum(other**2, axis=1) / usual, rules.code_limit) - base)
    return float(np.min(others @ evidence, initial=rules.code_limit * len(off)))


def foreign_rectangle_numpy(
    points: FloatArray, values: FloatArray, off: FloatArray, usual: FloatArray, half_mm: float, rules: OcclusionRules
) -> float:
    """The chi2 by which a rectangle, in one color or in any, explains the pixels better than the landmark does.

    Args:
        points: (N,2) mm.
        values: (N,3) of the pixels.
        off: (N,3) what the landmark leaves of them.
        usual: (N,) variance of those.
        half_mm: half side of the landmark.
    """
    weight = 1 / usual
    unexplained = np.minimum(np.sum(off**2, axis=1) * weight, rules.foreign_limit)
    colors = weight[:, None] * values
    sums = np.column_stack([np.ones(len(points)), weight, colors, unexplained, np.sum(colors * values, axis=1)])
    s = rectangles_numpy(points, sums, rules.foreign_reach * half_mm)
    s = s[s[:, 0] >= rules.foreign_pixels]
    own = s[:, 6] - np.sum(s[:, 2:5] ** 2, axis=1) / s[:, 1]
    return float(np.max(s[:, 5] - np.minimum(own, rules.foreign_pixel * s[:, 0]), initial=0.0))


def rectangles_numpy(points: FloatArray, sums: FloatArray, reach: float) -> FloatArray:
    """(R,S) sums (N,S) of points (N,2) over all rectangles of cells of a grid of half side ``reach``."""
    cells = np.floor((points / reach + 1) * (CELLS / 2))
    column, row = np.clip(cells, 0, CELLS - 1).astype(int).T
    above = np.zeros((CELLS + 1, CELLS + 1, sums.shape[1]))
    np.add.at(above, (row + 1, column + 1), sums)
    above = above.cumsum(axis=0).cumsum(axis=1)
    first, end = np.triu_indices(CELLS + 1, 1)
    strips = above[end] - above[first]
    return np.asarray((strips[:, end] - strips[:, first]).reshape(-1, sums.shape[1]))
