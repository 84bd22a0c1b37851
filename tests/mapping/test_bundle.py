"""Constraints between the frames of a recording, and the messages where frames are not connected."""

from dataclasses import replace

import numpy as np
import pytest

from lmkit.geometry.pose_array import PoseArray
from lmkit.mapping.bundle_adjustment import Anchor, BundleProblem
from lmkit.mapping.survey import survey_frames
from lmkit.mapping.survey_results import jump_landmarks
from lmkit.mapping.wall_constraints import LandmarkConstraint
from lmkit.model.landmark_id import ids_text
from lmkit.simulation.recording import make_drive


def true_poses(drive, rows):
    poses = [drive.pose(k) @ drive.rig.T_base_left for k in rows]
    return PoseArray.from_poses("map", "left", poses)


def test_without_odometry_a_frame_that_sees_nothing_lies_between_its_neighbors():
    drive = make_drive(2, seconds=10)
    frames, start = drive.frames[:5], true_poses(drive, range(5))
    frames = [*frames[:2], replace(frames[2], seen=((), ())), *frames[3:]]
    away = start.t.copy()
    away[2] += [0.5, -0.3, 0.2]
    problem = BundleProblem(
        frames, drive.rig, PoseArray("map", "left", start.R, away), drive.landmarks, {}, landmarks_fixed=True
    )
    problem.optimize(30)
    assert problem.p[2] == pytest.approx((problem.p[1] + problem.p[3]) / 2, abs=0.02)


def test_an_adjustment_that_converged_is_not_repeated_until_something_changes(monkeypatch):
    drive = make_drive(2, seconds=10)
    known = {m.id: Anchor(m, None) for m in drive.landmarks}
    poses = true_poses(drive, range(len(drive.frames)))
    problem = BundleProblem(drive.frames, drive.rig, poses, drive.landmarks, known)
    solved = []
    monkeypatch.setattr(problem, "solve", lambda e, damping: solved.append(damping) or e.solve(damping))
    problem.optimize(30)
    steps, cost = len(solved), problem.cost()
    assert steps > 0
    problem.optimize(30)
    assert len(solved) == steps
    problem.used = problem.used & (np.arange(len(problem.used)) > 5)
    problem.optimize(30)
    assert problem.cost() < cost
    assert len(solved) > steps


@pytest.mark.parametrize(("seconds", "named"), [(1.4, True), (20.0, False)])
def test_without_odometry_a_jump_over_a_time_without_views_is_named_where_no_robot_moves_so_far(seconds, named):
    drive = make_drive(2, seconds=40)
    away = [np.linalg.norm(drive.pose(k).t - drive.pose(60).t) for k in range(len(drive.frames))]
    far = int(np.argmax(away))
    before, after = drive.frames[40:61], drive.frames[far : far + 20]
    late = [replace(m, time_s=m.time_s - after[0].time_s + before[-1].time_s + seconds) for m in after]
    known = {m.id: Anchor(m, None) for m in drive.landmarks}
    result = survey_frames([*before, *late], drive.rig, dict.fromkeys(known, 0.18), known)
    jump_lengths = [round(to - since, 1) for since, to, _ in result.bundle.jumps]
    assert jump_lengths == ([seconds] if named else [])
    between = sorted({o.id for frame in (before[-1], late[0]) for o in frame.detections})
    for since, to, _ in result.bundle.jumps:
        assert jump_landmarks(result.bundle, since, to) == f" ({ids_text(between)})"


def test_the_step_is_downhill_of_what_walls_and_heights_cost():
    """Cauchy's weights in the equations are those of the cost that decides about steps."""
    drive = make_drive(2, seconds=4)
    codes = tuple({o.id: None for frame in drive.frames for o in frame.seen[0]})[:3]
    mapped = type(drive.landmarks)([drive.landmarks.find(code) for code in codes])
    rows = range(len(drive.frames))
    # A recording without observations: only the constraints are left, and they are far from satisfied.
    blind = [replace(m, seen=((), ())) for m in drive.frames]
    constraints = [
        LandmarkConstraint("height", tuple(codes), 0.02, 0.02),
        LandmarkConstraint("wall", tuple(codes), 0.5, 0.5),
    ]
    problem = BundleProblem(blind, drive.rig, true_poses(drive, rows), mapped, {}, constraints=constraints)
    problem.lm_p = problem.lm_p + np.random.default_rng(0).normal(size=(3, 3)) * 0.1
    equations, _ = problem._equations()
    for k in range(3):
        for axis in range(3):
            costs = []
            for step in (-1e-6, 1e-6):
                moved = problem.lm_p[k].copy()
                moved[axis] += step
                before = problem.state()
                problem.put(k, problem.lm_R[k], moved)
                costs.append(problem.cost())
                problem.restore(before)
            slope = (costs[1] - costs[0]) / 2e-6
            gradient = equations.shared_gradient[problem.own + 6 * k + axis]
            assert -2 * gradient == pytest.approx(slope, rel=1e-3, abs=1e-3)
