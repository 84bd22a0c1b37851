"""Corners of landmarks as rays, with their covariance: what one camera observed, without its lens.

Corners are undistorted once; errors of rays become pixels by the lens's own derivative, so that no pose needs the
lens again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.geometry.camera import REACHED_PX, CameraModel
from lmkit.kernels.lens import Lens, corners_through_lens
from lmkit.model.observation import Detection

UNKNOWN = np.zeros((8, 8))  # covariance of corners that come without


@dataclass(frozen=True, eq=False)
class CameraCorrespondences:
    """Observed corners of one camera as rays, without distortion.

    Attributes:
        kept: of the observations, those that the lens model reaches.
        rays: (S,4,2) corners as x/z and y/z, without distortion.
        by_ray: (S,4,2,2) how pixels change with them.
        whitener: (S,8,8) from errors of rays to standard deviations of the corners.
    """

    kept: list[int]
    rays: FloatArray
    by_ray: FloatArray
    whitener: FloatArray


def through_lens(
    observations: Sequence[Detection], camera: CameraModel, corner_floor_px: float
) -> CameraCorrespondences:
    """Corners as rays, each with its own covariance and that of the floor."""
    if not observations:
        return CameraCorrespondences([], np.zeros((0, 4, 2)), np.zeros((0, 4, 2, 2)), np.zeros((0, 8, 8)))
    corners = np.array([o.corners for o in observations])
    covariance = None
    if any(o.covariance is not None for o in observations):
        covariance = np.array([UNKNOWN if o.covariance is None else o.covariance for o in observations])
    rays, by_ray, whitener, reached = corners_through_lens(
        lens_of(camera), corners, covariance, corner_floor_px, REACHED_PX
    )
    if reached.all():
        return CameraCorrespondences(list(range(len(corners))), rays, by_ray, whitener)
    return CameraCorrespondences(np.flatnonzero(reached).tolist(), rays[reached], by_ray[reached], whitener[reached])


@lru_cache(maxsize=16)
def lens_of(camera: CameraModel) -> Lens:
    """The camera's intrinsics as the kernels take them."""
    return Lens(camera.K, camera.distortion, camera.model == "fisheye")
