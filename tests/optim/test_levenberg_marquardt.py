"""The solver loop and the robust loss: laws, and problems with a known minimum."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lmkit.optim.levenberg_marquardt import Damping, minimize, start_at, try_step
from lmkit.optim.robust_loss import cauchy_cost, cauchy_weight


class Rosenbrock:
    """10 (y - x^2) and 1 - x: a curved valley with its minimum at (1, 1)."""

    def linearize(self, state):
        x, y = state
        r = np.array([10 * (y - x * x), 1 - x])
        J = np.array([[20 * x, -10.0], [1.0, 0.0]])  # derivatives of what is subtracted
        return (J.T @ J, J.T @ r), float(r @ r)

    def solve(self, equations, damping):
        normal, gradient = equations
        return np.linalg.solve(normal + damping * np.diag(np.diag(normal)), gradient)

    def retract(self, state, step):
        return state + step


@given(st.floats(-3, 3), st.floats(-3, 3))
def test_the_minimum_of_a_curved_valley_is_found(x, y):
    end = minimize(Rosenbrock(), np.array([x, y]), 500, 1e-18)
    assert np.allclose(end.state, 1.0, atol=1e-5)


@given(st.floats(-3, 3), st.floats(-3, 3), st.floats(1e-9, 1e3))
def test_a_step_never_raises_the_cost(x, y, damping):
    now = start_at(Rosenbrock(), np.array([x, y]), damping)
    after = try_step(Rosenbrock(), now, Damping())
    assert after.cost <= now.cost
    assert (after.gain is None) == (after.damping > now.damping)
    if after.gain is None:
        assert after.state is now.state


def test_the_loop_ends_at_the_first_state_that_needs_no_further_step():
    start, passed = np.array([-1.0, 2.0]), []

    def is_there(state):
        passed.append(state[0])
        return state[0] > 0

    end = minimize(Rosenbrock(), start, 200, 1e-12, until=is_there)
    assert all(x <= 0 for x in passed[:-1])
    assert 0 < end.state[0] == passed[-1] < 0.99


def test_a_step_that_is_predicted_to_gain_little_is_accepted_without_evaluation():
    evaluated = []

    class Counted(Rosenbrock):
        def linearize(self, state):
            evaluated.append(state)
            return super().linearize(state)

    def predicted(equations, step):
        return float(equations[1] @ step)

    end = minimize(Counted(), np.array([-1.0, 2.0]), 200, 1e-6, predicted=predicted)
    assert all(end.state is not state for state in evaluated)
    assert 0 < end.gain < 1e-6
    assert np.allclose(end.state, 1.0, atol=1e-5)
    assert end.cost == pytest.approx(0.0, abs=1e-6)


class Undetermined(Rosenbrock):
    def solve(self, equations, damping):
        raise np.linalg.LinAlgError("singular")


def test_what_is_not_determined_ends_where_it_began():
    start = np.array([0.0, 0.0])
    assert minimize(Undetermined(), start, 100, 0.0).state is start


@given(st.floats(0, 1e6), st.floats(0.1, 100))
def test_the_weight_is_the_derivative_of_the_cost(squared, scale):
    h = 1e-6 * max(squared, 1.0)
    slope = (cauchy_cost(squared + h, scale) - cauchy_cost(max(squared - h, 0.0), scale)) / (
        squared + h - max(squared - h, 0.0)
    )
    assert slope == pytest.approx(cauchy_weight(squared, scale), rel=1e-3, abs=1e-6)
    assert 0 < cauchy_weight(squared, scale) <= 1
    assert cauchy_cost(squared, scale) <= squared + 1e-9
