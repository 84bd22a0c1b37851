"""Observed corners of one camera as undistorted rays, with their covariance.

Corners are undistorted once.  Errors of rays are converted to pixels with the derivative of the lens model, so it is
not evaluated for every pose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lmkit.arrays import FloatArray, stacked
from lmkit.geometry.camera import REACHED_PX, CameraModel
from lmkit.kernels.lens import Lens, corners_through_lenses
from lmkit.model.observation import Detection

UNKNOWN = np.zeros((8, 8))  # covariance of corners without one
NEXT = [1, 2, 3, 0]  # corner that follows


@dataclass(frozen=True, eq=False)
class CameraCorrespondences:
    """Observed corners as rays, without distortion.

    Attributes:
        kept: the observations within the valid area of the lens model.
        corners: (S,4,2) pixels.
        rays: (S,4,2) corners as x/z and y/z, without distortion.
        by_ray: (S,4,2,2) how pixels change with them.
        whitener: (S,8,8) from errors of rays to standard deviations of the corners.
        variances: (S,) stated variance of a corner's coordinate, px^2: mean of the eight, without the floor.
    """

    kept: list[int]
    corners: FloatArray
    rays: FloatArray
    by_ray: FloatArray
    whitener: FloatArray
    variances: FloatArray


def through_lens(
    observations: Sequence[Detection], camera: CameraModel, corner_floor_px: float
) -> CameraCorrespondences:
    """Corners of one camera as rays, each with its own covariance and that of the floor."""
    return through_lenses(observations, [camera], [len(observations)], corner_floor_px)


def through_lenses(
    observations: Sequence[Detection], cameras: Sequence[CameraModel], counts: Sequence[int], corner_floor_px: float
) -> CameraCorrespondences:
    """Corners of several cameras as rays, camera after camera, with given counts."""
    corners = stacked([o.corners for o in observations], (4, 2))
    stated = [o.covariance for o in observations]
    known = any(one is not None for one in stated)
    covariance = stacked([UNKNOWN if one is None else one for one in stated], (8, 8)) if known else None
    rays, by_ray, whitener, reached = corners_through_lenses(
        [lens_of(camera) for camera in cameras], counts, corners, covariance, corner_floor_px, REACHED_PX
    )
    variances = np.zeros(len(corners)) if covariance is None else covariance.trace(axis1=1, axis2=2) / 8
    if reached.all():
        return CameraCorrespondences(list(range(len(corners))), corners, rays, by_ray, whitener, variances)
    kept = np.flatnonzero(reached)
    return CameraCorrespondences(
        kept.tolist(), corners[kept], rays[kept], by_ray[kept], whitener[kept], variances[kept]
    )


def sides_px(corners: FloatArray) -> FloatArray:
    """(S,) mean sides in the image of corners (S,4,2) in pixels."""
    steps = corners[:, NEXT] - corners
    return np.asarray(np.hypot(steps[..., 0], steps[..., 1]).sum(axis=1) / 4)


@lru_cache(maxsize=16)
def lens_of(camera: CameraModel) -> Lens:
    """The camera's intrinsics as the kernels take them."""
    return Lens(camera.K, camera.distortion, camera.lens.is_equidistant)
