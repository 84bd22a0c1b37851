"""The damped Gauss-Newton loop of all solvers (Levenberg 1944, Marquardt 1963).

A problem linearizes its cost at a state, solves for a step, and moves a state by a step;
states and steps have any type.  Weights of a robust loss are recomputed at every linearization.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

State = TypeVar("State")
Equations = TypeVar("Equations")
Step = TypeVar("Step")


class LeastSquares(Protocol[State, Equations, Step]):
    """A nonlinear least squares problem."""

    def linearize(self, state: State) -> tuple[Equations, float]:
        """Normal equations at a state, and its cost; an infinite cost rejects the state."""
        ...

    def solve(self, equations: Equations, damping: float) -> Step:
        """The step of the damped equations.

        Raises:
            numpy.linalg.LinAlgError: the equations do not determine the step.
        """
        ...

    def retract(self, state: State, step: Step) -> State:
        """The state moved by the step."""
        ...


@dataclass(frozen=True)
class Damping:
    """Rule for the damping after successful and failed steps.

    Attributes:
        start: of the first step, as a share of the diagonal.
        least, most: bounds; above ``most`` the loop gives up.
        shrink, grow: factors after a step that lowers the cost, and after one that does not.
        first_grown: at least this much after a failure.
    """

    start: float = 1e-6
    least: float = 1e-9
    most: float = 1e8
    shrink: float = 10.0
    grow: float = 30.0
    first_grown: float = 1e-6


@dataclass(frozen=True)
class Iterate(Generic[State, Equations]):
    """The state of the loop.

    Attributes:
        state, equations, cost: the best state so far, linearized; after a step that was not evaluated, the equations
            are those before it, and the cost is the predicted one.
        damping: of the next step.
        gain: decrease of the cost by the last step; None if the step was rejected.
    """

    state: State
    equations: Equations
    cost: float
    damping: float
    gain: float | None = None


def start_at(
    problem: LeastSquares[State, Equations, Step], state: State, damping: float
) -> Iterate[State, Equations]:
    """Linearize at a first state."""
    return Iterate(state, *problem.linearize(state), damping)


def try_step(
    problem: LeastSquares[State, Equations, Step],
    now: Iterate[State, Equations],
    rule: Damping,
    least_gain: float = 0.0,
    predicted: Callable[[Equations, Step], float] | None = None,
) -> Iterate[State, Equations]:
    """Try one damped step; if it does not lower the cost, the iterate keeps its state, with more damping.

    Args:
        least_gain, predicted: as of :func:`minimize`.
    """
    grown = max(now.damping * rule.grow, rule.first_grown)
    try:
        step = problem.solve(now.equations, now.damping)
        state = problem.retract(now.state, step)
        if predicted is not None and (gain := predicted(now.equations, step)) < least_gain:
            return Iterate(state, now.equations, now.cost - gain, now.damping, gain)
        equations, cost = problem.linearize(state)
    except np.linalg.LinAlgError:
        return Iterate(now.state, now.equations, now.cost, grown)
    if not cost <= now.cost:
        return Iterate(now.state, now.equations, now.cost, grown)
    return Iterate(state, equations, cost, max(now.damping / rule.shrink, rule.least), now.cost - cost)


def minimize(
    problem: LeastSquares[State, Equations, Step],
    state: State,
    steps: int,
    least_gain: float,
    rule: Damping | None = None,
    least_share: float = 0.0,
    until: Callable[[State], bool] | None = None,
    predicted: Callable[[Equations, Step], float] | None = None,
) -> Iterate[State, Equations]:
    """Minimize from a start.

    Args:
        steps: largest number of tried steps.
        least_gain, least_share: a step that lowers the cost by less than this, or less than this share of it, is the
            last one.
        until: whether a state needs no further step.
        predicted: decrease of the cost by a step, as the equations predict it.  If this is given, a last step is
            recognized by it, and is accepted without evaluating the cost.
    """
    rule = rule or Damping()
    now = start_at(problem, state, rule.start)
    for _ in range(steps):
        now = try_step(problem, now, rule, max(least_gain, least_share * now.cost), predicted)
        if now.damping > rule.most or (now.gain is not None and now.gain < max(least_gain, least_share * now.cost)):
            break
        if until is not None and until(now.state):
            break
    return now


def minimize_rescaled(
    problem_at: Callable[[float], LeastSquares[State, Equations, Step]],
    scale_of: Callable[[State], float],
    state: State,
    steps: int,
    least_share: float,
    rule: Damping,
    most_tried: int = 8,
) -> tuple[State, float]:
    """Minimize a robust cost whose scale is recomputed after every accepted step.

    Costs are comparable only at the same scale, so each step is a separate problem.

    Args:
        problem_at: the problem at a fixed scale.
        scale_of: the robust scale of a state's residuals.
        state: the start.
        steps: largest number of accepted steps.
        least_share: a step that lowers the cost by less than this share of it is the last one.
        rule: rule for the damping.
        most_tried: tries with increasing damping, after which the state counts as converged.

    Returns:
        The state and its scale.
    """
    damping, scale = rule.start, scale_of(state)
    for _ in range(steps):
        problem = problem_at(scale)
        now = start_at(problem, state, damping)
        before = now.cost
        for _ in range(most_tried):
            now = try_step(problem, now, rule)
            if now.gain is not None:
                break
        if not now.gain:
            break
        state, damping = now.state, now.damping
        scale = scale_of(state)
        if now.gain / before < least_share:
            break
    return state, scale
