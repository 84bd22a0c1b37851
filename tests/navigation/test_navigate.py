"""A simulated robot arrives, or stops and says why; it never claims an arrival wrongly."""

from __future__ import annotations

import numpy as np
import pytest
from floors import RIG, mounted_every, two_rooms
from ids import lm8

from lmkit.errors import InputError
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark, wall_pose
from lmkit.navigation.navigator import Site, Tolerance, drive_to, surely_there
from lmkit.planning.coverage import Demand, predict_coverage
from lmkit.planning.route import Goal
from lmkit.simulation.recording import WheelErrors
from lmkit.simulation.robot import SimulatedRobot
from lmkit.tracking.planar_stereo_filter import RigFilter
from lmkit.tracking.range_bearing_filter import TrackedPose

RADIUS_M = 0.25
WHEELS = WheelErrors(slips=2, delay_s=0.1)
GOAL = Goal(4.8, 1.2, 0.0)


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    floor = two_rooms(tmp_path_factory.mktemp("floor"))
    landmarks = mounted_every(floor, 0.7)
    return floor, landmarks, predict_coverage(floor, list(landmarks), RIG, RADIUS_M)


def go(world, seed, ground=None, landmarks=None, start=(1.0, 1.0, 0.3)):
    floor, mounted, coverage = world
    robot = SimulatedRobot(ground or floor, mounted, RIG, np.array(start), RADIUS_M, WHEELS, seed)
    inside = []

    def note(pose):
        if pose.state is not None and pose.status == "ok":
            off = pose.state[:2] - robot.seen_from[:2]
            inside.append(off @ np.linalg.solve(pose.covariance[:2, :2], off) < 5.991)

    known = mounted if landmarks is None else landmarks
    site = Site(floor, known, RIG, RADIUS_M, Demand(), coverage, corner_floor_px=0.0)
    journey = drive_to(robot, site, GOAL, on_pose=note)
    return journey, robot, inside


def off(robot):
    turn = robot.state[2] - (GOAL.heading_rad or 0.0)
    return np.hypot(robot.state[0] - GOAL.x_m, robot.state[1] - GOAL.y_m), abs(np.arctan2(np.sin(turn), np.cos(turn)))


def test_at_the_goal_with_a_loose_heading_it_says_so(world, monkeypatch):
    """The position is known to millimeters, but the heading is less accurate than required."""
    monkeypatch.setattr("lmkit.navigation.navigator.MOST_GOES", 1)
    floor, landmarks, coverage = world
    start = np.array([GOAL.x_m, GOAL.y_m, 0.0])
    robot = SimulatedRobot(floor, landmarks, RIG, start, RADIUS_M, WHEELS, 3)
    site = Site(floor, landmarks, RIG, RADIUS_M, Demand(), coverage, corner_floor_px=0.0)
    journey = drive_to(robot, site, GOAL, Tolerance(0.05, np.deg2rad(0.001)))
    assert journey.status == "unsure"
    assert "(5 cm allowed)" in journey.why
    assert "deg turned (0.001 deg allowed)" in journey.why


def test_it_looks_to_the_side_that_is_nearer_to_the_goal(world):
    """At the goal it faces a bare wall; from the landmark on its left it has to turn too far to be sure."""
    floor, here, mounted = world[0], np.array([1.5, 2.0]), []
    for code, turn_deg in enumerate((165.0, -95.0)):
        bearing = np.pi + np.deg2rad(turn_deg)
        place = here + 1.4 * np.array([np.cos(bearing), np.sin(bearing)])
        mounted.append(MappedLandmark(lm8(code), 0.18, wall_pose([*place, 1.1], bearing + np.pi)))
    landmarks = LandmarkMap(mounted)
    site = Site(floor, landmarks, RIG, RADIUS_M, Demand(), predict_coverage(floor, mounted, RIG, RADIUS_M), 0.0)
    robot = SimulatedRobot(floor, landmarks, RIG, np.append(here, np.pi), RADIUS_M, WheelErrors(delay_s=0.1), 0)
    journey = drive_to(robot, site, Goal(*here, np.pi))
    assert journey.status == "arrived", journey.why
    assert abs(robot.state[2] - np.pi) % (2 * np.pi) < np.deg2rad(3)


@pytest.mark.slow
def test_it_arrives_and_knows_where_it_is(world):
    inside = []
    for seed in range(3):
        journey, robot, hits = go(world, seed)
        assert journey.status == "arrived", journey.why
        assert not robot.touched
        assert off(robot)[0] < 0.05
        assert off(robot)[1] < np.deg2rad(3)
        inside += hits
    assert 0.9 < np.mean(inside) <= 1.0


@pytest.mark.parametrize(
    ("x_m", "turn_deg", "sigma_m", "sigma_deg", "status", "there"),
    [
        (4.8, 0.0, 0.01, 0.5, "ok", True),
        (4.83, 0.0, 0.01, 0.5, "ok", False),
        (4.83, 0.0, 0.001, 0.5, "ok", True),
        (4.8, 0.0, 0.03, 0.5, "ok", False),
        (4.8, 2.5, 0.01, 0.5, "ok", False),
        (4.8, 0.0, 0.01, 2.0, "ok", False),
        (4.8, 0.0, 0.01, 0.5, "lost", False),
    ],
)
def test_it_is_there_only_when_that_is_sure(x_m, turn_deg, sigma_m, sigma_deg, status, there):
    state = np.array([x_m, GOAL.y_m, np.deg2rad(turn_deg)])
    covariance = np.diag([sigma_m**2, 1e-8, np.deg2rad(sigma_deg) ** 2])
    assert surely_there(TrackedPose(1.0, status, state, covariance), GOAL, Tolerance()) is there


def test_it_goes_around_what_is_on_no_plan(world):
    boxed = world[0].blocked(np.array([[4.0, 2.2]]), 0.2)
    journey, robot, _ = go(world, 5, ground=boxed)
    assert journey.status == "arrived", journey.why
    assert not robot.touched


def test_a_blocked_door_stops_it(world):
    blocks = np.array([[3.0, y] for y in np.arange(2.5, 4.1, 0.2)])
    journey, robot, _ = go(world, 6, ground=world[0].blocked(blocks, 0.15))
    assert journey.status == "blocked"
    assert not robot.touched
    assert journey.why


def test_without_landmarks_it_does_not_move_and_says_so(world):
    floor, _, coverage = world
    robot = SimulatedRobot(floor, LandmarkMap([]), RIG, np.array([1.0, 1.0, 0.0]), RADIUS_M, WHEELS, 0)
    journey = drive_to(robot, Site(floor, LandmarkMap([]), RIG, RADIUS_M, Demand(), coverage), GOAL)
    assert journey.status == "lost"
    assert np.hypot(*(robot.state[:2] - 1.0)) < 0.02


def test_a_filter_that_is_carried_off_finds_itself_again(world):
    floor, mounted, _ = world
    robot = SimulatedRobot(floor, mounted, RIG, np.array([1.2, 1.2, np.pi]), RADIUS_M, WheelErrors(delay_s=0.02), 1)
    tracker = RigFilter(mounted, RIG, corner_floor_px=0.0)
    found = []
    for k in range(24):
        if k == 12:
            robot.state = np.array([4.6, 2.2, 0.0])
        for time_s, forward_m, turn_rad, rate in robot.drive(0.0, 0.0, 0.2):
            tracker.wheels.add_odometry(time_s, forward_m, turn_rad)
            tracker.wheels.add_gyro(time_s, rate)
        found.append(tracker.observe(robot.time_s, robot.look()))
    assert np.hypot(*(found[11].state[:2] - [1.2, 1.2])) < 0.03
    assert any(pose.status == "lost" or pose.outliers for pose in found[12:16])
    assert any(pose.restarted for pose in found[12:])
    assert np.hypot(*(found[-1].state[:2] - [4.6, 2.2])) < 0.03


def test_a_landmark_that_was_moved_is_not_believed(world):
    floor, mounted, _ = world
    robot = SimulatedRobot(floor, mounted, RIG, np.array([1.6, 1.2, np.pi]), RADIUS_M, WheelErrors(delay_s=0.02), 1)
    left, _ = robot.look()
    moved = left[0].id
    wrong = LandmarkMap([m if m.id != moved else type(m)(m.id, m.size_m, shifted(m.T_map_landmark)) for m in mounted])
    tracker = RigFilter(wrong, RIG, corner_floor_px=0.0)
    for _ in range(8):
        robot.drive(0.0, 0.0, 0.2)
        pose = tracker.observe(robot.time_s, robot.look())
    assert moved in pose.outliers
    assert np.hypot(*(pose.state[:2] - [1.6, 1.2])) < 0.03


def shifted(T):
    return type(T)(T.to_frame, T.from_frame, T.R, T.t + 0.3 * T.R[:, 0])


def test_a_rig_without_base_is_refused():
    with pytest.raises(InputError, match="T_base_left"):
        RigFilter(LandmarkMap([]), StereoRig(RIG.left, RIG.right, RIG.T_right_left))
