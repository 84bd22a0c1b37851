"""A calibrated stereo camera, rigid; its own frame is the left camera's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.pose import Pose, require_frames


def mounted_ahead(height_m: float) -> Pose:
    """T_base_left of a left camera above the robot's center that looks straight ahead."""
    axes = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    return Pose("base", "left", axes, np.array([0.0, 0.0, height_m]))


@dataclass(frozen=True, eq=False)
class StereoRig:
    """Two cameras with their relative pose.

    Attributes:
        left, right: the cameras.
        T_right_left: ``x_right = R @ x_left + t`` (OpenCV's R, T with the left camera given first).
        T_base_left: pose of the left camera on the robot's base, if known.
        covariance: (6,6) of T_right_left, if known: t (m), then a rotation vector applied on the
            left (rad).
        intrinsics_sigma: standard deviations of fx fy cx cy and the distortion of the left and of the right
            camera, if known.
        intrinsics_correlation: (4+D,4+D) correlations of the same numbers, if known.
        right_time_offset_s: added to the stamps of the right camera's images, it gives the time of exposure on the
            left camera's clock.

    Raises:
        TypeError: a camera is no CameraModel, or a pose no Pose.
        ValueError: a pose joins other frames.

    Examples:
        >>> import lmkit
        >>> camera = lmkit.CameraModel((640, 480), [[460, 0, 320], [0, 460, 240], [0, 0, 1]], [0, 0, 0, 0, 0])
        >>> right = lmkit.Pose("right", "left", [[1, 0, 0], [0, 1, 0], [0, 0, 1]], [-0.12, 0, 0])
        >>> lmkit.StereoRig(camera, camera, right).baseline_m
        0.12
    """

    left: CameraModel
    right: CameraModel
    T_right_left: Pose
    T_base_left: Pose | None = None
    covariance: FloatArray | None = None
    intrinsics_sigma: tuple[FloatArray, FloatArray] | None = None
    intrinsics_correlation: tuple[FloatArray, FloatArray] | None = None
    right_time_offset_s: float = 0.0

    def __post_init__(self) -> None:
        for name in ("left", "right"):
            if not isinstance(camera := getattr(self, name), CameraModel):
                raise TypeError(f"{name} of a StereoRig must be a CameraModel, not {type(camera).__name__}")
        require_frames(self.T_right_left, "right", "left")
        if self.T_base_left is not None:
            require_frames(self.T_base_left, "base", "left")

    def T_map_right(self, T_map_left: Pose) -> Pose:
        """Pose of the right camera for a pose of the left one."""
        T = self.T_right_left.inverse()
        return Pose(T_map_left.to_frame, "right", T_map_left.R @ T.R, T_map_left.R @ T.t + T_map_left.t)

    def __repr__(self) -> str:
        width, height = self.left.image_size
        place = "" if self.T_base_left is None else ", on a base"
        return f"StereoRig({self.models}, {width} x {height}, baseline {1000 * self.baseline_m:.2f} mm{place})"

    @property
    def models(self) -> str:
        """Lens model of both cameras, or of the left and of the right one, separated by a comma."""
        return ",".join(dict.fromkeys((self.left.model, self.right.model)))

    @property
    def baseline_m(self) -> float:
        """Distance between the two optical centers, meters."""
        return float(np.linalg.norm(self.T_right_left.t))


def ahead_of(T_map_base: Pose) -> Pose:
    """The pose of a camera that looks along the x axis of a robot's base."""
    axes = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    return Pose("map", "camera", T_map_base.R @ axes, T_map_base.t)
