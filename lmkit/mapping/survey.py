"""`survey_frames`: the landmark map from a recording.

1. Initialization (`initialization.py`): poses and landmarks found one from the other.
2. Bundle adjustment (`bundle_adjustment.py`): outliers are left out, and odometry is weighted by how well it agrees
   with the observations; frames and landmarks left over are tried once more with the resulting map.
3. The second pose of every landmark is tried (`pose_ambiguity.py`).
4. Warnings: landmarks that part of the recording contradicts, that have an ambiguous pose, that are off their
   constraints (`wall_constraints.py`), or that are poorly determined.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from lmkit.geometry.stereo_rig import StereoRig
from lmkit.mapping.bundle_adjustment import Anchor, Bundle, BundleProblem
from lmkit.mapping.initialization import Start, find_start
from lmkit.mapping.pose_ambiguity import resolve_pose_ambiguities
from lmkit.mapping.wall_constraints import Tie, strays
from lmkit.model.landmark_id import LandmarkId, ids_text
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.model.recording import StereoFrame
from lmkit.odometry.motion_model import Motion, describe_odometry

OUTLIER_SIGMA = 4.5  # root mean square over an observation's eight coordinates
ROUNDS, STEPS = 4, 30
WEIGHINGS = 2
ODD_SHARE, LEAST_ODD = 0.1, 3  # observations of a landmark that do not fit, before it is called odd
ASTRAY_SIGMA = 4.0
WEAK_M, WEAK_RAD = 0.03, np.deg2rad(2.0)


@dataclass(frozen=True)
class ContradictedLandmark:
    """A landmark that part of its observations contradict.

    Attributes:
        off, observations: how many of its observations do not fit.
        from_s, to_s: when those were.
    """

    id: LandmarkId
    off: int
    sightings: int
    from_s: float
    to_s: float

    def __str__(self) -> str:
        return (
            f"{self.off} of {self.sightings} observations of {self.id}, from {self.from_s:.2f} to {self.to_s:.2f} s, "
            "contradict its pose: it was moved, its code appears twice, or it was misread; check it in the room"
        )


@dataclass(frozen=True, eq=False)
class Survey:
    """A surveyed recording.

    Attributes:
        bundle: poses, landmarks seen, parameters.
        landmarks: those, and known ones that the recording did not see, as they were.
        rows: (N,) which of the frames given have a pose.
        odd: landmarks contradicted by part of their observations.
        weak: landmarks determined to no better than 3 cm or 2 deg, with both deviations (m, rad).
        unplaced: landmarks that were seen, but not well enough to be placed.
        dropped: observations left out.
        ambiguous: landmarks that may as well are mounted turned, by their second pose.
        off: landmarks that do not be mounted as declared, what was declared of them, and how far they are off (m).
        warnings: what a user should check, in words.
    """

    bundle: Bundle
    landmarks: LandmarkMap
    rows: tuple[int, ...]
    odd: tuple[ContradictedLandmark, ...]
    weak: tuple[tuple[LandmarkId, float, float], ...]
    unplaced: tuple[LandmarkId, ...]
    dropped: int
    ambiguous: tuple[LandmarkId, ...] = ()
    astray: tuple[tuple[LandmarkId, Tie, float], ...] = ()
    warnings: tuple[str, ...] = ()


def survey_frames(
    moments: Sequence[StereoFrame],
    rig: StereoRig,
    sizes_m: Mapping[LandmarkId, float],
    anchors: Mapping[LandmarkId, Anchor],
    motion: Motion | None = None,
    ties: Sequence[Tie] = (),
) -> Survey:
    """Survey the landmarks and the poses of the rig.

    Args:
        frames: in the order of time.
        sizes_m: printed sizes, by id.
        anchors: landmarks known beforehand, by id; with none, the landmark seen best is taken to mount
            upright at the origin and to look along x; with wheels it is above the origin, and the floor that the
            robot stood on is z = 0.
        motion: odometry; of wheels it needs the rig's T_base_left.
        ties: walls and heights that landmarks are declared to share.

    Raises:
        InputError: nothing to start from, or odometry without T_base_left or of another time.
    """
    start = find_start(moments, rig, sizes_m, anchors, motion)
    problem = start.problem(moments, rig, motion, ties)
    settle_all(problem)
    if start.unplaced or None in start.poses:
        # By the map as it is now more may be located and placed than while it grew.
        again = find_start(moments, rig, sizes_m, _hung(start, problem), motion)
        if len(again.rows) > len(start.rows) or len(again.unplaced) < len(start.unplaced):
            # What is known beforehand is still that alone.
            start = replace(again, anchors=start.anchors)
            problem = start.problem(moments, rig, motion, ties)
            settle_all(problem)
    if not anchors and motion is not None and motion.of_base:
        _lay_on_the_floor(problem)
    undecided = resolve_pose_ambiguities(problem)
    dropped = problem.drop_outliers(OUTLIER_SIGMA)
    problem.settle(STEPS)
    bundle = problem.answer(OUTLIER_SIGMA, undecided)
    hung = {m.id for m in problem.hung}
    # A landmark that is mounted where none of its observations has it was started wrong.
    fitting = bundle.of[bundle.misfits < OUTLIER_SIGMA].tolist()
    believed = {bundle.ids[k] for k in fitting} | set(start.anchors)
    lost = [m for m in bundle.landmarks if m.id not in believed]
    bundle = _only(bundle, believed)
    unseen = [
        replace(anchor.landmark, covariance=anchor.covariance) for key, anchor in anchors.items() if key not in hung
    ]
    landmarks = LandmarkMap([*bundle.landmarks, *unseen])
    unplaced = tuple(sorted([*start.unplaced, *(m.id for m in lost)]))
    ambiguous = tuple(sorted({problem.hung[k].id for k in undecided} & believed))
    odd = tuple(odd for odd in contradicted_landmarks(bundle) if odd.id in believed)
    return Survey(
        bundle,
        landmarks,
        start.rows,
        odd,
        _weak(bundle.landmarks),
        unplaced,
        dropped,
        ambiguous,
        _astray(ties, bundle.landmarks),
    )


def _lay_on_the_floor(problem: BundleProblem) -> None:
    """On wheels a robot stands upright on z = 0, on the whole."""
    R, p = problem.base_poses()
    up = R[:, :, 2].mean(axis=0)
    turn = Rotation.align_vectors([[0.0, 0.0, 1.0]], [up])[0].as_matrix()
    problem.lay(turn, np.array([0.0, 0.0, -float(np.median(p @ turn[2]))]))


def _hung(start: Start, problem: BundleProblem) -> dict[LandmarkId, Anchor]:
    """Landmarks as they are known now, those that nothing saw among them."""
    found = {m.id: m for m in problem.landmarks()}
    return {key: Anchor(found.get(key, m), None) for key, m in start.placed.items()}


def settle_all(problem: BundleProblem) -> None:
    """Bundle adjustment to the end, observations that do not fit left out."""
    # Wheels rarely slip by much; were they allowed to at once, they would for a landmark that was moved.
    problem.may_slip = False
    problem.settle(STEPS)
    dropped = -1
    for round_ in range(ROUNDS):
        now = problem.drop_outliers(OUTLIER_SIGMA)
        problem.may_slip = True
        problem.settle(STEPS)
        if round_ < WEIGHINGS:
            problem.weigh_motion()
            problem.settle(STEPS)
        elif now == dropped:
            break
        dropped = now


def contradicted_landmarks(bundle: Bundle) -> tuple[ContradictedLandmark, ...]:
    """Landmarks with more contradicting observations than chance explains."""
    odd = []
    for k in np.unique(bundle.of):
        mine = bundle.of == k
        off = mine & (bundle.misfits > OUTLIER_SIGMA)
        if off.sum() >= max(LEAST_ODD, ODD_SHARE * mine.sum()):
            times = bundle.times_s[bundle.moments[off]]
            odd.append(
                ContradictedLandmark(
                    bundle.ids[k], int(off.sum()), int(mine.sum()), float(times.min()), float(times.max())
                )
            )
    return tuple(odd)


def _only(bundle: Bundle, ids: set[LandmarkId]) -> Bundle:
    kept = [k for k, m in enumerate(bundle.landmarks) if m.id in ids]
    rows = (6 * np.array(kept, dtype=np.int64)[:, None] + np.arange(6)).ravel()
    hung = list(bundle.landmarks)
    return replace(
        bundle, landmarks=LandmarkMap([hung[k] for k in kept]), joint=bundle.joint[rows[:, None], rows[None]]
    )


def _weak(landmarks: LandmarkMap) -> tuple[tuple[LandmarkId, float, float], ...]:
    weak = []
    for m in landmarks:
        place, turn = deviations(m)
        if place > WEAK_M or turn > WEAK_RAD:
            weak.append((m.id, place, turn))
    return tuple(weak)


def _astray(ties: Sequence[Tie], landmarks: LandmarkMap) -> tuple[tuple[LandmarkId, Tie, float], ...]:
    hung = list(landmarks)
    R, p = np.array([m.T_map_landmark.R for m in hung]), np.array([m.T_map_landmark.t for m in hung])
    sigmas = np.array([deviations(m) for m in hung])
    found = []
    for tie in ties:
        members = [k for k, m in enumerate(hung) if m.id in tie.ids]
        if len(members) < 3:
            continue  # of two nobody knows which is off
        for k, off, standardised in zip(members, *strays(tie, members, R, p, sigmas), strict=True):
            if standardised > ASTRAY_SIGMA:
                found.append((hung[k].id, tie, float(off)))
    return tuple(found)


def deviations(landmark: MappedLandmark) -> tuple[float, float]:
    """Standard deviation of a landmark's place (m, all axes together) and of its worst turn (rad)."""
    C = landmark.covariance
    if C is None:
        return 0.0, 0.0
    # What is not determined at all may come out negative; its size is as telling.
    return float(np.sqrt(abs(np.trace(C[:3, :3])))), float(np.sqrt(abs(np.linalg.eigvalsh(C[3:, 3:])[-1])))


def landmark_sizes(
    moments: list[StereoFrame], size_m: float, anchors: dict[LandmarkId, Anchor]
) -> dict[LandmarkId, float]:
    sizes = {o.id: size_m for moment in moments for o in (*moment.left, *moment.right)}
    sizes.update({key: anchor.landmark.size_m for key, anchor in anchors.items()})
    return sizes


def survey_warnings(
    result: Survey, motion: Motion | None, ties: list[Tie], advice: dict[LandmarkId, str]
) -> list[str]:

    texts = [str(odd) for odd in result.odd]
    doubt = None if motion is None else describe_odometry(motion, result.bundle.parameters)
    if doubt is not None:
        texts.append(doubt)
    for from_s, to_s, metres in result.bundle.jumps:
        texts.append(
            f"between {from_s:.2f} and {to_s:.2f} s the rig jumps by {metres:.2f} m: it slid or was carried, or a "
            "landmark seen there was moved, or is placed by the wrong one of its two poses; look from another side"
        )
    for code in result.ambiguous:
        texts.append(f"{code} has an ambiguous pose: it was seen from one side and from afar; look from another side")
    for code, tie, metres in result.astray:
        texts.append(
            f"{code} is {1000 * metres:.0f} mm off the {tie} that it is declared to share; check it in the room"
        )
    mapped = {m.id for m in result.bundle.landmarks}
    for tie in ties:
        missing = [id_ for id_ in tie.ids if id_ not in mapped]
        if missing:
            texts.append(f"of the {tie} that was declared, {ids_text(missing)} did not come into the map")
    for code in result.unplaced:
        texts.append(
            f"{code} is not placed: its observations are too few, or do not agree; drive past it again, and nearer"
        )
    for code, place, turn in result.weak:
        known = f"{code} is known to {1000 * place:.0f} mm and {math.degrees(turn):.1f} deg only"
        texts.append(f"{known}: {advice[code]}" if code in advice else known)
    return texts


def survey_dict(result: Survey, moments: list[StereoFrame], motion: Motion | None, output: Path) -> dict[str, Any]:
    from lmkit.mapping.survey import deviations

    bundle = result.bundle
    sightings = dict(zip(bundle.ids, np.bincount(bundle.of, minlength=len(bundle.ids)).tolist(), strict=True))
    entries = []
    for m in bundle.landmarks:
        place, turn = deviations(m)
        entries.append(
            {
                "id": str(m.id),
                "code": m.code,
                "position": m.T_map_landmark.t.tolist(),
                "quaternion": m.T_map_landmark.quaternion_xyzw.tolist(),
                "sigma_m": place,
                "sigma_rad": turn,
                "sightings": sightings[m.id],
            }
        )
    return {
        "map": str(output),
        "landmarks": entries,
        "moments": len(moments),
        "located": len(result.rows),
        "dropped": result.dropped,
        "reprojection_error_px": bundle.rms_px if math.isfinite(bundle.rms_px) else None,
        "odd": [
            {"id": str(o.id), "code": o.id.code, "off": o.off, "of": o.sightings, "from_s": o.from_s, "to_s": o.to_s}
            for o in result.odd
        ],
        "jumps": [{"from_s": a, "to_s": b, "metres": m} for a, b, m in result.bundle.jumps],
        "weak": [str(id_) for id_, _, _ in result.weak],
        "unplaced": [str(id_) for id_ in result.unplaced],
        "ambiguous": [str(id_) for id_ in result.ambiguous],
        "astray": [{"id": str(id_), "of": str(tie), "metres": metres} for id_, tie, metres in result.astray],
        "odometry": {} if motion is None else dict(zip(motion.names, bundle.parameters.tolist(), strict=True)),
    }
