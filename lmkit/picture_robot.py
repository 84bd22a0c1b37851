"""A simulated robot that sees by pictures: photographed where it stands, and read by the detector, end to end."""

from __future__ import annotations

import numpy as np

from lmkit.arrays import ByteArray, FloatArray
from lmkit.detect.landmarks import detect_landmarks
from lmkit.detect.options import DetectOptions
from lmkit.model.floor_plan import FloorPlan
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.observation import LandmarkObservation
from lmkit.model.pose import Pose
from lmkit.model.stereo_rig import StereoRig
from lmkit.simulate.drive import WheelErrors
from lmkit.simulate.photograph import ImagingChain, Sensor, photograph
from lmkit.simulate.robot import SimulatedRobot
from lmkit.simulate.scene import floor_scene

Seen = tuple[LandmarkObservation, ...]
CHAIN = ImagingChain(sensor=Sensor(6000.0, 8.0, bayer=True))


class PictureRobot(SimulatedRobot):
    """`SimulatedRobot` with pictures in place of simulated corners.

    Attributes:
        left_picture: the last one taken, BGR; None before the first.
        read: what was read in it.
    """

    def __init__(
        self,
        floor: FloorPlan,
        landmarks: LandmarkMap,
        rig: StereoRig,
        state: FloatArray,
        radius_m: float,
        errors: WheelErrors,
        seed: int,
        every_s: float = 0.6,
    ) -> None:
        super().__init__(floor, landmarks, rig, state, radius_m, errors, seed)
        self._scene, self._every_s, self._taken_s = floor_scene(seed, floor, landmarks), every_s, -np.inf
        self._light = np.random.default_rng([seed, 9])
        self.left_picture: ByteArray | None = None
        self.read: Seen = ()

    def look(self) -> tuple[Seen, Seen]:
        """What the detector reads in two pictures, now and then; between them nothing."""
        if self.time_s < self._taken_s + self._every_s - 1e-9:
            return (), ()
        self._taken_s = self.time_s
        assert self.rig.T_base_left is not None
        T_left = self.leaning() @ self.rig.T_base_left
        T = Pose("map", "camera", T_left.R, T_left.t)
        T_left_right = Pose("camera", "camera", self.rig.T_right_left.R, self.rig.T_right_left.t).inverse()
        pictures = [
            photograph(self._scene, camera, pose, CHAIN, self._light)
            for camera, pose in ((self.rig.left, T), (self.rig.right, T @ T_left_right))
        ]
        left, right = (
            tuple(detect_landmarks(picture, DetectOptions(camera=camera)))
            for picture, camera in zip(pictures, (self.rig.left, self.rig.right), strict=True)
        )
        self.left_picture, self.read = pictures[0], left
        return left, right
