"""The robust loss of all solvers: Cauchy's, by its scale in standard deviations.

An error of squared size s costs ``scale^2 log(1 + s / scale^2)``: s for small errors, growing slowly for errors far
beyond the scale.  Iteratively reweighted least squares multiplies the squared error by a weight (Holland and Welsch
1977; Triggs et al. 2000, section 4.3).
"""

from __future__ import annotations

import numpy as np

from lmkit.arrays import FloatArray

CAUCHY_SCALE = 2.4  # standard deviations: 95 % efficient on Gaussian errors (Holland and Welsch 1977)


def cauchy_cost(squared: FloatArray, scale: float = CAUCHY_SCALE) -> FloatArray:
    """Costs of squared errors, both in squared standard deviations; any shape."""
    return np.asarray(scale**2 * np.log1p(squared / scale**2))


def cauchy_weight(squared: FloatArray, scale: float = CAUCHY_SCALE) -> FloatArray:
    """Weights, 0 to 1, of squared errors in squared standard deviations; any shape."""
    return np.asarray(1 / (1 + squared / scale**2))
