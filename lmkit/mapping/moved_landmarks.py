"""Moved landmarks between recordings, found by a hypothesis test on the joint cost.

If one recording has a landmark at another place than the others, two poses explain it better than one.
Splitting it adds six unknowns ``e``, the second pose relative to the first, and lowers the joint cost by

    e' S e,  with  e = S^-1 (b_v - H_v H^-1 b)  and  S = H_vv - H_v H^-1 H_v',

where H_v, H_vv and b_v are the information of that recording on the landmark, and H and b that of all recordings,
every pose and odometry error eliminated.  If nobody moved the landmark, the decrease is chi-squared with six degrees
of freedom; all recordings' estimates of all landmarks are tested, so the level is divided by their number
(Bonferroni). A landmark of the known map that was moved later is found in the same way (`moved_known_landmarks.py`).
Observations that the adjustment left out as outliers of a landmark take part in its test.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lmkit.arrays import BoolArray, FloatArray, IntArray
from lmkit.mapping.bundle_adjustment import BundleProblem
from lmkit.mapping.joint_adjustment import JointProblem
from lmkit.mapping.moved_known_landmarks import LEAST_SEEN, unmoved_covariance, with_left_out
from lmkit.mapping.recording_group import Version
from lmkit.model.landmark_information import LandmarkInformation
from lmkit.optim.information_sum import unknowns_of


@dataclass(frozen=True)
class SplitTest:
    """Result for one recording's estimate of one landmark.

    Attributes:
        version: number of the landmark's version.
        member: recording, and row among its landmarks.
        chi2: decrease of the cost with two poses instead of one.
    """

    version: int
    member: tuple[int, int]
    chi2: float


def split_tests(
    joint: JointProblem,
    problems: Sequence[BundleProblem],
    versions: Sequence[Version],
    usable: Sequence[BoolArray],
    noise: float,
) -> list[SplitTest]:
    """Test every recording's estimate of every landmark that other recordings also observed.

    Args:
        joint: adjusted; its first problems are ``problems``.
        usable: (S,) of each recording: inliers of its own survey.
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
                part, H, b = with_left_out(left_out, problem, part, H, b, joint.rows[recording])
            chi2 = _drop(part, row, H, b, joint.rows[recording], noise)
            found.append(SplitTest(number, (recording, row), chi2))
    return found


def _drop(part: LandmarkInformation, row: int, H: FloatArray, b: FloatArray, rows: IntArray, noise: float) -> float:
    """Chi-squared of the offset of a landmark in one recording."""
    columns, own = unknowns_of(rows, 6), slice(6 * row, 6 * row + 6)
    across = np.zeros((6, len(b)))
    across[:, columns] = part.H[own]
    try:
        solved = np.linalg.solve(H, np.column_stack([across.T, b]))
        S = part.H[own, own] - across @ solved[:, :6]
        e = np.linalg.solve(S, part.b[own] - across @ solved[:, 6])
        return float(e @ np.linalg.solve(noise * np.linalg.inv(S) + unmoved_covariance(), e))
    except np.linalg.LinAlgError:
        return 0.0
