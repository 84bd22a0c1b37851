"""Lens models that end inside the image, and the warnings about them."""

from __future__ import annotations

import numpy as np
import pytest

from lmkit.calibration.sanity_checks import beyond_model, end_of_lens
from lmkit.calibration.view_coverage import camera_coverage, covered_share, visible_cells
from lmkit.geometry.camera import CameraModel


def camera(model: str, distortion: list[float], focal_px: float) -> CameraModel:
    K = np.array([[focal_px, 0, 479.5], [0, focal_px, 299.5], [0, 0, 1.0]])
    return CameraModel((960, 600), K, np.array(distortion), model=model)


def test_what_a_wide_fisheye_lens_shows_beside_it_is_no_fault_of_its_model():
    for distortion in ([0.01, 0.0, 0.0, 0.0], [0.022, -0.0099, 0.0064, -0.0035]):
        check_wide(camera("fisheye", distortion, 227.0))


def check_wide(wide: CameraModel) -> None:
    corners = np.array([[0.0, 0.0], [959.0, 599.0]])
    assert not wide.reaches(corners).any()
    assert beyond_model(wide) == 0
    assert end_of_lens(wide, "the left camera") is None


def test_views_are_not_asked_for_where_a_wide_lens_shows_the_dark():
    wide, narrow = (camera("fisheye", [0.01, 0.0, 0.0, 0.0], focal_px) for focal_px in (227.0, 600.0))
    assert visible_cells(narrow).all()
    visible = visible_cells(wide)
    assert visible.sum() == 15
    assert not visible[:, [0, 4]].any()
    middles = np.array([[480.0 + 192 * x, 300.0 + 120 * y] for x in (-1, 0, 1) for y in (-2, -1, 0, 1, 2)])
    poses = np.tile(np.eye(3), (len(middles), 1, 1)), np.tile([0, 0, 1.0], (len(middles), 1))
    for lens, share in ((wide, 1.0), (narrow, 0.6)):
        cells, advice = camera_coverage(list(middles[:, None]), *poses, lens)
        assert covered_share(cells, lens) == pytest.approx(share)
        assert any("corner of the image" in text for text in advice) == (share < 1)


def test_another_model_is_named_than_the_one_that_folds():
    folding = {"pinhole": ([-0.45, 0.2, 0.0, 0.0, -0.1], 420.0), "fisheye": ([-0.3, 0.0, 0.0, 0.0], 300.0)}
    other = {"pinhole": "fisheye", "fisheye": "pinhole"}
    for model, (distortion, focal_px) in folding.items():
        message = end_of_lens(camera(model, distortion, focal_px), "the left camera")
        assert message is not None
        assert f"--model {other[model]}" in message
