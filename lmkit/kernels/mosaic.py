"""Which colors of a mosaic the pixels of one landmark saw, from what its fit leaves: the definition of `mosaic.h`.

A sensor with a color mosaic measures one color in a pixel; the others are interpolated, and err where the image is
curved: by so much more than the measured ones that a single landmark often shows where red lies in the cells of 2 x 2
pixels.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating[Any]]

PLACES = 4  # of red in a cell: row times 2, plus column
FARTHEST = 300.0
BLUE, GREEN, RED = range(3)
# Weights of half the curvatures across and down in the error of an interpolated value, by the pixels that have the
# color: this one, those beside it in the row, in the column, on the diagonals, all four neighbors.
NEIGHBORS = np.array([(0, 0), (1, 0), (0, 1), (1, 1), (0.5, 0.5)])
# By color and by how the pixel's cell differs from red's.
KINDS = np.array([(3, 2, 1, 0), (4, 0, 0, 4), (0, 1, 2, 3)])
_MEAN_SHARES = np.array([0.5, 0.25, 0.5])  # of the sum of both curvatures, over the places


class MosaicRules(NamedTuple):
    """How values of a color mosaic are weighed.

    Attributes:
        error_share: of interpolated values, relative to half the curvature.
        evidence: weight of the log likelihood, since neighboring pixels share their errors.
        log_odds: of a mosaic with red at a certain place against none, before a residual is seen.
        least_weight: of an interpolated value, where the place is sure.
    """

    error_share: float
    evidence: float
    log_odds: float
    least_weight: float


def mosaic_weights_numpy(
    residuals: FloatArray, across: FloatArray, down: FloatArray, cells: FloatArray, rules: MosaicRules
) -> FloatArray:
    """(3,4) square roots of the weights of blue, green and red in the four cells of a mosaic.

    Residuals follow a t distribution of 3 degrees of freedom, which is wider where a value was interpolated and the
    image is curved; interpolation may have blurred, too.  Without a mosaic all are alike: as wide as measured values,
    or as the average.

    Args:
        residuals: (N,3) BGR, over their scale.
        across, down: (N,3) half the second derivatives of the model, over the same scale.
        cells: (N,) row modulo 2 times 2, plus column modulo 2.
    """
    r, x, y = (np.clip(array, -FARTHEST, FARTHEST) for array in (residuals, across, down))
    both, places = x + y, cells.astype(int)[:, None] ^ np.arange(PLACES)
    curved = NEIGHBORS[KINDS] @ np.stack([x, y]).transpose(2, 0, 1)  # (3,4,N)
    v = 1 + (rules.error_share * curved) ** 2
    blurred = curved - (_MEAN_SHARES * both).T[:, None]
    likely = [_log_likelihood(r.T[:, None] - mean, v).sum(axis=0) for mean in (0.0, blurred)]
    by_place = [[one[places[:, red], range(len(r))].sum() for red in range(PLACES)] for one in likely]
    alike = max(_log_likelihood(r.T, width).sum() for width in (np.ones_like(r.T), v.mean(axis=1)))
    odds = np.exp(np.clip(rules.evidence * (np.max(by_place, axis=0) - alike) + rules.log_odds, -100, 100))
    cell_from_red = np.arange(PLACES)[:, None] ^ np.arange(PLACES)
    weights = np.where(KINDS[:, cell_from_red] == 0, 1.0, rules.least_weight)
    return np.asarray(np.sqrt((1 + weights @ odds) / (1 + odds.sum())))


def _log_likelihood(d: FloatArray, v: FloatArray) -> FloatArray:
    """Up to a constant, of a t distribution of 3 degrees of freedom and width v."""
    return np.asarray(1.5 * np.log(v) - 2 * np.log(3 * v + d**2))
