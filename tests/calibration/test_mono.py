"""One camera from images of a board: the camera, its deviations, and images that do not belong."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from board_views import BOARD, views

from lmkit.calibration.initialization import CameraStarts
from lmkit.calibration.intrinsics import (
    KnownIntrinsics,
    intrinsics_vector,
    sigma_and_correlation,
    stated_covariance,
)
from lmkit.calibration.mono import calibrate_camera
from lmkit.errors import InputError
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.rotations import rotation_exp
from lmkit.model.observation import BoardObservation
from lmkit.simulation.scene import make_rig

CAMERA = make_rig().left


def seen(count: int, noise: float, seed: int = 1):
    return [(v.name, BoardObservation(v.ids_left, v.left)) for v in views(count, noise, seed)]


def test_the_camera_comes_out_within_its_deviations():
    off = []
    for seed in range(3):
        result = calibrate_camera(seen(14, 0.1, seed), BOARD, CAMERA.image_size, "pinhole")
        sigma = result.rig.cameras[0].intrinsics_sigma
        off.append(((intrinsics_vector(result.rig.left) - intrinsics_vector(CAMERA)) / sigma)[:4])
    assert np.sqrt(np.mean(np.square(off))) < 2.0
    assert result.held_out_px == pytest.approx(0.125, abs=0.03)
    assert len(result.used) == 14


def test_a_bad_image_is_named_and_left_out():
    images = seen(12, 0.1)
    name, board = images[4]
    rng = np.random.default_rng(0)
    images[4] = (name, BoardObservation(board.ids, board.image_points + rng.normal(0, 4, board.image_points.shape)))
    result = calibrate_camera(images, BOARD, CAMERA.image_size, "pinhole")
    assert [image for image, _ in result.rejected] == [name]
    assert "images_disagree" in [w.code for w in result.warnings]
    assert name not in result.to_dict()["images_used"]


@pytest.mark.parametrize("focal", [250.0, 1600.0])
def test_an_equidistant_camera_is_found_for_any_focal_length(focal):
    K = np.array([[focal, 0, 325.0], [0, focal, 236.0], [0, 0, 1.0]])
    lens = CameraModel((640, 480), K, np.array([-0.1, 0.02, 0.0, 0.0, 0.0]))
    rng, images = np.random.default_rng(1), []
    points = BOARD.object_points - BOARD.object_points.mean(axis=0)
    while len(images) < 14:
        R, z = rotation_exp(rng.normal(0, 0.35, 3)), focal * np.ptp(points[:, 0]) / 640 * rng.uniform(1.6, 2.4)
        pixels = lens.project(points @ R.T + z * np.array([*rng.uniform(-0.2, 0.2, 2) * 640 / focal, 1.0]))
        if lens.contains(pixels).all():
            noisy = pixels + rng.normal(0, 0.1, pixels.shape)
            images.append((f"{len(images)}", BoardObservation(np.arange(len(points)), noisy)))
    result = calibrate_camera(images, BOARD, lens.image_size, "fisheye")
    assert result.rejected == ()
    assert result.held_out_px == pytest.approx(0.125, abs=0.03)
    assert result.rig.left.K[0, 0] == pytest.approx(focal, rel=0.02)


def test_an_equidistant_start_of_a_narrow_lens_needs_no_fisheye_fit(monkeypatch):
    def refused(*arguments, **options):
        raise AssertionError("the pinhole camera's neighbor explains the corners")

    monkeypatch.setattr(cv2.fisheye, "calibrate", refused)
    corners = [(o.ids, o.image_points) for _, o in seen(14, 0.1)]
    start = CameraStarts(BOARD.object_points, corners, CAMERA.image_size).camera("fisheye")
    pixels = np.concatenate([points for _, points in corners])
    rays = np.column_stack([CAMERA.unproject(pixels), np.ones(len(pixels))])
    assert np.linalg.norm(start.project(rays) - pixels, axis=1).max() < 3.0


def test_a_camera_that_misses_its_own_corners_is_refused():
    scrambled = [(name, replace(o, ids=np.roll(o.ids, 7 * k))) for k, (name, o) in enumerate(seen(8, 0.1))]
    with pytest.raises(InputError, match="misses the corners"):
        calibrate_camera(scrambled, BOARD, CAMERA.image_size, "pinhole")


def test_two_images_are_too_few():
    with pytest.raises(InputError, match="only 2 usable images"):
        calibrate_camera(seen(2, 0.1), BOARD, CAMERA.image_size)


def test_a_file_without_correlations_claims_no_more_than_one_with_them():
    """For any correlations, the widened diagonal is at least the covariance."""
    rng = np.random.default_rng(5)
    for _ in range(20):
        root = rng.normal(size=(9, 9)) * 10.0 ** rng.uniform(-2, 2, (9, 1))
        covariance = root @ root.T
        sigma, correlation = sigma_and_correlation(covariance)
        assert np.allclose(stated_covariance(sigma, correlation), covariance)
        assert np.linalg.eigvalsh(stated_covariance(sigma, None) - covariance)[0] > -1e-9 * covariance.max()
        W = KnownIntrinsics(sigma, covariance).root
        assert np.allclose(W @ covariance @ W.T, np.eye(9), atol=1e-5)
