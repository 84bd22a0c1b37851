"""Dead reckoning from located frames to others, with the uncertainty of the predicted poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lmkit.arrays import FloatArray, IntArray
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import AnyRig
from lmkit.geometry.rotations import orthonormal, rotation_angle
from lmkit.odometry.motion_model import Motion

# Error of odometry: a constant, and a share of the distance; a frame located farther off saw a landmark that is
# mounted twice, was moved or misread.
STRAY_M, STRAY_RAD, STRAY_SHARE = 0.3, 0.15, 0.1


@dataclass(frozen=True, eq=False)
class ReckonedPose:
    """A pose by dead reckoning, and the distance traveled to it (rotations count, too)."""

    pose: Pose
    way_m: float

    def allows(self, pose: Pose) -> bool:
        """Whether a pose agrees with dead reckoning, within its error."""
        stray = STRAY_SHARE * self.way_m
        turned = rotation_angle(pose.R.T @ self.pose.R)
        return bool(np.linalg.norm(pose.t - self.pose.t) < STRAY_M + stray and turned < STRAY_RAD + stray)


@dataclass(frozen=True, eq=False)
class OdometryPath:
    """Path of the left camera from odometry alone.

    Attributes:
        R, t: (N,3,3), (N,3) T_left(0)_left(k).
        way_m: (N,) distance traveled up to each frame, including rotations.
        stretch: (N,) number of odometry gaps before it.
    """

    R: FloatArray
    t: FloatArray
    way_m: FloatArray
    stretch: IntArray

    @classmethod
    def of(cls, times_s: FloatArray, rig: AnyRig, motion: Motion) -> OdometryPath:
        """Between frames (N,) of a recording."""
        steps = motion.steps(times_s, motion.nominal)
        R, t = np.repeat(np.eye(3)[None], len(times_s), axis=0), np.zeros((len(times_s), 3))
        turned, moved = steps.of_camera(rig.T_base_left or Pose.identity("base", "left"))
        for k in range(len(moved)):
            R[k + 1], t[k + 1] = R[k] @ turned[k], t[k] + R[k] @ moved[k]
        angles = np.arccos(np.clip((np.einsum("nii->n", steps.R) - 1) / 2, -1, 1))
        way = np.where(steps.known, np.linalg.norm(steps.t, axis=1) + angles, 0.0)
        return cls(R, t, np.append(0.0, np.cumsum(way)), np.append(0, np.cumsum(~steps.known)))

    def reckon(self, pose: Pose, at: int, to: int) -> ReckonedPose | None:
        """Dead reckoning from the pose of one frame to another; None over a gap."""
        if self.stretch[at] != self.stretch[to]:
            return None
        back = pose.R @ self.R[at].T
        T = Pose("map", "left", orthonormal(back @ self.R[to]), pose.t + back @ (self.t[to] - self.t[at]))
        return ReckonedPose(T, abs(float(self.way_m[to] - self.way_m[at])))


class ReckonedPoses:
    """Dead reckoning for every frame without a pose, from the nearest one that has a pose.

    Args:
        poses: (N) of the frames, as they are now.
        path: None without odometry: no dead reckoning.

    Attributes:
        way_m: (N,) distance of the dead reckoning; infinite without.
    """

    def __init__(self, poses: Sequence[Pose | None], path: OdometryPath | None) -> None:
        self._poses, self._path = list(poses), path
        self._nearest: IntArray = np.full(len(poses), -1)
        self.way_m = np.full(len(poses), np.inf)
        known = np.flatnonzero([pose is not None for pose in poses])
        if path is None or len(known) == 0:
            return
        rows = np.arange(len(poses))
        after = np.searchsorted(known, rows)
        distances = []
        sides = np.array([known[np.clip(after - 1, 0, None)], known[np.clip(after, None, len(known) - 1)]])
        for side in sides:
            way = np.abs(path.way_m - path.way_m[side])
            distances.append(np.where(path.stretch == path.stretch[side], way, np.inf))
        self.way_m = np.min(distances, axis=0)
        self.way_m[known] = np.inf
        self._nearest = np.where(np.isfinite(self.way_m), sides[np.argmin(distances, axis=0), rows], -1)

    def __getitem__(self, k: int) -> ReckonedPose | None:
        at = int(self._nearest[k])
        pose = self._poses[at] if at >= 0 else None
        return None if pose is None or self._path is None else self._path.reckon(pose, at, k)
