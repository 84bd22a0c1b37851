"""Initial pose of one landmark, from frames with known poses.

One view of one landmark allows two poses.  All candidates from its largest views are evaluated on all these views,
and the landmark is placed when one candidate explains them clearly better than the others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from lmkit.arrays import FloatArray, IntArray
from lmkit.errors import InputError
from lmkit.geometry.pose import Pose
from lmkit.geometry.pose_array import PoseArray
from lmkit.geometry.rig import AnyRig, mounted_cameras
from lmkit.geometry.rotations import rotation_angle
from lmkit.kernels.landmark_bundle import Bundle, bundle_chi2
from lmkit.localization.absolute_pose import possible_poses
from lmkit.localization.reprojection import through_lenses
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.model.observation import Detection
from lmkit.model.recording import RigFrame
from lmkit.odometry.dead_reckoning import ReckonedPoses

VIEWS = 8  # of a landmark that place it, the largest
CANDIDATE_VIEWS = 4  # of those, that give candidates
SURE_RATIO = 10.0  # log likelihood ratio of a landmark's best candidate to another one
CAP = 8 * 4.5**2  # of a view's chi2
LOCATED_PX, CARRIED_PX = 0.5, 12.0  # corner error due to the pose of the frame, located or from dead reckoning
CARRY_M = 6.0  # dead reckoning is used up to this distance
SAME_M, SAME_RAD = 0.3, 0.35

View = tuple[tuple[Detection, ...], ...]
At = list[tuple[int, Pose, float]]  # frame, T_map_left, and corner error due to that pose


class Placing:
    """The views of a recording's landmarks, and the candidate poses of each view.

    Args:
        sizes_m: printed sizes of the landmarks to place.
    """

    def __init__(self, frames: Sequence[RigFrame], rig: AnyRig, sizes_m: Mapping[LandmarkId, float]) -> None:
        self._frames, self._rig, self._sizes_m = frames, rig, sizes_m
        self.views = _views(frames)
        self.wanted = {key for key in self.views if key in sizes_m}
        # For a frame and a landmark: candidate camera poses in the landmark's frame.
        self._seen_from: dict[tuple[int, LandmarkId], list[Pose]] = {}
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
        """Pose on which its views agree best; None if another pose is as good, or too few views agree.

        Args:
            poses, carried: of the frames, located and from dead reckoning.
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
        """The largest views from located frames, and some from frames near these."""
        views = self.views[key]
        located = [(k, pose, LOCATED_PX) for _, k in views if (pose := poses[k]) is not None][:VIEWS]
        room = VIEWS - len(located) // 2
        near = [k for _, k in views if reckoned.way_m[k] < CARRY_M][:room]
        return located + [(k, c.pose, CARRIED_PX) for k in near if (c := reckoned[k]) is not None]

    def _cameras(self, k: int, key: LandmarkId) -> list[Pose]:
        """T_camera_landmark as that view allows."""
        if (k, key) not in self._seen_from:
            self._seen_from[k, key] = possible_poses(_only(self._frames[k], key), self._rig, self._alone(key))
        return self._seen_from[k, key]

    def _arms(self, key: LandmarkId) -> FloatArray:
        """(4,3) corners in the landmark's own frame, meters."""
        return next(iter(self._alone(key))).corners_map

    def _alone(self, key: LandmarkId) -> LandmarkMap:
        if key not in self._maps:
            mapped = MappedLandmark(key, self._sizes_m[key], Pose.identity("map", "landmark"))
            self._maps[key] = LandmarkMap([mapped])
        return self._maps[key]

    def _chi2(self, candidates: Sequence[Pose], key: LandmarkId, at: At) -> FloatArray:
        """(C,V) chi2 of candidates and views, each at most the cap."""
        chi2 = np.full((len(candidates), len(at)), CAP)
        for floor_px in {floor for _, _, floor in at}:
            columns = np.array([column for column, (_, _, floor) in enumerate(at) if floor == floor_px])
            of, squared = self._squared_errors(candidates, key, [at[c] for c in columns.tolist()], floor_px)
            counts = np.bincount(of, minlength=len(columns))
            sums = np.zeros((len(columns), len(candidates)))
            np.add.at(sums, of, squared.T)
            seen = counts > 0
            chi2[:, columns[seen]] = np.minimum(CAP, (sums[seen] / counts[seen, None]).T)
        return chi2

    def _squared_errors(
        self, candidates: Sequence[Pose], key: LandmarkId, at: At, floor_px: float
    ) -> tuple[IntArray, FloatArray]:
        """(S,) view of every observation of the landmark, and (C,S) its chi2 with the landmark at each candidate."""
        listed: list[Detection] = []
        rows: list[tuple[int, int]] = []
        cameras = mounted_cameras(self._rig)
        for which in range(len(cameras)):
            for column, (k, _, _) in enumerate(at):
                same = [o for o in self._frames[k].seen[which] if o.id == key]
                if len(same) == 1:  # if one image has two, it is unknown which is the mapped one
                    listed += same
                    rows.append((column, which))
        numbers = np.array(rows, dtype=np.int64).reshape(-1, 2)
        counts = np.bincount(numbers[:, 1], minlength=len(cameras)).tolist()
        looked = through_lenses(listed, [camera.model for camera in cameras], counts, floor_px)
        view, mount = np.ascontiguousarray(numbers[looked.kept].T)
        # In the landmark's frame, each candidate gives other camera poses.
        T = PoseArray.from_poses("map", "landmark", candidates).inverse()
        rigs = PoseArray.from_poses("map", "left", [pose for _, pose, _ in at])
        R = T.R[:, None] @ rigs.R
        p = T.t[:, None] + (T.R[:, None] @ rigs.t[..., None])[..., 0]
        count, each = len(candidates), len(view)
        poses = (len(at) * np.arange(count)[:, None] + view).ravel()
        bundle = Bundle(
            poses,
            np.zeros(count * each, dtype=np.int64),
            np.tile(mount, count),
            np.tile(looked.rays, (count, 1, 1)),
            np.tile(looked.by_ray, (count, 1, 1, 1)),
            np.tile(looked.whitener, (count, 1, 1)),
            np.array([camera.T_camera_left.R for camera in cameras]),
            np.array([camera.T_camera_left.t for camera in cameras]),
            R.reshape(-1, 3, 3),
            p.reshape(-1, 3),
            np.eye(3)[None],
            np.zeros((1, 3)),
            self._arms(key)[None],
        )
        return view, bundle_chi2(bundle)[0].reshape(count, each)


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
