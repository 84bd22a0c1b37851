"""Corners of landmarks as rays: what an eye saw, and what it should see from wherever rig and landmark are.

Corners are undistorted once, and what they are off by is carried back into pixels by the lens's own derivative, so
that no pose needs the lens again.  A view takes any leading axes: many poses of one moment (`sightings.py`), or all
sightings of a drive (`mapping/bundle_adjustment.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.geometry.camera import REACHED_PX, CameraModel
from lmkit.kernels.lens import Lens, corners_through_lens
from lmkit.model.observation import Detection

NEAREST_M = 0.02  # corners nearer than that, or behind the camera, are seen nowhere
NOWHERE = 1e2  # as x/z
UNKNOWN = np.zeros((8, 8))  # covariance of corners that come without


@dataclass(frozen=True, eq=False)
class CameraCorrespondences:
    """What one camera saw, looked through its lens.

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
        _lens(camera), corners, covariance, corner_floor_px, REACHED_PX
    )
    if reached.all():
        return CameraCorrespondences(list(range(len(corners))), rays, by_ray, whitener)
    return CameraCorrespondences(np.flatnonzero(reached).tolist(), rays[reached], by_ray[reached], whitener[reached])


@lru_cache(maxsize=16)
def _lens(camera: CameraModel) -> Lens:
    return Lens(camera.K, camera.distortion, camera.model == "fisheye")


class View:
    """Corners as an eye should see them.

    Args:
        offset: (...,4,3) from the rig to the corners, in the map.
        turn, eye_t: (...,3,3) from the map into the eye, (...,3) from the rig into it.
    """

    def __init__(self, offset: FloatArray, turn: FloatArray, eye_t: FloatArray) -> None:
        self._offset, self._turn = offset, turn
        seen = offset @ turn.swapaxes(-1, -2) + eye_t[..., None, :]
        self._behind = (seen[..., 2] < NEAREST_M).any(axis=-1)
        self._depth = np.maximum(seen[..., 2:], NEAREST_M)
        self._expected = seen[..., :2] / self._depth

    def errors(self, rays: FloatArray) -> FloatArray:
        """(...,8) observed rays (...,4,2) minus expected ones; huge where a corner lies behind the camera."""
        errors = rays - self._expected
        errors = errors.reshape(*errors.shape[:-2], 8)
        errors[self._behind] = NOWHERE
        return np.asarray(errors)

    @cached_property
    def by_point(self) -> FloatArray:
        """(...,4,2,3) derivatives of expected rays with the corners in the map."""
        across, along = self._turn[..., None, :2, :], self._turn[..., None, 2:, :]
        return np.asarray((across - self._expected[..., None] * along) / self._depth[..., None])

    def by_rig(self) -> FloatArray:
        """(...,8,6) derivatives with the rig's place and its turn about the map's axes."""
        # x_left = R' exp(-turn) (X - p - shift); g' skew(o) = g x o.
        G = self.by_point
        return _eight(-G, _cross(G, self._offset[..., None, :]))

    def by_landmark(self, arms: FloatArray) -> FloatArray:
        """(...,8,6) the same with the landmark's; arms are (...,4,3) from its middle to its corners, in the map."""
        G = self.by_point
        return _eight(G, -_cross(G, arms[..., None, :]))


def _eight(by_place: FloatArray, by_turn: FloatArray) -> FloatArray:
    J = np.concatenate([by_place, by_turn], axis=-1)
    return np.asarray(J.reshape(*J.shape[:-3], 8, 6))


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Like np.cross over the last axis, without its overhead."""
    a0, a1, a2 = a[..., 0], a[..., 1], a[..., 2]
    b0, b1, b2 = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], axis=-1)
