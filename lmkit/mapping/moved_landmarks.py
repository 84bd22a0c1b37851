"""Moved landmarks between recordings, found by a hypothesis test on the joint cost.

A landmark that one recording has elsewhere than the others do is better explained by two poses than by one.
Splitting it adds six unknowns ``e``, the second pose relative to the first, and lowers the joint cost by

    e' S e,  with  e = S^-1 (b_v - H_v H^-1 b)  and  S = H_vv - H_v H^-1 H_v',

H_v, H_vv and b_v being what that recording says of the landmark, H and b all that all recordings say, every pose and
every error of the odometry eliminated.  Where nobody moved it, the drop is chi-squared with six degrees of freedom;
all recordings' views of all landmarks are tested, so that the level is divided by their number (Bonferroni).
A landmark of the known map that was moved since is found in the same way: what the map says of it is one view more.
Observations that the adjustment left out for the landmark's own sake take part in its test.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from lmkit.arrays import BoolArray, FloatArray, IntArray
from lmkit.geometry.rotations import rotation_log
from lmkit.mapping.bundle_adjustment import Anchor, BundleProblem
from lmkit.mapping.joint_adjustment import JointProblem, recording_information
from lmkit.mapping.recording_group import Version
from lmkit.model.landmark_information import LandmarkInformation
from lmkit.optim.information_sum import unknowns_of

LEVEL = 0.01  # probability that any landmark of a survey is called moved though nobody touched it
LEAST_SHARE = 1e-9  # of what tells most of a pose: what tells less in some direction tells nothing
LEAST_SEEN = 3  # observations of a landmark by a recording that says it was moved
STILL_M, STILL_RAD = 0.002, np.deg2rad(0.3)  # how still a landmark is that nobody moved


@dataclass(frozen=True)
class SplitTest:
    """Result for one recording's view of one landmark.

    Attributes:
        version: number of the landmark's version.
        member: recording, and row among its landmarks.
        chi2: by which two poses explain all recordings better than one.
    """

    version: int
    member: tuple[int, int]
    chi2: float


def moved_threshold(tests: int) -> float:
    """Chi-squared of six numbers that chance exceeds in none of so many tests, at the level of the survey."""
    return float(chdtri(6, LEVEL / max(tests, 1)))


def still() -> FloatArray:
    """Covariance (6,6) of the pose of a landmark that nobody moved, from one recording to the next."""
    return np.diag([STILL_M**2] * 3 + [STILL_RAD**2] * 3)


def split_tests(
    joint: JointProblem,
    problems: Sequence[BundleProblem],
    versions: Sequence[Version],
    usable: Sequence[BoolArray],
    noise: float,
) -> list[SplitTest]:
    """Test every recording's view of every landmark that other recordings have as well.

    Args:
        joint: adjusted; its first problems are ``problems``.
        usable: (S,) of each recording: observations that it believes on its own.
        noise: factor of all variances (`observation_noise.py`).
    """
    parts = joint.information()
    total = joint.sum_of_information(parts)
    found = []
    for number, version in enumerate(versions):
        if len(version.members) < 2:
            continue
        for recording, row in version.members:
            problem, mine = problems[recording], usable[recording]
            own = (problem.seen.of == row) & mine
            if own.sum() < LEAST_SEEN:
                continue
            part, H, b = parts[recording], *total
            left_out = own & ~problem.used
            if left_out.any():
                part, H, b = _with(left_out, problem, part, H, b, joint.rows[recording])
            chi2 = _drop(part, row, H, b, joint.rows[recording], noise)
            found.append(SplitTest(number, (recording, row), chi2))
    return found


def anchor_chi2(anchor: Anchor, R: FloatArray, p: FloatArray, C: FloatArray, noise: float) -> float:
    """Chi-squared of how far a landmark is from where it is known to be, by all else; 0 where that tells nothing.

    Args:
        anchor: its pose with a covariance.
        R, p: (3,3), (3,) its pose by all, what is known of it among that.
        C: (6,6) covariance of that pose.
        noise: factor of the variances of all else.
    """
    assert anchor.covariance is not None
    T, known = anchor.landmark.T_map_landmark, np.linalg.inv(anchor.covariance)
    else_known = np.linalg.inv(C) - known
    values = np.linalg.eigvalsh(else_known)
    if values[0] <= LEAST_SHARE * values[-1]:
        return 0.0
    off = np.concatenate([T.t - p, rotation_log(T.R @ R.T)])
    without = np.linalg.inv(else_known)
    # The pose by all is the mean of the two, weighed by what they tell.
    e = off + without @ known @ off
    return float(e @ np.linalg.solve(anchor.covariance + noise * without + still(), e))


def _with(
    left_out: BoolArray,
    problem: BundleProblem,
    part: LandmarkInformation,
    H: FloatArray,
    b: FloatArray,
    rows: IntArray,
) -> tuple[LandmarkInformation, FloatArray, FloatArray]:
    """Information of a recording, and of all, with observations that were left out."""
    before = problem.used
    problem.used = before | left_out
    whole = recording_information(problem)
    problem.used = before
    columns = unknowns_of(rows, 6)
    H, b = H.copy(), b.copy()
    H[columns[:, None], columns] += whole.H - part.H
    b[columns] += whole.b - part.b
    return whole, H, b


def _drop(part: LandmarkInformation, row: int, H: FloatArray, b: FloatArray, rows: IntArray, noise: float) -> float:
    """Chi-squared of the offset of a landmark in one recording."""
    columns, own = unknowns_of(rows, 6), slice(6 * row, 6 * row + 6)
    across = np.zeros((6, len(b)))
    across[:, columns] = part.H[own]
    try:
        solved = np.linalg.solve(H, np.column_stack([across.T, b]))
        S = part.H[own, own] - across @ solved[:, :6]
        e = np.linalg.solve(S, part.b[own] - across @ solved[:, 6])
        return float(e @ np.linalg.solve(noise * np.linalg.inv(S) + still(), e))
    except np.linalg.LinAlgError:
        return 0.0
