"""Poses from images lie in the ellipsoids that are stated for them; benchmarks/pose_intervals.py has many more."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from simulated import CAMERA, shoot

from lmkit.detection.config import DetectOptions
from lmkit.detection.detector import detect_landmarks
from lmkit.geometry.pose import Pose
from lmkit.localization.absolute_pose import LocateOptions, locate_camera
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.simulation.photograph import Development, ImagingChain, Lens, Light, Sensor

CHAIN = ImagingChain(Lens(0.6), Light(0.6), Sensor(6000, 6, True), Development(sharpen=0.5, jpeg_quality=92))


def squared_error(seed: int) -> float:
    """Squared normalized error (3 numbers) of the place of a camera before a landmark; infinite if none is found."""
    rng = np.random.default_rng(seed)
    side, turn, tilt, code = rng.uniform(45, 75), rng.uniform(-20, 20), rng.uniform(30, 50), int(rng.integers(256))
    image, _ = shoot(code, side, turn, tilt, CHAIN, seed)
    roll = cv2.Rodrigues(np.array([0.0, 0.0, np.deg2rad(turn)]))[0]
    lean = cv2.Rodrigues(np.array([0.0, np.deg2rad(tilt), 0.0]))[0]
    at = np.array([0.01, -0.02, CAMERA.K[0, 0] * 0.18 / side])
    T = Pose("map", "landmark", lean @ roll @ np.diag([1.0, -1.0, -1.0]), at)
    landmarks = LandmarkMap([MappedLandmark(LandmarkId("lm8", code), 0.18, T)])
    found = detect_landmarks(image, DetectOptions(camera=CAMERA))
    pose = locate_camera(found, CAMERA, landmarks, LocateOptions(corner_floor_px=0.0))
    if pose.status != "ok":
        return np.inf
    off = pose.T_map_camera.t
    return float(off @ np.linalg.solve(pose.covariance[:3, :3], off))


@pytest.mark.slow
def test_places_of_cameras_from_images_are_in_their_95_percent_ellipsoids_and_these_are_not_far_too_large():
    squared = np.array([squared_error(seed) for seed in range(24)])
    assert (squared < 7.815).sum() >= 20, squared.round(1)
    assert np.median(squared) > 0.9, squared.round(2)
