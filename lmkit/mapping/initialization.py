"""Initialization of a survey: poses and landmarks are found in turn, nearest first.

The known landmarks locate the rig in every frame that shows them reliably.  The located frames place further
landmarks (`landmark_initialization.py`), and a few steps of adjustment follow.  Odometry, where there is some,
extends the located frames by dead reckoning (`odometry/dead_reckoning.py`), so that a landmark is judged from several
sides.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from lmkit.errors import InputError
from lmkit.geometry.pose import Pose
from lmkit.geometry.pose_array import PoseArray
from lmkit.geometry.rig import AnyRig
from lmkit.geometry.rotations import orthonormal, rotation_angle
from lmkit.localization.absolute_pose import LocateOptions, locate_rig
from lmkit.localization.correspondences import CORNER_FLOOR_PX, Correspondences
from lmkit.localization.many_frames import locate_frames
from lmkit.mapping.bundle_adjustment import Anchor, BundleProblem
from lmkit.mapping.landmark_initialization import CAP, SURE_RATIO, Placing
from lmkit.mapping.recorded_observations import RecordedObservations
from lmkit.mapping.wall_constraints import LandmarkConstraint
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark, wall_pose
from lmkit.model.pose_status import PoseStatus
from lmkit.model.recording import RigFrame
from lmkit.odometry.dead_reckoning import STRAY_M, STRAY_RAD, OdometryPath, ReckonedPose, ReckonedPoses
from lmkit.odometry.motion_model import BoundedMotion, Motion

SETTLING = 4  # steps of bundle adjustment after each round
SETTLED_SHARE = 3e-2  # of the cost: the next round changes it by more than what is left then
RETRY = 1.5
NEIGHBOUR_M = 0.5  # of odometry to a located neighbor, from which a frame is refined without a search
REFINING = 8
# Without odometry: largest distance of neighbors in time.
NEIGHBOUR_S, NEIGHBOUR_MPS, NEIGHBOUR_RADPS = 1.0, 1.0, 1.5
LEAST_VIEWS = 2  # frames that agree on a landmark's place; one alone may have misread its code
# Single landmarks leave valleys of poses; a view with an uncertainty of a meter places no landmark.
PLACING = LocateOptions(far_m=0.25, far_rad=np.deg2rad(8.0))


@dataclass(frozen=True, eq=False)
class Start:
    """Poses and landmarks connected by the observations of a recording.

    Attributes:
        poses: T_map_left of frames, located or from dead reckoning; None: neither.
        placed: landmarks.
        anchors: known landmarks, or the one that was chosen.
        unplaced: landmarks that could not be placed.
        recorded: the recording's observations as arrays.
    """

    poses: Sequence[Pose | None]
    placed: Mapping[LandmarkId, MappedLandmark]
    anchors: Mapping[LandmarkId, Anchor]
    unplaced: tuple[LandmarkId, ...] = ()
    recorded: RecordedObservations | None = None

    @property
    def rows(self) -> tuple[int, ...]:
        """Frames that have a pose."""
        return tuple(k for k, pose in enumerate(self.poses) if pose is not None)

    def problem(
        self,
        frames: Sequence[RigFrame],
        rig: AnyRig,
        motion: Motion | None,
        constraints: Sequence[LandmarkConstraint] = (),
        landmarks_fixed: bool = False,
    ) -> BundleProblem:
        """Bundle adjustment of the frames that have a pose, and of the landmarks that they observe."""
        rows, recorded = self.rows, self.recorded
        some = [frames[k] for k in rows]
        if recorded is not None and not recorded.are_of(frames, rig):
            recorded = None
        seen = recorded.ids_in(rows) if recorded else {o.id for frame in some for o in frame.detections}
        mapped = [m for key, m in self.placed.items() if key in seen]
        return BundleProblem(
            some,
            rig,
            PoseArray.from_poses("map", "left", [pose for pose in self.poses if pose is not None]),
            LandmarkMap(mapped),
            self.anchors,
            motion,
            landmarks_fixed,
            constraints,
            recorded.only(rows, [m.id for m in mapped]) if recorded else None,
        )


def find_start(
    frames: Sequence[RigFrame],
    rig: AnyRig,
    sizes_m: Mapping[LandmarkId, float],
    anchors: Mapping[LandmarkId, Anchor],
    motion: Motion | None = None,
) -> Start:
    """Poses and landmarks that are connected by observations.

    Args:
        sizes_m: printed size of every landmark to be placed.
        anchors: landmarks whose poses are known, exactly or not; none: the landmark observed best is upright
            at the map's origin and faces along its x axis.

    Raises:
        InputError: no frame can be located, or odometry without T_base_left or of another time.
    """
    if motion is not None:
        if motion.of_base and rig.T_base_left is None:
            raise InputError(
                "no_base", "odometry moves the robot's base, and the rig has no T_base_left", "add it to the rig file"
            )
        motion.require_overlap(np.array([frame.time_s for frame in frames]))
    recorded = RecordedObservations(frames, rig)
    placing = Placing(frames, rig, sizes_m, recorded)
    if not anchors:
        best = placing.best_seen()
        mapped = MappedLandmark(best, sizes_m[best], wall_pose([0.0, 0.0, 0.0], 0.0))
        anchors = {best: Anchor(mapped, None)}
    if not any(key in placing.views for key in anchors):
        raise InputError(
            "anchor_unseen",
            "none of the known landmarks is seen in the recording",
            "give known landmarks that are in the images",
        )
    search = _Search(frames, rig, anchors, placing, recorded, motion)
    search.run()
    reckoned = ReckonedPoses(search.poses, search.path)
    poses = [pose or (c.pose if (c := reckoned[k]) else None) for k, pose in enumerate(search.poses)]
    if not any(poses):
        raise InputError(
            "nothing_located",
            "no frame of the recording could be located",
            "check some of its images with lmkit locate",
        )
    unplaced = tuple(sorted(placing.wanted - set(search.placed)))
    return Start(poses, search.placed, anchors, unplaced, search.recorded)


@dataclass(eq=False)
class _Search:
    """Frames located and landmarks placed so far."""

    frames: Sequence[RigFrame]
    rig: AnyRig
    anchors: Mapping[LandmarkId, Anchor]
    placing: Placing
    recorded: RecordedObservations
    motion: Motion | None
    poses: list[Pose | None] = field(init=False)
    placed: dict[LandmarkId, MappedLandmark] = field(init=False)
    tries: dict[int, int] = field(default_factory=dict)  # placed landmarks of a frame when it last failed

    def __post_init__(self) -> None:
        self.poses = [None] * len(self.frames)
        self.placed = {key: anchor.landmark for key, anchor in self.anchors.items()}
        times = np.array([frame.time_s for frame in self.frames])
        self.path = None if self.motion is None else OdometryPath.of(times, self.rig, self.motion)
        # Velocities are found once everything has its place.
        self.expected = self.motion or BoundedMotion(times, most_knots=0)

    def run(self) -> None:
        """Repeat rounds until no frame or landmark is added."""
        least = LEAST_VIEWS
        while True:
            news = self.locate_more()
            reckoned = ReckonedPoses(self.poses, self.path)
            news += self.place_more(reckoned, least)
            # Landmarks of a single frame are placed last, and only without contradiction.
            stuck = news == 0 and least == 1
            if stuck:
                news = self.locate_by_neighbors(reckoned) if any(self.poses) else self.locate_likeliest(reckoned)
                if news == 0:
                    return
            least = LEAST_VIEWS if news else 1

    def place_more(self, reckoned: ReckonedPoses, least: int) -> int:
        """Place landmarks on which enough views agree."""
        placed = self.placing.place(sorted(self.placing.wanted - self.placed.keys()), self.poses, reckoned, least)
        self.placed.update(placed)
        if placed:
            self.optimize()
        return len(placed)

    def optimize(self) -> None:
        """A few steps of bundle adjustment, so that errors do not accumulate over rounds."""
        start = Start(self.poses, self.placed, self.anchors, recorded=self.recorded)
        problem = start.problem(self.frames, self.rig, self.expected)
        problem.optimize(SETTLING, least_share=SETTLED_SHARE)
        for k, R, p in zip(start.rows, problem.R, problem.p, strict=True):
            self.poses[k] = Pose("map", "left", orthonormal(R), p)
        self.placed.update({m.id: m for m in problem.landmarks()})

    def map_so_far(self) -> LandmarkMap:
        """The placed landmarks as a map without covariances."""
        return LandmarkMap([replace(m, covariance=None) for m in self.placed.values()])

    def locate_more(self) -> int:
        """Locate frames with placed landmarks; frames that failed are tried again when more of theirs are placed."""
        landmarks, news = self.map_so_far(), 0
        reckoned = ReckonedPoses(self.poses, self.path)
        known = self.recorded.shown[:, self.recorded.numbers(self.placed)].sum(axis=1).tolist()
        # Again only when clearly more of its landmarks are placed.
        rows = [
            k
            for k, pose in enumerate(self.poses)
            if pose is None and known[k] and known[k] >= RETRY * self.tries.get(k, 0)
        ]
        self.tries.update((k, known[k]) for k in rows)
        located = self.located(rows)
        for k in rows:
            guess = self.beside_a_neighbor(k)
            refined = None if guess is None else _refined(guess, self.frames[k], self.rig, landmarks)
            if refined is not None:
                pose, sure = refined
                self.poses[k] = pose if sure else None
            else:
                found, at = located.get(k), reckoned[k]
                if found is not None and (at is None or at.allows(found)):
                    self.poses[k] = found
            news += self.poses[k] is not None
        return news

    def located(self, rows: Sequence[int]) -> dict[int, Pose]:
        """Unambiguous and precise poses of some frames by the placed landmarks, each frame on its own."""
        recorded = self.recorded
        seen = recorded.rows_in(rows, self.placed)
        corners = recorded.corners(seen, {key: m.corners_map for key, m in self.placed.items()})
        at, of = recorded.arrays.at[seen], recorded.arrays.of[seen]
        starts = np.searchsorted(at, [*rows, len(self.frames)])
        camera, side_px = recorded.arrays.camera[seen], recorded.side_px[seen]
        found = locate_frames(corners, starts, of, camera, side_px, PLACING)
        poses = {k: found.pose(row) for row, k in enumerate(rows) if found.is_sure[row]}
        for row in np.flatnonzero(found.needs_retry).tolist():
            estimate = locate_rig(self.frames[rows[row]].seen, self.rig, self.map_so_far(), PLACING)
            if estimate.status == PoseStatus.OK and estimate.T_map_camera is not None:
                poses[rows[row]] = estimate.T_map_camera
        return poses

    def beside_a_neighbor(self, k: int) -> ReckonedPose | None:
        """Pose by dead reckoning from a located neighbor in time; None if none is near."""
        if self.path is None:
            return None
        for at in (k - 1, k + 1):
            pose = self.poses[at] if 0 <= at < len(self.poses) else None
            if pose is not None:
                guess = self.path.reckon(pose, at, k)
                return guess if guess is not None and guess.way_m < NEIGHBOUR_M else None
        return None

    def locate_likeliest(self, reckoned: ReckonedPoses) -> int:
        """Locate the frame whose best pose is most likely relative to its second; 0 if there is none."""
        landmarks = self.map_so_far()
        best: tuple[float, int, Pose] | None = None
        for k, frame in enumerate(self.frames):
            if self.poses[k] is not None or reckoned[k] is not None:
                continue
            found = locate_rig(frame.seen, self.rig, landmarks)
            if found.T_map_camera is None or found.covariance is None:
                continue
            ratio = found.alternatives[0][1] if found.alternatives else SURE_RATIO
            # Nearer views first among views of equal certainty.
            score = min(ratio, SURE_RATIO) - float(np.sqrt(np.trace(found.covariance[:3, :3])))
            if best is None or score > best[0]:
                best = score, k, found.T_map_camera
        if best is None:
            return 0
        self.poses[best[1]] = best[2]
        return 1

    def locate_by_neighbors(self, reckoned: ReckonedPoses) -> int:
        """Locate frames with several poses, or a valley of poses, by the pose near the previous frame."""
        landmarks, frames = self.map_so_far(), self.frames
        allowed: dict[int, list[Pose]] = {}
        news = 0
        for order in (range(1, len(frames)), range(len(frames) - 2, -1, -1)):
            for k in order:
                before = self.poses[k - order.step]
                seconds = abs(frames[k].time_s - frames[k - order.step].time_s)
                if self.poses[k] is not None or reckoned[k] is not None or before is None or seconds > NEIGHBOUR_S:
                    continue
                if k not in allowed:
                    found = locate_rig(frames[k].seen, self.rig, landmarks)
                    best = [] if found.T_map_camera is None else [found.T_map_camera]
                    allowed[k] = best + [pose for pose, _ in found.alternatives]
                near = [
                    pose
                    for pose in allowed[k]
                    if np.linalg.norm(pose.t - before.t) < STRAY_M + NEIGHBOUR_MPS * seconds
                    and rotation_angle(pose.R.T @ before.R) < STRAY_RAD + NEIGHBOUR_RADPS * seconds
                ]
                if near:
                    self.poses[k] = min(near, key=lambda pose: _apart(pose, before))
                    news += 1
        return news


def _refined(guess: ReckonedPose, frame: RigFrame, rig: AnyRig, landmarks: LandmarkMap) -> tuple[Pose, bool] | None:
    """The pose near the guess that fits all observations, and whether it is unambiguous; None if none fits."""
    seen = Correspondences.of_rig(frame.seen, rig, landmarks, CORNER_FLOOR_PX)
    if len(seen) == 0 or seen.twice:
        return None
    used = np.ones((1, len(seen)), dtype=bool)
    found = seen.refine(PoseArray.from_poses("map", "left", [guess.pose]), used, None, REFINING)
    pose = found.pose(0)
    if not guess.allows(pose) or seen.chi2(found).max() > CAP:
        return None
    variances = np.diag(np.linalg.pinv(seen.equations(found, used, None)[0][0]))
    return pose, bool(variances[:3].sum() < PLACING.far_m**2 and variances[3:].max() < PLACING.far_rad**2)


def _apart(a: Pose, b: Pose) -> float:
    """Distance of two poses in meters; a radian counts as a meter."""
    return float(np.linalg.norm(a.t - b.t)) + rotation_angle(a.R.T @ b.R)
