"""Calibration on known truth: perfect, then seeded noise, then planted wrong pairs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from board_views import BOARD, views

from lmkit.calibration import board_equations
from lmkit.calibration.bundle_adjustment import FitOptions, Solution, StereoProblem, _moved, _Prior
from lmkit.calibration.initialization import RADTAN, CameraStarts
from lmkit.calibration.intrinsics import KnownIntrinsics, intrinsics_vector, sigma_of_pixels, with_intrinsics
from lmkit.calibration.sanity_checks import CalibrationWarning, Declared
from lmkit.calibration.stereo import calibrate_stereo
from lmkit.calibration.uncertainty import projection_uncertainty
from lmkit.errors import InputError
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.rotations import rotation_angle
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.io.kalibr import rig_to_camchain
from lmkit.model.board import BoardSpec
from lmkit.model.observation import PairView
from lmkit.reports.calibration import calibration_summary
from lmkit.simulation.scene import board_poses, make_rig


def test_perfect_corners_give_the_rig_back():
    truth = make_rig()
    result = calibrate_stereo(views(12, 0.0), BOARD, (640, 480))
    assert result.rms_px < 1e-4
    assert result.held_out_epipolar_px < 1e-3
    assert np.allclose(result.rig.left.K, truth.left.K, atol=0.02)
    assert np.allclose(result.rig.T_right_left.t, truth.T_right_left.t, atol=1e-6)


def test_perfect_fisheye_corners_give_the_rig_back():
    def wide(cx):
        K = np.array([[240.0, 0, cx], [0, 239.0, 241.0], [0, 0, 1]])
        return CameraModel((640, 480), K, np.array([0.02, -0.015, 0.008, -0.002]), "fisheye")

    truth = StereoRig(wide(322.0), wide(317.0), make_rig().T_right_left)
    result = calibrate_stereo(views(14, 0.0, 2, truth), BOARD, (640, 480), "fisheye")
    assert result.rms_px < 1e-3
    assert np.allclose(result.rig.left.K, truth.left.K, atol=0.05)
    assert np.allclose(result.rig.T_right_left.t, truth.T_right_left.t, atol=1e-5)


@pytest.mark.slow
def test_noise_gives_errors_of_the_stated_size():
    """The baseline's error over 20 seeds, in units of its stated sigma: about one, neither 0.3 nor 3."""
    truth = make_rig().baseline_m
    z = []
    for seed in range(20):
        result = calibrate_stereo(views(12, 0.1, seed), BOARD, (640, 480), "pinhole")
        z.append((result.rig.baseline_m - truth) / result.baseline_sigma_m)
        assert result.rms_px == pytest.approx(0.1 * np.sqrt(2), rel=0.15)
    assert 0.6 < np.sqrt(np.mean(np.square(z))) < 1.6


@pytest.mark.slow
def test_swapped_images_are_named_and_do_no_harm():
    clean = calibrate_stereo(views(14, 0.1), BOARD, (640, 480))
    planted = views(14, 0.1)
    for a, b in ((2, 3), (7, 8)):
        first, second = planted[a], planted[b]
        planted[a] = replace(first, right=second.right)
        planted[b] = replace(second, right=first.right)
    result = calibrate_stereo(planted, BOARD, (640, 480))
    assert {name for name, _ in result.rejected} == {"02", "03", "07", "08"}
    assert result.held_out_epipolar_px < 1.3 * clean.held_out_epipolar_px


@pytest.mark.slow
def test_a_rig_that_moved_is_warned_of_with_the_pairs_named(data):
    from lmkit.pipelines.board_views import find_board_pairs

    root = data / "stereo" / "ricsar"
    board = BoardSpec.parse("chessboard:9x6:24mm")
    left, right = (sorted((root / side).iterdir()) for side in ("left", "right"))
    pairs = find_board_pairs(list(zip(left, right, strict=True)), board)
    result = calibrate_stereo(pairs.views, board, pairs.image_size, rejected=pairs.rejected)
    warned = {name for w in result.warnings if w.code == "pairs_disagree" for name in w.pairs}
    assert {"001", "002", "003"} <= warned


@pytest.mark.slow
def test_corners_that_err_together_widen_the_intervals(monkeypatch):
    """Errors that the corners of an image share widen the deviations; independent noise of corners does not."""

    def widened(seen):
        sigma = calibrate_stereo(seen, BOARD, (640, 480), "pinhole").baseline_sigma_m
        with monkeypatch.context() as patch:
            patch.setattr(board_equations, "LEAST_PAIRS", 10**6)
            return sigma / calibrate_stereo(seen, BOARD, (640, 480), "pinhole").baseline_sigma_m

    assert widened(views(16, 0.1, 3)) < 1.15
    rng = np.random.default_rng(3)
    for count in (16, 5):
        distorted = []
        for view in views(count, 0.02, 3):
            x, y = ((view.left - [320, 240]) / 240).T
            distortion_px = np.column_stack([x * y, x**2, y**2]) @ rng.normal(0, 0.2, (3, 2))
            distorted.append(replace(view, left=view.left + distortion_px))
        assert widened(distorted) > 1.5


def test_what_a_turn_of_the_camera_makes_up_for_is_no_uncertainty():
    camera = make_rig().left

    def uncertain(index):
        covariance = np.zeros((9, 9))
        covariance[index, index] = 1.0 if index < 4 else 1e-4
        return projection_uncertainty(camera, covariance, None)

    # A shift of the principal point by one pixel is like a rotation; a change of the focal length is not.
    assert np.nanmedian(uncertain(2)) < 0.2
    assert np.nanmax(uncertain(4)[:, [0, -1]]) > 0.3


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_cameras_of_different_times_are_refused_with_the_reason(seed):
    """The board moved by some 6 px between the left and the right image of every pair."""
    rng = np.random.default_rng(seed)
    apart = [replace(view, right=view.right + rng.normal(0, 6, 2)) for view in views(12, 0.1, seed)]
    with pytest.raises(InputError, match="not taken at the same time") as caught:
        calibrate_stereo(apart, BOARD, (640, 480))
    assert caught.value.code == "not_rigid"


def test_two_pairs_are_too_few():
    with pytest.raises(InputError, match="2 usable pairs"):
        calibrate_stereo(views(2, 0.1), BOARD, (640, 480))


def test_the_derivatives_are_those_of_finite_differences():
    rig = make_rig()
    pose = board_poses(1, rig, BOARD, 2)
    problem = StereoProblem(BOARD.object_points, views(2, 0.3))
    s = Solution(
        rig.left,
        rig.right,
        rig.T_right_left.R,
        rig.T_right_left.t,
        np.array([0.001, -0.002]),
        np.array([p.R for p in pose]),
        np.array([p.t for p in pose]),
    )
    blocks = problem._normal_equations(
        s, 1e9, _Prior(np.zeros(26), np.zeros((26, 26)))
    )  # with such a wide loss, this is plain least squares
    gradient = np.concatenate([blocks.shared_gradient.sum(axis=0), blocks.pose_gradient.ravel()])
    for k in range(len(gradient)):
        step = np.zeros(len(gradient))
        step[k] = 1e-6
        cost = []
        for sign in (1, -1):
            moved = _moved(s, sign * step[:26], sign * step[26:].reshape(-1, 6))
            cost.append(sum(float((r**2).sum()) for pair in problem.residuals(moved) for r in pair) / 2)
        slope = (cost[1] - cost[0]) / 2e-6
        assert gradient[k] == pytest.approx(slope, rel=1e-3, abs=1e-2 * max(1, abs(slope)))


def test_known_intrinsics_are_kept_and_the_rotation_is_surer():
    """Half boards at one distance do not determine lenses and rotation together; with known lenses they do."""
    rig = make_rig()
    half = [PairView(v.name, v.ids_left[:30], v.left[:30], v.ids_right[:30], v.right[:30]) for v in views(8, 0.1)]
    free = calibrate_stereo(half, BOARD, rig.left.image_size, "pinhole")
    kept = calibrate_stereo(half, BOARD, rig.left.image_size, declared=Declared(cameras=(rig.left, rig.right)))
    assert [w.code for w in free.warnings if w.code == "unsure_rotation"] == [
        w.code.replace("rests_on_lenses", "unsure_rotation") for w in kept.warnings if w.code == "rests_on_lenses"
    ]
    assert np.array_equal(kept.rig.left.K, rig.left.K)
    assert np.array_equal(kept.rig.right.distortion, rig.right.distortion)

    def sigma(found):
        return float(np.sqrt(np.diag(found.rig.covariance)[3:].max()))

    assert sigma(kept) < 0.5 * sigma(free)
    turned = np.rad2deg(rotation_angle(kept.rig.T_right_left.R @ rig.T_right_left.R.T))
    assert turned < 4 * np.rad2deg(sigma(kept)) * np.sqrt(3)


def test_lenses_known_within_stated_deviations_are_fitted_too():
    """A narrow prior gives the fixed lens, a wide one the free fit; a lens that is 2 sigma off is corrected."""
    rig = make_rig()
    problem = StereoProblem(BOARD.object_points, views(6, 0.05))
    poses = board_poses(1, rig, BOARD, 6)
    R, t = rig.T_right_left.R, rig.T_right_left.t
    boards = np.array([p.R for p in poses]), np.array([p.t for p in poses])
    start = Solution(rig.left, rig.right, R, t, np.zeros(2), *boards)
    mean = np.concatenate([intrinsics_vector(rig.left), intrinsics_vector(rig.right)])
    off = mean.copy()
    off[2] += 4.0  # cx of the left camera

    def fitted(sigma_px, mean=mean):
        sigma = np.concatenate([sigma_of_pixels(camera, sigma_px) for camera in (rig.left, rig.right)])
        return problem.solve(start, FitOptions(known=KnownIntrinsics(mean, np.diag(sigma**2)), warp=False))

    fixed, free = (problem.solve(start, FitOptions(intrinsics=i, warp=False)) for i in (False, True))
    narrow, wide, moved = fitted(1e-4), fitted(1e3), fitted(2.0, off)
    assert np.allclose(narrow.R, fixed.R, atol=1e-7)
    assert np.allclose(intrinsics_vector(wide.left)[:4], intrinsics_vector(free.left)[:4], atol=0.3)
    at = np.sqrt(moved.covariance[2, 2])
    assert at <= 2.0
    assert abs(intrinsics_vector(moved.left)[2] - mean[2]) < 3 * at < 3.0
    assert np.sqrt(narrow.covariance[2, 2]) <= 1e-4 * (1 + 1e-9)


def test_known_lenses_count_more_where_the_corners_of_an_image_err_together():
    """Right lenses, known to 2 px: errors that the corners of an image share move the principal point by 0.8 px."""
    rig, rng = make_rig(), np.random.default_rng(5)
    lenses = np.concatenate([intrinsics_vector(rig.left), intrinsics_vector(rig.right)])
    sigma = np.concatenate([sigma_of_pixels(camera, 2.0) for camera in (rig.left, rig.right)])
    options = FitOptions(known=KnownIntrinsics(lenses, np.diag(sigma**2)))
    errors, stated = [], []
    for seed in range(1, 9):
        shifted = []
        for view in views(5, 0.05, seed):
            x, y = ((view.left - view.left.mean(axis=0)) / 100).T
            shift_px = np.column_stack([x * y, x**2, y**2]) @ rng.normal(0, 0.4, (3, 2))
            shifted.append(replace(view, left=view.left + shift_px))
        poses = board_poses(seed, rig, BOARD, 5)
        boards = np.array([p.R for p in poses]), np.array([p.t for p in poses])
        start = Solution(rig.left, rig.right, rig.T_right_left.R, rig.T_right_left.t, np.zeros(2), *boards)
        found = StereoProblem(BOARD.object_points, shifted).solve(start, options)
        errors.append(intrinsics_vector(found.left)[2:4] - lenses[2:4])
        stated.append(np.sqrt(np.diag(found.covariance)[2:4]))
    assert np.sqrt(np.mean(np.square(errors))) < 1.0  # 2.0 where corners count as independent
    assert (np.abs(errors) < 1.96 * np.array(stated)).all()
    assert np.max(stated) <= 2.0 * (1 + 1e-9)


def test_lenses_that_the_images_contradict_are_named():
    """One camera's principal point is 25 px off, known to 2 px or kept; the other camera is right."""
    rig = make_rig()
    values = intrinsics_vector(rig.left)
    other = with_intrinsics(rig.left, values + 25.0 * (np.arange(len(values)) == 2))
    covariances = np.diag(sigma_of_pixels(rig.left, 2.0) ** 2), np.diag(sigma_of_pixels(rig.right, 2.0) ** 2)

    def warned(left, covariances):
        declared = Declared(cameras=(left, rig.right), covariances=covariances)
        found = calibrate_stereo(views(6, 0.05), BOARD, rig.left.image_size, declared=declared)
        return [w.message for w in found.warnings if w.code == "intrinsics_contradicted"]

    for how in (covariances, None):
        assert "the left camera" in warned(other, how)[0]
    assert warned(rig.left, None) == []


def test_radtan_starts_with_four_coefficients_and_is_written_for_kalibr_exactly():
    K = np.array([[420.0, 0, 322.0], [0, 421.0, 241.0], [0, 0, 1]])
    truth = CameraModel((640, 480), K, np.array([-0.2, 0.05, 0.001, -0.002]))
    seen = [(v.ids_left, v.left) for v in views(6, 0.0, rig=StereoRig(truth, truth, make_rig().T_right_left))]
    camera = CameraStarts(BOARD.object_points, seen, (640, 480)).camera(RADTAN)
    assert (camera.model, camera.distortion.shape) == ("pinhole", (4,))
    assert np.allclose(camera.distortion, truth.distortion, atol=2e-4)
    _, lens, error_px = rig_to_camchain(StereoRig(camera, camera, make_rig().T_right_left))
    assert (lens, error_px) == ("radtan", 0.0)


def test_the_result_follows_the_intervals():
    result = calibrate_stereo(views(12, 0.1), BOARD, make_rig().left.image_size, "pinhole")
    loose = CalibrationWarning("unsure_rotation", "the rotation between the cameras is known to 0.4 deg only")
    assert calibration_summary(replace(result, warnings=()))[0] == "good"
    kind, title, text = calibration_summary(replace(result, warnings=(loose,)))
    assert (kind, title) == ("poor", "Not determined by these views.")
    assert "0.4 deg" in text
