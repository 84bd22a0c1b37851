"""Lenses with typical errors of a calibration: a smooth field of errors, the same in every image."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lmkit.geometry.camera import CameraModel
from lmkit.geometry.rig import AnyRig
from lmkit.geometry.stereo_rig import StereoRig

STEP = 1e-2  # a change so small that errors are proportional to it


def with_lens_errors(rig: AnyRig, error_px: float, seed: int) -> AnyRig:
    """The rig with an error of every lens: root mean square over the image, px along each axis.

    Examples:
        >>> from lmkit.simulation.scene import make_rig
        >>> rig = make_rig((640, 480), 460.0)
        >>> wrong = with_lens_errors(rig, 0.06, 1)
        >>> off = wrong.left.project(np.array([[0.2, 0.1, 1.0]])) - rig.left.project(np.array([[0.2, 0.1, 1.0]]))
        >>> bool(0 < np.abs(off).max() < 0.3)
        True
    """
    if not error_px:
        return rig
    rng = np.random.default_rng([seed, 31])
    if isinstance(rig, StereoRig):
        return replace(rig, left=_changed(rig.left, error_px, rng), right=_changed(rig.right, error_px, rng))
    cameras = tuple(replace(c, model=_changed(c.model, error_px, rng)) for c in rig.cameras)
    return replace(rig, cameras=cameras)


def _changed(camera: CameraModel, error_px: float, rng: np.random.Generator) -> CameraModel:
    """The camera with focal lengths, center and two terms of distortion changed at random."""
    width, height = camera.image_size
    x, y = np.meshgrid(np.linspace(0, width - 1, 9), np.linspace(0, height - 1, 7))
    rays = camera.unproject(np.column_stack([x.ravel(), y.ravel()]))
    points = np.column_stack([rays, np.ones(len(rays))])
    draw = rng.normal(size=6)

    def changed(scale: float) -> CameraModel:
        K, distortion = camera.K.copy(), camera.distortion.copy()
        K[[0, 1], [0, 1]] += scale * (draw[0] + 0.2 * draw[1] * np.array([1.0, -1.0]))
        K[[0, 1], [2, 2]] += scale * draw[2:4]
        distortion[:2] += scale * draw[4:6] * np.array([4.0, 8.0]) / camera.K[0, 0]
        return replace(camera, K=K, distortion=distortion)

    off = changed(STEP).project(points) - camera.project(points)
    return changed(STEP * error_px / float(np.sqrt(np.mean(off**2))))
