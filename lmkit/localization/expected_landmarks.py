"""Predicted places of the map's landmarks in the images, for a pose: where to search for them."""

from __future__ import annotations

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import AnyRig, mounted_cameras
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap

LEAST_SIDE_PX = 10.0  # of a window that is searched
PLAIN_SIDE_PX = 32.0  # a landmark that should certainly be read
PLAIN_FACING = 0.6
BORDER_PX = 12.0
NEAREST_M = 0.15
SLACK_PX = 4.0  # largest error of a prediction

Expected = dict[LandmarkId, FloatArray]


class ExpectedLandmarks:
    """Predicted places of the map's landmarks in the images, for a pose."""

    def __init__(self, rig: AnyRig, landmarks: LandmarkMap) -> None:
        self._cameras = mounted_cameras(rig)
        self._ids = [m.id for m in landmarks]
        self._corners = np.array([m.corners_map for m in landmarks]).reshape(-1, 4, 3)
        self._normals = np.array([m.T_map_landmark.R[:, 2] for m in landmarks]).reshape(-1, 3)

    def in_camera(self, index: int, T_map_left: Pose) -> tuple[Expected, tuple[LandmarkId, ...]]:
        """Corners (4,2), px, of all landmarks in the image, largest first; and those that are clearly in view."""
        if not len(self._ids):
            return {}, ()
        camera = self._cameras[index]
        T = camera.T_camera_left @ T_map_left.inverse()
        points = T.apply(self._corners)
        middle = points.mean(axis=1)
        distance = np.linalg.norm(middle, axis=1)
        facing = -np.einsum("ij,ij->i", self._normals @ T.R.T, middle) / np.maximum(distance, 1e-9)
        # Far outside the image the distortion folds back into it.
        limit = np.array(camera.model.image_size) / camera.model.K[[0, 1], [0, 1]]
        ahead = points[:, :, 2].min(axis=1) > NEAREST_M
        flat = points[:, :, :2] / np.maximum(points[:, :, 2:], NEAREST_M)
        candidates = np.flatnonzero(ahead & (facing > 0.1) & (np.abs(flat) < 0.75 * limit).all(axis=(1, 2)))
        if not len(candidates):
            return {}, ()
        pixels = camera.model.project(points[candidates].reshape(-1, 3)).reshape(-1, 4, 2)
        sides = np.linalg.norm(pixels - np.roll(pixels, 1, axis=1), axis=2).mean(axis=1)
        inside = camera.model.contains(pixels.reshape(-1, 2)).reshape(-1, 4)
        within = camera.model.contains(pixels.reshape(-1, 2), BORDER_PX).reshape(-1, 4)
        well_inside = np.asarray(within.all(axis=1)).reshape(-1)
        found: Expected = {}
        plain = []
        for k in np.argsort(-sides):
            if sides[k] < LEAST_SIDE_PX or not inside[k].any():
                continue
            id_ = self._ids[candidates[k]]
            found[id_] = pixels[k]
            if sides[k] > PLAIN_SIDE_PX and facing[candidates[k]] > PLAIN_FACING and bool(well_inside[k]):
                plain.append(id_)
        return found, tuple(plain)


def is_wholly_inside(quad: FloatArray, size: tuple[int, int]) -> bool:
    """Whether all (4,2) corners may be inside the image, given prediction errors; only such landmarks are read."""
    return bool(((quad >= -SLACK_PX) & (quad <= np.array(size) - 1 + SLACK_PX)).all())
