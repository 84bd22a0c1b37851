"""Initial pose of one landmark, from frames with known poses.

One view of one landmark allows two poses.  All candidates from its largest views are evaluated on all these views,
and the landmark is placed when one candidate explains them clearly better than the others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from lmkit.arrays import FloatArray, IntArray
from lmkit.errors import InputError
from lmkit.geometry.pose import Pose
from lmkit.geometry.pose_array import PoseArray
from lmkit.geometry.rig import AnyRig, mounted_cameras
from lmkit.geometry.rotations import rotation_log
from lmkit.kernels.landmark_bundle import Bundle, bundle_chi2
from lmkit.localization.absolute_pose import LocateOptions, possible_poses
from lmkit.localization.many_frames import locate_frames
from lmkit.localization.reprojection import through_lenses
from lmkit.mapping.recorded_observations import RecordedObservations
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
AT_ONCE = 100  # landmarks of one call: its tables have a number for each candidate and view

At = list[tuple[int, Pose, float]]  # frame, T_map_left, and corner error due to that pose


@dataclass(frozen=True, eq=False)
class _Candidates:
    """Candidates T_map_landmark of one landmark, and the views on which they are evaluated."""

    key: LandmarkId
    poses: PoseArray
    at: At


class Placing:
    """The views of a recording's landmarks, and the candidate poses of each view.

    Args:
        sizes_m: printed sizes of the landmarks to place.
    """

    def __init__(
        self,
        frames: Sequence[RigFrame],
        rig: AnyRig,
        sizes_m: Mapping[LandmarkId, float],
        recorded: RecordedObservations,
    ) -> None:
        self._frames, self._rig, self._sizes_m, self._recorded = frames, rig, sizes_m, recorded
        self.views = recorded.largest_views()
        self.wanted = {key for key in recorded.ids if key in sizes_m}
        # For a frame and a landmark: candidates T_left_landmark.
        self._seen_from: dict[tuple[int, LandmarkId], PoseArray] = {}
        self._maps: dict[LandmarkId, LandmarkMap] = {}  # of one landmark each, at the origin

    def best_seen(self) -> LandmarkId:
        """The landmark to place that is observed best.

        Raises:
            InputError: none is seen.
        """
        wanted = self.wanted & self.views.keys()
        if not wanted:
            raise InputError(
                "nothing_seen", "no landmark is seen in the recording", "check the images with lmkit detect"
            )
        return max(wanted, key=lambda key: sum(side for side, _ in self.views[key][:VIEWS]))

    def place(
        self, keys: Sequence[LandmarkId], poses: Sequence[Pose | None], reckoned: ReckonedPoses, least: int
    ) -> dict[LandmarkId, MappedLandmark]:
        """Poses on which the views of a landmark agree best; without those that have another pose as good, or too
        few views that agree.

        Args:
            poses, reckoned: of the frames, located and from dead reckoning.
            least: frames that must agree.
        """
        at = {key: views for key in keys if len(views := self._known_views(key, poses, reckoned)) >= least}
        self._find_cameras([(k, key) for key, views in at.items() for k, _, _ in views[:CANDIDATE_VIEWS]])
        candidates = [
            _Candidates(key, found, views) for key, views in at.items() if (found := self._poses(key, views))
        ]
        parts = [candidates[first : first + AT_ONCE] for first in range(0, len(candidates), AT_ONCE)]
        placed = {}
        for one, chi2 in zip(candidates, chain.from_iterable(map(self._chi2, parts)), strict=True):
            best = _best(one.poses, chi2, least)
            if best is not None:
                placed[one.key] = MappedLandmark(one.key, self._sizes_m[one.key], one.poses.pose(best))
        return placed

    def _known_views(self, key: LandmarkId, poses: Sequence[Pose | None], reckoned: ReckonedPoses) -> At:
        """The largest views from located frames, and some from frames near these."""
        views = self.views.get(key, [])
        located = [(k, pose, LOCATED_PX) for _, k in views if (pose := poses[k]) is not None][:VIEWS]
        room = VIEWS - len(located) // 2
        near = [k for _, k in views if reckoned.way_m[k] < CARRY_M][:room]
        return located + [(k, c.pose, CARRIED_PX) for k in near if (c := reckoned[k]) is not None]

    def _poses(self, key: LandmarkId, at: At) -> PoseArray:
        """Candidates T_map_landmark from the first views."""
        views = [(camera, self._seen_from[k, key]) for k, camera, _ in at[:CANDIDATE_VIEWS]]
        R = np.concatenate([camera.R @ seen.R for camera, seen in views])
        t = np.concatenate([seen.t @ camera.R.T + camera.t for camera, seen in views])
        return PoseArray("map", "landmark", R, t)

    def _find_cameras(self, views: Sequence[tuple[int, LandmarkId]]) -> None:
        """Find the candidates of views (frame, landmark): the rig's poses with the landmark at the map's origin."""
        new = [view for view in dict.fromkeys(views) if view not in self._seen_from]
        recorded = self._recorded
        rows = [recorded.rows_of(*view) for view in new]
        every = _joined(rows)
        arms = {key: self._arms(key) for _, key in new}
        starts = np.cumsum([0, *map(len, rows)])
        seen, side_px = recorded.arrays, recorded.side_px[every]
        found = locate_frames(
            recorded.corners(every, arms), starts, seen.of[every], seen.camera[every], side_px, LocateOptions()
        )
        for number, (k, key) in enumerate(new):
            if found.explains_all[number]:
                poses = found.possible(number)
            else:
                each = possible_poses(_only(self._frames[k], key), self._rig, self._alone(key))
                poses = PoseArray.from_poses("map", "left", each)
            self._seen_from[k, key] = poses.inverse()

    def _arms(self, key: LandmarkId) -> FloatArray:
        """(4,3) corners in the landmark's own frame, meters."""
        return next(iter(self._alone(key))).corners_map

    def _alone(self, key: LandmarkId) -> LandmarkMap:
        if key not in self._maps:
            mapped = MappedLandmark(key, self._sizes_m[key], Pose.identity("map", "landmark"))
            self._maps[key] = LandmarkMap([mapped])
        return self._maps[key]

    def _chi2(self, candidates: Sequence[_Candidates]) -> list[FloatArray]:
        """(C,V) chi2 of each landmark's candidates and views, each at most the cap."""
        chi2 = [np.full((len(one.poses), len(one.at)), CAP) for one in candidates]
        for floor_px in (LOCATED_PX, CARRIED_PX):
            columns = [[column for column, view in enumerate(one.at) if view[2] == floor_px] for one in candidates]
            if not any(columns):
                continue
            for into, own, squared in zip(chi2, columns, self._mean_chi2(candidates, columns, floor_px), strict=True):
                into[:, own] = np.minimum(into[:, own], squared)
        return chi2

    def _mean_chi2(
        self, candidates: Sequence[_Candidates], columns: Sequence[Sequence[int]], floor_px: float
    ) -> list[FloatArray]:
        """(C,V) chi2 of each landmark's candidates and some of its views, the mean of all cameras."""
        recorded, cameras = self._recorded, mounted_cameras(self._rig)
        views = [(number, one.key, one.at[c]) for number, one in enumerate(candidates) for c in columns[number]]
        rows = [recorded.rows_of(k, key) for _, key, (k, _, _) in views]
        every, view = _joined(rows), np.repeat(np.arange(len(rows)), list(map(len, rows)))
        order = np.argsort(recorded.arrays.camera[every], kind="stable")
        every, view = every[order], view[order]
        camera = recorded.arrays.camera[every]
        looked = through_lenses(
            [recorded.detections[k] for k in every.tolist()],
            [mounted.model for mounted in cameras],
            np.bincount(camera, minlength=len(cameras)).tolist(),
            floor_px,
        )
        view, camera = view[looked.kept], camera[looked.kept]
        # Every candidate of a landmark with all observations of its views.
        number_of_pose = np.repeat(np.arange(len(candidates)), [len(one.poses) for one in candidates])
        number_of_view = np.array([number for number, _, _ in views], dtype=np.int64)
        pose, row = np.nonzero(number_of_pose[:, None] == number_of_view[view])
        arms = np.array([self._arms(one.key) for one in candidates]).reshape(-1, 4, 3)
        rigs = PoseArray.from_poses("map", "left", [rig for _, _, (_, rig, _) in views])
        squared = bundle_chi2(
            Bundle(
                view[row],
                pose,
                camera[row],
                looked.rays[row],
                looked.by_ray[row],
                looked.whitener[row],
                np.array([mounted.T_camera_left.R for mounted in cameras]),
                np.array([mounted.T_camera_left.t for mounted in cameras]),
                rigs.R,
                rigs.t,
                np.concatenate([one.poses.R for one in candidates]),
                np.concatenate([one.poses.t for one in candidates]),
                arms[number_of_pose],
            )
        )[0]
        pairs = pose * len(views) + view[row]
        total, count = (
            np.bincount(pairs, weights, len(number_of_pose) * len(views)).reshape(-1, len(views))
            for weights in (squared, None)
        )
        with np.errstate(invalid="ignore"):
            mean = np.where(count > 0, total / count, np.inf)
        return [mean[np.ix_(number_of_pose == number, number_of_view == number)] for number in range(len(candidates))]


def _best(candidates: PoseArray, chi2: FloatArray, least: int) -> int | None:
    """The candidate that explains the views clearly better than others; None if too few views agree on one.

    Args:
        chi2: (C,V) of candidates and views.
        least: views that must agree.
    """
    costs = chi2.sum(axis=1) / 2
    best = int(np.argmin(costs))
    agree = int((chi2[best] < CAP).sum())
    if agree < least or 2 * agree < chi2.shape[1]:
        return None
    apart = np.linalg.norm(candidates.t - candidates.t[best], axis=1) >= SAME_M
    apart |= np.linalg.norm(rotation_log(candidates.R.transpose(0, 2, 1) @ candidates.R[best]), axis=1) >= SAME_RAD
    others = costs[apart] - costs[best]
    if len(others) and others.min() < SURE_RATIO and least > 1:
        return None
    return best


def _joined(rows: Sequence[IntArray]) -> IntArray:
    return np.concatenate([np.zeros(0, dtype=np.int64), *rows])


def _only(frame: RigFrame, key: LandmarkId) -> tuple[tuple[Detection, ...], ...]:
    return tuple(tuple(o for o in camera if o.id == key) for camera in frame.seen)
