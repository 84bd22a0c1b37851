"""Actual errors of observations relative to their stated covariances, from the residuals of an adjustment."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lmkit.mapping.bundle_adjustment import BundleProblem

NEIGHBORS_S = 2.0  # between images that follow each other
MOST_ALIKE = 0.95  # correlation


def noise_factor(problems: Sequence[BundleProblem]) -> float:
    """Factor of actual over stated variance of the observations; at least 1.

    On real cameras, errors of one landmark in consecutive images are correlated, since lens, blur and light are
    similar.  N observations whose neighbors correlate by rho count as N (1 - rho) / (1 + rho): a first-order
    autoregression.
    """
    squared, across, within = 0.0, 0.0, 0.0
    count = 0
    for problem in problems:
        errors, seen = problem.whitened_errors(), problem.seen
        order = np.lexsort((seen.at, seen.camera, seen.of))
        order = order[problem.used[order]]
        squared += float((errors[order] ** 2).sum())
        count += errors[order].size
        a, b = order[:-1], order[1:]
        alike = (seen.of[a] == seen.of[b]) & (seen.camera[a] == seen.camera[b])
        alike &= problem.times[seen.at[b]] - problem.times[seen.at[a]] < NEIGHBORS_S
        a, b = a[alike], b[alike]
        across += float((errors[a] * errors[b]).sum())
        within += float((errors[a] ** 2 + errors[b] ** 2).sum()) / 2
    if not count:
        return 1.0
    rho = min(max(across / within, 0.0), MOST_ALIKE) if within else 0.0
    return max(1.0, squared / count * (1 + rho) / (1 - rho))
