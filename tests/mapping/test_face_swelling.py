"""Faces that appear larger or smaller than they are: a survey estimates and states this swelling."""

from dataclasses import replace

import numpy as np
import pytest

from lmkit.geometry.pose_array import PoseArray
from lmkit.kernels.face_swelling import FaceSums, add_face_equations
from lmkit.kernels.landmark_bundle import errors_of_rays
from lmkit.mapping import bundle_adjustment
from lmkit.mapping.bundle_adjustment import Anchor, BundleProblem
from lmkit.mapping.face_swelling import SwellingPrior
from lmkit.mapping.stated_equations import StatedEquations
from lmkit.mapping.survey import solve_recording
from lmkit.simulation.recording import make_drive

SWELLING_PX = np.array([-0.06, -0.1])
STATED_PX = 0.12  # by a detector, of corners that such a camera shifts


@pytest.fixture(scope="module")
def drive():
    return make_drive(2, seconds=12, noise_px=0.03)


def swollen(detection):
    a, b, c, d = detection.corners
    across, down = b - a + c - d, d - a + c - b
    x, y = SWELLING_PX[0] * across / np.linalg.norm(across), SWELLING_PX[1] * down / np.linalg.norm(down)
    off = np.array([-x - y, x - y, x + y, y - x])
    return replace(detection, corners=detection.corners + off, covariance=STATED_PX**2 * np.eye(8))


@pytest.fixture(scope="module")
def frames(drive):
    return [replace(f, seen=tuple(tuple(map(swollen, some)) for some in f.seen)) for f in drive.frames]


def problem_of(drive, frames):
    poses = [drive.pose(k) @ drive.rig.T_base_left for k in range(len(frames))]
    anchors = {m.id: Anchor(m, None) for m in list(drive.landmarks)[:1]}
    return BundleProblem(frames, drive.rig, PoseArray.from_poses("map", "left", poses), drive.landmarks, anchors)


def errors(problem, drive, shared):
    """Root mean square of the errors of landmarks' places, m, and their mean square in standard deviations.

    Args:
        shared: covariance of the shared unknowns.
    """
    seen = np.flatnonzero(np.bincount(problem.seen.of, minlength=len(problem.mapped)))[1:]
    off = problem.lm_p[seen] - np.array([m.T_map_landmark.t for m in drive.landmarks])[seen]
    rows = problem.own + 6 * seen[:, None] + np.arange(3)
    C = shared[rows[:, :, None], rows[:, None]]
    nees = (off * np.linalg.solve(C, off[..., None])[..., 0]).sum(axis=1)
    return np.sqrt((off**2).sum(axis=1).mean()), nees.mean() / 3


def shared_of(stated, columns):
    """Rows of the shared unknowns without the faces, and of the rig, in some columns of stated equations."""
    border = stated.chain.dense_border()
    return stated.chain.corner[stated.places[:, None], columns], border[:, :, columns]


def test_what_they_pull_at_is_how_the_gradient_changes_with_them(drive, monkeypatch):
    monkeypatch.setattr(bundle_adjustment, "CAUCHY_SCALE", 1e6)  # weights change as well
    problem, step = problem_of(drive, drive.frames), 1e-4
    # Without errors, the observed corners, which undo the swelling, equal the expected ones, which define it.
    exact = problem.seen.rays - errors_of_rays(problem._correspondences()).reshape(-1, 4, 2)
    monkeypatch.setattr(problem, "seen", replace(problem.seen, rays=exact))
    stated, before = problem.stated_equations(1.0)[0], problem.equations()[0]
    common = np.arange(problem.own - 2, problem.own)
    seen_most = int(np.bincount(problem.seen.of).argmax())
    for columns, name, places in ((common, "swelling", ...), (stated.faces[seen_most], "faces", seen_most)):
        corner, border = shared_of(stated, columns)
        for k in range(2):
            moved = np.zeros_like(getattr(problem, name))
            moved[places] += step * np.eye(2)[k]
            with monkeypatch.context() as patch:
                patch.setattr(problem, name, moved)
                after = problem.equations()[0]
            pulled = (before.shared_gradient - after.shared_gradient) / step
            others = np.setdiff1d(np.arange(len(pulled)), common)  # equations hold the swelling
            whole = corner[others, k]
            assert pulled[others] == pytest.approx(whole, abs=1e-5 * np.abs(whole).max())
            whole = border[:, :, k]
            assert (before.gradient - after.gradient) / step == pytest.approx(whole, abs=1e-5 * np.abs(whole).max())


def test_errors_of_corners_alone_pull_no_face_outward(drive):
    """Twenty times the stated errors; a direction that turns with them would bias the swelling by 17 deviations."""
    problem, rng, pulls = problem_of(drive, drive.frames), np.random.default_rng(7), []
    bundle = problem._correspondences()
    expected = bundle.rays - errors_of_rays(bundle).reshape(-1, 4, 2)
    count = len(bundle.at)
    for _ in range(200):
        off = np.linalg.solve(bundle.whitener, 20 * rng.normal(size=(count, 8, 1))).reshape(-1, 4, 2)
        sums = FaceSums.zeros(np.arange(count), None, count, len(problem.mapped), 0)
        add_face_equations(replace(bundle, rays=expected + off), np.ones(count), sums)
        pulls.append(sums.gradient.sum(axis=0) / (20 * np.sqrt(np.diag(sums.corner.sum(axis=0)))))
    assert np.abs(np.sum(pulls, axis=0) / np.sqrt(len(pulls))).max() < 3.5


def test_swelling_is_found_and_the_map_is_the_better_for_it_and_says_how_good(drive, frames):
    problem = problem_of(drive, frames)
    problem.optimize(20)
    before, too_sure = errors(problem, drive, problem.equations()[0].covariances()[2])
    problem.find_swelling(1.0)
    problem.optimize(20)
    assert problem.swelling == pytest.approx(SWELLING_PX, abs=0.03)
    stated = problem.stated_equations(1.0)[0]
    after, honest = errors(problem, drive, stated.covariances()[1])
    assert after < 0.6 * before
    assert honest < 1 < too_sure
    states, shared, faces = stated.solve()
    around = stated.solve_around(shared[problem.own :], problem.own)
    assert around[0] == pytest.approx(states, abs=1e-6 * np.abs(states).max())
    assert around[1] == pytest.approx(shared, abs=1e-6 * np.abs(shared).max())
    assert around[2] == pytest.approx(faces, abs=1e-6 * np.abs(faces).max() + 1e-12)
    known = problem.own + 6  # the first landmark is known exactly
    left = np.linalg.inv(stated.eliminate(problem.own).information)[6:, 6:]
    assert left == pytest.approx(stated.covariances()[1][known:, known:], rel=1e-4, abs=1e-4 * np.abs(left).max())


def test_the_step_of_the_swelling_moves_the_other_unknowns_only_if_that_lowers_the_cost(drive, frames, monkeypatch):
    def stepped():
        problem = problem_of(drive, frames)
        problem.optimize(20)
        before = problem.p
        problem.find_swelling(1.0)
        assert problem.swelling.all()
        return problem.p is before

    assert not stepped()
    solve = StatedEquations.solve

    def too_far(stated):
        states, shared, faces = solve(stated)
        return 100 * states, shared, faces

    monkeypatch.setattr(StatedEquations, "solve", too_far)
    assert stepped()


def test_a_landmark_that_seems_smaller_than_others_is_found(drive):
    """One landmark of a recording seems smaller than the others by 0.04 px along its height."""
    counts = np.bincount(problem_of(drive, drive.frames).seen.of)
    row = int(counts[1:].argmax()) + 1
    small = list(drive.landmarks)[row].id

    def shrunk(detection):
        a, b, c, d = detection.corners
        down = d - a + c - b
        y = -0.04 * down / np.linalg.norm(down)
        off = np.array([-y, -y, y, y]) if detection.id == small else 0.0
        return replace(detection, corners=detection.corners + off)

    found = []
    for change in (lambda detection: detection, shrunk):
        seen = [replace(f, seen=tuple(tuple(map(change, some)) for some in f.seen)) for f in drive.frames]
        problem = problem_of(drive, seen)
        problem.optimize(20)
        problem.find_swelling(1.0)
        found.append(problem.faces[:, 1])
    changed = found[1] - found[0]
    assert -0.04 < changed[row] < -0.01
    assert np.abs(np.delete(changed, row)).max() < 0.5 * abs(changed[row])


def test_a_survey_finds_it(drive, frames):
    known = {m.id: Anchor(m, None) for m in list(drive.landmarks)[:1]}
    solved = solve_recording(frames, drive.rig, {m.id: m.size_m for m in drive.landmarks}, known)
    assert solved.problem.swelling == pytest.approx(SWELLING_PX, abs=0.03)


@pytest.mark.parametrize(
    ("stated_px", "common_px"),
    [([0.3, 0.3], 0.06), ([0.06, 0.06, 0.5], 0.03), ([0.01], 0.02), ([0.0, 0.0, 0.01], 0.06), ([], 0.06)],
)
def test_the_prior_is_narrower_where_corners_are_exact_and_wide_where_nothing_is_stated(stated_px, common_px):
    prior = SwellingPrior.of(np.array(stated_px) ** 2)
    assert prior.common_px == pytest.approx(common_px)
    assert prior.faces_px(np.array([60.0, 30.0, 15.0, 1.0])) == pytest.approx(
        0.3 * common_px * np.array([0.25, 1, 4, 4])
    )
