"""Odometry carries the rig from moments where it is known to others, and says which poses it allows there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.model.pose import Pose, orthonormal, rotation_angle
from lmkit.model.stereo_rig import StereoRig
from lmkit.motion import Motion

# Odometry strays by so much, and by that share of the way; a moment located farther off saw a landmark that hangs
# twice, was moved or misread.
STRAY_M, STRAY_RAD, STRAY_SHARE = 0.3, 0.15, 0.1


@dataclass(frozen=True, eq=False)
class Carried:
    """A pose carried on by odometry, over so much of a way (turns count, too)."""

    pose: Pose
    way_m: float

    def allows(self, pose: Pose) -> bool:
        """May the rig be there?"""
        stray = STRAY_SHARE * self.way_m
        turned = rotation_angle(pose.R.T @ self.pose.R)
        return bool(np.linalg.norm(pose.t - self.pose.t) < STRAY_M + stray and turned < STRAY_RAD + stray)


@dataclass(frozen=True, eq=False)
class CarrySteps:
    """(N-1,3,3), (N-1,3) T_left(k)_left(k + 1), and (N-1,) the way, infinite where nothing is known."""

    R: FloatArray
    t: FloatArray
    way_m: FloatArray

    @classmethod
    def of(cls, times_s: FloatArray, rig: StereoRig, motion: Motion | None) -> CarrySteps | None:
        """As the left eye moves; None without odometry."""
        if motion is None or len(times_s) < 2:
            return None
        steps = motion.steps(times_s, motion.nominal)
        R, t = steps.of_camera(rig.T_base_left or Pose.identity("base", "left"))
        turned = np.arccos(np.clip((np.einsum("nii->n", steps.R) - 1) / 2, -1, 1))
        return cls(R, t, np.where(steps.known, np.linalg.norm(steps.t, axis=1) + turned, np.inf))

    def step(self, at: Carried, k: int, onwards: bool) -> Carried:
        """From moment k to the next, or from there back to moment k."""
        way = at.way_m + float(self.way_m[k])
        if onwards:
            R, t = at.pose.R @ self.R[k], at.pose.t + at.pose.R @ self.t[k]
        else:
            R = at.pose.R @ self.R[k].T
            t = at.pose.t - R @ self.t[k]
        return Carried(Pose("map", "camera", orthonormal(R), t), way)


def carried_poses(poses: Sequence[Pose | None], steps: CarrySteps | None) -> list[Carried | None]:
    """Where moments without a pose are, carried on from the nearest that has one; None for those that have."""
    count = len(poses)
    found: list[Carried | None] = [None] * count
    if steps is None:
        return found
    for onwards in (True, False):
        at: Carried | None = None
        for k in range(count) if onwards else range(count - 1, -1, -1):
            pose = poses[k]
            if pose is not None:
                at = Carried(pose, 0.0)
                continue
            if at is None:
                continue
            at = steps.step(at, k - 1 if onwards else k, onwards)
            before = found[k]
            if np.isfinite(at.way_m) and (before is None or at.way_m < before.way_m):
                found[k] = at
    return found
