"""The answer of `locate`: a pose, how sure it is, and what else it might have been."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.geometry.pose import Pose
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.pose_status import PoseStatus


@dataclass(frozen=True, eq=False, repr=False)
class PoseEstimate:
    """Estimated pose of the camera in the map.

    Attributes:
        status: what the pose is worth.
        T_map_camera: pose of the left (or only) camera; None unless the status is ok, ambiguous or imprecise.
        covariance: (6,6) x y z (m), then rotation about x y z (rad), in the map frame.
        inliers: landmarks that the pose explains.
        outliers: landmarks of the map that were read and that the pose does not explain, or that are in one image
            more than once.
        alternatives: other poses, best first, each with its log likelihood ratio to the answer.
        reprojection_error_px: root mean square over the corners of the inliers, both images.
        T_map_base, covariance_base: the pose of the robot's base, where the rig was given; the left camera's where
            the rig has no base.
    """

    status: PoseStatus
    T_map_camera: Pose | None = None
    covariance: FloatArray | None = None
    inliers: tuple[LandmarkId, ...] = ()
    outliers: tuple[LandmarkId, ...] = ()
    alternatives: tuple[tuple[Pose, float], ...] = ()
    reprojection_error_px: float | None = None
    T_map_base: Pose | None = None
    covariance_base: FloatArray | None = None

    @property
    def sigma_m(self) -> float | None:
        """Standard deviation of the position, metres: root of the sum of its three variances."""
        C = self.covariance if self.covariance_base is None else self.covariance_base
        return None if C is None else float(np.sqrt(np.trace(C[:3, :3])))

    def __repr__(self) -> str:
        pose = self.T_map_camera if self.T_map_base is None else self.T_map_base
        if pose is None or self.sigma_m is None:
            return f"PoseEstimate({self.status})"
        x, y, z = pose.t
        return f"PoseEstimate({self.status}, x {x:.3f} y {y:.3f} z {z:.3f} m, sigma {1000 * self.sigma_m:.1f} mm)"
