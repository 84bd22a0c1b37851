"""Tracking of simulated recordings: poses, their covariances, and errors of the wheels."""

from dataclasses import replace

import numpy as np
import pytest
from ids import lm8

from lmkit.geometry.planar import between
from lmkit.geometry.pose import Pose
from lmkit.localization.range_bearing_noise import ReadingNoise
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.pose_status import PoseStatus
from lmkit.model.recording import Gyro, Odometry
from lmkit.model.tracked_trajectory import TrackedTrajectory, tracked_lines
from lmkit.odometry.online_wheel_odometry import Wheels
from lmkit.odometry.wheel_odometry import NOMINAL, MotionModel
from lmkit.simulation.recording import WheelErrors, make_drive
from lmkit.tracking import range_bearing_filter as planar_filter
from lmkit.tracking.batch import track_images, track_readings
from lmkit.tracking.online import run_live, track_images_live, track_live
from lmkit.tracking.range_bearing_filter import PlanarFilter


def planar_errors(drive, tracked):
    """(N,3) errors of x, y and heading, and the covariances."""
    rows = [int(np.argmin(np.abs(drive.times_s - time))) for time in tracked.times_s]
    found = np.array([[*pose.t[:2], np.arctan2(pose.R[1, 0], pose.R[0, 0])] for pose in tracked.poses])
    off = found - drive.truth[rows]
    off[:, 2] = np.arctan2(np.sin(off[:, 2]), np.cos(off[:, 2]))
    at = np.array([0, 1, 5])
    return off, tracked.covariances[:, at[:, None], at[None]]


def rmse(off):
    return float(np.sqrt((off[:, :2] ** 2).sum(axis=1).mean()))


@pytest.mark.slow
@pytest.mark.parametrize("follow", [track_readings, track_live])
def test_readings_and_wheels_follow_the_robot(follow):
    errors, headings, nees = [], [], []
    for seed in (0, 1, 2):
        drive = make_drive(seed, errors=WheelErrors(slips=1))
        tracked = follow(drive.readings(seed), drive.odometry, None, drive.landmarks)
        off, C = planar_errors(drive, tracked)
        errors.append(rmse(off))
        headings.append(np.sqrt((off[:, 2] ** 2).mean()))
        nees.append(np.einsum("ni,nij,nj->n", off, np.linalg.inv(C), off).mean())
        # The scale errors of the wheels are found.
        assert tracked.parameters["forward_scale"] == pytest.approx(0.92, abs=0.04)
    assert max(errors) < 0.12
    assert np.rad2deg(max(headings)) < 2.0
    # Consecutive readings are taken as correlated, but simulated ones are independent: covariances are too large.
    assert max(nees) < (0.8 if follow is track_readings else 1.5)


@pytest.mark.slow
def test_corners_of_both_cameras_are_followed_live():
    for seed in (0, 3):
        drive = make_drive(seed, errors=WheelErrors(slips=1))
        tracked = track_images_live(drive.frames, drive.rig, drive.landmarks, drive.odometry, drive.gyro)
        off, C = planar_errors(drive, tracked)
        assert len(off) > 0.8 * len(drive.frames)
        # A slip moves the robot by up to 10 cm and 6 deg until a landmark is seen again.
        assert np.median(np.hypot(off[:, 0], off[:, 1])) < 0.01
        assert rmse(off) < 0.06
        assert np.median(np.einsum("ni,nij,nj->n", off, np.linalg.inv(C), off)) < 3
        assert tracked.parameters["forward_scale"] == pytest.approx(0.92, abs=0.04)


@pytest.mark.parametrize("count", [1, 15, 16, 60])
def test_cameras_are_tracked_without_odometry(count):
    drive = make_drive(0, seconds=14)
    tracked = track_images(drive.frames[:count], drive.rig, drive.landmarks, None)
    off, _ = planar_errors(drive, tracked)
    assert len(off) >= 0.8 * min(count, len(drive.frames))
    assert np.median(np.hypot(off[:, 0], off[:, 1])) < 0.05


def test_the_smoother_beats_the_filter_and_the_filter_beats_the_wheels():
    drive = make_drive(5, errors=WheelErrors(slips=2))
    readings = drive.readings(5)
    smooth, live = (
        rmse(planar_errors(drive, follow(readings, drive.odometry, None, drive.landmarks))[0])
        for follow in (track_readings, track_live)
    )
    motions = MotionModel(drive.odometry).increments(drive.times_s, np.array(NOMINAL)).motions
    wheels = np.linalg.norm(motions[:, :2].sum(axis=0) - between(drive.truth)[:, :2].sum(axis=0))
    assert smooth < live < wheels


def test_wrong_codes_do_not_pull_and_are_named():
    drive = make_drive(1)
    rng = np.random.default_rng(0)
    codes = [m.code for m in drive.landmarks]
    wrong, changed = [], {}
    for time, seen in drive.readings(1):
        frame = []
        for r in seen:
            id_ = lm8(int(rng.choice(codes))) if rng.random() < 0.1 else r.id
            if id_ != r.id:
                changed.setdefault(time, set()).add(id_)
            frame.append(type(r)(id_, r.range_m, r.bearing_rad))
        wrong.append((time, frame))
    for follow in (track_readings, track_live):
        tracked = follow(wrong, drive.odometry, None, drive.landmarks)
        off, _ = planar_errors(drive, tracked)
        assert rmse(off) < 0.2
        named = dict(zip(tracked.times_s.tolist(), map(set, tracked.outliers), strict=True))
        stated = [bool(named[time] & bad) for time, bad in changed.items() if time in named]
        assert np.mean(stated) > 0.8


def test_a_robot_carried_off_is_noticed_and_found_again():
    drive = make_drive(2)
    # From half way on, the robot is where it will be 15 s later.
    half = len(drive.frames) // 2
    readings = drive.readings(2)
    jump = 75
    moved = readings[:half] + [(readings[k][0], readings[k + jump][1]) for k in range(half, len(readings) - jump)]
    tracked = track_live(moved, drive.odometry, None, drive.landmarks)
    last = tracked.poses[-1].t[:2] - drive.truth[len(readings) - 1][:2]
    assert np.linalg.norm(last) < 0.5
    # In between, the status is not `ok`.
    truth = [drive.truth[k if k < half else k + jump] for k in range(len(moved))]
    offset = len(moved) - len(tracked.poses)
    for k, (pose, status) in enumerate(zip(tracked.poses, tracked.statuses, strict=True)):
        if np.linalg.norm(pose.t[:2] - truth[k + offset][:2]) > 1.0 and status == "ok":
            assert k + offset < half + 6, "more than a second of wrong poses called ok"


def test_images_and_wheels_follow_the_robot_in_space():
    drive = make_drive(6, seconds=40)
    tracked = track_images(drive.frames, drive.rig, drive.landmarks, MotionModel(drive.odometry, drive.gyro))
    assert len(tracked.poses) == len(drive.frames)
    off = [np.linalg.norm(pose.t - drive.pose(k).t) for k, pose in enumerate(tracked.poses)]
    assert max(off) < 0.03
    assert set(tracked.statuses) == {"ok"}
    squared = [
        (pose.t - drive.pose(k).t) @ np.linalg.solve(C[:3, :3], pose.t - drive.pose(k).t) / 3
        for k, (pose, C) in enumerate(zip(tracked.poses, tracked.covariances, strict=True))
    ]
    assert 0.1 < np.mean(squared) < 3


def test_the_delay_of_the_wheels_is_found_where_the_robot_turns_now_and_then():
    """Readings of a robot that stops and turns, wheels 0.25 s early."""
    times = np.arange(0, 120, 0.02)
    rate = np.where((times // 5) % 2 == 0, 0.0, np.where((times // 10) % 2 == 0, 0.5, -0.5))
    heading = np.concatenate([[0.0], np.cumsum(rate[:-1]) * 0.02])
    speed = np.full_like(times, 0.2)
    x, y = (np.concatenate([[0.0], np.cumsum(speed[:-1] * f(heading[:-1]) * 0.02)]) for f in (np.cos, np.sin))
    odometry = Odometry.from_velocities(times - 0.25, speed, rate)
    drive = make_drive(0)
    rng = np.random.default_rng(1)
    frames = []
    for k in range(50, len(times), 25):
        seen = []
        for m in drive.landmarks:
            off = m.T_map_landmark.t[:2] - [x[k], y[k]]
            bearing = np.arctan2(off[1], off[0]) - heading[k] + 0.005 * rng.normal()
            seen.append((m.id, float(np.hypot(*off) * (1 + 0.02 * rng.normal())), float(bearing)))
        frames.append((float(times[k]), seen))
    from lmkit.model.observation import RangeBearing

    readings = [(t, [RangeBearing(*reading) for reading in seen[:3]]) for t, seen in frames]
    tracked = track_readings(readings, odometry, None, drive.landmarks)
    assert tracked.parameters["delay_s"] == pytest.approx(0.25, abs=0.05)
    sigma = tracked.parameter_sigmas["delay_s"]
    assert 0.001 < sigma < 0.05
    assert abs(tracked.parameters["delay_s"] - 0.25) < 4 * sigma


def test_a_gyro_takes_the_place_of_the_wheels_turns():
    times = np.arange(0, 10, 0.1)
    odometry = Odometry.from_velocities(times, np.full(100, 0.3), np.zeros(100))
    gyro = Gyro(times, np.full(100, 0.2))
    quiet = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    turned = MotionModel(odometry, gyro).increments(np.array([1.0, 6.0]), quiet).motions[0, 2]
    assert turned == pytest.approx(1.0, abs=1e-9)


def test_nothing_is_known_where_odometry_has_a_gap():
    times = np.array([0.0, 0.1, 0.2, 5.2, 5.3])
    motion = MotionModel(Odometry(times, np.full(5, 0.02), np.zeros(5)))
    quiet = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    increments = motion.increments(np.array([0.0, 0.2, 5.2, 5.3]), quiet)
    assert increments.known.tolist() == [True, False, True]
    assert increments.sigmas[1, 0] > 1.0 > 10 * increments.sigmas[0, 0]


def test_before_the_first_fix_the_filter_says_lost():
    drive = make_drive(0)
    answer = PlanarFilter(drive.landmarks).observe(0.0, [])
    assert answer.status == "lost"
    assert answer.state is None


@pytest.mark.parametrize("delay_s", [-0.1, 0.0, 0.1])
def test_a_robot_that_runs_ahead_of_its_odometry_is_not_lost(delay_s):
    """Odometry ends at the present time; if the landmarks' clock is behind, the motion is continued."""
    wheels = Wheels()
    for k in range(1, 51):
        wheels.add_odometry(0.02 * k, 0.3 * 0.02, 0.0)
    x = np.concatenate([np.zeros(3), NOMINAL])
    x[-1] = delay_s
    later, P = wheels.predict(x, np.zeros((len(x), len(x))), 0.8, 1.0)
    assert later[:3] == pytest.approx([0.06, 0, 0], abs=1e-6)
    assert np.sqrt(P[0, 0]) < 0.03


@pytest.mark.slow
@pytest.mark.parametrize("follow", [track_readings, track_live])
def test_what_the_map_leaves_open_enters_poses_and_covariance(follow):
    """Landmarks measured to 0.1 m: if the map states this, poses are better and their covariance holds."""
    errors, nees = {True: [], False: []}, {True: [], False: []}
    C = np.zeros((6, 6))
    C[:3, :3] = 0.1**2 * np.eye(3)
    for seed in range(3):
        drive = make_drive(seed, seconds=40)
        rng = np.random.default_rng(seed)
        moved = [
            replace(m, T_map_landmark=Pose("map", "landmark", m.T_map_landmark.R, m.T_map_landmark.t + shift))
            for m, shift in zip(drive.landmarks, 0.1 * rng.normal(size=(len(drive.landmarks), 3)), strict=True)
        ]
        for said in (True, False):
            landmarks = LandmarkMap([replace(m, covariance=C if said else None) for m in moved])
            tracked = follow(drive.readings(seed), drive.odometry, drive.gyro, landmarks)
            off, covariances = planar_errors(drive, tracked)
            errors[said].append(rmse(off))
            nees[said].append(np.einsum("ni,nij,nj->n", off, np.linalg.inv(covariances), off).mean())
    assert np.mean(errors[True]) < 0.9 * np.mean(errors[False])
    assert np.mean(nees[True]) < 3.5 < np.mean(nees[False])


def innovation_ratio(tracked):
    """Mean normalized innovation squared: 1 if the covariance of the filter is right."""
    squared, stated = tracked.nis.sum(axis=0)
    return squared / stated


@pytest.mark.slow
def test_innovations_are_as_large_as_expected_where_readings_scatter_as_stated(monkeypatch):
    # As simulated: errors are independent and as stated.  Wheels are better than the filter assumes.
    independent = ReadingNoise(1e-3, 0.03, 0.01, 1e-4, related_s=0.0)
    monkeypatch.setattr(planar_filter, "DRIVE_NOISE", independent)
    ratios = []
    for seed in range(4):
        drive = make_drive(seed)
        ratios.append(innovation_ratio(track_live(drive.readings(seed), drive.odometry, drive.gyro, drive.landmarks)))
    assert 0.6 < np.mean(ratios) < 1.2


def test_innovations_of_readings_that_share_errors_are_judged_by_their_own_noise():
    """Readings of one landmark within 40 s weigh as one; with their weights as noise the ratio was 0.08."""
    drive = make_drive(1, seconds=20)
    filter_ = PlanarFilter(drive.landmarks, ReadingNoise(1e-3, 0.03, 0.01, 1e-4))
    readings = drive.readings(1)
    times = [time_s for time_s, _ in readings]
    answers = run_live(times, lambda k: filter_.observe(*readings[k]), filter_.wheels, drive.odometry, None)
    squared, dof = np.sum([(a.nis, a.nis_dof) for a in answers], axis=0)
    assert 0.3 < squared / dof < 1.2


def test_innovations_of_corners_are_as_large_as_expected():
    ratios = []
    for seed in range(3):
        drive = make_drive(seed, seconds=20)
        tracked = track_images_live(drive.frames, drive.rig, drive.landmarks, drive.odometry, drive.gyro)
        ratios.append(innovation_ratio(tracked))
    assert 0.5 < np.mean(ratios) < 1.2


def test_odometry_errors_are_printed_in_words():
    drive = TrackedTrajectory(
        np.zeros(1), [Pose.identity("map", "base")], np.zeros((1, 6, 6)), [PoseStatus.OK], [()],
        {"forward_scale": 0.92, "delay_s": 0.1}, parameter_sigmas={"forward_scale": 0.03},
    )  # fmt: skip
    assert tracked_lines(drive)[1:] == [
        "odometry errors:",
        "  distance scale (true / measured): 0.92 ± 0.03",
        "  delay of the images after the odometry, s: 0.1",
    ]
