"""Where to start a survey: poses and landmarks found one from the other, nearest first.

From the landmarks known so far the rig is located wherever they are surely seen; from the located moments further
landmarks are placed.  One view of one landmark allows two poses: all candidates of a landmark from all its views are
judged on all its views, and a landmark is placed once one of them explains what the others cannot.  Odometry, where
there is some, carries the rig on from where it is known, so that a landmark is judged from more than one side.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.errors import InputError
from lmkit.locate.rig import LocateOptions, locate_rig
from lmkit.locate.sightings import CORNER_FLOOR_PX, Poses, Sightings
from lmkit.model.drive import StereoMoment
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark, wall_pose
from lmkit.model.observation import LandmarkObservation
from lmkit.model.pose import Pose, orthonormal, rotation_angle
from lmkit.model.stereo_rig import StereoRig
from lmkit.motion import Motion
from lmkit.survey.bundle import Anchor, BundleProblem

VIEWS = 8  # of a landmark that place it, the largest
SETTLING = 4  # steps of bundle adjustment after each round
CANDIDATE_VIEWS = 4  # of those, that say where it may hang
SURE_RATIO = 10.0  # log likelihood ratio of a landmark's best candidate to another one
CAP = 8 * 4.5**2  # of a view's squared misfit
LOCATED_PX, CARRIED_PX = 0.5, 12.0  # what a corner may be off, seen from where the rig was located or carried to
CARRY_M = 6.0  # odometry is believed that far
# Odometry strays by so much, and by that share of the way; a moment located farther off saw a landmark that hangs
# twice, was moved or misread.
STRAY_M, STRAY_RAD, STRAY_SHARE = 0.3, 0.15, 0.1
RETRY = 1.5
NEIGHBOUR_M = 0.5  # of odometry to a located neighbour, from which a moment is refined without looking further
REFINING = 8
# Without odometry: neighbours in time are so near to each other.
NEIGHBOUR_S, NEIGHBOUR_MPS, NEIGHBOUR_RADPS = 1.0, 1.0, 1.5
LEAST_VIEWS = 2  # moments that agree on a landmark's place; one alone may have misread its code
SAME_M, SAME_RAD = 0.3, 0.35
# Single landmarks leave valleys of poses; a view that is known to a metre places nothing.
PLACING = LocateOptions(far_m=0.25, far_rad=np.deg2rad(8.0))

View = tuple[tuple[LandmarkObservation, ...], tuple[LandmarkObservation, ...]]
Key = tuple[str, int]


@dataclass(frozen=True, eq=False)
class Carried:
    """A pose carried on by odometry, over so much of a way (turns count, too)."""

    pose: Pose
    way_m: float


@dataclass(frozen=True, eq=False)
class _Steps:
    """(N-1,3,3), (N-1,3) T_left(k)_left(k + 1), and (N-1,) the way."""

    R: FloatArray
    t: FloatArray
    way_m: FloatArray

    def onwards(self, pose: Pose, k: int) -> Carried:
        """From the pose of moment k to the next."""
        return Carried(
            Pose("map", "camera", orthonormal(pose.R @ self.R[k]), pose.t + pose.R @ self.t[k]), float(self.way_m[k])
        )

    def back(self, pose: Pose, k: int) -> Carried:
        """From the pose of moment k + 1 to moment k."""
        R = orthonormal(pose.R @ self.R[k].T)
        return Carried(Pose("map", "camera", R, pose.t - R @ self.t[k]), float(self.way_m[k]))


@dataclass(eq=False)
class Start:
    """What is placed so far.

    Attributes:
        poses: of moments; None: not yet located.
        placed: landmarks.
        anchors: those that were known beforehand, or the one that was chosen.
        unplaced: at the end, what could not be placed.
        carried: poses of moments that odometry alone gives.
        seen_from: of a moment and a landmark: where the camera may be in the landmark's frame.
    """

    poses: list[Pose | None]
    placed: dict[Key, MappedLandmark]
    anchors: Mapping[Key, Anchor]
    unplaced: tuple[Key, ...] = ()
    carried: list[Carried | None] = field(default_factory=list)
    seen_from: dict[tuple[int, Key], list[Pose]] = field(default_factory=dict)

    def known_poses(self) -> tuple[tuple[int, ...], Poses]:
        """Which moments have a pose, located or carried, and those poses.

        Raises:
            InputError: none has.
        """
        posed = [
            (k, located or (carried.pose if carried else None))
            for k, (located, carried) in enumerate(zip(self.poses, self.carried, strict=True))
        ]
        known = [(k, pose) for k, pose in posed if pose is not None]
        if not known:
            raise InputError(
                "nothing_located",
                "no moment of the drive could be located",
                "see what lmkit locate says of its pictures",
            )
        R, p = np.array([pose.R for _, pose in known]), np.array([pose.t for _, pose in known])
        return tuple(k for k, _ in known), Poses(R, p)


def find_start(
    moments: Sequence[StereoMoment],
    rig: StereoRig,
    sizes_m: dict[Key, float],
    anchors: Mapping[Key, Anchor],
    motion: Motion | None = None,
) -> Start:
    """Poses and landmarks, as far as sightings tie them together.

    Args:
        sizes_m: printed size of every landmark to be placed.
        anchors: landmarks whose poses are known, roughly or well; none: the landmark that is seen best hangs upright
            in the map's origin and looks along its x.

    Raises:
        InputError: nothing to start from, or odometry without T_base_left or of another time.
    """
    if motion is not None:
        if motion.of_base and rig.T_base_left is None:
            raise InputError(
                "no_base", "odometry moves the robot's base, and the rig has no T_base_left", "add it to the rig file"
            )
        motion.require_overlap(np.array([moment.time_s for moment in moments]))
    views = _views(moments)
    wanted = {key for key in views if key in sizes_m}
    if not anchors:
        first = _best_seen(views, wanted)
        hung = MappedLandmark(first[1], first[0], sizes_m[first], wall_pose([0.0, 0.0, 0.0], 0.0))
        anchors = {first: Anchor(hung, None)}
    if not any(key in views for key in anchors):
        raise InputError(
            "anchor_unseen",
            "none of the landmarks known beforehand is seen in the drive",
            "anchor the survey at a landmark that the pictures show",
        )
    start = Start([None] * len(moments), {key: anchor.landmark for key, anchor in anchors.items()}, anchors)
    steps = _steps(moments, rig, motion)
    tries: dict[int, int] = {}
    least = LEAST_VIEWS
    while True:
        news = _locate_more(start, moments, rig, tries, _carried(start, steps), steps)
        carried, before = _carried(start, steps), len(start.placed)
        for key in sorted(wanted - start.placed.keys()):
            pose = _placed(key, views[key], start, carried, moments, rig, sizes_m[key], least)
            if pose is not None:
                start.placed[key] = MappedLandmark(key[1], key[0], sizes_m[key], pose)
                news += 1
        if len(start.placed) > before:
            _settle(start, moments, rig, motion)
        # What one moment alone saw is placed last, and only where nothing contradicts.
        stuck = news == 0 and least == 1
        if stuck and any(start.poses):
            news = _locate_by_neighbours(start, carried, moments, rig)
        elif stuck:
            news = _locate_likeliest(start, moments, rig, carried)
        if stuck and news == 0:
            break
        least = LEAST_VIEWS if news else 1
    start.carried = _carried(start, steps)
    start.unplaced = tuple(sorted(wanted - set(start.placed)))
    return start


def _views(moments: Sequence[StereoMoment]) -> dict[Key, list[tuple[float, int]]]:
    """Of every landmark: (side in px, moment) of its views."""
    views: dict[Key, dict[int, float]] = {}
    for k, moment in enumerate(moments):
        for o in (*moment.left, *moment.right):
            side = float(np.linalg.norm(o.corners - np.roll(o.corners, 1, axis=0), axis=1).mean())
            at = views.setdefault((o.family, o.code), {})
            at[k] = max(at.get(k, 0.0), side)
    return {key: sorted(((side, k) for k, side in at.items()), reverse=True) for key, at in views.items()}


def _best_seen(views: dict[Key, list[tuple[float, int]]], wanted: set[Key]) -> Key:
    if not wanted:
        raise InputError("nothing_seen", "no landmark is seen in the drive", "check the pictures with lmkit detect")
    return max(wanted, key=lambda key: sum(side for side, _ in views[key][:VIEWS]))


def _locate_more(
    start: Start,
    moments: Sequence[StereoMoment],
    rig: StereoRig,
    tries: dict[int, int],
    carried: list[Carried | None],
    steps: _Steps | None,
) -> int:
    """Moments located from what is placed; those tried before are tried again when they see more of it."""
    landmarks, news = LandmarkMap([replace(m, covariance=None) for m in start.placed.values()]), 0
    for k, moment in enumerate(moments):
        if start.poses[k] is not None:
            continue
        known = len({(o.family, o.code) for o in (*moment.left, *moment.right)} & start.placed.keys())
        # Again only when it sees a good deal more of what is placed.
        if known == 0 or known < RETRY * tries.get(k, 0):
            continue
        tries[k] = known
        guess = _beside_a_neighbour(start, k, steps)
        refined = None if guess is None else _refined(guess, moments[k], rig, landmarks)
        if refined is not None:
            pose, sure = refined
            if sure:
                start.poses[k] = pose
                news += 1
            continue
        estimate = locate_rig(moment.left, moment.right, rig, landmarks, PLACING)
        if estimate.status == "ok" and estimate.T_map_camera is not None:
            if not _believable(estimate.T_map_camera, carried[k]):
                continue
            start.poses[k] = estimate.T_map_camera
            news += 1
    return news


def _settle(start: Start, moments: Sequence[StereoMoment], rig: StereoRig, motion: Motion | None) -> None:
    """A few steps of bundle adjustment of what is known so far, so that errors do not add up from round to round."""
    located = [(k, pose) for k, pose in enumerate(start.poses) if pose is not None]
    rows, poses = [k for k, _ in located], [pose for _, pose in located]
    seen = {(o.family, o.code) for k in rows for o in (*moments[k].left, *moments[k].right)}
    hung = [m for key, m in start.placed.items() if key in seen]
    problem = BundleProblem(
        [moments[k] for k in rows],
        rig,
        Poses(np.array([pose.R for pose in poses]), np.array([pose.t for pose in poses])),
        LandmarkMap(hung),
        start.anchors,
        motion,
    )
    problem.settle(SETTLING)
    for k, R, p in zip(rows, problem.R, problem.p, strict=True):
        start.poses[k] = Pose("map", "camera", orthonormal(R), p)
    start.placed.update({(m.family, m.code): m for m in problem.landmarks()})


def _beside_a_neighbour(start: Start, k: int, steps: _Steps | None) -> Carried | None:
    """Where odometry leads from a located neighbour in time."""
    if steps is None:
        return None
    before = start.poses[k - 1] if k > 0 else None
    after = start.poses[k + 1] if k + 1 < len(start.poses) else None
    guess = None
    if before is not None:
        guess = steps.onwards(before, k - 1)
    elif after is not None:
        guess = steps.back(after, k)
    return guess if guess is not None and guess.way_m < NEIGHBOUR_M else None


def _refined(
    guess: Carried, moment: StereoMoment, rig: StereoRig, landmarks: LandmarkMap
) -> tuple[Pose, bool] | None:
    """The pose near the guess that fits all that is seen, and whether that is sure; None where it does not fit."""
    seen = Sightings.of_rig(moment.left, moment.right, rig, landmarks, CORNER_FLOOR_PX)
    if len(seen) == 0 or seen.twice:
        return None
    used = np.ones((1, len(seen)), dtype=bool)
    found = seen.refine(Poses(guess.pose.R[None], guess.pose.t[None]), used, None, REFINING)
    pose = Pose("map", "camera", orthonormal(found.R[0]), found.p[0])
    if not _believable(pose, guess) or seen.misfits(found).max() > CAP:
        return None
    variances = np.diag(np.linalg.pinv(seen.equations(found, used, None)[0][0]))
    return pose, bool(variances[:3].sum() < PLACING.far_m**2 and variances[3:].max() < PLACING.far_rad**2)


def _locate_likeliest(
    start: Start, moments: Sequence[StereoMoment], rig: StereoRig, carried: list[Carried | None]
) -> int:
    """Where nothing is sure: the moment whose best pose is the likeliest against its others; 0 without one."""
    landmarks = LandmarkMap([replace(m, covariance=None) for m in start.placed.values()])
    best: tuple[float, int, Pose] | None = None
    for k, moment in enumerate(moments):
        if start.poses[k] is not None or carried[k] is not None:
            continue
        estimate = locate_rig(moment.left, moment.right, rig, landmarks)
        if estimate.T_map_camera is None or estimate.covariance is None:
            continue
        ratio = estimate.alternatives[0][1] if estimate.alternatives else SURE_RATIO
        # Nearer views first among those that are as sure.
        score = min(ratio, SURE_RATIO) - float(np.sqrt(np.trace(estimate.covariance[:3, :3])))
        if best is None or score > best[0]:
            best = score, k, estimate.T_map_camera
    if best is None:
        return 0
    start.poses[best[1]] = best[2]
    return 1


def _locate_by_neighbours(
    start: Start, carried: list[Carried | None], moments: Sequence[StereoMoment], rig: StereoRig
) -> int:
    """Moments that allow several poses, or a valley of them: the one that lies near where the rig was just before."""
    landmarks = LandmarkMap([replace(m, covariance=None) for m in start.placed.values()])
    allowed: dict[int, list[Pose]] = {}
    news = 0
    for order in (range(1, len(moments)), range(len(moments) - 2, -1, -1)):
        for k in order:
            before = start.poses[k - order.step]
            seconds = abs(moments[k].time_s - moments[k - order.step].time_s)
            if start.poses[k] is not None or carried[k] is not None or before is None or seconds > NEIGHBOUR_S:
                continue
            if k not in allowed:
                estimate = locate_rig(moments[k].left, moments[k].right, rig, landmarks)
                best = [] if estimate.T_map_camera is None else [estimate.T_map_camera]
                allowed[k] = best + [pose for pose, _ in estimate.alternatives]
            near = [
                pose
                for pose in allowed[k]
                if np.linalg.norm(pose.t - before.t) < STRAY_M + NEIGHBOUR_MPS * seconds
                and rotation_angle(pose.R.T @ before.R) < STRAY_RAD + NEIGHBOUR_RADPS * seconds
            ]
            if near:
                start.poses[k] = min(near, key=lambda pose: _apart(pose, before))
                news += 1
    return news


def _steps(moments: Sequence[StereoMoment], rig: StereoRig, motion: Motion | None) -> _Steps | None:
    """Odometry from moment to moment, as the left eye moves; None without odometry."""
    if motion is None or len(moments) < 2:
        return None
    steps = motion.steps(np.array([moment.time_s for moment in moments]), np.array(motion.nominal))
    R, t = steps.of_camera(rig.T_base_left or Pose.identity("base", "left"))
    turned = np.arccos(np.clip((np.einsum("nii->n", steps.R) - 1) / 2, -1, 1))
    return _Steps(R, t, np.where(steps.known, np.linalg.norm(steps.t, axis=1) + turned, np.inf))


def _believable(pose: Pose, carried: Carried | None) -> bool:
    """Does odometry allow it?"""
    if carried is None:
        return True
    stray = STRAY_SHARE * carried.way_m
    turned = rotation_angle(pose.R.T @ carried.pose.R)
    return bool(np.linalg.norm(pose.t - carried.pose.t) < STRAY_M + stray and turned < STRAY_RAD + stray)


def _carried(start: Start, steps: _Steps | None) -> list[Carried | None]:
    """Poses of moments that were not located, carried on from the nearest that was."""
    count = len(start.poses)
    poses: list[Carried | None] = [None] * count
    if steps is None:
        return poses
    found: list[tuple[float, FloatArray, FloatArray] | None] = [None] * count
    for order in (range(count), range(count - 1, -1, -1)):
        at: tuple[float, FloatArray, FloatArray] | None = None
        for k in order:
            pose = start.poses[k]
            if pose is not None:
                at = (0.0, pose.R, pose.t)
                continue
            if at is None:
                continue
            way, R, p = at
            if order.step > 0:
                R, p, way = R @ steps.R[k - 1], p + R @ steps.t[k - 1], way + steps.way_m[k - 1]
            else:
                R = R @ steps.R[k].T
                p, way = p - R @ steps.t[k], way + steps.way_m[k]
            at = (way, R, p)
            before = found[k]
            if np.isfinite(way) and (before is None or way < before[0]):
                found[k] = at
    for k, one in enumerate(found):
        if one is not None:
            poses[k] = Carried(Pose("map", "camera", orthonormal(one[1]), one[2]), float(one[0]))
    return poses


def _placed(
    key: Key,
    views: list[tuple[float, int]],
    start: Start,
    carried: list[Carried | None],
    moments: Sequence[StereoMoment],
    rig: StereoRig,
    size_m: float,
    least: int,
) -> Pose | None:
    """T_map_landmark that its views agree with best; None while two that differ do as well, or too few agree."""
    located = [(k, pose, LOCATED_PX) for _, k in views if (pose := start.poses[k]) is not None][:VIEWS]
    near = [(k, c) for _, k in views if (c := carried[k]) is not None and c.way_m < CARRY_M]
    far = [(k, c.pose, CARRIED_PX) for k, c in near[: VIEWS - len(located) // 2]]
    at = located + far
    if len(at) < least:
        return None
    alone = LandmarkMap([MappedLandmark(key[1], key[0], size_m, Pose.identity("map", "landmark"))])
    candidates: list[Pose] = []
    for k, camera, _ in at[:CANDIDATE_VIEWS]:
        left, right = _only(moments[k], key)
        if (k, key) not in start.seen_from:
            estimate = locate_rig(left, right, rig, alone)
            likeliest = [] if estimate.T_map_camera is None else [estimate.T_map_camera]
            start.seen_from[k, key] = [*likeliest, *(pose for pose, _ in estimate.alternatives)]
        for T in start.seen_from[k, key]:
            candidates.append(Pose("map", "landmark", camera.R @ T.R.T, camera.t - camera.R @ T.R.T @ T.t))
    if not candidates:
        return None
    misfits = _misfits(candidates, key, at, moments, rig, alone)
    costs = misfits.sum(axis=1) / 2
    best = int(np.argmin(costs))
    agree = int((misfits[best] < CAP).sum())
    if agree < least or 2 * agree < len(at):
        return None
    others = [costs[k] - costs[best] for k, T in enumerate(candidates) if not _same(T, candidates[best])]
    if others and min(others) < SURE_RATIO and least > 1:
        return None
    return candidates[best]


def _misfits(
    candidates: Sequence[Pose],
    key: Key,
    at: list[tuple[int, Pose, float]],
    moments: Sequence[StereoMoment],
    rig: StereoRig,
    alone: LandmarkMap,
) -> FloatArray:
    """(C,V) squared misfits of candidates and views, each at most the cap."""
    # Seen from the landmark, a candidate puts each view's camera somewhere else.
    back = np.array([T.R.T for T in candidates])
    places = np.array([T.t for T in candidates])
    misfits = np.full((len(candidates), len(at)), CAP)
    for column, (k, pose, floor_px) in enumerate(at):
        left, right = _only(moments[k], key)
        seen = Sightings.of_rig(left, right, rig, alone, floor_px)
        if len(seen):
            cameras = Poses(back @ pose.R, (back @ (pose.t - places)[..., None])[..., 0])
            misfits[:, column] = np.minimum(CAP, seen.misfits(cameras).mean(axis=1))
    return misfits


def _only(moment: StereoMoment, key: Key) -> View:
    left = tuple(o for o in moment.left if (o.family, o.code) == key)
    return left, tuple(o for o in moment.right if (o.family, o.code) == key)


def _apart(a: Pose, b: Pose) -> float:
    """Metres, a radian as much as a metre."""
    return float(np.linalg.norm(a.t - b.t)) + rotation_angle(a.R.T @ b.R)


def _same(a: Pose, b: Pose) -> bool:
    turned = np.arccos(np.clip((np.trace(a.R.T @ b.R) - 1) / 2, -1, 1))
    return bool(np.linalg.norm(a.t - b.t) < SAME_M and turned < SAME_RAD)
