"""The answer of `locate`: a pose, how sure it is, and what else it might have been."""

from __future__ import annotations

from dataclasses import dataclass

from lmkit.arrays import FloatArray
from lmkit.geometry.pose import Pose


@dataclass(frozen=True, eq=False)
class PoseEstimate:
    """Where the camera stands in the map.

    Attributes:
        status: ``ok``; ``ambiguous`` (a second pose explains the pictures almost as well, or one
            half a metre away that the covariance holds);
            ``no_landmarks`` (none of the map's landmarks was read); ``inconsistent`` (landmarks
            were read, but no pose explains them); ``exchanged`` (they fit with the two pictures exchanged).
        T_map_camera: pose of the left (or only) camera; None unless ok or ambiguous.
        covariance: (6,6) x y z (m), then rotation about x y z (rad), in the map frame.
        inlier_codes: codes that the pose explains.
        outlier_codes: codes read and mapped that it does not, or that are in one picture more than once.
        alternatives: other poses, best first, each with its log likelihood ratio to the answer.
        reprojection_error_px: root mean square over the corners of the inliers, both pictures.
    """

    status: str
    T_map_camera: Pose | None = None
    covariance: FloatArray | None = None
    inlier_codes: tuple[int, ...] = ()
    outlier_codes: tuple[int, ...] = ()
    alternatives: tuple[tuple[Pose, float], ...] = ()
    reprojection_error_px: float | None = None
