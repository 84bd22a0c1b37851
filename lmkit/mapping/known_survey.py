"""Survey of a recording with a known map, some of whose landmarks may have been moved."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass

import numpy as np

from lmkit.geometry.rotations import rotation_angle
from lmkit.mapping.bundle_adjustment import Anchor
from lmkit.mapping.joint_adjustment import JointProblem
from lmkit.mapping.moved_known_landmarks import KnownTest, KnownView, find_moved, is_at_known_place, is_exact
from lmkit.mapping.observation_noise import noise_factor
from lmkit.mapping.solved_recording import SolvedRecording
from lmkit.model.landmark_id import LandmarkId

MOST_RELEASED = 12  # landmarks, one at a time; if more are at other places, the map itself is doubted
LEAST_REFUTING, REFUTED, AGREES = 10, 0.8, 0.2  # observations of a landmark; shares of them that do not fit
LEAST_AGREEING = 2  # other landmarks
NEAR_M, NEAR_RAD = 0.1, np.deg2rad(15)  # of an exact place: within these limits, another landmark may have pulled it
HARDLY_KNOWN = np.diag([1.0] * 3 + [0.25] * 3)  # m^2, rad^2


@dataclass(frozen=True, eq=False)
class KnownSurvey:
    """A recording solved with the unmoved known landmarks.

    Attributes:
        solved: the recording.
        anchors: unmoved known landmarks.
        released: known landmarks that were moved since.
        disputed: known landmarks that contradict each other, with too few in view to determine which was moved.
    """

    solved: SolvedRecording
    anchors: Mapping[LandmarkId, Anchor]
    released: frozenset[LandmarkId] = frozenset()
    disputed: tuple[LandmarkId, ...] = ()


def solve_by_known(
    solve: Callable[[Mapping[LandmarkId, Anchor]], SolvedRecording], known: Mapping[LandmarkId, Anchor]
) -> KnownSurvey:
    """Solve a recording, and again without each known landmark that was moved since, the clearest one first.

    A moved landmark shifts the recording, and with it unmoved landmarks: landmarks that are later found
    at their known places become anchors again.

    Args:
        solve: solves the recording with the given anchors, and may raise its own errors.
    """
    released: set[LandmarkId] = set()
    held: set[LandmarkId] = set()  # are not released again
    hardly: dict[LandmarkId, Anchor] = {}  # released, but can only be placed from their known places

    def solve_without_released() -> SolvedRecording:
        believed = {id_: anchor for id_, anchor in known.items() if id_ not in released}
        return solve(believed | {id_: anchor for id_, anchor in hardly.items() if id_ in released})

    solved = solve(known)
    while True:
        believed = {id_: anchor for id_, anchor in known.items() if id_ not in released | held}
        test = _test(solved, believed) or _refuted(solved, believed)
        if test is None:
            back = {id_ for id_ in released if _stands(solved, known[id_], known)}
            if not back:
                break
            released -= back
            held |= back
        elif test.disputed or len(released) == MOST_RELEASED:
            disputed = released | {test.worst} | set(test.disputed)
            return KnownSurvey(solve(known) if released else solved, known, frozenset(), tuple(sorted(disputed)))
        else:
            released.add(test.worst)
        solved = solve_without_released()
        if lost := released - set(solved.problem.landmark_ids):
            hardly |= {id_: Anchor(known[id_].landmark, HARDLY_KNOWN) for id_ in lost}
            solved = solve_without_released()
    anchors = {id_: anchor for id_, anchor in known.items() if id_ not in released}
    return KnownSurvey(solved, anchors, frozenset(released))


def _test(solved: SolvedRecording, anchors: Mapping[LandmarkId, Anchor]) -> KnownTest | None:
    problem = solved.problem
    joint = JointProblem([problem], [np.arange(len(problem.mapped))], problem.lm_R, problem.lm_p)
    views = {id_: KnownView(k, [(0, k)]) for k, id_ in enumerate(problem.landmark_ids) if id_ in anchors}
    return find_moved(joint, [problem], views, anchors, noise_factor([problem]))


def _refuted(solved: SolvedRecording, anchors: Mapping[LandmarkId, Anchor]) -> KnownTest | None:
    """The landmark with an exact place that nearly all its observations contradict, while others agree with theirs.

    The accuracy of such places is not stated, so no statistical test applies; a large share of observations is
    required.
    """
    problem = solved.problem
    exact = [k for k, id_ in enumerate(problem.landmark_ids) if id_ in anchors and is_exact(anchors[id_])]
    count = np.bincount(problem.seen.of, minlength=len(problem.mapped))[exact]
    off = np.bincount(problem.seen.of, ~problem.used, len(problem.mapped))[exact]
    enough = count >= LEAST_REFUTING
    refuted, agree = enough & (off >= REFUTED * count), enough & (off <= AGREES * count)
    if not refuted.any() or agree.sum() < max(LEAST_AGREEING, refuted.sum()):
        return None
    return KnownTest(problem.landmark_ids[exact[int(np.argmax(np.where(refuted, off, 0)))]])


def _stands(solved: SolvedRecording, anchor: Anchor, known: Collection[LandmarkId]) -> bool:
    problem = solved.problem
    k = problem.landmark_ids.index(anchor.landmark.id)
    R, p = problem.lm_R[k], problem.lm_p[k]
    if is_exact(anchor):
        T = anchor.landmark.T_map_landmark
        return bool(np.linalg.norm(T.t - p) < NEAR_M) and rotation_angle(T.R @ R.T) < NEAR_RAD
    rows = slice(problem.own + 6 * k, problem.own + 6 * k + 6)
    C = problem.stated_equations(noise_factor([problem]))[0].covariances()[1][rows, rows]
    return is_at_known_place(anchor, R, p, C, len(set(known) & set(problem.landmark_ids)))
