"""`survey_frames`: the landmark map from a recording.

1. Initialization (`initialization.py`): frames and landmarks are located in turn.
2. Bundle adjustment (`bundle_adjustment.py`): outliers are left out, and odometry is weighted by how well it agrees
   with the observations; remaining frames and landmarks are tried again with the resulting map.
3. The second pose of every landmark is tried (`pose_ambiguity.py`).
4. Known landmarks that were moved are placed from the recording (`known_survey.py`).
5. Warnings: landmarks that part of the recording contradicts, that have an ambiguous pose, that are off their
   constraints (`wall_constraints.py`), or that are poorly determined.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from lmkit.arrays import FloatArray
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import AnyRig
from lmkit.geometry.rotations import orthonormal
from lmkit.mapping.bundle_adjustment import Anchor, BundleProblem
from lmkit.mapping.bundle_results import Bundle
from lmkit.mapping.carried_cameras import are_synchronous, split_by_exposure, synchronous
from lmkit.mapping.initialization import Start, find_start
from lmkit.mapping.known_survey import solve_by_known
from lmkit.mapping.landmark_support import doubtful_landmarks
from lmkit.mapping.motion_rows import NEVER, SLIP_SIGMA
from lmkit.mapping.moved_landmark import THIS_RECORDING, MovedLandmark
from lmkit.mapping.observation_noise import noise_factor
from lmkit.mapping.pose_ambiguity import resolve_pose_ambiguities
from lmkit.mapping.reading_rate import LocatedFrames
from lmkit.mapping.second_places import with_second_places
from lmkit.mapping.solved_recording import SolvedRecording
from lmkit.mapping.survey_results import ContradictedLandmark, Survey, deviations
from lmkit.mapping.wall_constraints import LandmarkConstraint, strays
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.recording import RigFrame
from lmkit.odometry.motion_model import Motion

OUTLIER_SIGMA = 4.5  # root mean square over an observation's eight coordinates
ROUNDS, STEPS = 4, 30
WEIGHINGS = 2
CONTRADICTED_SHARE, LEAST_CONTRADICTED = 0.1, 3  # observations that do not fit
OFF_CONSTRAINT_SIGMA = 4.0
POOR_M, POOR_RAD = 0.03, np.deg2rad(2.0)


def survey_frames(
    frames: Sequence[RigFrame],
    rig: AnyRig,
    sizes_m: Mapping[LandmarkId, float],
    anchors: Mapping[LandmarkId, Anchor],
    motion: Motion | None = None,
    constraints: Sequence[LandmarkConstraint] = (),
    keep_doubtful: bool = False,
) -> Survey:
    """Survey the landmarks and the poses of the rig.

    Args:
        frames: frames in the order of time.
        sizes_m: printed sizes, by id.
        anchors: landmarks known beforehand, by id; with none, the best-observed landmark
            defines the origin, its normal is the x axis and it is upright; with wheel odometry it is above the
            origin, and the floor is z = 0.
        motion: odometry; of wheels it needs the rig's T_base_left.
        constraints: walls and heights that landmarks share.
        keep_doubtful: keep landmarks in the map that too few frames support (`landmark_support.py`).

    Raises:
        InputError: nothing to start from, or odometry without T_base_left or of another time.
    """
    solve = partial(solve_recording, frames, rig, sizes_m, motion=motion, constraints=constraints)
    known = solve_by_known(solve, anchors)
    result = survey_of(known.solved, known.anchors, constraints)
    contradicted = with_second_places(result.contradicted, result.bundle, OUTLIER_SIGMA, frames, rig, sizes_m)
    result = replace(result, contradicted=contradicted)
    if not keep_doubtful:
        seen = LocatedFrames.of(known.solved.problem, rig)
        result = _without_doubtful(result, seen, {*known.solved.start.anchors, *anchors})
    moved = moved_since_known(result, anchors, known.released)
    current = {one.after.id: one.after for one in moved}
    landmarks = LandmarkMap([*(current.get(m.id, m) for m in result.landmarks), *(one.before for one in moved)])
    return replace(result, landmarks=landmarks, moved=moved, disputed=known.disputed)


def _without_doubtful(result: Survey, seen: LocatedFrames, known: Collection[LandmarkId]) -> Survey:
    """The survey without landmarks that too few frames support."""
    bundle = result.bundle
    kept_out = doubtful_landmarks(bundle.landmarks, [seen], known)
    out = {one.id for one in kept_out}
    return replace(
        result,
        bundle=_only(bundle, {m.id for m in bundle.landmarks} - out),
        landmarks=LandmarkMap(m for m in result.landmarks if m.id not in out),
        contradicted=tuple(one for one in result.contradicted if one.id not in out),
        poorly_determined=tuple(one for one in result.poorly_determined if one[0] not in out),
        ambiguous=tuple(id_ for id_ in result.ambiguous if id_ not in out),
        off_constraint=tuple(one for one in result.off_constraint if one[0] not in out),
        kept_out=kept_out,
    )


def moved_since_known(
    result: Survey, anchors: Mapping[LandmarkId, Anchor], released: Collection[LandmarkId]
) -> tuple[MovedLandmark, ...]:
    """Moves of known landmarks, from their known places to their places in the recording.

    Args:
        anchors: as they were known.
        released: ids of moved landmarks.
    """
    moved, bundle = [], result.bundle
    for id_ in sorted(released):
        after = bundle.landmarks.find(id_)
        if after is not None:
            seen = (bundle.of == bundle.ids.index(id_)) & (bundle.residuals < OUTLIER_SIGMA)
            since_s = float(bundle.times_s[bundle.frames[seen]].min())
            moved.append(MovedLandmark.since_known(anchors[id_], after, since_s, (THIS_RECORDING,)))
    return tuple(moved)


def solve_recording(
    frames: Sequence[RigFrame],
    rig: AnyRig,
    sizes_m: Mapping[LandmarkId, float],
    anchors: Mapping[LandmarkId, Anchor],
    motion: Motion | None = None,
    constraints: Sequence[LandmarkConstraint] = (),
) -> SolvedRecording:
    """Initialization, bundle adjustment, and the second poses; arguments and errors as of :func:`survey_frames`."""
    if motion is not None and not are_synchronous(frames, rig):
        frames, rig = split_by_exposure(frames, rig), synchronous(rig)
    start = start_of(frames, rig, sizes_m, anchors, motion)
    problem = start.problem(frames, rig, motion, constraints)
    optimize_all(problem)
    if start.unplaced or None in start.poses:
        # With the final map, more frames and landmarks may be located than during initialization.
        again = start_of(frames, rig, sizes_m, _start_anchors(start, problem), motion)
        if len(again.rows) > len(start.rows) or len(again.unplaced) < len(start.unplaced):
            # The anchors are unchanged.
            start = replace(again, anchors=start.anchors)
            problem = start.problem(frames, rig, motion, constraints)
            optimize_all(problem)
    if not anchors and motion is not None and motion.of_base:
        _lay_on_the_floor(problem)
    undecided = resolve_pose_ambiguities(problem)
    problem.drop_outliers(OUTLIER_SIGMA)
    problem.optimize(STEPS)
    problem.find_swelling(noise_factor([problem]))
    problem.optimize(STEPS)
    problem.forget_equations()
    names = () if motion is None else tuple(motion.names)
    return SolvedRecording(replace(start, recorded=None), problem, undecided, len(frames), names)


def start_of(
    frames: Sequence[RigFrame],
    rig: AnyRig,
    sizes_m: Mapping[LandmarkId, float],
    anchors: Mapping[LandmarkId, Anchor],
    motion: Motion | None = None,
) -> Start:
    """Initialization (`find_start`); cameras that do not expose together are first located separately."""
    if are_synchronous(frames, rig):
        return find_start(frames, rig, sizes_m, anchors, motion)
    split, alike = split_by_exposure(frames, rig), synchronous(rig)
    start = find_start(split, alike, sizes_m, anchors, motion)
    problem = start.problem(split, alike, motion)
    optimize_all(problem)
    found = {
        time_s: Pose("map", "left", orthonormal(R), p)
        for time_s, R, p in zip(problem.times.tolist(), problem.R, problem.p, strict=True)
    }
    placed = {**start.placed, **{m.id: m for m in problem.landmarks()}}
    return replace(start, poses=[found.get(frame.time_s) for frame in frames], placed=placed)


def survey_of(
    solved: SolvedRecording,
    anchors: Mapping[LandmarkId, Anchor],
    constraints: Sequence[LandmarkConstraint] = (),
    known: FloatArray | None = None,
) -> Survey:
    """The results of a solved recording.

    Args:
        anchors: known landmarks; known landmarks that the recording did not see stay in the map unchanged.
        known: (6L,6L) information on the landmarks from other sources, such as other recordings.
    """
    start, problem = solved.start, solved.problem
    bundle = problem.answer(OUTLIER_SIGMA, solved.undecided, known, noise_factor([problem]))
    mapped = {m.id for m in problem.mapped}
    # A landmark at a place that none of its observations supports had a wrong initial pose.
    fitting = bundle.of[bundle.residuals < OUTLIER_SIGMA].tolist()
    believed = {bundle.ids[k] for k in fitting} | set(start.anchors)
    lost = [m for m in bundle.landmarks if m.id not in believed]
    bundle = _only(bundle, believed)
    unseen = [
        replace(anchor.landmark, covariance=anchor.covariance) for key, anchor in anchors.items() if key not in mapped
    ]
    landmarks = LandmarkMap([*bundle.landmarks, *unseen])
    unplaced = tuple(sorted([*start.unplaced, *(m.id for m in lost)]))
    ambiguous = tuple(sorted({problem.mapped[k].id for k in solved.undecided} & believed))
    contradicted = tuple(
        contradicted for contradicted in contradicted_landmarks(bundle) if contradicted.id in believed
    )
    return Survey(
        bundle,
        landmarks,
        start.rows,
        contradicted,
        poorly_determined_landmarks(bundle.landmarks),
        unplaced,
        int((~problem.used).sum()),
        ambiguous,
        landmarks_off_constraint(constraints, bundle.landmarks, bundle.joint),
        frames=solved.frames,
        # Without odometry the parameters are velocities, which have no names.
        odometry=dict(zip(solved.odometry, bundle.parameters.tolist(), strict=False)),
        odometry_sigmas=dict(zip(solved.odometry, bundle.parameter_sigmas.tolist(), strict=False)),
    )


def _lay_on_the_floor(problem: BundleProblem) -> None:
    """Align the map with the floor: with wheels, the robot is upright on z = 0 on average."""
    R, p = problem.base_poses()
    up = R[:, :, 2].mean(axis=0)
    turn = Rotation.align_vectors([[0.0, 0.0, 1.0]], [up])[0].as_matrix()
    problem.transform(turn, np.array([0.0, 0.0, -float(np.median(p @ turn[2]))]))


def _start_anchors(start: Start, problem: BundleProblem) -> dict[LandmarkId, Anchor]:
    """Current poses of the landmarks, including anchors without observations."""
    found = {m.id: m for m in problem.landmarks()}
    return {key: Anchor(found.get(key, m), None) for key, m in start.placed.items()}


def optimize_all(problem: BundleProblem) -> None:
    """Bundle adjustment to convergence, without outlier observations."""
    # Large slips are rare; if they were allowed from the start, a moved landmark would be explained by a slip.
    problem.slip_sigma = NEVER
    problem.carry()
    problem.optimize(STEPS)
    dropped = -1
    for round_ in range(ROUNDS):
        now = problem.drop_outliers(OUTLIER_SIGMA)
        problem.slip_sigma = SLIP_SIGMA
        problem.carry()
        problem.optimize(STEPS)
        if round_ < WEIGHINGS:
            problem.weigh_motion()
            problem.optimize(STEPS)
        elif now == dropped:
            break
        dropped = now


def contradicted_landmarks(bundle: Bundle) -> tuple[ContradictedLandmark, ...]:
    """Landmarks with more contradicting observations than chance explains."""
    contradicted = []
    for k in np.unique(bundle.of):
        mine = bundle.of == k
        off = mine & (bundle.residuals > OUTLIER_SIGMA)
        if off.sum() >= max(LEAST_CONTRADICTED, CONTRADICTED_SHARE * mine.sum()):
            times = bundle.times_s[bundle.frames[off]]
            contradicted.append(
                ContradictedLandmark(
                    bundle.ids[k], int(off.sum()), int(mine.sum()), float(times.min()), float(times.max())
                )
            )
    return tuple(contradicted)


def _only(bundle: Bundle, ids: set[LandmarkId]) -> Bundle:
    kept = [k for k, m in enumerate(bundle.landmarks) if m.id in ids]
    rows = (6 * np.array(kept, dtype=np.int64)[:, None] + np.arange(6)).ravel()
    mapped = list(bundle.landmarks)
    return replace(
        bundle, landmarks=LandmarkMap([mapped[k] for k in kept]), joint=bundle.joint[rows[:, None], rows[None]]
    )


def poorly_determined_landmarks(landmarks: LandmarkMap) -> tuple[tuple[LandmarkId, float, float], ...]:
    """Landmarks determined to no better than 3 cm or 2 deg, with both deviations (m, rad)."""
    poorly_determined = []
    for m in landmarks:
        place, turn = deviations(m)
        if place > POOR_M or turn > POOR_RAD:
            poorly_determined.append((m.id, place, turn))
    return tuple(poorly_determined)


def landmarks_off_constraint(
    constraints: Sequence[LandmarkConstraint], landmarks: LandmarkMap, joint: FloatArray
) -> tuple[tuple[LandmarkId, LandmarkConstraint, float], ...]:
    """Landmarks off their constraints, with the constraint and the distance (m).

    Args:
        joint: (6L,6L) their covariance.
    """
    mapped = list(landmarks)
    R, p = np.array([m.T_map_landmark.R for m in mapped]), np.array([m.T_map_landmark.t for m in mapped])
    found = []
    for constraint in constraints:
        members = [k for k, m in enumerate(mapped) if m.id in constraint.ids]
        if len(members) < 3:
            continue  # with two landmarks, the wrong one is unknown
        for k, off, standardized in zip(members, *strays(constraint, members, R, p, joint), strict=True):
            if standardized > OFF_CONSTRAINT_SIGMA:
                found.append((mapped[k].id, constraint, float(off)))
    return tuple(found)


def landmark_sizes(
    frames: Sequence[RigFrame], size_m: float, anchors: Mapping[LandmarkId, Anchor]
) -> dict[LandmarkId, float]:
    """Printed size of every landmark observed or known, meters: an anchor's own, else ``size_m``."""
    sizes = {o.id: size_m for frame in frames for o in frame.detections}
    sizes.update({key: anchor.landmark.size_m for key, anchor in anchors.items()})
    return sizes


def anchors_of(landmarks: LandmarkMap, sigma: tuple[float, float] | None = None) -> dict[LandmarkId, Anchor]:
    """Known landmarks as anchors of a survey.

    Args:
        sigma: standard deviation of position (m, each axis) and rotation (rad, each axis); None: as the map states.
    """
    covariance = None if sigma is None else np.diag([sigma[0] ** 2] * 3 + [sigma[1] ** 2] * 3)
    return {
        m.id: Anchor(replace(m, covariance=None), m.covariance if covariance is None else covariance)
        for m in landmarks
    }
