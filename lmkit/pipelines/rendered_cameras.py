"""Cameras of a simulated robot with rendered images and the real detector."""

from __future__ import annotations

import numpy as np

from lmkit.arrays import ByteArray
from lmkit.detection.config import DetectOptions
from lmkit.detection.detector import detect_landmarks
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import AnyRig, T_map_cameras, mounted_cameras
from lmkit.model.observation import Detection
from lmkit.simulation.photograph import ImagingChain, Sensor, photograph
from lmkit.simulation.scene import Scene

Seen = tuple[Detection, ...]
CHAIN = ImagingChain(sensor=Sensor(6000.0, 8.0, bayer=True))


class RenderedCameras:
    """Detections in the rendered images of a scene at intervals; none between them.

    Args:
        rig: with its T_base_left.
        every_s: between two frames.
    """

    def __init__(self, scene: Scene, rig: AnyRig, seed: int, every_s: float = 0.6) -> None:
        self._scene, self._rig, self._every_s, self._taken_s = scene, rig, every_s, -np.inf
        self._rng = np.random.default_rng([seed, 9])

    def __call__(self, time_s: float, T_map_base: Pose) -> tuple[Seen, ...]:
        """Detections from a pose of the robot's base."""
        if time_s < self._taken_s + self._every_s - 1e-9:
            return tuple(() for _ in mounted_cameras(self._rig))
        self._taken_s = time_s
        return self.look(T_map_base)[1]

    def look(self, T_map_base: Pose) -> tuple[ByteArray, tuple[Seen, ...]]:
        """The left image (BGR), and the detections in all images."""
        assert self._rig.T_base_left is not None
        T_map_left = T_map_base @ self._rig.T_base_left
        images, read = [], []
        for camera, T in zip(mounted_cameras(self._rig), T_map_cameras(self._rig, T_map_left), strict=True):
            image = photograph(self._scene, camera.model, T, CHAIN, self._rng)
            images.append(image)
            read.append(tuple(detect_landmarks(image, DetectOptions(camera=camera.model))))
        return images[0], tuple(read)
