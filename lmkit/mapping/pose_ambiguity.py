"""Pose ambiguity: a small square seen from one side has two poses (Collins and Bartoli 2014).

Each landmark is reflected about its viewing direction and fitted to its observations again, with fixed rig poses.  If
the second pose explains them nearly as well, the whole recording is solved with it, and the better one is kept.  If
neither is clearly better, the ambiguity is reported, and the landmark's covariance includes the distance of the two.
Seen nearly head-on, the two poses are the ends of one flat valley of the cost; the solution stops between them or at
either end: that is ambiguous as well.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.geometry.rotations import rotation_angle, rotation_exp, rotation_log
from lmkit.mapping.bundle_adjustment import BundleProblem, State

HOPEFUL = 30.0  # excess cost of a second pose, with fixed rig poses
MOST_TRIED = 8
FITTING, SETTLING = 8, 12  # steps
STILL = 30.0  # times the predicted gain of a step: more is not expected from all further steps
SURE = 10.0  # of the cost, twice the log likelihood ratio
DIFFERENT_RAD = 0.1


def resolve_pose_ambiguities(problem: BundleProblem) -> dict[int, FloatArray]:
    """Replace poses by second poses that explain the recording better.

    Returns:
        (6,6) to add to the covariance of landmarks whose ambiguity is not resolved, by row.
    """
    undecided: dict[int, FloatArray] = {}
    own, alternatives, R, p = _fitted_alternatives(problem)
    worse = alternatives - own
    cost: float | None = None
    for k in map(int, np.argsort(worse)[:MOST_TRIED]):
        if worse[k] > HOPEFUL:
            break
        before = problem.state()
        cost = problem.cost() if cost is None else cost
        off = _apart(R[k], p[k], before.lm_R[k], before.lm_p[k])
        problem.put(k, R[k], p[k])
        is_back = partial(_is_turned_back, before.lm_R[k], k)
        problem.optimize(SETTLING, until=is_back)
        there = problem.cost()
        settled = _apart(problem.lm_R[k], problem.lm_p[k], before.lm_R[k], before.lm_p[k])
        if is_back(problem.state()):
            # It returned to the first pose: only the flatness of the valley matters.
            problem.restore(before)
            apart, worth = off, float(worse[k])
        else:
            apart, worth = settled, abs(there - cost)
            if there >= cost:
                problem.restore(before)
            else:
                cost = there
        if worth < SURE and np.linalg.norm(apart[3:]) > DIFFERENT_RAD:
            undecided[k] = _spread(apart, worth)
    return undecided


def _apart(R: FloatArray, p: FloatArray, R_other: FloatArray, p_other: FloatArray) -> FloatArray:
    """(6,) from one pose to another: shift (m), rotation about the map's axes (rad)."""
    return np.concatenate([p - p_other, rotation_log(R @ R_other.T)])


def _is_turned_back(R: FloatArray, k: int, state: State) -> bool:
    """Whether landmark k has returned to its rotation R (3,3), so that it will not reach a second pose."""
    return rotation_angle(state.lm_R[k] @ R.T) < DIFFERENT_RAD


def _spread(apart: FloatArray, worse: float) -> FloatArray:
    """(6,6) mean square about the more likely pose, for the probability of the other one."""
    share = 1 / (1 + np.exp(worse / 2))
    return np.asarray(share * np.outer(apart, apart))


def _fitted_alternatives(problem: BundleProblem) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """(L,) costs of landmarks and of their second poses, and the second poses' (L,3,3) and (L,3)."""
    own, before = problem.landmark_costs(), problem.state()
    toward = problem.seen_along()
    normals = problem.lm_R[:, :, 2]
    flipped = 2 * np.einsum("li,li->l", toward, normals)[:, None] * toward - normals
    axis = np.cross(normals, flipped)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    angle = np.arctan2(sine[:, 0], np.einsum("li,li->l", normals, flipped))
    turn = rotation_exp(axis / np.maximum(sine, 1e-12) * angle[:, None])
    R, p = turn @ problem.lm_R, problem.lm_p.copy()
    # Skip landmarks that are nearly symmetric, fixed, or unobserved.
    held = np.array([problem.is_fixed(k) for k in range(len(own))])
    seen = np.bincount(problem.seen.of, problem.used, len(own)) > 0
    fitted = (angle >= DIFFERENT_RAD) & ~held & seen
    best, best_R, best_p = np.full(len(own), np.inf), R, p
    used, open_ = problem.used, fitted
    for left in reversed(range(FITTING)):
        problem.lm_R, problem.lm_p, problem.used = R, p, used & open_[problem.seen.of]
        cost = problem.landmark_costs()
        better = open_ & (cost < best)
        best = np.where(better, cost, best)
        best_R, best_p = np.where(better[:, None, None], R, best_R), np.where(better[:, None], p, best_p)
        # A fit that returned to the first pose will stay there.
        fitted &= _angles(R, before.lm_R) >= DIFFERENT_RAD
        open_ = open_ & fitted
        if not left or not open_.any():
            break
        step, gain = problem.landmark_steps()
        open_ = open_ & (cost - own - HOPEFUL < STILL * gain)
        R, p = rotation_exp(step[:, 3:]) @ R, p + step[:, :3]
    problem.used = used
    problem.restore(before)
    best[~fitted] = np.inf
    return own, best, best_R, best_p


def _angles(R: FloatArray, R_other: FloatArray) -> FloatArray:
    """(L,) angles between rotations (L,3,3), rad."""
    return np.asarray(np.linalg.norm(rotation_log(R @ R_other.transpose(0, 2, 1)), axis=1))
