"""Outlines begin at steps larger than the usual changes of an image: noise starts few, and squares are found."""

import numpy as np
import pytest

from lmkit.kernels.quad_rules import QuadRules
from lmkit.kernels.quads import dark_quads

EVERYWHERE = QuadRules(4.0, 0.01, 8 * 320, 10.0, 0.012)
AT_STEPS = EVERYWHERE._replace(step_per_change=3.0, least_step=2.0, most_step=12.0)


@pytest.mark.parametrize("sigma", [2.0, 4.0])
def test_a_square_in_noise_is_found_and_noise_is_not_followed(sigma):
    plane = np.full((420, 540), 100.0)
    plane[50:80, 60:95] = 70
    noisy = (plane + np.random.default_rng(3).normal(0, sigma, plane.shape)).clip(0, 255).astype(np.uint8)
    square = np.array([[59.5, 49.5], [94.5, 49.5], [94.5, 79.5], [59.5, 79.5]])

    def found(rules):
        quads = dark_quads(noisy, None, 5, rules)
        return quads, (np.abs(quads - square).max(axis=(1, 2)) < 1.5).any()

    (all_quads, _), (few, is_found) = found(EVERYWHERE), found(AT_STEPS)
    assert is_found
    assert len(few) <= 0.75 * len(all_quads)
