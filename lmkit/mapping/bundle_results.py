"""Results of a bundle adjustment."""

from __future__ import annotations

from dataclasses import dataclass

from lmkit.arrays import FloatArray, IntArray
from lmkit.geometry.pose import Pose
from lmkit.geometry.pose_array import PoseArray
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap


@dataclass(frozen=True, eq=False)
class Bundle:
    """A solved recording.

    Attributes:
        times_s: (N,).
        poses: of the left camera in the map, with (N,6,6) covariances.
        landmarks: with their covariances.
        joint: (6L,6L) covariance of all landmarks, in their order: their errors are correlated.
        parameters: (P,) errors of the odometry, named by its `names`; empty without odometry.
        parameter_sigmas: (P,) their standard deviations.
        residuals: (S,) root mean square of each observation's eight standardized corner coordinates.
        ids: (L) of the landmarks.
        of, frames: (S,) of the observations: index into ``ids``, and frame.
        rms_px: of the corners of inliers.
        jumps: (from_s, to_s, meters) of motions that contradict the odometry, or are too fast.
    """

    times_s: FloatArray
    poses: PoseArray
    covariances: FloatArray
    landmarks: LandmarkMap
    joint: FloatArray
    parameters: FloatArray
    parameter_sigmas: FloatArray
    residuals: FloatArray
    ids: tuple[LandmarkId, ...]
    of: IntArray
    frames: IntArray
    rms_px: float
    jumps: tuple[tuple[float, float, float], ...]

    def left_poses(self) -> list[Pose]:
        """T_map_left of every frame."""
        return [self.poses.pose(k) for k in range(len(self.poses))]
