"""The estimate of the left camera's pose, with the pose of the robot's base that follows from it."""

from __future__ import annotations

from dataclasses import replace

from lmkit.geometry.pose import Pose
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.localization.absolute_pose import covariance_at_base
from lmkit.model.estimate import PoseEstimate


def with_base(estimate: PoseEstimate, rig: StereoRig) -> PoseEstimate:
    """The estimate with T_map_base and its covariance; unchanged without a pose.

    A rig without T_base_left is its own base: the base frame is then the left camera's.
    """
    if estimate.T_map_camera is None:
        return estimate
    T = Pose.identity("base", "left") if rig.T_base_left is None else rig.T_base_left
    T_camera_base = Pose("camera", "base", T.inverse().R, T.inverse().t)
    return replace(
        estimate,
        T_map_base=estimate.T_map_camera @ T_camera_base,
        covariance_base=covariance_at_base(estimate, T_camera_base),
    )
