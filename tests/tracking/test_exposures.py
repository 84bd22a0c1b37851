"""Filters of cameras that do not expose together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import with_time_offsets
from lmkit.geometry.rotations import rotation_log
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.simulation.observations import look
from lmkit.simulation.recording import T_BASE_LEFT, Drive, WheelErrors, make_drive
from lmkit.simulation.scene import make_rig
from lmkit.tracking.exposure_queue import ExposureQueue
from lmkit.tracking.online import track_poses_live
from lmkit.tracking.planar_stereo_filter import RigFilter
from lmkit.tracking.range_bearing_filter import TrackedPose
from lmkit.tracking.spatial_stereo_filter import PoseFilter, SpacePose

LATE_S = 0.09


@pytest.fixture(scope="module")
def late():
    """A recording whose second camera exposes later, and the rig without that offset."""
    rig = replace(make_rig(), T_base_left=T_BASE_LEFT)
    return make_drive(5, 10.0, 10.0, rig=with_time_offsets(rig, [LATE_S])), rig


def test_wheels_carry_a_late_camera_with_their_noise(late):
    drive, rig = late
    tracker, rows, squared = RigFilter(drive.landmarks, rig), 0, []
    o = drive.odometry
    for frame, true in zip(drive.frames, drive.truth, strict=True):
        while rows < len(o.times_s) and o.times_s[rows] <= frame.time_s:
            tracker.wheels.add_odometry(o.times_s[rows], o.forward_m[rows], o.turn_rad[rows])
            rows += 1
        answer = tracker.observe(frame.time_s, frame.seen, (frame.time_s, frame.time_s + LATE_S))
        if answer.state is not None and frame.time_s > drive.times_s[0] + 3:
            d = answer.state - true
            d[2] = np.angle(np.exp(1j * d[2]))
            squared.append(d @ np.linalg.solve(answer.covariance, d))
    assert len(squared) > 40
    # With dead reckoning without noise, the mean is over 40.
    assert np.mean(squared) < 4


def test_odometry_carries_a_late_camera_with_its_noise(late):
    drive, rig = late
    tracker, odometry, squared = PoseFilter(drive.landmarks, rig), drive.visual_odometry(3), []
    for k, frame in enumerate(drive.frames):
        tracker.add_odometry(float(odometry.times_s[k]), odometry.pose(k, "odometry", "base"))
        answer = tracker.observe(frame.time_s, frame.seen, (frame.time_s, frame.time_s + LATE_S))
        if answer.T_map_left is not None and frame.time_s > drive.times_s[0] + 3:
            true = drive.pose(k) @ T_BASE_LEFT
            d = np.append(answer.T_map_left.t - true.t, rotation_log(answer.T_map_left.R @ true.R.T))
            squared.append(d @ np.linalg.solve(answer.covariance, d))
    assert len(squared) > 40
    assert np.mean(squared) < 8


def test_exposures_are_taken_in_their_order():
    queue = ExposureQueue()
    assert queue.due(1.0, (["a"], ["b"])) == [(1.0, [["a"], ["b"]])]
    assert queue.due(2.0, (["c"], ["d"]), (2.0, 2.3)) == [(2.0, [["c"], ()])]
    assert queue.due(3.0, (["e"], ["f"]), (3.00001, 2.9)) == [
        (2.3, [(), ["d"]]),
        (2.9, [(), ["f"]]),
        (3.0, [["e"], ()]),
    ]
    assert queue.due(4.0, ([], ["g"]), (4.0, 4.1)) == []
    queue.clear()
    assert queue.due(5.0, ([], [])) == []


EXACT = WheelErrors(1.0, 1.0, 0.1, 0.0, 0.0, gyro_bias=0.0, gyro_noise=0.0)
Follow = tuple[RigFilter | PoseFilter, Callable[[float], None]]


@lru_cache
def driven(offset_s: float) -> tuple[Drive, StereoRig]:
    """A recording without errors whose second camera exposes at another time, and the rig without that offset."""
    rig = replace(make_rig(), T_base_left=T_BASE_LEFT)
    return make_drive(5, 2.0, 10.0, 32, rig=with_time_offsets(rig, [offset_s]), errors=EXACT, noise_px=0.02), rig


def follow(kind: str, drive: Drive, rig: StereoRig) -> Follow:
    """A filter, and a function that gives it the odometry up to a time."""
    if kind == "wheels":
        tracker, o = RigFilter(drive.landmarks, rig), drive.odometry
        rows = list(zip(o.times_s, o.forward_m, o.turn_rad, strict=True))
        add = tracker.wheels.add_odometry
    else:
        tracker, o = PoseFilter(drive.landmarks, rig), drive.visual_odometry(0, 0.0, 0.0)
        rows = [(float(o.times_s[k]), o.pose(k, "odometry", "base")) for k in range(len(o))]
        add = tracker.add_odometry

    def until(time_s: float) -> None:
        while rows and rows[0][0] <= time_s:
            add(*rows.pop(0))

    return tracker, until


def off_mm(answer: TrackedPose | SpacePose, true: Pose) -> float:
    """How far a pose is off on the floor; ``true`` is T_map_base."""
    if isinstance(answer, TrackedPose):
        return 1000 * float(np.linalg.norm(answer.state[:2] - true.t[:2]))
    return 1000 * float(np.linalg.norm((answer.T_map_left.t - (true @ T_BASE_LEFT).t)[:2]))


@pytest.mark.parametrize("kind", ["wheels", "poses"])
def test_a_first_pose_takes_a_late_camera_at_its_time(kind):
    drive, rig = driven(LATE_S)
    found = []
    for k in (3, 7, 11, 14):
        tracker, until = follow(kind, drive, rig)
        time_s = drive.times_s[k]
        until(time_s + 0.3)
        answer = tracker.observe(time_s, drive.frames[k].seen, (time_s, time_s + LATE_S))
        if answer.restarted:
            found.append(off_mm(answer, drive.pose(k)))
    assert len(found) == 4
    assert max(found) < 2  # with the time of the frame for the late camera, there is no pose


@pytest.mark.parametrize("kind", ["wheels", "poses"])
def test_an_exposure_before_the_last_frame_is_taken_at_its_time(kind):
    early_s = 0.19
    drive, rig = driven(-early_s)
    tracker, until = follow(kind, drive, rig)
    found = []
    for k, (time_s, frame) in enumerate(zip(drive.times_s, drive.frames, strict=True)):
        until(time_s)
        answer = tracker.observe(time_s, frame.seen, (time_s, time_s - early_s))
        if k > 7:
            assert answer.outliers == ()
            found.append(off_mm(answer, drive.pose(k)))
    assert max(found) < 2


@pytest.mark.parametrize("kind", ["wheels", "poses"])
def test_what_the_start_has_used_does_not_count_again(kind):
    """The robot is carried to the other side of the room and is found again while an exposure waits."""
    drive, rig = driven(LATE_S)
    turned = Pose.from_rvec("map", "map", np.array([0.0, 0.0, np.pi]), np.array([8.0, 5.0, 0.0]))
    tracker, until = follow(kind, drive, rig)
    rng = np.random.default_rng(0)
    for k, time_s in enumerate(drive.times_s[:-1]):
        until(time_s)
        poses = [turned @ pose if k >= 5 else pose for pose in (drive.pose(k), drive.pose(k + 1))]
        seen = [look(drive.landmarks, rig, pose, 0.02, rng)[c] for c, pose in enumerate(poses)]
        answer = tracker.observe(time_s, seen, (time_s, drive.times_s[k + 1]))
        if k >= 5 and answer.restarted:
            break
    else:
        pytest.fail("it was not found anew")
    until(drive.times_s[k + 1])
    assert tracker.observe(drive.times_s[k + 1], ((), ())).nis_dof == 0


def test_poses_through_space_take_every_exposure_at_its_time():
    drive, _ = driven(LATE_S)
    tracked = track_poses_live(drive.frames, drive.rig, drive.landmarks, drive.visual_odometry(0, 0.0, 0.0))
    rows = np.searchsorted(drive.times_s, tracked.times_s)
    assert np.allclose(drive.times_s[rows], tracked.times_s)
    off = 1000 * np.linalg.norm(tracked.positions - [drive.pose(k).t for k in rows], axis=1)
    assert len(off) > 14
    assert np.median(off) < 2
