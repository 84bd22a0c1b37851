"""Squares of one landmark that are moved to the same place: the one that fitted better before represents all."""

from __future__ import annotations

import itertools

import numpy as np
from pattern_kernel_pairs import screening_of_a_landmark

from lmkit.kernels.screening import SAME_SHARE, Shares, likely, likely_numpy, screen

ROUNDS = 4


def test_a_share_that_is_larger_by_rounding_changes_nothing():
    rng = np.random.default_rng(5)
    pyramid, tables, rules, corners = screening_of_a_landmark(rng)
    tried = corners + rng.normal(0, 3.0, (40, 4, 2))
    found = screen(pyramid, tables, rules, tried, 0).pattern
    moved = screen(pyramid, tables, rules, tried, ROUNDS)
    step = np.floor(moved.pattern / SAME_SHARE)
    # Pairs of which the first fitted better, and the second is now larger within a step.
    tied = [
        (a, b)
        for a, b in itertools.permutations(np.flatnonzero(found > 0.1).tolist(), 2)
        if found[a] > found[b] + 2 * SAME_SHARE and step[a] == step[b] and moved.pattern[b] > moved.pattern[a]
    ]
    assert len(tied) >= 2
    for choose, (a, b) in ((likely, tied[0]), (likely, tied[1]), (likely_numpy, tied[0])):
        best = choose(pyramid, tables, rules, tried[[b, a]], Shares(0.02, 0.05), ROUNDS).quads
        assert len(best) == 1
        assert np.abs(best[0] - moved.quads[a]).max() < 1e-3 < np.abs(best[0] - moved.quads[b]).max()


def test_a_square_that_fails_the_gate_removes_none_of_its_equals():
    pyramid, tables, rules, corners = screening_of_a_landmark(np.random.default_rng(5))
    middle = corners.mean(axis=0)
    # Within 5 % of the side, and the border's points already lie on the margin.
    too_large = middle + 1.06 * (corners - middle)
    alone, both = (
        screen(pyramid, tables, rules, np.array(some), 0).pattern for some in ([corners], [too_large, corners])
    )
    assert both[0] < 0 < alone[0] == both[1]
    assert len(likely(pyramid, tables, rules, np.array([too_large, corners]), Shares(0.02, 0.05), ROUNDS).quads) == 1
