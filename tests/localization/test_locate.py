"""Localization on known truth: perfect, then seeded noise (is the covariance true?), then planted faults."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from ids import lm8
from scipy.stats import chi2

from lmkit.geometry.pose import Pose
from lmkit.geometry.rotations import rotation_angle, rotation_log
from lmkit.localization.absolute_pose import LocateOptions, locate_camera, locate_rig
from lmkit.localization.contradicted_prior import without_contradicted_prior
from lmkit.localization.pose_prior import PosePrior
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark, wall_pose
from lmkit.model.observation import Detection
from lmkit.simulation.scene import looking, make_rig

RIG = make_rig()
LANDMARKS = [
    MappedLandmark(lm8(code), 0.18, wall_pose([x, 0.0, z], np.pi / 2))
    for code, x, z in ((10, -0.8, 1.2), (20, 0.1, 1.5), (30, 0.9, 1.1))
] + [MappedLandmark(lm8(40), 0.18, wall_pose([1.6, 0.9, 1.3], np.pi))]
MAP = LandmarkMap(LANDMARKS)
STATION = looking(np.array([0.2, 2.4, 1.2]), -np.pi / 2 + 0.1, 0.02)


def see(T_map_camera: Pose, noise: float, rng, landmarks=LANDMARKS) -> tuple[list, list]:
    cameras = []
    for camera, R, t in (
        (RIG.left, np.eye(3), np.zeros(3)),
        (RIG.right, RIG.T_right_left.R, RIG.T_right_left.t),
    ):
        seen = []
        for landmark in landmarks:
            pixels = camera.project(T_map_camera.inverse().apply(landmark.corners_map) @ R.T + t)
            if camera.contains(pixels).all():
                noisy = pixels + rng.normal(0, noise, (4, 2))
                covariance = max(noise, 1e-3) ** 2 * np.eye(8)
                seen.append(Detection(landmark.id, noisy, 0.99, 50.0, covariance=covariance))
        cameras.append(seen)
    return cameras[0], cameras[1]


def test_perfect_corners_give_the_pose_back():
    estimate = locate_rig(see(STATION, 0.0, np.random.default_rng(0)), RIG, MAP)
    assert estimate.status == "ok"
    assert np.allclose(estimate.T_map_camera.t, STATION.t, atol=1e-6)
    assert rotation_angle(estimate.T_map_camera.R @ STATION.R.T) < 1e-6
    assert estimate.inliers == tuple(map(lm8, (10, 20, 30)))


def test_one_camera_is_enough():
    left, _ = see(STATION, 0.0, np.random.default_rng(0))
    estimate = locate_camera(left, RIG.left, MAP)
    assert estimate.status == "ok"
    assert np.allclose(estimate.T_map_camera.t, STATION.t, atol=1e-6)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_the_covariance_is_true(count):
    """Mean normalized squared error over 300 draws lies within the 99.9 % chi-square band around six."""
    from scipy.stats import chi2

    from lmkit.localization.absolute_pose import LocateOptions

    rng = np.random.default_rng(count)
    options = LocateOptions(corner_floor_px=1e-3)
    draws, total = 300, 0.0
    # Seen from the side: head-on, the tilt of a single landmark does not depend linearly on its corners.
    station = looking(np.array([1.2, 1.2, 1.3]), -np.pi / 2 - 0.75, 0.02)
    for _ in range(draws):
        seen = see(station, 0.2, rng, LANDMARKS[:3][-count:])
        estimate = locate_rig(seen, RIG, MAP, options)
        error = np.concatenate(
            [estimate.T_map_camera.t - station.t, rotation_log(estimate.T_map_camera.R @ station.R.T)]
        )
        total += error @ np.linalg.solve(estimate.covariance, error)
    low, high = chi2.ppf([0.0005, 0.9995], 6 * draws)
    assert low < total < high


@pytest.mark.parametrize("count", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_the_covariance_knows_what_the_map_does_not(count):
    """Landmarks are mounted off their mapped places by draws of the map's covariance, a different one each."""
    from dataclasses import replace

    from scipy.stats import chi2

    from lmkit.geometry.rotations import rotation_exp
    from lmkit.localization.absolute_pose import LocateOptions

    rng = np.random.default_rng(40 + count)
    options = LocateOptions(corner_floor_px=1e-3)
    station = looking(np.array([1.2, 1.2, 1.3]), -np.pi / 2 - 0.75, 0.02)
    sigmas = [np.array([a, a, a, b, b, b]) for a, b in ((0.005, 0.01), (0.02, 0.02), (0.01, 0.005))]
    known = [
        replace(landmark, covariance=np.diag(sigma**2)) for landmark, sigma in zip(LANDMARKS[:3], sigmas, strict=True)
    ][-count:]
    draws, total, explained = 300, 0.0, 0
    for _ in range(draws):
        mounted = []
        for landmark in known:
            off = rng.multivariate_normal(np.zeros(6), landmark.covariance)
            T = landmark.T_map_landmark
            mounted.append(
                replace(landmark, T_map_landmark=Pose("map", "landmark", rotation_exp(off[3:]) @ T.R, T.t + off[:3]))
            )
        estimate = locate_rig(see(station, 0.2, rng, mounted), RIG, LandmarkMap(known), options)
        explained += len(estimate.inliers) == count
        error = np.concatenate(
            [estimate.T_map_camera.t - station.t, rotation_log(estimate.T_map_camera.R @ station.R.T)]
        )
        total += error @ np.linalg.solve(estimate.covariance, error)
    low, high = chi2.ppf([0.0005, 0.9995], 6 * draws)
    assert low < total < high, total / 6 / draws
    assert explained > 0.99 * draws


def test_a_place_known_in_some_directions_only():
    """A landmark that may have slid along its wall, and in nothing else: a covariance that is singular."""
    from dataclasses import replace

    slid = np.zeros((6, 6))
    slid[0, 0] = 0.1**2
    seen = see(STATION, 0.1, np.random.default_rng(2), LANDMARKS[:1])
    loose, firm = (
        locate_rig(seen, RIG, LandmarkMap([replace(LANDMARKS[0], covariance=covariance)])).covariance
        for covariance in (slid, None)
    )
    assert loose[0, 0] - firm[0, 0] == pytest.approx(0.1**2, rel=0.03)
    assert loose[2, 2] == pytest.approx(firm[2, 2], rel=0.03)


def test_a_wrong_code_is_named_and_does_not_capture_the_pose():
    left, right = see(STATION, 0.2, np.random.default_rng(1))
    for side in (left, right):
        side[0] = Detection(lm8(40), side[0].corners, 0.99, 50.0, covariance=side[0].covariance)
    estimate = locate_rig((left, right), RIG, MAP)
    assert estimate.status == "ok"
    assert estimate.outliers == tuple(map(lm8, (40,)))
    assert np.linalg.norm(estimate.T_map_camera.t - STATION.t) < 0.02


def test_two_landmarks_that_contradict_each_other_give_no_pose():
    left, right = see(STATION, 0.2, np.random.default_rng(1), LANDMARKS[:2])
    for side in (left, right):
        side[0] = Detection(lm8(40), side[0].corners, 0.99, 50.0, covariance=side[0].covariance)
    estimate = locate_rig((left, right), RIG, MAP)
    assert estimate.status == "inconsistent"
    assert estimate.T_map_camera is None


def test_a_far_landmark_alone_in_one_camera_is_called_ambiguous():
    rng = np.random.default_rng(3)
    station = looking(np.array([0.1, 5.5, 1.45]), -np.pi / 2, 0.0)
    statuses = []
    for _ in range(20):
        left, _ = see(station, 0.3, rng, LANDMARKS[1:2])
        estimate = locate_camera(left, RIG.left, MAP)
        statuses.append(estimate.status)
        if estimate.status == "ambiguous":
            wide = np.linalg.eigvalsh(estimate.covariance[:3, :3])[-1] ** 0.5 > 0.15
            assert estimate.alternatives or wide
    assert statuses.count("ambiguous") > 10


def test_a_heading_resolves_what_one_far_landmark_leaves_open():
    """From 4 m, head-on, one camera: two poses.  A gyro and a level floor decide; no wrong pose is `ok`."""
    rng = np.random.default_rng(5)
    station = looking(np.array([-1.2, 3.6, 1.45]), -np.pi / 2 + 0.4, 0.0)
    heading = float(np.arctan2(station.R[1, 2], station.R[0, 2]))
    prior = PosePrior(heading_rad=heading, heading_sigma=np.deg2rad(1), height_m=1.45, down=(0.0, 1.0, 0.0))
    with_heading = LocateOptions(prior=prior)
    plain, helped = [], []
    for _ in range(30):
        left, _ = see(station, 0.25, rng, LANDMARKS[1:2])
        for found, options in ((plain, None), (helped, with_heading)):
            estimate = locate_camera(left, RIG.left, MAP, options)
            off = float(np.linalg.norm(estimate.T_map_camera.t - station.t))
            found.append((estimate.status, off))
    assert sum(status == "ok" for status, _ in helped) > sum(status == "ok" for status, _ in plain) + 10
    assert max(off for status, off in helped if status == "ok") < 0.25


def test_a_level_floor_and_a_known_height_narrow_the_pose():
    station = looking(np.array([0.3, 3.5, 1.2]), -np.pi / 2, 0.0)
    level = LocateOptions(prior=PosePrior(height_m=1.2, down=(0.0, 1.0, 0.0)))
    free, held = [], []
    rng = np.random.default_rng(6)
    for _ in range(40):
        left, right = see(station, 0.2, rng, LANDMARKS[1:2])
        for errors, options in ((free, None), (held, level)):
            estimate = locate_rig((left, right), RIG, MAP, options)
            errors.append(estimate.T_map_camera.t - station.t)
    assert np.linalg.norm(held, axis=1).mean() < 0.75 * np.linalg.norm(free, axis=1).mean()
    assert np.abs(np.array(held)[:, 2]).mean() < 0.005


def test_a_height_known_to_a_hair_is_the_height():
    left, right = see(
        looking(np.array([0.3, 3.5, 1.2]), -np.pi / 2, 0.0), 0.1, np.random.default_rng(6), LANDMARKS[1:2]
    )
    options = LocateOptions(prior=PosePrior(height_m=1.23, height_sigma=1e-4))
    assert locate_rig((left, right), RIG, MAP, options).T_map_camera.t[2] == pytest.approx(1.23, abs=1e-3)


def test_the_covariance_with_a_prior_is_true():
    station = looking(np.array([0.2, 2.4, 1.2]), -np.pi / 2 + 0.1, 0.0)
    heading = float(np.arctan2(station.R[1, 2], station.R[0, 2]))
    rng = np.random.default_rng(7)
    total = 0.0
    for _ in range(150):
        prior = PosePrior(
            heading + rng.normal(0, 0.01),
            0.01,
            1.2 + rng.normal(0, 0.005),
            0.005,
            (rng.normal(0, 0.005), 1.0, rng.normal(0, 0.005)),
            0.005,
        )
        left, right = see(station, 0.3, rng, LANDMARKS[1:3])
        estimate = locate_rig((left, right), RIG, MAP, LocateOptions(prior=prior, corner_floor_px=0.0))
        off = estimate.T_map_camera.t - station.t
        total += off @ np.linalg.solve(estimate.covariance[:3, :3], off)
    low, high = chi2.ppf([0.0005, 0.9995], 3 * 150)
    assert low < total < high


def test_far_and_small_landmarks_are_not_called_ok():
    """Two landmarks near each other, 8 m away: the covariance holds poses over half a meter off."""
    station = looking(np.array([0.1, 8.0, 1.4]), -np.pi / 2, 0.0)
    rng = np.random.default_rng(8)
    for _ in range(20):
        left, right = see(station, 0.3, rng, LANDMARKS[:2])
        estimate = locate_rig((left, right), RIG, MAP)
        off = float(np.linalg.norm(estimate.T_map_camera.t - station.t))
        assert estimate.status in ("ambiguous", "imprecise") or off < 0.5


@pytest.mark.parametrize("fault", ["upside down", "moved"])
def test_a_wrongly_mounted_landmark_is_the_outlier(fault):
    rng = np.random.default_rng(9)
    wrong = LANDMARKS[2].T_map_landmark
    if fault == "moved":
        wrong = Pose("map", "landmark", wrong.R, wrong.t + np.array([0.3, 0, 0]))
    else:
        wrong = Pose("map", "landmark", wrong.R @ np.diag([-1.0, -1.0, 1.0]), wrong.t)
    mounted = [*LANDMARKS[:2], replace(LANDMARKS[2], T_map_landmark=wrong)]
    left, right = see(STATION, 0.15, rng, mounted)
    estimate = locate_rig((left, right), RIG, MAP)
    assert estimate.status == "ok"
    assert estimate.outliers == tuple(map(lm8, (30,)))
    assert np.linalg.norm(estimate.T_map_camera.t - STATION.t) < 0.03


@pytest.mark.parametrize("distance", [1.6, 2.4, 3.2])
def test_swapped_cameras_are_reported(distance):
    rng = np.random.default_rng(10)
    left, right = see(looking(np.array([0.2, distance, 1.2]), -np.pi / 2 + 0.1, 0.02), 0.15, rng)
    assert locate_rig((right, left), RIG, MAP).status == "swapped"
    assert locate_rig((left, right), RIG, MAP).status == "ok"


def test_codes_that_are_not_in_the_map_are_no_landmarks():
    left, _ = see(STATION, 0.0, np.random.default_rng(0))
    unknown = [Detection(lm8(200), o.corners, 0.9, 9.0) for o in left]
    assert locate_rig((unknown, []), RIG, MAP).status == "no_landmarks"
    assert locate_rig(([], []), RIG, MAP).status == "no_landmarks"


def test_the_same_code_twice_in_an_image_is_not_used_and_named():
    left, right = see(STATION, 0.1, np.random.default_rng(2))
    left.append(Detection(lm8(10), left[1].corners + 40, 0.9, 9.0))
    estimate = locate_rig((left, right), RIG, MAP)
    assert estimate.status == "ok"
    assert estimate.outliers == tuple(map(lm8, (10,)))
    assert np.linalg.norm(estimate.T_map_camera.t - STATION.t) < 0.02


def test_the_covariance_of_the_base_is_that_of_draws():
    """The covariance of the base, by the formula and by 4000 draws of the camera's pose."""
    from lmkit.geometry.rotations import rotation_exp
    from lmkit.model.estimate import PoseEstimate

    rng = np.random.default_rng(4)
    A = rng.normal(size=(6, 6)) * 0.01
    T_camera_base = Pose.from_rvec("left", "base", np.array([0.3, -1.0, 0.4]), np.array([0.1, 0.5, -0.3]))
    estimate = PoseEstimate("ok", STATION, A @ A.T)
    draws = []
    for d in rng.multivariate_normal(np.zeros(6), A @ A.T, 4000):
        moved = Pose("map", "left", rotation_exp(d[3:]) @ STATION.R, STATION.t + d[:3]) @ T_camera_base
        draws.append(moved.t)
    formula = estimate.covariance_at(T_camera_base)[:3, :3]
    assert np.allclose(np.cov(np.array(draws).T), formula, atol=0.1 * np.trace(formula))


def test_exactly_head_on():
    """Landmarks seen head-on, where OpenCV's own solver for squares fails."""
    station = looking(np.array([0.1, 1.0, 1.5]), -np.pi / 2, 0.0)
    left, right = see(station, 0.0, np.random.default_rng(0), LANDMARKS[1:2])
    estimate = locate_rig((left, right), RIG, MAP)
    assert np.linalg.norm(estimate.T_map_camera.t - station.t) < 1e-4


def test_landmarks_of_two_families_with_the_same_code_are_two_landmarks():
    """A moved lm12:5 beside an lm8:5: the moved one is reported, and the pose stays right."""
    moved, *others = (LandmarkId("lm12", 5), lm8(5), lm8(6), lm8(7))
    mounted = [
        MappedLandmark(i, 0.18, wall_pose([x, 0.0, 1.2], np.pi / 2))
        for i, x in zip((moved, *others), (-0.6, 0.0, 0.6, 1.2), strict=True)
    ]
    left, right = see(STATION, 0.1, np.random.default_rng(0), mounted)
    before = replace(mounted[0], T_map_landmark=wall_pose([-0.6, 0.0, 1.5], np.pi / 2))
    estimate = locate_rig((left, right), RIG, LandmarkMap([before, *mounted[1:]]))
    assert (estimate.status, estimate.outliers, estimate.inliers) == ("ok", (moved,), tuple(others))
    assert np.linalg.norm(estimate.T_map_camera.t - STATION.t) < 0.01


@pytest.mark.parametrize(
    ("prior", "words"),
    [
        (PosePrior(heading_rad=0.3), "heading -90.0, not 17.2 deg"),
        (PosePrior(height_m=0.4, down=(0.0, 1.0, 0.0)), "not 0.400 m;"),
        (PosePrior(height_m=1.2, down=(0.0, 1.0, 0.3)), "the floor leans by 16."),
    ],
)
def test_a_prior_that_the_images_contradict_is_named_and_left_out(prior, words):
    """With the wrong prior, the pose was shifted by 13 cm, and 2 of 5 landmarks became outliers."""
    seen = see(looking(np.array([0.3, 2.5, 1.2]), -np.pi / 2, 0.0), 0.1, np.random.default_rng(6), LANDMARKS)
    free = locate_rig(seen, RIG, MAP)
    found = without_contradicted_prior(LocateOptions(prior=prior), partial(locate_rig, seen, RIG, MAP))
    assert words in found.warnings[0]
    assert (found.status, found.outliers) == ("ok", ())
    assert found.T_map_camera.t == pytest.approx(free.T_map_camera.t)
    right = LocateOptions(prior=PosePrior(height_m=1.2, down=(0.0, 1.0, 0.0)))
    assert without_contradicted_prior(right, partial(locate_rig, seen, RIG, MAP)).warnings == ()
