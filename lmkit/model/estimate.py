"""The result of `locate`: a pose, its covariance, and alternative poses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.errors import InputError
from lmkit.geometry.pose import Pose
from lmkit.geometry.pose_array import moved_covariance
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.pose_status import PoseStatus


@dataclass(frozen=True, eq=False, repr=False)
class PoseEstimate:
    """Estimated pose of the camera in the map.

    Attributes:
        status: whether the pose is unique and accurate (:class:`PoseStatus`).
        T_map_camera: pose of the left (or only) camera; None unless the status is ok, ambiguous or imprecise.
        covariance: (6,6) x y z (m), then rotation about x y z (rad), in the map frame.
        inliers: landmarks that the pose explains.
        outliers: landmarks of the map that were read but contradict the pose, or that appear in one image
            more than once.
        alternatives: other poses, best first, each with its log likelihood ratio to the answer.
        reprojection_error_px: root mean square over the corners of the inliers, all images.
        T_camera_base: the robot's base in the left camera's frame; None where the rig has no base.
        warnings: why landmarks contradict the map, where a cause is recognized (`localization/contradiction.py`).
        outlier_cameras: names of the cameras that contradict the majority; the pose leaves their detections out.
    """

    status: PoseStatus
    T_map_camera: Pose | None = None
    covariance: FloatArray | None = None
    inliers: tuple[LandmarkId, ...] = ()
    outliers: tuple[LandmarkId, ...] = ()
    alternatives: tuple[tuple[Pose, float], ...] = ()
    reprojection_error_px: float | None = None
    T_camera_base: Pose | None = None
    warnings: tuple[str, ...] = ()
    outlier_cameras: tuple[str, ...] = ()

    @property
    def T_map_base(self) -> Pose | None:
        """Pose of the robot's base in the map; of the left camera, where the rig has no base."""
        return None if self.T_map_camera is None else self._at_base(self.T_map_camera)

    @property
    def covariance_base(self) -> FloatArray | None:
        """(6,6) covariance of T_map_base, in the order of ``covariance``."""
        return self.covariance if self.T_camera_base is None else self.covariance_at(self.T_camera_base)

    @property
    def sigma_m(self) -> float | None:
        """Standard deviation of the base's position, meters: root of the sum of its three variances."""
        C = self.covariance_base
        return None if C is None else float(np.sqrt(np.trace(C[:3, :3])))

    def covariance_at(self, T_camera_point: Pose) -> FloatArray | None:
        """(6,6) covariance of another frame that is fixed to the camera; None without a pose."""
        if self.T_map_camera is None or self.covariance is None:
            return None
        return moved_covariance(self.covariance, self.T_map_camera.R @ T_camera_point.t)

    def to_dict(self, frame: str = "base") -> dict[str, Any]:
        """The estimate as JSON values; docs/formats.md lists the keys.

        Args:
            frame: ``base`` or ``camera``: whose pose is given.

        Raises:
            InputError: another frame.
        """
        if frame not in ("base", "camera"):
            raise InputError("bad_frame", f"frame {frame!r} is unknown", "choose base or camera")
        at_base = frame == "base"
        pose = self.T_map_base if at_base else self.T_map_camera
        covariance = self.covariance_base if at_base else self.covariance
        others = [(self._at_base(other) if at_base else other, ratio) for other, ratio in self.alternatives]
        return {
            "status": str(self.status),
            "position": None if pose is None else pose.t.tolist(),
            "quaternion": None if pose is None else pose.quaternion_xyzw.tolist(),
            "covariance": None if pose is None or covariance is None else covariance.tolist(),
            "codes": [i.code for i in self.inliers],
            "ids": [str(i) for i in self.inliers],
            "outlier_codes": [i.code for i in self.outliers],
            "outlier_ids": [str(i) for i in self.outliers],
            "alternatives": [
                {
                    "position": other.t.tolist(),
                    "quaternion": other.quaternion_xyzw.tolist(),
                    "log_likelihood_ratio": ratio,
                }
                for other, ratio in others
            ],
            "reprojection_error_px": self.reprojection_error_px,
            "warnings": list(self.warnings),
            "outlier_cameras": list(self.outlier_cameras),
        }

    def _at_base(self, T_map_camera: Pose) -> Pose:
        return T_map_camera if self.T_camera_base is None else T_map_camera @ self.T_camera_base

    def __repr__(self) -> str:
        pose = self.T_map_base
        if pose is None or self.sigma_m is None:
            return f"PoseEstimate({self.status})"
        x, y, z = pose.t
        return f"PoseEstimate({self.status}, x {x:.3f} y {y:.3f} z {z:.3f} m, sigma {1000 * self.sigma_m:.1f} mm)"
