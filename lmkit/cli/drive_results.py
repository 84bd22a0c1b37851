"""What `lmkit survey` and `lmkit track` write alike: trajectories and plans."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lmkit.model.stereo_rig import StereoRig
    from lmkit.survey.bundle import Bundle

MOST_DRAWN = 60  # poses of a plan


def trajectory_text(bundle: Bundle, rig: StereoRig) -> str:
    """TUM lines of the robot's base where the rig names one, else of the left camera."""
    from lmkit.formats.trajectory import poses_to_tum
    from lmkit.model.pose import Pose, orthonormal

    poses = []
    for time_s, R, p in zip(bundle.times_s, bundle.poses.R, bundle.poses.p, strict=True):
        pose = Pose("map", "left", orthonormal(R), p)
        poses.append((float(time_s), pose if rig.T_base_left is None else pose @ rig.T_base_left.inverse()))
    return poses_to_tum(poses)


def draw_drive(bundle: Bundle, kind: str) -> bytes:
    """Map and poses from above."""
    from lmkit.errors import InputError
    from lmkit.model.pose import Pose, orthonormal
    from lmkit.room_plan import Found, draw_plan

    if kind not in ("png", "svg"):
        raise InputError("bad_suffix", f"cannot write a plan of kind {kind!r}", "name it .png or .svg")
    step = 1 + len(bundle.times_s) // MOST_DRAWN
    found = [
        Found(
            f"{bundle.times_s[k]:.1f} s",
            Pose("map", "camera", orthonormal(bundle.poses.R[k]), bundle.poses.p[k]),
            bundle.covariances[k][:2, :2],
        )
        for k in range(0, len(bundle.times_s), step)
    ]
    return draw_plan(bundle.landmarks, found, kind=kind)
