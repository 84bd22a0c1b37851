"""Simulated detections of both cameras: corners with noise instead of images."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from lmkit.arrays import BoolArray, FloatArray
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import AnyRig, mounted_cameras
from lmkit.model.detector_model import corner_sigma_px, half_read_px, recognized
from lmkit.model.floor_plan import FloorPlan
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.model.observation import Detection

MOST_TILT = 0.35  # cosine of the steepest view that is read, if the noise is fixed
LEAST_SIDE_PX = 15.0
NEAREST_M = 0.3
FARTHEST_SIZES = 100.0  # largest distance in sides; no lens shows a readable landmark beyond

Seen = tuple[Detection, ...]


def look(
    landmarks: LandmarkMap,
    rig: AnyRig,
    T_map_base: Pose,
    noise_px: float | None,
    rng: np.random.Generator,
    floor: FloorPlan | None = None,
) -> tuple[Seen, ...]:
    """Detections of every camera from a pose of the robot's base.

    Args:
        rig: with its T_base_left.
        noise_px: of every corner; all landmarks except small and slanted ones are read; None: corners and detection
            as measured (`model/detector_model.py`).
        floor: floor plan whose walls hide landmarks; None: no landmark is hidden.
    """
    assert rig.T_base_left is not None
    T_map_left = T_map_base @ rig.T_base_left
    T_left = T_map_left.inverse()
    origin = T_map_left.t[None, :2]
    shown = _shown(list(landmarks), origin, floor)
    # A landmark is read by all cameras that see it, or by none.
    luck = np.zeros(len(shown)) if noise_px is not None else rng.uniform(size=len(shown))
    return tuple(
        tuple(_seen(shown, luck, camera.model, camera.T_camera_left @ T_left, noise_px, rng))
        for camera in mounted_cameras(rig)
    )


def _shown(landmarks: list[MappedLandmark], origin: FloatArray, floor: FloorPlan | None) -> list[MappedLandmark]:
    """Landmarks that are not hidden by a wall."""
    if floor is None or not landmarks:
        return landmarks
    places = np.array([m.T_map_landmark.t[:2] for m in landmarks])
    sizes = np.array([m.size_m for m in landmarks])
    near = np.flatnonzero(np.linalg.norm(places - origin, axis=1) < FARTHEST_SIZES * sizes)
    clear = floor.sees(np.repeat(origin, len(near), axis=0), places[near])
    return [landmarks[k] for k in near[clear]]


def _seen(
    landmarks: Sequence[MappedLandmark],
    luck: FloatArray,
    camera: CameraModel,
    T: Pose,
    noise_px: float | None,
    rng: np.random.Generator,
) -> Iterator[Detection]:
    for k in np.flatnonzero(_in_view(landmarks, camera, T)).tolist():
        landmark, chance = landmarks[k], luck[k]
        points = T.apply(landmark.corners_map)
        center = points.mean(axis=0)
        facing = float(-(T.R @ landmark.T_map_landmark.R[:, 2]) @ center / np.linalg.norm(center))
        if facing <= 0:
            continue
        corners = camera.project(points)
        if not camera.contains(corners).all():
            continue
        sides = np.linalg.norm(corners - corners[[3, 0, 1, 2]], axis=1)
        if noise_px is None:
            side = np.array(sides.mean())
            if chance >= recognized(side, np.arccos(facing), half_read_px(landmark.id.family)):
                continue
            sigma = float(corner_sigma_px(side))
        elif facing < MOST_TILT or sides.min() < LEAST_SIDE_PX:
            continue
        else:
            sigma = noise_px
        noisy = corners + rng.normal(0, sigma, (4, 2))
        C = sigma**2 * np.eye(8)
        yield Detection(landmark.id, noisy, 0.99, 50.0, covariance=C)


def _in_view(landmarks: Sequence[MappedLandmark], camera: CameraModel, T: Pose) -> BoolArray:
    """(N,) whether all corners are in front of the camera and near its field of view, for a valid lens model."""
    points = T.apply(np.array([m.corners_map for m in landmarks]).reshape(-1, 3)).reshape(-1, 4, 3)
    ahead = points[..., 2].min(axis=1) >= NEAREST_M
    # Far outside the image the distortion folds back into it.
    limit = 0.75 * np.array(camera.image_size) / camera.K[[0, 1], [0, 1]]
    return np.asarray(ahead & (np.abs(points[..., :2]) <= limit * points[..., 2:]).all(axis=(1, 2)))
