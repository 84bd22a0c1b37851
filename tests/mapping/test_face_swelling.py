"""Faces that a camera shows larger or smaller than they are: found by a survey, and stated."""

from dataclasses import replace

import numpy as np
import pytest

from lmkit.geometry.pose_array import PoseArray
from lmkit.mapping import bundle_adjustment
from lmkit.mapping.bundle_adjustment import Anchor, BundleProblem
from lmkit.mapping.survey import solve_recording
from lmkit.simulation.recording import make_drive

SWELLING_PX = np.array([-0.06, -0.1])


@pytest.fixture(scope="module")
def drive():
    return make_drive(2, seconds=12, noise_px=0.03)


def swollen(detection):
    a, b, c, d = detection.corners
    across, down = b - a + c - d, d - a + c - b
    x, y = SWELLING_PX[0] * across / np.linalg.norm(across), SWELLING_PX[1] * down / np.linalg.norm(down)
    return replace(detection, corners=detection.corners + np.array([-x - y, x - y, x + y, y - x]))


@pytest.fixture(scope="module")
def frames(drive):
    return [replace(f, seen=tuple(tuple(map(swollen, some)) for some in f.seen)) for f in drive.frames]


def problem_of(drive, frames):
    poses = [drive.pose(k) @ drive.rig.T_base_left for k in range(len(frames))]
    anchors = {m.id: Anchor(m, None) for m in list(drive.landmarks)[:1]}
    return BundleProblem(frames, drive.rig, PoseArray.from_poses("map", "left", poses), drive.landmarks, anchors)


def errors(problem, drive, equations):
    """Root mean square of the errors of landmarks' places, m, and their mean square in standard deviations."""
    seen = np.flatnonzero(np.bincount(problem.seen.of, minlength=len(problem.mapped)))[1:]
    off = problem.lm_p[seen] - np.array([m.T_map_landmark.t for m in drive.landmarks])[seen]
    rows = problem.own + 6 * seen[:, None] + np.arange(3)
    C = equations.covariances()[2][rows[:, :, None], rows[:, None]]
    nees = (off * np.linalg.solve(C, off[..., None])[..., 0]).sum(axis=1)
    return np.sqrt((off**2).sum(axis=1).mean()), nees.mean() / 3


def test_what_it_pulls_at_is_how_the_gradient_changes_with_it(drive, monkeypatch):
    monkeypatch.setattr(bundle_adjustment, "CAUCHY_SCALE", 1e6)  # weights change as well
    problem, step = problem_of(drive, drive.frames), 1e-4
    stated, before = problem.stated_equations(1.0)[0], problem.equations()[0]
    for k in range(2):
        problem.swelling = step * np.eye(2)[k]
        after = problem.equations()[0]
        column = problem.own - 2 + k
        for whole, a, b in (
            (stated.border[:, :, column], before.gradient, after.gradient),
            (
                stated.corner[: problem.own - 2, column],
                *(e.shared_gradient[: problem.own - 2] for e in (before, after)),
            ),
            (stated.corner[problem.own :, column], *(e.shared_gradient[problem.own :] for e in (before, after))),
        ):
            assert (a - b) / step == pytest.approx(whole, abs=1e-5 * np.abs(whole).max())


def test_it_is_found_and_the_map_is_the_better_for_it_and_says_how_good(drive, frames):
    problem = problem_of(drive, frames)
    problem.optimize(20)
    before, too_sure = errors(problem, drive, problem.equations()[0])
    problem.find_swelling(1.0)
    problem.optimize(20)
    assert problem.swelling == pytest.approx(SWELLING_PX, abs=0.03)
    after, honest = errors(problem, drive, problem.stated_equations(1.0)[0])
    assert after < 0.6 * before
    assert honest < 1 < too_sure


def test_a_survey_finds_it(drive, frames):
    known = {m.id: Anchor(m, None) for m in list(drive.landmarks)[:1]}
    solved = solve_recording(frames, drive.rig, {m.id: m.size_m for m in drive.landmarks}, known)
    assert solved.problem.swelling == pytest.approx(SWELLING_PX, abs=0.03)
