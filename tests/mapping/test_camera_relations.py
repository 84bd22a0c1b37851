"""Relative poses of the cameras as unknowns of a survey, and the weight of correlated errors."""

from dataclasses import replace

import numpy as np
import pytest

from lmkit.geometry.pose_array import PoseArray
from lmkit.mapping.bundle_adjustment import Anchor, BundleProblem
from lmkit.mapping.observation_noise import noise_factor
from lmkit.mapping.survey import survey_frames
from lmkit.simulation.recording import make_drive
from lmkit.simulation.site import turned

TURN_DEG = np.array([0.03, 0.06, -0.02])


@pytest.fixture(scope="module")
def drive():
    return make_drive(2, seconds=12)


def problem_of(drive, rig):
    poses = [drive.pose(k) @ drive.rig.T_base_left for k in range(len(drive.frames))]
    anchors = {m.id: Anchor(m, 1e-4 * np.eye(6)) for m in list(drive.landmarks)[:1]}
    return BundleProblem(drive.frames, rig, PoseArray.from_poses("map", "left", poses), drive.landmarks, anchors)


def test_the_gradient_is_that_of_the_cost(drive):
    problem = problem_of(drive, drive.rig)
    problem.relations = problem.relations.moved(np.array([0.001, -0.002, 0.003, 0.002, -0.001, 0.0015]))
    gradient = problem.equations()[0].shared_gradient
    state, still = problem.state(), np.zeros((len(problem.times), 6))
    for k in range(6):
        costs = []
        for sign in (1, -1):
            step = np.zeros(problem.shared)
            step[k] = sign * 1e-6
            problem.restore(problem.retract(state, (still, step)))
            costs.append(problem.equations()[1])
        assert -(costs[0] - costs[1]) / 4e-6 == pytest.approx(gradient[k], rel=1e-4)


def test_a_camera_that_stands_otherwise_than_the_rig_file_says_is_found(drive):
    problem = problem_of(drive, turned(drive.rig, -TURN_DEG))
    problem.optimize(20)
    found = np.rad2deg(problem.relations.turn[1])
    assert [found[2, 1], found[0, 2], found[1, 0]] == pytest.approx(TURN_DEG, abs=0.01)


def test_a_rig_file_that_is_hardly_off_hardly_moves_landmarks(drive):
    known = {m.id: Anchor(m, None) for m in list(drive.landmarks)[:1]}
    sizes = {m.id: m.size_m for m in drive.landmarks}
    places = []
    for rig in (drive.rig, turned(drive.rig, TURN_DEG)):
        found = survey_frames(drive.frames, rig, sizes, known).landmarks
        places.append({m.id: m.T_map_landmark.t for m in found})
    off = [np.linalg.norm(places[0][id_] - places[1][id_]) for id_ in places[0].keys() & places[1].keys()]
    assert np.median(off) < 0.005


def with_alike_errors(drive, correlation):
    """The recording, with errors of corners that have this correlation from one image to the next."""
    rng, errors = np.random.default_rng(5), {}

    def error(key):
        new = rng.normal(0, 0.3, (4, 2))
        errors[key] = correlation * errors.get(key, new) + np.sqrt(1 - correlation**2) * new
        return errors[key]

    def noisy(frame):
        seen = [
            tuple(replace(d, corners=d.corners + error((camera, d.id)), covariance=0.09 * np.eye(8)) for d in some)
            for camera, some in enumerate(frame.seen)
        ]
        return replace(frame, seen=tuple(seen))

    return replace(drive, frames=tuple(map(noisy, drive.frames)))


@pytest.mark.parametrize(("correlation", "least", "most"), [(0.0, 1.0, 1.3), (0.9, 4.0, 40.0)])
def test_errors_that_are_alike_in_consecutive_images_count_less(drive, correlation, least, most):
    problem = problem_of(with_alike_errors(drive, correlation), drive.rig)
    assert least <= noise_factor([problem]) < most


def test_a_map_states_what_errors_that_are_alike_cost(drive):
    known = {m.id: Anchor(m, None) for m in list(drive.landmarks)[:1]}
    sizes = {m.id: m.size_m for m in drive.landmarks}
    independent, alike = (
        survey_frames(with_alike_errors(drive, correlation).frames, drive.rig, sizes, known).landmarks
        for correlation in (0.0, 0.9)
    )
    shares = [np.trace(m.covariance[:3, :3]) / np.trace(independent.find(m.id).covariance[:3, :3])
              for m in alike if m.id not in known and independent.find(m.id) is not None]  # fmt: skip
    assert np.median(shares) > 3
