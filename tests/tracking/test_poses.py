"""Odometry in 3D: its motions, and their use in filter and bundle adjustment."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lmkit.errors import InputError
from lmkit.geometry.pose import Pose
from lmkit.mapping.bundle_adjustment import Anchor
from lmkit.mapping.survey import survey_frames
from lmkit.model.trajectory import Trajectory
from lmkit.odometry.motion_model import BoundedMotion
from lmkit.odometry.pose_odometry import PoseMotion
from lmkit.simulation.recording import make_drive
from lmkit.tracking.batch import track_images
from lmkit.tracking.online import track_poses_live
from lmkit.tracking.spatial_stereo_filter import PoseFilter


def winding(count=40):
    times = np.linspace(0, 4, count)
    places = np.column_stack([np.sin(times), 0.5 * times, 0.1 * times**2])
    turns = Rotation.from_rotvec(np.column_stack([0.1 * times, 0.3 * np.sin(times), times]))
    return Trajectory(times, places, turns.as_quat())


def test_motions_lead_from_pose_to_pose():
    poses = winding()
    steps = PoseMotion(poses).steps(poses.times_s[::3], np.array([1.0, 0.0]))
    R, p = poses.rotations[0], poses.positions[0]
    for turn, way in zip(steps.R, steps.t, strict=True):
        R, p = R @ turn, p + R @ way
    assert p == pytest.approx(poses.positions[39], abs=1e-9)
    assert pytest.approx(poses.rotations[39], abs=1e-9) == R
    assert steps.known.all()


SLOW = 2e-4 * np.sin(np.arange(4 * 6))  # m/s and rad/s at four knots, turns so small that they add up


@pytest.mark.parametrize(
    ("motion", "at"),
    [(PoseMotion(winding()), np.array([1.02, 0.01])), (BoundedMotion(np.array([0.0, 13.0])), SLOW)],
    ids=["poses", "velocities"],
)
def test_derivatives_are_those_of_the_motions(motion, at):
    times = np.array([0.5, 0.9, 2.2, 3.1]) * (1 if len(at) == 2 else 4)
    steps = motion.steps(times, at)
    derivatives = np.zeros((len(steps.t), len(at), 6))
    np.add.at(
        derivatives, (np.arange(len(steps.t))[:, None], steps.parameters), steps.by_parameters.transpose(0, 2, 1)
    )
    for k, by_parameter in enumerate(derivatives.transpose(1, 0, 2)):
        moved = motion.steps(times, at + 1e-6 * np.eye(len(at))[k])
        turned = Rotation.from_matrix(steps.R.transpose(0, 2, 1) @ moved.R).as_rotvec() / 1e-6
        assert by_parameter[:, :3] == pytest.approx((moved.t - steps.t) / 1e-6, rel=0.02, abs=2e-3)
        assert by_parameter[:, 3:] == pytest.approx(turned, rel=0.02, abs=5e-3)


def test_without_knots_a_rig_is_expected_at_rest():
    steps = BoundedMotion(np.array([0.0, 13.0]), most_knots=0).steps(np.array([0.5, 0.9, 2.2]), np.zeros(0))
    assert (np.eye(3) == steps.R).all() and not steps.t.any()
    assert steps.parameters.shape == (2, 0) and steps.by_parameters.shape == (2, 6, 0)


def test_beyond_its_ends_odometry_says_nothing():
    steps = PoseMotion(winding()).steps(np.array([1.0, 2.0, 6.0]), np.array([1.0, 0.0]))
    assert steps.known.tolist() == [True, False]
    assert steps.sigmas[1, 0] > 1.0 > 10 * steps.sigmas[0, 0]


@pytest.mark.slow
def test_poses_and_images_follow_the_cameras_while_they_move():
    squared, worst = [], []
    for seed in range(4):
        drive = make_drive(seed, seconds=30)
        tracked = track_poses_live(drive.frames, drive.rig, drive.landmarks, drive.visual_odometry(seed))
        assert len(tracked.poses) >= len(drive.frames) - 10
        assert not tracked.remarks
        first = len(drive.frames) - len(tracked.poses)
        for k, (pose, C) in enumerate(zip(tracked.poses, tracked.covariances, strict=True)):
            true = drive.pose(first + k)
            off = np.concatenate([pose.t - true.t, Rotation.from_matrix(pose.R @ true.R.T).as_rotvec()])
            squared.append(off @ np.linalg.solve(C, off) / 6)
            worst.append(np.linalg.norm(off[:3]))
    assert max(worst) < 0.06
    assert 0.4 < np.mean(squared) < 1.6


def test_odometry_carries_the_cameras_on_where_nothing_is_seen():
    drive = make_drive(1, seconds=30)
    blind = slice(60, 100)
    filter_ = PoseFilter(drive.landmarks, drive.rig)
    odometry, sigmas = drive.visual_odometry(1), []
    for k, frame in enumerate(drive.frames):
        filter_.add_odometry(float(odometry.times_s[k]), odometry.pose(k, "odometry", "base"))
        seen = ((), ()) if blind.start <= k < blind.stop else frame.seen
        answer = filter_.observe(frame.time_s, seen)
        if k == blind.stop - 1:
            off = answer.T_map_left.t - (drive.pose(k) @ drive.rig.T_base_left).t
            assert np.linalg.norm(off) < 3 * np.sqrt(np.trace(answer.covariance[:3, :3])) < 0.4
        sigmas.append(0.0 if answer.covariance is None else np.sqrt(np.trace(answer.covariance[:3, :3])))
    assert sigmas[99] > 3 * sigmas[59]


def test_cameras_that_were_carried_off_are_found_again():
    drive = make_drive(2, seconds=40)
    odometry = drive.visual_odometry(2)
    # From frame 80 on, everything is 60 frames further, and odometry does not show this.
    there = [*range(80), *range(140, len(drive.frames))]
    filter_ = PoseFilter(drive.landmarks, drive.rig)
    restarts = []
    for n, k in enumerate(there):
        filter_.add_odometry(n / 5, odometry.pose(min(n, 79), "odometry", "base"))
        answer = filter_.observe(n / 5, drive.frames[k].seen)
        restarts.append(answer.restarted)
        if 80 <= n < 80 + 3:
            assert answer.outliers
    assert any(restarts[81:90])


@pytest.mark.parametrize("exact", [True, False])
def test_a_recording_is_smoothed_through_space(exact):
    drive = make_drive(3, seconds=30)
    odometry = drive.visual_odometry(3)
    unseen = [m if not 40 <= k < 70 else type(m)(m.time_s, ((), ()), m.name) for k, m in enumerate(drive.frames)]
    if exact:
        tracked = track_images(unseen, drive.rig, drive.landmarks, PoseMotion(odometry))
        found = tracked.poses
    else:
        sizes = {m.id: m.size_m for m in drive.landmarks}
        seen = {o.code for m in unseen[:20] for o in m.seen[0]}
        anchors = {m.id: Anchor(m, None) for m in drive.landmarks if m.code in seen}
        result = survey_frames(unseen, drive.rig, sizes, anchors, PoseMotion(odometry))
        assert result.rows == tuple(range(len(unseen)))
        assert abs(result.bundle.parameters[0] - 1) < 0.01
        found = [pose @ drive.rig.T_base_left.inverse() for pose in result.bundle.left_poses()]
    off = [np.linalg.norm(pose.t - drive.pose(k).t) for k, pose in enumerate(found)]
    assert max(off) < 0.1
    assert np.median(off) < (0.01 if exact else 0.04)


def test_odometry_of_one_pose_is_refused():
    with pytest.raises(InputError, match="one pose"):
        PoseMotion(Trajectory(np.zeros(1), np.zeros((1, 3)), np.array([[0.0, 0.0, 0.0, 1.0]])))


def test_odometry_between_times_loses_no_way():
    """Its rows lie half a period before the frames: what was traveled since the last row counts as well."""
    drive = make_drive(1, seconds=30)
    true = Trajectory(
        drive.times_s,
        np.array([drive.pose(k).t for k in range(len(drive.times_s))]),
        np.array([drive.pose(k).quaternion_xyzw for k in range(len(drive.times_s))]),
    )
    filter_ = PoseFilter(drive.landmarks, drive.rig)
    for k, frame in enumerate(drive.frames[:90]):
        before = true.pose(max(k - 1, 0), "odometry", "base")
        half = Rotation.from_matrix([before.R, true.pose(k, "odometry", "base").R]).mean()
        place = (before.t + true.positions[k]) / 2
        filter_.add_odometry(frame.time_s - 0.1, Pose("odometry", "base", half.as_matrix(), place))
        seen = frame.seen if k < 60 else ((), ())
        answer = filter_.observe(frame.time_s, seen)
    # Six seconds and two meters without landmarks: exact odometry gives the pose.
    off = np.linalg.norm(answer.T_map_left.t - (drive.pose(89) @ drive.rig.T_base_left).t)
    assert off < 0.06
    assert np.sqrt(np.trace(answer.covariance[:3, :3])) < 0.15


def test_odometry_may_begin_after_the_cameras():
    drive = make_drive(1, seconds=30)
    odometry = drive.visual_odometry(1)
    filter_ = PoseFilter(drive.landmarks, drive.rig)
    for k, frame in enumerate(drive.frames[:30]):
        if k >= 5:
            filter_.add_odometry(float(odometry.times_s[k]), odometry.pose(k, "odometry", "base"))
        answer = filter_.observe(frame.time_s, frame.seen)
        assert not answer.restarted or k == 0
        assert not answer.outliers


def test_one_long_step_strays_as_many_short_ones_do():
    """An early rotation error displaces the rest of the trajectory, however the trajectory is cut."""
    times = np.linspace(0.0, 20.0, 401)
    places = np.column_stack([0.3 * times, np.zeros((401, 2))])
    motion = PoseMotion(Trajectory(times, places, np.tile([0.0, 0.0, 0.0, 1.0], (401, 1))))
    sides = []
    for frames in (times[[0, 400]], times[::4]):
        steps = motion.steps(frames, motion.nominal)
        P = np.zeros((2, 2))  # aside, turn
        for way, sigma in zip(steps.t[:, 0], steps.sigmas, strict=True):
            F = np.array([[1.0, way], [0.0, 1.0]])
            P = F @ P @ F.T + np.diag([sigma[1] ** 2, sigma[5] ** 2])
        sides.append(np.sqrt(P[0, 0]))
    assert sides[0] == pytest.approx(sides[1], rel=0.05)


def test_cameras_that_see_nothing_and_have_no_odometry_are_lost():
    drive = make_drive(1, seconds=10)
    filter_ = PoseFilter(drive.landmarks, drive.rig)
    for frame in drive.frames[:20]:
        assert filter_.observe(frame.time_s, frame.seen).status == "ok"
    for frame in drive.frames[20:40]:
        answer = filter_.observe(frame.time_s, ((), ()))
    # A robot may move at a meter a second, in an unknown direction.
    assert answer.status == "lost"
