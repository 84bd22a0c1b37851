"""Landmarks of a known map that were moved later, found by a hypothesis test on the cost.

The known map is one estimate of a landmark, recordings are others.  If nobody moved the landmark, the squared
distance of the two in standard deviations is chi-squared with six degrees of freedom; all known landmarks in view are
tested, so the level is divided by their number (Bonferroni).  Observations that the adjustment left out as outliers
of this landmark take part in its test: a landmark that was moved far keeps its known place, and all its observations
are outliers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from lmkit.arrays import BoolArray, FloatArray, IntArray
from lmkit.geometry.rotations import rotation_exp, rotation_log
from lmkit.mapping.bundle_adjustment import EXACT, Anchor, BundleProblem
from lmkit.mapping.joint_adjustment import JointProblem, recording_information
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_information import LandmarkInformation
from lmkit.optim.information_sum import unknowns_of

LEVEL = 0.01  # probability that any landmark of a survey is called moved although nobody moved it
LEAST_SHARE = 1e-9  # of the largest eigenvalue of the information on a pose: smaller ones count as zero
LEAST_SEEN = 3  # least observations of a landmark by a recording in which it was moved
LEAST_KNOWN = 3  # known landmarks in view: with only two that contradict each other, the moved one is unknown
SURVEYED_M = 0.03  # places known better come from a survey; by hand they may be measured worse than is stated
STILL_M, STILL_RAD = 0.002, np.deg2rad(0.3)  # repeatability of the pose of a landmark that nobody moved


@dataclass(frozen=True)
class KnownView:
    """A landmark of the known map in a joint problem.

    Attributes:
        number: among the joint landmarks.
        members: recordings that saw it, and its row among the landmarks of each.
    """

    number: int
    members: Sequence[tuple[int, int]]


@dataclass(frozen=True)
class KnownTest:
    """The known landmark farthest from its known place, if significantly.

    Attributes:
        worst: its id.
        disputed: known landmarks that contradict each other, if too few are in view to decide which was moved.
    """

    worst: LandmarkId
    disputed: tuple[LandmarkId, ...] = ()


def moved_threshold(tests: int) -> float:
    """Threshold of chi-squared with six degrees of freedom for this number of tests, at the level of a survey."""
    return float(chdtri(6, LEVEL / max(tests, 1)))


def unmoved_covariance() -> FloatArray:
    """Covariance (6,6) of the pose of a landmark that nobody moved, from one recording to the next."""
    return np.diag([STILL_M**2] * 3 + [STILL_RAD**2] * 3)


def find_moved(
    joint: JointProblem,
    problems: Sequence[BundleProblem],
    views: Mapping[LandmarkId, KnownView],
    anchors: Mapping[LandmarkId, Anchor],
    noise: float,
) -> KnownTest | None:
    """The known landmark that was moved most significantly; None if no known landmark was.

    Args:
        joint: adjusted; its first problems are ``problems``.
        views: of the known landmarks in view, by id.
        anchors: their known poses.
        noise: factor of the observations' variances (`observation_noise.py`).
    """
    in_view = {id_: view for id_, view in views.items() if _observations(problems, view) >= LEAST_SEEN}
    tested = [id_ for id_ in in_view if is_surveyed(anchors[id_])]
    if len(in_view) < 2 or not tested:
        return None
    parts = joint.information()
    total = joint.sum_of_information(parts)
    chi2 = {}
    for id_ in tested:
        H, b = total
        for recording, row in in_view[id_].members:
            problem = problems[recording]
            left_out = (problem.seen.of == row) & ~problem.used
            if left_out.any():
                _, H, b = with_left_out(left_out, problem, parts[recording], H, b, joint.rows[recording])
        chi2[id_] = _chi2_in(joint, in_view[id_].number, H, b, anchors[id_], noise)
    worst = max(tested, key=lambda id_: chi2[id_])
    if chi2[worst] <= moved_threshold(len(tested)):
        return None
    return KnownTest(worst, () if len(in_view) >= LEAST_KNOWN else tuple(sorted(in_view)))


def is_exact(anchor: Anchor) -> bool:
    """Whether a place is taken as exact, because its accuracy is not stated."""
    return anchor.covariance is None or not anchor.covariance.any()


def is_surveyed(anchor: Anchor) -> bool:
    """Whether a place was surveyed; one measured by hand may be less accurate than stated without any move.

    A place without a covariance is not tested either: it is taken as exact because its accuracy is not stated.
    """
    C = anchor.covariance
    return C is not None and not is_exact(anchor) and bool(np.trace(C[:3, :3]) < SURVEYED_M**2)


def is_at_known_place(anchor: Anchor, R: FloatArray, p: FloatArray, C: FloatArray, tests: int) -> bool:
    """Whether a landmark, solved without its known place, is at this place within the errors.

    Args:
        R, p, C: (3,3), (3,) its pose, and the (6,6) covariance of that.
        tests: known landmarks that were tested.
    """
    known = EXACT * np.eye(6) if anchor.covariance is None else anchor.covariance
    T = anchor.landmark.T_map_landmark
    e = np.concatenate([T.t - p, rotation_log(T.R @ R.T)])
    return float(e @ np.linalg.solve(known + C + unmoved_covariance(), e)) <= moved_threshold(tests)


def anchor_chi2(anchor: Anchor, R: FloatArray, p: FloatArray, C: FloatArray, noise: float) -> float:
    """Chi-squared of a landmark's known place, compared with all other information; 0 if there is none.

    Args:
        anchor: its pose with a covariance.
        R, p: (3,3), (3,) its pose from all information, including the known place.
        C: (6,6) covariance of that pose.
        noise: factor of the variances of the other information.
    """
    assert anchor.covariance is not None
    T, known = anchor.landmark.T_map_landmark, np.linalg.inv(EXACT * np.eye(6) + anchor.covariance)
    else_known = np.linalg.inv(C) - known
    values = np.linalg.eigvalsh(else_known)
    if values[0] <= LEAST_SHARE * values[-1]:
        return 0.0
    off = np.concatenate([T.t - p, rotation_log(T.R @ R.T)])
    without = np.linalg.inv(else_known)
    # The pose from all is the mean of the two, weighted by their information.
    e = off + without @ known @ off
    return float(e @ np.linalg.solve(anchor.covariance + noise * without + unmoved_covariance(), e))


def with_left_out(
    left_out: BoolArray,
    problem: BundleProblem,
    part: LandmarkInformation,
    H: FloatArray,
    b: FloatArray,
    rows: IntArray,
) -> tuple[LandmarkInformation, FloatArray, FloatArray]:
    """Information of a recording, and of all, including observations that were left out."""
    before = problem.used
    problem.used = before | left_out
    whole = recording_information(problem)
    problem.used = before
    columns = unknowns_of(rows, 6)
    H, b = H.copy(), b.copy()
    H[columns[:, None], columns] += whole.H - part.H
    b[columns] += whole.b - part.b
    return whole, H, b


def _observations(problems: Sequence[BundleProblem], view: KnownView) -> int:
    return sum(int((problems[recording].seen.of == row).sum()) for recording, row in view.members)


def _chi2_in(joint: JointProblem, number: int, H: FloatArray, b: FloatArray, anchor: Anchor, noise: float) -> float:
    """Chi-squared of a known landmark, from the information of map and observations."""
    rows = unknowns_of(np.array([number]), 6)
    try:
        solved = np.linalg.solve(H, np.column_stack([np.eye(len(b))[:, rows], b]))[rows]
        R = rotation_exp(solved[None, 3:, 6])[0] @ joint.R[number]
        return anchor_chi2(anchor, R, joint.p[number] + solved[:3, 6], solved[:, :6], noise)
    except np.linalg.LinAlgError:
        return 0.0
