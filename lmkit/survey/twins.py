"""Landmarks that may as well hang turned: a small square seen from one side has a twin (Collins and Bartoli 2014).

Each landmark is turned over the line from which it was seen, and fitted to its sightings again with the rig where it
is.  Where that explains them nearly as well, the whole drive is solved with the twin in its place, and the better one
stays; where neither is clearly better, that is said.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from lmkit.arrays import FloatArray
from lmkit.survey.bundle import BundleProblem

HOPEFUL = 30.0  # of a twin's cost above the landmark's, while the rig keeps to the landmark
MOST_TRIED = 8
FITTING, SETTLING = 8, 12  # steps
SURE = 10.0  # of the cost, twice the log likelihood ratio
DIFFERENT_RAD = 0.1


def resolve_twins(problem: BundleProblem) -> tuple[int, ...]:
    """Put twins in place that explain the drive better; rows of landmarks of which it cannot be told."""
    undecided = []
    own, twins, R, p = _fitted_twins(problem)
    worse = twins - own
    for k in np.argsort(worse)[:MOST_TRIED]:
        if worse[k] > HOPEFUL:
            break
        before, cost = problem.state(), problem.cost()
        problem.put(int(k), R[k], p[k])
        there = problem.settle(SETTLING)
        turned = Rotation.from_matrix(problem.lm_R[k] @ before.lm_R[k].T).magnitude()
        if turned < DIFFERENT_RAD:
            problem.restore(before)
            continue
        if there >= cost:
            problem.restore(before)
        if abs(there - cost) < SURE:
            undecided.append(int(k))
    return tuple(undecided)


def _fitted_twins(problem: BundleProblem) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """(L,) costs of landmarks and of their twins, and the twins' (L,3,3) and (L,3)."""
    own, before = problem.landmark_costs(), problem.state()
    towards = problem.seen_along()
    normals = problem.lm_R[:, :, 2]
    flipped = 2 * np.einsum("li,li->l", towards, normals)[:, None] * towards - normals
    axis = np.cross(normals, flipped)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    angle = np.arctan2(sine[:, 0], np.einsum("li,li->l", normals, flipped))
    turn = Rotation.from_rotvec(axis / np.maximum(sine, 1e-12) * angle[:, None]).as_matrix()
    R, p = turn @ problem.lm_R, problem.lm_p.copy()
    best = np.full(len(own), np.inf)
    best_R, best_p = R, p
    for _ in range(FITTING):
        problem.lm_R, problem.lm_p = R, p
        cost = problem.landmark_costs()
        better = cost < best
        best = np.where(better, cost, best)
        best_R, best_p = np.where(better[:, None, None], R, best_R), np.where(better[:, None], p, best_p)
        step = problem.landmark_steps()
        R, p = Rotation.from_rotvec(step[:, 3:]).as_matrix() @ R, p + step[:, :3]
    problem.restore(before)
    # What is hardly turned is no twin, what is held does not turn, and of what nothing is believed nothing is known.
    held = np.array([problem.is_held(k) for k in range(len(own))])
    seen = np.bincount(problem.of, problem.used, len(own)) > 0
    best[(angle < DIFFERENT_RAD) | held | ~seen] = np.inf
    return own, best, best_R, best_p
