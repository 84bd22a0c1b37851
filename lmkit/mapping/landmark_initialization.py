"""Initial pose of one landmark, from frames with known poses.

One view of one landmark allows two poses: all candidates from its largest views are judged on all of them, and the
landmark is placed once one of them explains what the others cannot.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.errors import InputError
from lmkit.geometry.pose import Pose
from lmkit.geometry.pose_array import PoseArray
from lmkit.geometry.rig import AnyRig
from lmkit.geometry.rotations import rotation_angle
from lmkit.localization.absolute_pose import locate_rig
from lmkit.localization.correspondences import Correspondences
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.model.observation import Detection
from lmkit.model.recording import RigFrame
from lmkit.odometry.dead_reckoning import ReckonedPoses

VIEWS = 8  # of a landmark that place it, the largest
CANDIDATE_VIEWS = 4  # of those, that say where it may be mounted
SURE_RATIO = 10.0  # log likelihood ratio of a landmark's best candidate to another one
CAP = 8 * 4.5**2  # of a view's chi2
LOCATED_PX, CARRIED_PX = 0.5, 12.0  # what a corner may be off, seen from where the rig was located or carried to
CARRY_M = 6.0  # odometry is believed that far
SAME_M, SAME_RAD = 0.3, 0.35

View = tuple[tuple[Detection, ...], ...]
At = list[tuple[int, Pose, float]]  # frame, T_map_left, and what a corner may be off


class Placing:
    """The views of a recording's landmarks, and what each of them allows.

    Args:
        sizes_m: printed sizes of those that are to be placed.
    """

    def __init__(self, frames: Sequence[RigFrame], rig: AnyRig, sizes_m: Mapping[LandmarkId, float]) -> None:
        self._frames, self._rig, self._sizes_m = frames, rig, sizes_m
        self.views = _views(frames)
        self.wanted = {key for key in self.views if key in sizes_m}
        # Of a frame and a landmark: where the camera may be in the landmark's frame.
        self._seen_from: dict[tuple[int, LandmarkId], list[Pose]] = {}
        self._looked: dict[tuple[int, LandmarkId, float], Correspondences] = {}
        self._maps: dict[LandmarkId, LandmarkMap] = {}  # of one landmark each, at the origin

    def best_seen(self) -> LandmarkId:
        """The landmark to place that is observed best.

        Raises:
            InputError: none is seen.
        """
        if not self.wanted:
            raise InputError(
                "nothing_seen", "no landmark is seen in the recording", "check the images with lmkit detect"
            )
        return max(self.wanted, key=lambda key: sum(side for side, _ in self.views[key][:VIEWS]))

    def place(
        self, key: LandmarkId, poses: Sequence[Pose | None], reckoned: ReckonedPoses, least: int
    ) -> MappedLandmark | None:
        """Pose on which its views agree best; None while a different one does as well, or too few agree.

        Args:
            poses, carried: of the frames, located and carried on.
            least: frames that must agree.
        """
        at = self._known_views(key, poses, reckoned)
        if len(at) < least:
            return None
        candidates = [
            Pose("map", "landmark", camera.R @ T.R.T, camera.t - camera.R @ T.R.T @ T.t)
            for k, camera, _ in at[:CANDIDATE_VIEWS]
            for T in self._cameras(k, key)
        ]
        if not candidates:
            return None
        chi2 = self._chi2(candidates, key, at)
        costs = chi2.sum(axis=1) / 2
        best = int(np.argmin(costs))
        agree = int((chi2[best] < CAP).sum())
        if agree < least or 2 * agree < len(at):
            return None
        others = [costs[k] - costs[best] for k, T in enumerate(candidates) if not _same(T, candidates[best])]
        if others and min(others) < SURE_RATIO and least > 1:
            return None
        return MappedLandmark(key, self._sizes_m[key], candidates[best])

    def _known_views(self, key: LandmarkId, poses: Sequence[Pose | None], reckoned: ReckonedPoses) -> At:
        """The largest views from frames that were located, and some from frames not far from those."""
        views = self.views[key]
        located = [(k, pose, LOCATED_PX) for _, k in views if (pose := poses[k]) is not None][:VIEWS]
        room = VIEWS - len(located) // 2
        near = [k for _, k in views if reckoned.way_m[k] < CARRY_M][:room]
        return located + [(k, c.pose, CARRIED_PX) for k in near if (c := reckoned[k]) is not None]

    def _cameras(self, k: int, key: LandmarkId) -> list[Pose]:
        """T_camera_landmark as that view allows."""
        if (k, key) not in self._seen_from:
            estimate = locate_rig(_only(self._frames[k], key), self._rig, self._alone(key))
            likeliest = [] if estimate.T_map_camera is None else [estimate.T_map_camera]
            self._seen_from[k, key] = [*likeliest, *(pose for pose, _ in estimate.alternatives)]
        return self._seen_from[k, key]

    def _correspondences(self, k: int, key: LandmarkId, floor_px: float) -> Correspondences:
        """Possible camera poses of one frame in the landmark's frame."""
        if (k, key, floor_px) not in self._looked:
            self._looked[k, key, floor_px] = Correspondences.of_rig(
                _only(self._frames[k], key), self._rig, self._alone(key), floor_px
            )
        return self._looked[k, key, floor_px]

    def _alone(self, key: LandmarkId) -> LandmarkMap:
        if key not in self._maps:
            mapped = MappedLandmark(key, self._sizes_m[key], Pose.identity("map", "landmark"))
            self._maps[key] = LandmarkMap([mapped])
        return self._maps[key]

    def _chi2(self, candidates: Sequence[Pose], key: LandmarkId, at: At) -> FloatArray:
        """(C,V) chi2 of candidates and views, each at most the cap."""
        # Seen from the landmark, a candidate puts each view's camera somewhere else.
        T_landmark_map = PoseArray.from_poses("map", "landmark", candidates).inverse()
        chi2 = np.full((len(candidates), len(at)), CAP)
        for column, (k, pose, floor_px) in enumerate(at):
            seen = self._correspondences(k, key, floor_px)
            if len(seen):
                chi2[:, column] = np.minimum(CAP, seen.chi2(T_landmark_map @ pose).mean(axis=1))
        return chi2


def _views(frames: Sequence[RigFrame]) -> dict[LandmarkId, list[tuple[float, int]]]:
    """Views of every landmark: (side in px, frame), the largest first."""
    views: dict[LandmarkId, dict[int, float]] = {}
    seen = [(k, o) for k, frame in enumerate(frames) for o in frame.detections]
    if seen:
        corners = np.array([o.corners for _, o in seen])
        sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean(axis=1).tolist()
        for (k, o), side in zip(seen, sides, strict=True):
            at = views.setdefault(o.id, {})
            at[k] = max(at.get(k, 0.0), side)
    return {key: sorted(((side, k) for k, side in at.items()), reverse=True) for key, at in views.items()}


def _only(frame: RigFrame, key: LandmarkId) -> View:
    return tuple(tuple(o for o in camera if o.id == key) for camera in frame.seen)


def _same(a: Pose, b: Pose) -> bool:
    return bool(np.linalg.norm(a.t - b.t) < SAME_M and rotation_angle(a.R.T @ b.R) < SAME_RAD)
