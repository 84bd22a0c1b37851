"""Covariances of filters include errors that do not average out: a robot that stands still sees the same errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lmkit.arrays import FloatArray
from lmkit.geometry.planar import planar_pose, wrap_heading
from lmkit.geometry.pose import Pose
from lmkit.geometry.rotations import rotation_exp, rotation_log
from lmkit.model.landmark_map import LandmarkMap
from lmkit.navigation.navigator import WITH_GYRO
from lmkit.odometry.pose_odometry import PoseNoise
from lmkit.simulation.observations import look
from lmkit.simulation.recording import Drive, make_drive
from lmkit.tracking.planar_stereo_filter import RigFilter
from lmkit.tracking.spatial_stereo_filter import PoseFilter

PLACE_M, TURN_RAD = 0.005, 0.01
RUNS, FRAMES = 14, 10


def misplaced(landmarks: LandmarkMap, rng: np.random.Generator) -> LandmarkMap:
    """A map with errors as large as it states."""
    C = np.diag([PLACE_M**2] * 3 + [TURN_RAD**2] * 3)
    moved = []
    for landmark in landmarks:
        T = landmark.T_map_landmark
        R, t = rotation_exp(TURN_RAD * rng.normal(size=3)) @ T.R, T.t + PLACE_M * rng.normal(size=3)
        moved.append(replace(landmark, T_map_landmark=Pose("map", T.from_frame, R, t), covariance=C))
    return LandmarkMap(moved)


def on_floor(drive: Drive, landmarks: LandmarkMap, state: FloatArray, rng: np.random.Generator) -> float | None:
    """Squared error over the three coordinates, in standard deviations, after a robot has stood for a while."""
    tracker = RigFilter(landmarks, drive.rig, WITH_GYRO, 0.0)
    for k in range(FRAMES):
        tracker.wheels.add_odometry(0.2 * k, 0.0, 0.0)
        answer = tracker.observe(0.2 * k, look(drive.landmarks, drive.rig, planar_pose(state), 0.1, rng))
    if answer.state is None or answer.covariance is None:
        return None
    off = answer.state - state
    off[2] = wrap_heading(off[2])
    return float(off @ np.linalg.solve(answer.covariance, off)) / 3


def in_space(drive: Drive, landmarks: LandmarkMap, state: FloatArray, rng: np.random.Generator) -> float | None:
    """Squared error over the six numbers of a pose in space, likewise."""
    still = PoseNoise(**{name: 0.02 * value for name, value in PoseNoise().__dict__.items()})
    tracker, pose = PoseFilter(landmarks, drive.rig, still, 0.0), planar_pose(state)
    for k in range(FRAMES):
        tracker.add_odometry(0.2 * k, Pose.identity("odometry", "base"))
        answer = tracker.observe(0.2 * k, look(drive.landmarks, drive.rig, pose, 0.1, rng))
    if answer.T_map_left is None or answer.covariance is None:
        return None
    assert drive.rig.T_base_left is not None
    true = pose @ drive.rig.T_base_left
    turned = rotation_log(answer.T_map_left.R @ true.R.T)
    off = np.concatenate([answer.T_map_left.t - true.t, turned])
    return float(off @ np.linalg.solve(answer.covariance, off)) / 6


@pytest.mark.parametrize("stood", [on_floor, in_space])
def test_a_map_that_is_off_as_it_says_stays_off_however_often_it_is_seen(stood: object) -> None:
    """Without lasting errors the means are 5.6 and 11."""
    assert callable(stood)
    drive, found = make_drive(1, 10.0, 5.0, count=7), []
    for seed in range(RUNS):
        rng = np.random.default_rng([seed, 36])
        state = drive.truth[rng.integers(len(drive.truth))]
        found.append(stood(drive, misplaced(drive.landmarks, rng), state, rng))
    known = [value for value in found if value is not None]
    assert len(known) > RUNS / 2
    # With right covariances, 99 % of the means of a dozen draws of three numbers lie in this band.
    assert 0.4 < np.mean(known) < 1.65


def test_one_image_seen_many_times_says_no_more_than_once_and_another_view_does() -> None:
    """Without lasting errors the variance falls to a tenth in both."""
    drive, rng = make_drive(1, 10.0, 5.0, count=7), np.random.default_rng(7)
    tracker, space = RigFilter(drive.landmarks, drive.rig, WITH_GYRO), PoseFilter(drive.landmarks, drive.rig)
    seen = look(drive.landmarks, drive.rig, drive.pose(8), 0.1, rng)
    variances, variances_in_space = [], []
    for k in range(FRAMES):
        tracker.wheels.add_odometry(0.2 * k, 0.0, 0.0)
        space.add_odometry(0.2 * k, Pose.identity("odometry", "base"))
        answer, in_space = tracker.observe(0.2 * k, seen), space.observe(0.2 * k, seen)
        assert answer.covariance is not None
        assert in_space.covariance is not None
        variances.append(np.trace(answer.covariance[:2, :2]))
        variances_in_space.append(np.trace(in_space.covariance[:3, :3]))
    assert min(variances[2:]) > 0.7 * variances[1]
    assert min(variances_in_space) > 0.7 * variances_in_space[0]
    moved = [[replace(o, corners=o.corners + np.array([0.0, 4.0])) for o in one] for one in seen]
    with_news = tracker.observe(0.2 * FRAMES, moved).covariance
    assert with_news is not None
    assert np.trace(with_news[:2, :2]) < 0.95 * variances[-1]
