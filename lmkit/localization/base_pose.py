"""The estimate of the left camera's pose, with the robot's base that the rig names."""

from __future__ import annotations

from dataclasses import replace

from lmkit.geometry.rig import AnyRig
from lmkit.model.estimate import PoseEstimate


def with_base(estimate: PoseEstimate, rig: AnyRig) -> PoseEstimate:
    """The estimate with the rig's T_camera_base; unchanged where the rig has no base."""
    if rig.T_base_left is None:
        return estimate
    return replace(estimate, T_camera_base=rig.T_base_left.inverse())
