"""Poses of a rig in many frames at once, by the rules of `locate_rig` (`absolute_pose.py`)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lmkit.arrays import BoolArray, FloatArray, IntArray
from lmkit.geometry.pose import Pose
from lmkit.geometry.pose_array import PoseArray
from lmkit.geometry.rotations import orthonormal
from lmkit.kernels.frame_search import FoundPoses, search_frames
from lmkit.kernels.reprojection import Corners
from lmkit.localization.absolute_pose import LocateOptions, listed_poses, pose_search


@dataclass(frozen=True, eq=False)
class FramePoses:
    """The likeliest poses of F frames.

    Attributes:
        found: these poses.
        is_sure: (F,) whether the status of `locate_rig` is ``ok``.
        explains_all: (F,) whether the likeliest pose explains all observations.
        needs_retry: (F,) whether some cameras may contradict the others: `locate_rig` tries without them.
    """

    found: FoundPoses
    is_sure: BoolArray
    explains_all: BoolArray
    needs_retry: BoolArray

    def pose(self, frame: int) -> Pose:
        """T_map_left of a frame, the likeliest."""
        return Pose("map", "left", orthonormal(self.found.R[frame, 0]), self.found.p[frame, 0])

    def possible(self, frame: int) -> PoseArray:
        """T_map_left of a frame, the likeliest first, then its alternatives."""
        cost = self.found.cost[frame, : self.found.count[frame]].tolist()
        rows = [0, *listed_poses([one - cost[0] for one in cost])] if cost else []
        return PoseArray("map", "left", self.found.R[frame, rows], self.found.p[frame, rows])


def locate_frames(
    corners: Corners, starts: IntArray, of: IntArray, camera: IntArray, side_px: FloatArray, options: LocateOptions
) -> FramePoses:
    """Poses of all frames, each on its own and without a prior.

    Args:
        corners: S observations of certain landmarks, frame after frame; an image has a landmark at most once.
        starts: (F+1,) first observation of every frame, and S.
        of, camera, side_px: (S,) number of its landmark and camera, and side in the image.
    """
    search = pose_search(options.outlier_sigma, options.gate_share)
    found = search_frames(corners, starts, of, side_px, search)
    frame = np.repeat(np.arange(len(found.count)), np.diff(starts))
    inliers = found.chi2 < search.limit
    landmarks, explained = _distinct(frame, of, inliers, len(found.count))
    cameras, believed = _distinct(frame, camera, inliers, len(found.count))
    consistent = (found.count > 0) & (believed == cameras)
    consistent &= (2 * explained >= landmarks) & ((landmarks < 2) | (explained >= 2))
    reach = math.sqrt(2 * options.ambiguous_below)
    near = _widest(found.covariance[:, :3, :3]) <= options.far_m / reach
    near &= _widest(found.covariance[:, 3:, 3:]) <= options.far_rad / reach
    clear = ~(found.cost[:, 1] < found.cost[:, 0] + options.ambiguous_below)
    all_explained = np.bincount(frame[~inliers], minlength=len(found.count)) == 0
    return FramePoses(found, consistent & near & clear, all_explained, ~consistent & (cameras > 2))


def _distinct(frame: IntArray, of: IntArray, inliers: BoolArray, frames: int) -> tuple[IntArray, IntArray]:
    """(F,) how many different numbers each frame has, and how many of them have inliers."""
    wide = int(of.max(initial=0)) + 1
    pairs, place = np.unique(frame * wide + of, return_inverse=True)
    with_inliers = np.bincount(place.ravel(), inliers, len(pairs)) > 0
    return np.bincount(pairs // wide, minlength=frames), np.bincount(pairs[with_inliers] // wide, minlength=frames)


def _widest(covariance: FloatArray) -> FloatArray:
    """(F,) standard deviations along the direction known least of (F,3,3); infinite where they are NaN."""
    known = np.isfinite(covariance).all(axis=(1, 2))
    wide = np.full(len(covariance), np.inf)
    wide[known] = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance[known])[:, -1], 0.0))
    return wide
