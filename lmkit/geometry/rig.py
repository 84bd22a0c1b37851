"""A rigid rig of one or more cameras; its own frame is the first camera's, which is named ``left`` in every rig."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.errors import InputError
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.pose import Pose, require_frames
from lmkit.geometry.pose_array import moved_covariance
from lmkit.geometry.stereo_rig import StereoRig


@dataclass(frozen=True, eq=False)
class MountedCamera:
    """One camera of a rig.

    Attributes:
        name: in the rig, such as ``front``.
        model: intrinsics.
        T_camera_left: from the rig's first camera into this one: ``x_camera = R @ x_left + t``.
        covariance: (6,6) of T_camera_left, if known: t (m), then a rotation vector applied on the left (rad).
        intrinsics_sigma: standard deviations of fx fy cx cy and the distortion, if known.
        intrinsics_correlation: (4+D,4+D) correlations of the same numbers, if known.
        time_offset_s: added to the stamps of this camera's images, it gives the time of exposure on the first
            camera's clock.

    Raises:
        TypeError: the model is no CameraModel, or T_camera_left no Pose.
        ValueError: T_camera_left joins other frames.

    Examples:
        >>> import lmkit
        >>> camera = lmkit.CameraModel((640, 480), [[460, 0, 320], [0, 460, 240], [0, 0, 1]], [0, 0, 0, 0, 0])
        >>> lmkit.MountedCamera("front", camera, lmkit.Pose.identity("camera", "left"))
        MountedCamera(front, pinhole, at x 0.000 y 0.000 z 0.000 m)
    """

    name: str
    model: CameraModel
    T_camera_left: Pose
    covariance: FloatArray | None = None
    intrinsics_sigma: FloatArray | None = None
    intrinsics_correlation: FloatArray | None = None
    time_offset_s: float = 0.0

    def __post_init__(self) -> None:
        if not isinstance(self.model, CameraModel):
            raise TypeError(f"model of camera {self.name!r} must be a CameraModel, not {type(self.model).__name__}")
        require_frames(self.T_camera_left, "camera", "left")

    def __repr__(self) -> str:
        x, y, z = -self.T_camera_left.R.T @ self.T_camera_left.t
        return f"MountedCamera({self.name}, {self.model.model}, at x {x:z.3f} y {y:z.3f} z {z:z.3f} m)"


@dataclass(frozen=True, eq=False)
class Rig:
    """One or more cameras with their relative poses.

    Attributes:
        cameras: the cameras; T_camera_left of the first one is the identity.
        T_base_left: pose of the first camera on the robot's base, if known.

    Raises:
        TypeError: something else than MountedCameras, or T_base_left is no Pose.
        ValueError: no camera, two of one name, or a first camera that is not at the rig's origin or on its clock.

    Examples:
        >>> import lmkit
        >>> camera = lmkit.CameraModel((640, 480), [[460, 0, 320], [0, 460, 240], [0, 0, 1]], [0, 0, 0, 0, 0])
        >>> rig = lmkit.Rig.of_one(camera, name="front")
        >>> [mounted.name for mounted in rig.cameras]
        ['front']
    """

    cameras: tuple[MountedCamera, ...]
    T_base_left: Pose | None = None

    def __post_init__(self) -> None:
        cameras = self.cameras if isinstance(self.cameras, list | tuple) else [self.cameras]
        if other := [camera for camera in cameras if not isinstance(camera, MountedCamera)]:
            kind = type(other[0]).__name__
            raise TypeError(f"cameras of a Rig must be MountedCameras, not {kind}; of one camera take Rig.of_one")
        if not self.cameras:
            raise ValueError("a rig needs at least one camera")
        if self.T_base_left is not None:
            require_frames(self.T_base_left, "base", "left")
        names = [camera.name for camera in self.cameras]
        if len(set(names)) < len(names):
            raise ValueError(f"two cameras have the same name: {', '.join(names)}")
        first = self.cameras[0].T_camera_left
        if not (np.array_equal(first.R, np.eye(3)) and not first.t.any()):
            raise ValueError("T_camera_left of the first camera is not the identity")
        if self.cameras[0].time_offset_s != 0.0:
            raise ValueError("time_offset_s of the first camera is not zero: its clock is the rig's")

    @classmethod
    def of_one(cls, model: CameraModel, T_base_left: Pose | None = None, name: str = "camera") -> Rig:
        """A rig of a single camera."""
        return cls((MountedCamera(name, model, Pose.identity("camera", "left")),), T_base_left)

    @property
    def left(self) -> CameraModel:
        """The first camera."""
        return self.cameras[0].model

    def __repr__(self) -> str:
        return f"Rig({', '.join(camera.name for camera in self.cameras)})"


AnyRig = Rig | StereoRig


@lru_cache(maxsize=16)
def mounted_cameras(rig: AnyRig) -> tuple[MountedCamera, ...]:
    """The cameras of a rig, the first (left) one first."""
    if isinstance(rig, Rig):
        return rig.cameras
    right = rig.T_right_left
    sigma, correlation = rig.intrinsics_sigma or (None, None), rig.intrinsics_correlation or (None, None)
    T = Pose("camera", "left", right.R, right.t)
    return (
        MountedCamera("left", rig.left, Pose.identity("camera", "left"), None, sigma[0], correlation[0]),
        MountedCamera("right", rig.right, T, rig.covariance, sigma[1], correlation[1], rig.right_time_offset_s),
    )


def as_stereo(rig: AnyRig, what: str) -> StereoRig:
    """The rig as a stereo pair.

    Args:
        what: the user of the pair; named in the error.

    Raises:
        InputError: it has one camera, or more than two.
    """
    if isinstance(rig, StereoRig):
        return rig
    if len(rig.cameras) != 2:
        count = f"{len(rig.cameras)} camera{'s' if len(rig.cameras) > 1 else ''}"
        raise InputError(
            "not_stereo", f"{what} needs a stereo pair, and the rig has {count}", "give a rig of two cameras"
        )
    left, right = rig.cameras
    sigmas = left.intrinsics_sigma, right.intrinsics_sigma
    correlations = left.intrinsics_correlation, right.intrinsics_correlation
    return StereoRig(
        left.model,
        right.model,
        Pose("right", "left", right.T_camera_left.R, right.T_camera_left.t),
        rig.T_base_left,
        right.covariance,
        None if sigmas[0] is None or sigmas[1] is None else (sigmas[0], sigmas[1]),
        None if correlations[0] is None or correlations[1] is None else (correlations[0], correlations[1]),
        right.time_offset_s,
    )


def with_time_offsets(rig: AnyRig, offsets_s: Sequence[float]) -> AnyRig:
    """The rig with the time offset of every camera but the first."""
    if isinstance(rig, StereoRig):
        return replace(rig, right_time_offset_s=float(offsets_s[0]))
    others = [replace(c, time_offset_s=float(s)) for c, s in zip(rig.cameras[1:], offsets_s, strict=True)]
    return replace(rig, cameras=(rig.cameras[0], *others))


def cameras_carried(rig: AnyRig, carried: Sequence[Pose]) -> tuple[MountedCamera, ...]:
    """The cameras with their poses at the time of exposure, relative to the rig at the time of the frame.

    Args:
        carried: T_left_left of every camera, as of `RigFrame.carried`; empty: all expose at that time.
    """
    cameras = mounted_cameras(rig)
    if not carried:
        return cameras
    return tuple(
        replace(camera, T_camera_left=camera.T_camera_left @ moved.inverse())
        for camera, moved in zip(cameras, carried, strict=True)
    )


def T_map_cameras(rig: AnyRig, T_map_left: Pose) -> list[Pose]:
    """Pose in the map of every camera, for the pose of the first one."""
    return [T_map_left @ camera.T_camera_left.inverse() for camera in mounted_cameras(rig)]


def at_base(poses: Sequence[Pose], covariances: FloatArray, rig: AnyRig) -> tuple[list[Pose], FloatArray]:
    """Poses and covariances of the first camera, moved to the robot's base if the rig has one."""
    T = rig.T_base_left
    if T is None:
        return list(poses), covariances
    T_left_base = T.inverse()
    offsets = np.array([pose.R @ T_left_base.t for pose in poses]).reshape(-1, 3)
    return [pose @ T_left_base for pose in poses], moved_covariance(covariances, offsets)
