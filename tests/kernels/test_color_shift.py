"""The share of a landmark's values that a shift of red and blue explains."""

from __future__ import annotations

import numpy as np
import pytest
from pattern_kernel_pairs import PRIORS, VIEW, _landmark

from lmkit.kernels.grid_pattern import jets_numpy
from lmkit.kernels.plane import light_numpy, plane_numpy
from lmkit.kernels.registration import Samples, blending_numpy, inks_numpy, linearize_numpy

STEP_PX = 1e-3


def test_a_shift_explains_nothing_that_inks_could():
    """With a mixed-pixel bias the inks are not quite optimal: chi2 once fell below 0, and with it a variance."""
    rng = np.random.default_rng(0)
    drawing, samples, state, hypothesis = _landmark(rng, 2, 400, False)
    dark = 0.05 * samples.values + rng.normal(0, 0.01, samples.values.shape)
    samples, state[14] = Samples.of(samples.at, dark, samples.variance), 0.4

    def error(shift_px: float) -> float:
        priors = PRIORS._replace(color_shift=shift_px)
        roots = np.ones(samples.values.T.shape)
        return linearize_numpy(drawing, VIEW, samples, priors, state, hypothesis, False, roots).error

    def coverage(at: np.ndarray) -> np.ndarray:
        points, spread, _, _ = plane_numpy(VIEW, state, at)
        parts = jets_numpy(drawing, points, spread, *hypothesis, slopes=False)[0].T
        return parts * light_numpy(VIEW, state, points)[:, None]

    at, values = samples.at.T.astype(np.float64), samples.values.T.astype(np.float64)
    root = 1 / np.sqrt(samples.variance.astype(np.float64))[:, None]
    inks = inks_numpy(coverage(at), values, np.repeat(root, 3, axis=1), state[14], PRIORS.ridge)

    def drawn(moved: np.ndarray) -> np.ndarray:
        parts = coverage(at + moved)
        return parts @ inks + state[14] * blending_numpy(parts[None], inks)[0]

    moves = [(drawn(move) - drawn(-move)) / (2 * STEP_PX) * [-1, 0, 1] * root for move in STEP_PX * np.eye(2)]
    residual, parts = (values - drawn(np.zeros(2))) * root, coverage(at) * root
    basis = np.linalg.qr(parts)[0]
    residual = residual - basis @ (basis.T @ residual)
    moves = [move - basis @ (basis.T @ move) for move in moves]
    own = np.array([[np.sum(a * b) for b in moves] for a in moves]) + PRIORS.weight / 0.2**2 * np.eye(2)
    seen = np.array([np.sum(move * residual) for move in moves])
    fall = seen @ np.linalg.solve(own, seen) / residual.size
    assert error(1e-9) - error(0.2) == pytest.approx(fall, rel=0.01)
