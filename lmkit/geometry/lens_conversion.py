"""The best approximation of a camera with another distortion model, for formats with fewer coefficients."""

from __future__ import annotations

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.errors import InputError
from lmkit.geometry.camera import CameraModel

GRID = (24, 18)
LEAST_PIXELS = 40  # of the grid, inside the range of the distortion


def with_four_coefficients(camera: CameraModel, model: str) -> tuple[CameraModel, float]:
    """A camera with four coefficients that approximates this one, and its largest error in px.

    Focal lengths and center move with the coefficients, so that the images agree where there is an image.

    Args:
        model: ``pinhole`` (k1 k2 p1 p2) or ``fisheye`` (k1 k2 k3 k4).

    Raises:
        InputError: no such camera is near.
    """
    from scipy.optimize import least_squares  # takes a quarter of a second to load; few need it

    D = camera.distortion
    if camera.model == model and not D[4:].any():
        return CameraModel(camera.image_size, camera.K, np.pad(D[:4], (0, max(0, 4 - len(D)))), model), 0.0
    width, height = camera.image_size
    u, v = np.meshgrid(np.linspace(0, width - 1, GRID[0]), np.linspace(0, height - 1, GRID[1]))
    pixels = np.column_stack([u.ravel(), v.ravel()])
    pixels = pixels[camera.reaches(pixels)]
    points = np.column_stack([camera.unproject(pixels), np.ones(len(pixels))])
    seen = camera.project(points)

    def made(x: FloatArray) -> CameraModel:
        K = np.array([[x[0], 0, x[2]], [0, x[1], x[3]], [0, 0, 1.0]])
        return CameraModel(camera.image_size, K, x[4:], model)

    K = camera.K
    lens = np.pad(D[:4], (0, max(0, 4 - len(D)))) if model == "pinhole" else np.zeros(4)
    start = np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *lens])
    try:
        if len(pixels) < LEAST_PIXELS:
            raise ValueError("the distortion is not valid anywhere in the image")
        scale = [100] * 4 + [0.1] * 4
        found = least_squares(lambda x: (made(x).project(points) - seen).ravel(), start, x_scale=scale)
        nearest = made(np.asarray(found.x))
    except ValueError as error:
        raise InputError(
            "no_such_lens", f"no {model} camera with four coefficients is near this one ({error})", "calibrate anew"
        ) from None
    return nearest, float(np.linalg.norm(nearest.project(points) - seen, axis=1).max())
