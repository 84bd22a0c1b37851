"""Rays of a grid of pixels, interpolated between those that go through the lens."""

from __future__ import annotations

import numpy as np
import pytest

from lmkit.geometry.camera import CameraModel

K = np.array([[460.0, 0, 322], [0, 458, 239], [0, 0, 1]])


@pytest.mark.parametrize(
    ("model", "distortion"),
    [
        ("pinhole", [-0.21, 0.055, 0.0007, -0.0004, 0.0]),
        ("rational", [0.4, 0.05, 0.0007, -0.0004, 0.01, 0.6, 0.08, 0.02]),
        ("fisheye", [0.02, -0.01, 0.003, -0.001]),
    ],
)
def test_a_grid_has_the_rays_of_its_pixels(model, distortion):
    camera = CameraModel((640, 480), K, np.array(distortion), model)
    x, y = np.arange(-1 / 3, 639.4, 1 / 3), np.arange(0.0, 480.0, 7.0)
    rays = camera.unproject_grid(x, y)
    rows, columns = np.arange(0, len(y), 5), np.arange(0, len(x), 37)
    pixels = np.stack(np.meshgrid(x[columns], y[rows]), axis=-1)
    exact = camera.unproject(pixels.reshape(-1, 2)).reshape(pixels.shape)
    np.testing.assert_allclose(rays[np.ix_(rows, columns)], exact, atol=1e-4 / 460)
    assert rays.shape == (len(y), len(x), 2)
    assert camera.unproject_grid(x[:1], y[:1]).shape == (1, 1, 2)
