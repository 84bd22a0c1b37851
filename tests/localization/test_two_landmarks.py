"""The paper's method: its worked example, what is wrong in print, and any number of landmarks."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from ids import lm8
from scipy.stats import chi2

from lmkit.localization.range_bearing import locate_planar
from lmkit.localization.range_bearing_noise import ReadingNoise
from lmkit.localization.two_landmarks import locate_by_two
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark, wall_pose
from lmkit.model.observation import RangeBearing

A, B = np.array([4.0, -1.0]), np.array([4.0, 2.0])
SENSOR = (0.160, 0.007)


def measure(robot, heading, place, sensor=(0.0, 0.0)):
    c, s = math.cos(heading), math.sin(heading)
    at = np.array([robot[0] + c * sensor[0] - s * sensor[1], robot[1] + s * sensor[0] + c * sensor[1]])
    off = place - at
    return float(np.hypot(*off)), math.remainder(math.atan2(off[1], off[0]) - heading, 2 * math.pi)


def test_the_worked_example_comes_back():
    pose = locate_by_two(A, B, 2.961457, 3.124446, math.radians(-36.7875), math.radians(22.2082), SENSOR)
    assert (pose.x_m, pose.y_m) == pytest.approx((1.2, 0.3), abs=2e-6)
    assert math.degrees(pose.heading_rad) == pytest.approx(10.0, abs=1e-4)


coordinates = st.floats(-8, 8)


@given(coordinates, coordinates, st.floats(-3.1, 3.1), coordinates, coordinates)
def test_exact_readings_give_the_pose_back(x, y, heading, bx, by):
    place_a, place_b = np.array([0.5, -0.25]), np.array([bx, by])
    robot = np.array([x, y])
    u = place_b - place_a
    off = robot - place_a
    assume(np.hypot(*u) > 0.5)
    assume(abs(u[0] * off[1] - u[1] * off[0]) / np.hypot(*u) > 0.05)  # not on the line through both
    assume(min(np.hypot(*off), np.hypot(*(robot - place_b))) > 0.3)
    (ra, ta), (rb, tb) = measure(robot, heading, place_a), measure(robot, heading, place_b)
    pose = locate_by_two(place_a, place_b, ra, rb, ta, tb)
    assert (pose.x_m, pose.y_m) == pytest.approx((x, y), abs=1e-5)
    assert math.remainder(pose.heading_rad - heading, 2 * math.pi) == pytest.approx(0, abs=1e-4)
    # A check that the paper never uses: the triangle of the readings closes.
    assert ra**2 + rb**2 - 2 * ra * rb * math.cos(tb - ta) == pytest.approx(u @ u)


def test_what_is_wrong_in_print():
    (ra, ta), (rb, tb) = (
        measure((1.2, 0.3), math.radians(10), A, SENSOR),
        measure((1.2, 0.3), math.radians(10), B, SENSOR),
    )
    d = 3.0
    # The angle at A of the triangle A, B, sensor, from its three sides.
    alpha = math.acos((ra**2 + d**2 - rb**2) / (2 * ra * d))
    assert math.sin(alpha) == pytest.approx(rb * math.sin(tb - ta) / d)
    assert math.sin(alpha) / ra != pytest.approx(math.sin(tb - ta) / d, rel=0.01)
    assert alpha - math.pi / 2 - ta == pytest.approx(math.radians(10))
    assert abs(math.pi / 2 + ta - alpha - math.radians(10)) > 0.3
    # From (1.2, -1.5) alpha is obtuse, and arcsin gives its supplement: 20 degrees off.
    (ra, ta), (rb, tb) = (measure((1.2, -1.5), math.radians(10), P, SENSOR) for P in (A, B))
    wrong = math.asin(rb * math.sin(tb - ta) / d) - math.pi / 2 - ta
    assert abs(math.degrees(wrong) - 10) == pytest.approx(20, abs=1.5)


LANDMARKS = LandmarkMap(
    [
        MappedLandmark(lm8(c), 0.18, wall_pose([x, y, 1.0], 0.0))
        for c, x, y in ((1, 4, -1), (2, 4, 2), (3, -2, 3), (4, 0, -4))
    ]
)
ROBOT, HEADING = (1.2, 0.3), 0.4


def read(code, rng=None, noise=ReadingNoise()):
    r, b = measure(ROBOT, HEADING, LANDMARKS.find(lm8(code)).T_map_landmark.t[:2])
    if rng is not None:
        r, b = r + rng.normal(0, float(noise.range_sigma(r))), b + rng.normal(0, noise.bearing_rad)
    return RangeBearing(lm8(code), r, b)


def test_exact_readings_of_four_landmarks():
    estimate = locate_planar([read(c) for c in (1, 2, 3, 4)], LANDMARKS)
    assert estimate.status == "ok"
    assert (estimate.pose.x_m, estimate.pose.y_m) == pytest.approx(ROBOT, abs=1e-6)
    assert estimate.pose.heading_rad == pytest.approx(HEADING, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("codes", [(1, 2), (1, 2, 3, 4)])
def test_the_covariance_is_true(codes):
    """Summed squared normalized errors of 400 draws against the 99.9 % chi-square band."""
    rng = np.random.default_rng(len(codes))
    wide = ReadingNoise(range_share=0.01, common_bearing_rad=0.0, outlier_sigma=8.0)
    total = 0.0
    for _ in range(400):
        estimate = locate_planar([read(c, rng, wide) for c in codes], LANDMARKS, wide)
        pose = estimate.pose
        error = np.array([pose.x_m - ROBOT[0], pose.y_m - ROBOT[1], pose.heading_rad - HEADING])
        total += error @ np.linalg.solve(estimate.covariance, error)
    low, high = chi2.ppf([0.0005, 0.9995], 3 * 400)
    assert low < total < high


def test_a_moved_landmark_is_named():
    readings = [read(c) for c in (1, 2, 4)] + [RangeBearing(lm8(3), read(3).range_m + 1.0, read(3).bearing_rad + 0.3)]
    estimate = locate_planar(readings, LANDMARKS)
    assert (estimate.status, estimate.outliers) == ("ok", (lm8(3),))
    assert (estimate.pose.x_m, estimate.pose.y_m) == pytest.approx(ROBOT, abs=1e-5)


def test_one_landmark_is_too_few_and_contradiction_is_said():
    assert locate_planar([read(1), read(1)], LANDMARKS).status == "no_landmarks"
    wrong = [read(1), RangeBearing(lm8(2), 6.0, read(2).bearing_rad + 1.0)]
    assert locate_planar(wrong, LANDMARKS).status == "inconsistent"


def only_ranges(codes, noise=0.0, rng=None):
    off = (lambda: 0.0) if rng is None else (lambda: rng.normal(0, noise))
    return [RangeBearing(lm8(c), read(c).range_m + off(), None) for c in codes]


def only_bearings(codes):
    return [RangeBearing(lm8(c), None, read(c).bearing_rad) for c in codes]


def test_ranges_alone_give_the_place_and_no_heading():
    estimate = locate_planar(only_ranges((1, 2, 3)), LANDMARKS)
    assert estimate.status == "ok"
    assert (estimate.pose.x_m, estimate.pose.y_m) == pytest.approx(ROBOT, abs=1e-6)
    assert estimate.pose.heading_rad is None
    assert estimate.covariance.shape == (2, 2)


def test_two_ranges_leave_two_places():
    estimate = locate_planar(only_ranges((1, 2)), LANDMARKS)
    assert estimate.status == "ambiguous"
    places = [estimate.pose, *(pose for pose, _ in estimate.alternatives)]
    assert len(places) == 2
    # The landmarks are at x = 4: the other place is the mirror image behind them.
    assert sorted(p.x_m for p in places) == pytest.approx([ROBOT[0], 8 - ROBOT[0]], abs=1e-6)


@given(st.floats(-1.5, 3.5), st.floats(-3, 1.8), st.floats(-3.1, 3.1))
def test_bearings_alone_give_the_pose(x, y, heading):
    """Anywhere except near the circle through the three landmarks, where resection has no solution."""
    places = {c: LANDMARKS.find(lm8(c)).T_map_landmark.t[:2] for c in (1, 2, 3)}
    one, two, three = places.values()
    D = 2 * np.linalg.det([two - one, three - one])
    center = one + np.linalg.solve(
        2 * np.array([two - one, three - one]), [(p - one) @ (p - one) for p in (two, three)]
    )
    assert abs(D) > 1
    assume(abs(np.hypot(x - center[0], y - center[1]) - np.hypot(*(one - center))) > 0.4)
    assume(all(np.hypot(*(p - [x, y])) > 0.4 for p in places.values()))
    seen = [RangeBearing(lm8(c), None, measure((x, y), heading, p)[1]) for c, p in places.items()]
    estimate = locate_planar(seen, LANDMARKS)
    poses = [estimate.pose, *(pose for pose, _ in estimate.alternatives)]
    assert any(np.hypot(p.x_m - x, p.y_m - y) < 1e-3 for p in poses if p is not None)


def test_a_range_and_three_bearings_may_come_from_different_landmarks():
    seen = [*only_bearings((1, 2)), *only_ranges((3,))]
    estimate = locate_planar(seen, LANDMARKS)
    poses = [estimate.pose, *(pose for pose, _ in estimate.alternatives)]
    assert any(np.hypot(p.x_m - ROBOT[0], p.y_m - ROBOT[1]) < 1e-4 for p in poses)


@pytest.mark.parametrize("seen", [only_bearings((1, 2)), only_ranges((1,)), [read(1)], []])
def test_too_little_is_said_to_be_too_little(seen):
    assert locate_planar(seen, LANDMARKS).status == "no_landmarks"
