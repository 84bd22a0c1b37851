"""The residuals of a landmark show which colors its pixels measured."""

from __future__ import annotations

import numpy as np
import pytest

from lmkit.kernels.mosaic import MosaicRules, mosaic_weights_numpy

RULES = MosaicRules(error_share=0.3, evidence=0.15, log_odds=2.0, least_weight=0.04)
CELLS = np.arange(800) % 4
COLOR = {0: "RGGB", 1: "GRBG", 2: "GBRG", 3: "BGGR"}  # of the four cells, by the place of red


def _is_measured(red: int) -> np.ndarray:
    """(4,3) whether the pixel of a cell measured blue, green and red."""
    return np.array([[color == bgr for bgr in "BGR"] for color in COLOR[red]])


def _weights(error_of_interpolated: np.ndarray, red: int) -> np.ndarray:
    """(4,3) weights for curved edges where interpolated values err by this multiple of the curvature."""
    rng = np.random.default_rng(5)
    across, down = rng.normal(0, 3, (2, 800, 3))
    error = np.where(_is_measured(red)[CELLS], 0, error_of_interpolated * (across + down) / 2)
    residuals = rng.normal(0, 1, (800, 3)) + error
    return mosaic_weights_numpy(residuals, across, down, CELLS, RULES).T ** 2


@pytest.mark.parametrize("red", range(4))
@pytest.mark.parametrize("blurs", [True, False])
def test_interpolated_values_count_little_wherever_red_is(red, blurs):
    """The error of interpolation is the curvature itself, or the curvature with a random sign."""
    error = np.ones((800, 3)) if blurs else np.random.default_rng(6).choice([-1.0, 1.0], (800, 3))
    weights = _weights(error, red)
    assert weights[_is_measured(red)].min() > 0.99
    assert weights[~_is_measured(red)].max() < 0.06


def test_all_values_count_alike_without_a_mosaic():
    assert _weights(np.zeros((800, 3)), 0).min() > 0.99
