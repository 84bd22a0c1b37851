"""Margins of a decoding by plain and by robust weights."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from lmkit.detection.decoding import cautious, cautious_decoding_of, decoding_of, tables_of
from lmkit.kernels.hypotheses import Decoded
from lmkit.model.landmark import LM8

ENERGY = st.floats(0.1, 50.0)


@st.composite
def decoded(draw) -> Decoded:
    """A result of a kernel: another code has a larger residual, or, with robust weights, a slightly smaller one."""
    left = draw(ENERGY)
    more = [left * draw(st.floats(0.9, 3.0)) for _ in range(3)]
    turn, code = draw(st.integers(0, 1)), draw(st.integers(0, 1))
    parts = 2 + LM8.gap_count
    return Decoded(turn, code, left, *more, np.full((4, 3), 0.5), 10.0, 0.0, np.zeros(parts), np.ones(parts))


@settings(max_examples=60)
@given(decoded(), decoded(), st.integers(20, 800))
def test_a_code_is_as_sure_as_the_less_sure_of_both_says(plain, robust, pixels):
    tables = tables_of(LM8)
    one, other = (decoding_of(tables, each, pixels) for each in (plain, robust))
    both = cautious_decoding_of(tables, plain, robust, pixels)
    stepwise = cautious(one, other)
    assert (both.code_margin, both.turn_margin) == (stepwise.code_margin, stepwise.turn_margin)
    assert (both.code, both.quarter) == (plain.code, plain.turn)
    if (robust.code, robust.turn) == (plain.code, plain.turn):
        assert both.code_margin == min(one.code_margin, other.code_margin)
        assert both.turn_margin == min(one.turn_margin, other.turn_margin)
    else:
        assert both.margin == 0.0


def test_nothing_by_robust_weights_is_no_code():
    plain = Decoded(0, 3, 1.0, 2.0, 2.0, 4.0, np.ones((4, 3)), 10.0, 0.0, np.zeros(10), np.ones(10))
    assert cautious_decoding_of(tables_of(LM8), plain, None, 400).margin == 0.0


def test_a_ground_that_is_extrapolated_to_less_than_black_is_promising():
    """The large blur that a fit starts with has this effect in sharp images of high contrast."""
    inks = np.array([[1.6, 1.5, 1.5], [-0.2, -0.1, 0.3], [0.05, -0.1, -0.1], [1.0, 1.0, 1.0]])
    parts = 2 + LM8.gap_count
    found = Decoded(0, 1, 1.0, 3.0, 5.0, 9.0, inks, 10.0, 0.0, np.zeros(parts), np.ones(parts))
    assert decoding_of(tables_of(LM8), found, 400).is_promising
