"""The size of a planar map comes from the priors of the wheels and of the ranges alone, not from their noise."""

import math

import numpy as np
import pytest

from lmkit.localization.range_bearing_noise import DRIVE_NOISE
from lmkit.mapping.planar_smoother import OWN, PlanarProblem
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.observation import RangeBearing
from lmkit.model.recording import Odometry
from lmkit.odometry.wheel_odometry import NOMINAL, PARAMETERS, PRIOR_SIGMA, MotionModel

STEP_S = 0.1


@pytest.fixture(scope="module")
def problem():
    """Half a minute of a robot that drives a winding path among landmarks, with noisy wheels and readings."""
    rng = np.random.default_rng(31)
    places, state, frames, rows = rng.uniform(-4, 4, (8, 2)), np.zeros(3), [], []
    for k in range(300):
        way, turn = 0.02, 0.03 * math.sin(0.05 * k)
        rows.append((STEP_S * k, way + rng.normal(0, 0.008), turn + rng.normal(0, 0.01)))
        heading = state[2] + turn / 2
        state = state + np.array([way * math.cos(heading), way * math.sin(heading), turn])
        if k % 10 == 9:
            off = places - state[:2]
            ranges = np.hypot(*off.T) * rng.normal(1, 0.08, len(off))
            bearings = np.arctan2(off[:, 1], off[:, 0]) - state[2] + rng.normal(0, 0.01, len(off))
            pairs = enumerate(zip(ranges, np.arctan2(np.sin(bearings), np.cos(bearings)), strict=True))
            time_s = STEP_S * (k + 1)
            frames.append((time_s, [RangeBearing(LandmarkId("lm8", j), r, b, time_s) for j, (r, b) in pairs]))
    times, forward, turn = np.array(rows).T
    odometry = Odometry.from_velocities(times, forward / STEP_S, turn / STEP_S)
    made = PlanarProblem(
        np.array([t for t, _ in frames]), [seen for _, seen in frames], MotionModel(odometry), None, DRIVE_NOISE
    )
    made.take_up()
    return made


def without_priors(problem):
    """Cost of readings and motions, and its gradient with the odometry's and the ranges' parameters."""
    sigma = np.append(PRIOR_SIGMA, problem.noise.range_scale)
    off = (np.append(NOMINAL, 1.0) - problem.parameters) / sigma
    equations, cost, _ = problem._equations()
    return cost - float((off**2).sum()), equations.shared_gradient[:OWN] - off / sigma


@pytest.fixture
def unknowns(problem):
    """The unknowns, put back afterwards."""
    before = problem.states, problem.parameters, problem.places
    yield problem
    problem.states, problem.parameters, problem.places = before


@pytest.mark.parametrize("scale", [0.8, 1.25])
def test_a_map_of_another_size_is_as_likely_but_for_the_priors(unknowns, scale):
    cost, _ = without_priors(unknowns)
    unknowns.states = unknowns.states * [scale, scale, 1.0]
    unknowns.places = unknowns.places * scale
    factors = dict.fromkeys(PARAMETERS, 1.0) | {"forward_scale": scale, "turn_per_m": 1 / scale}
    unknowns.parameters = unknowns.parameters * [*factors.values(), 1 / scale]
    assert without_priors(unknowns)[0] == pytest.approx(cost, rel=1e-9)


def test_the_gradient_with_the_scale_of_the_way_is_that_of_the_cost(unknowns):
    _, gradient = without_priors(unknowns)
    costs = []
    for step in (1e-5, -1e-5):
        unknowns.parameters = unknowns.parameters + np.where(np.arange(OWN) == 0, step, 0.0)
        costs.append(without_priors(unknowns)[0])
        unknowns.parameters = unknowns.parameters - np.where(np.arange(OWN) == 0, step, 0.0)
    assert -2 * gradient[0] == pytest.approx((costs[0] - costs[1]) / 2e-5, rel=1e-3, abs=0.1)


def test_ranges_weigh_as_expected_not_as_read(problem):
    seen, _, off = problem._errors()
    expected = problem.noise.range_sigma(problem.parameters[-1] * np.hypot(*off.T))
    assert seen.sigmas[:, 0] / problem._alike == pytest.approx(expected, rel=0.01)
