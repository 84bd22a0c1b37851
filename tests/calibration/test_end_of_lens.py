"""Lens models that end inside the image, and what is said of them."""

from __future__ import annotations

import numpy as np

from lmkit.calibration.sanity_checks import beyond_model, end_of_lens
from lmkit.geometry.camera import CameraModel


def camera(model: str, distortion: list[float], focal_px: float) -> CameraModel:
    K = np.array([[focal_px, 0, 479.5], [0, focal_px, 299.5], [0, 0, 1.0]])
    return CameraModel((960, 600), K, np.array(distortion), model=model)


def test_what_a_wide_fisheye_lens_shows_beside_it_is_no_fault_of_its_model():
    wide = camera("fisheye", [0.01, 0.0, 0.0, 0.0], 227.0)
    corners = np.array([[0.0, 0.0], [959.0, 599.0]])
    assert not wide.reaches(corners).any()
    assert beyond_model(wide) == 0
    assert end_of_lens(wide, "the left camera") is None


def test_another_model_is_named_than_the_one_that_folds():
    folding = {"pinhole": ([-0.45, 0.2, 0.0, 0.0, -0.1], 420.0), "fisheye": ([-0.3, 0.0, 0.0, 0.0], 300.0)}
    other = {"pinhole": "fisheye", "fisheye": "pinhole"}
    for model, (distortion, focal_px) in folding.items():
        message = end_of_lens(camera(model, distortion, focal_px), "the left camera")
        assert message is not None
        assert f"--model {other[model]}" in message
