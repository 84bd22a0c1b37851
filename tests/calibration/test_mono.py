"""One camera from images of a board: the camera, its deviations, and images that do not belong."""

from __future__ import annotations

import numpy as np
import pytest
from board_views import BOARD, views

from lmkit.calibration.intrinsics import (
    KnownIntrinsics,
    intrinsics_vector,
    sigma_and_correlation,
    stated_covariance,
)
from lmkit.calibration.mono import calibrate_camera
from lmkit.errors import InputError
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
