"""Measured color of each pixel in a mosaic, from the residuals of a landmark's fit: the definition of `mosaic.h`.

A sensor with a color mosaic measures one color per pixel; the others are interpolated, with errors where the image is
curved.  These are so much larger that a single landmark often shows the place of red in the cells of 2 x 2
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
# color: the pixel itself, its neighbors in the row, in the column, on the diagonals, all four neighbors.
NEIGHBORS = np.array([(0, 0), (1, 0), (0, 1), (1, 1), (0.5, 0.5)])
# By color, and by the offset of the pixel's cell from red's.
KINDS = np.array([(3, 2, 1, 0), (4, 0, 0, 4), (0, 1, 2, 3)])
_MEAN_SHARES = np.array([0.5, 0.25, 0.5])  # of the sum of both curvatures, over the places


class MosaicRules(NamedTuple):
    """Weights of values from a color mosaic.

    Attributes:
        error_share: of interpolated values, relative to half the curvature.
        evidence: weight of the log likelihood, since neighboring pixels share their errors.
        log_odds: prior log odds of a mosaic with red at a given place, compared with no mosaic.
        least_weight: weight of an interpolated value if the place is certain.
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
    image is curved; interpolation may also have blurred.  Without a mosaic all widths are equal: that of measured
    values, or the average.

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
    """Log density, up to a constant, of a t distribution of 3 degrees of freedom and width v."""
    return np.asarray(1.5 * np.log(v) - 2 * np.log(3 * v + d**2))
