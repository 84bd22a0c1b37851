"""A robot that drives around a room for a given time: truth at any time, wheels and gyro, images or corners."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lmkit.arrays import ByteArray, FloatArray
from lmkit.geometry.planar import planar_pose
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import AnyRig, Rig, T_map_cameras, mounted_cameras
from lmkit.model.families import MarkerFamily
from lmkit.model.landmark import LM8
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.observation import Detection
from lmkit.simulation.observations import look
from lmkit.simulation.quick_images import QuickCamera
from lmkit.simulation.recording import HEIGHT_M, T_BASE_LEFT, WheelErrors, _round_trip, _slip, _wheels
from lmkit.simulation.scene import furnish_room, make_rig, mount_landmarks

ROOM_M = (6.0, 4.5)
FOCAL_SHARE = 0.72  # focal length over image width


class RobotCourse:
    """A course through a room with landmarks on its walls.

    Attributes:
        landmarks: true landmarks.
        rig: with its T_base_left.
        seconds: length of the course.

    Args:
        cameras: number of cameras, 1 or 2.
    """

    def __init__(
        self,
        seed: int,
        seconds: float,
        landmarks: int = 6,
        image_size: tuple[int, int] = (640, 480),
        cameras: int = 2,
        errors: WheelErrors | None = None,
        family: MarkerFamily = LM8,
    ) -> None:
        rng = np.random.default_rng([seed, 12])
        codes = [int(code) for code in rng.permutation(min(family.code_count, 256))[:landmarks]]
        size_m = (*ROOM_M, HEIGHT_M)
        self.landmarks = LandmarkMap(mount_landmarks(rng, family, codes, size_m))
        self._scene = furnish_room(rng, self.landmarks, size_m)
        stereo = replace(make_rig(image_size, FOCAL_SHARE * image_size[0]), T_base_left=T_BASE_LEFT)
        self.rig: AnyRig = stereo if cameras == 2 else Rig.of_one(stereo.left, T_BASE_LEFT)
        self.seconds = seconds
        errors = errors or WheelErrors()
        self._times, truth = _round_trip(rng, seconds + 1.0, ROOM_M)
        self._truth = _slip(rng, self._times, truth, errors.slips)
        odometry, gyro = _wheels(rng, self._times, self._truth, errors)
        self.wheels = np.column_stack([odometry.times_s, odometry.forward_m, odometry.turn_rad])
        self.gyro = np.column_stack([gyro.times_s, gyro.rate_radps])
        self._seed, self._rng = seed, np.random.default_rng([seed, 13])
        self._cameras: list[QuickCamera] | None = None

    def state(self, time_s: float) -> FloatArray:
        """(3,) true x, y (m), heading (rad) of the base."""
        return np.array([np.interp(time_s, self._times, column) for column in self._truth.T])

    def T_map_base(self, time_s: float) -> Pose:
        """True pose of the base."""
        return planar_pose(self.state(time_s))

    def images(self, T_map_base: Pose, light: float = 1.0) -> tuple[ByteArray, ...]:
        """BGR images of all cameras."""
        if self._cameras is None:
            models = [camera.model for camera in mounted_cameras(self.rig)]
            self._cameras = [QuickCamera(self._scene, m, self._seed + k) for k, m in enumerate(models)]
        assert self.rig.T_base_left is not None
        poses = T_map_cameras(self.rig, T_map_base @ self.rig.T_base_left)
        return tuple(camera(T, light) for camera, T in zip(self._cameras, poses, strict=True))

    def corners(self, T_map_base: Pose) -> tuple[Sequence[Detection], ...]:
        """Detections of all cameras, simulated with the measured errors of the detector."""
        return look(self.landmarks, self.rig, T_map_base, None, self._rng)

    def motion(self, after_s: float, until_s: float) -> tuple[FloatArray, FloatArray]:
        """Further rows (time, forward, turn) of the wheels and (time, rate) of the gyro, up to a time."""
        return tuple(  # type: ignore[return-value]
            table[np.searchsorted(table[:, 0], after_s, "right") : np.searchsorted(table[:, 0], until_s, "right")]
            for table in (self.wheels, self.gyro)
        )
