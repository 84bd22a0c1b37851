"""Equations of the motions of a rig between neighbors in time, for bundle adjustment.

Odometry gives the motion of the rig between frames (`odometry/motion_model.py`).  Each motion gives six equations
on both poses and the odometry's errors, which are down-weighted if they do not fit, as for a slipping wheel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lmkit.arrays import FloatArray, IntArray
from lmkit.geometry.rotations import rotation_log, skew
from lmkit.odometry.motion_model import Motion, Steps
from lmkit.optim.block_chain import ChainEquations
from lmkit.optim.robust_loss import cauchy_cost, cauchy_weight

SLIP_SIGMA, NEVER = 10.0, 1e6  # scale of the loss of motions; of one that lets no wheel slip
LEAST_TO_WEIGH = 20  # motions
KNOWN_BELOW = 0.3  # share of a motion's variance that remains after the camera observations


@dataclass(frozen=True, eq=False)
class StandardMotions:
    """Motions between neighbors in time, in standard deviations, without robust weights.

    Attributes:
        before, after: (N-1,6,6) derivatives with the earlier and the later pose.
        residuals: (N-1,6).
        parameters: (N-1,c) numbers of the odometry's errors that each motion depends on.
        by_parameters: (N-1,6,c) derivatives with those.
        sigmas: (N-1,6) m and rad.
    """

    before: FloatArray
    after: FloatArray
    residuals: FloatArray
    parameters: IntArray
    by_parameters: FloatArray
    sigmas: FloatArray


@dataclass(frozen=True, eq=False)
class MotionRows:
    """Equations of the motions between neighbors in time, in standard deviations, with robust weights.

    Attributes:
        before, after: (N-1,6,6) derivatives with the earlier and the later pose.
        residuals: (N-1,6).
        parameters: (N-1,c) numbers of the odometry's errors that each motion depends on.
        by_parameters: (N-1,6,c) derivatives with those.
        root_weights: (N-1,) roots of the robust weights.
        cost: of all.
    """

    before: FloatArray
    after: FloatArray
    residuals: FloatArray
    parameters: IntArray
    by_parameters: FloatArray
    root_weights: FloatArray
    cost: float


def standard_motions(
    steps: Steps, scale: FloatArray, base: tuple[FloatArray, FloatArray], arm: FloatArray
) -> StandardMotions:
    """Motions of a robot compared with its odometry.

    Args:
        steps: motions of the odometry.
        scale: (6,) factors of its standard deviations.
        base: (N,3,3), (N,3) T_map_base of the robot.
        arm: (N,3) from the rig to the base, about the map's axes; poses turn about the rig.
    """
    R_b, p_b = base
    back = R_b[:-1].transpose(0, 2, 1)
    v = p_b[1:] - p_b[:-1]
    turned = rotation_log(steps.R.transpose(0, 2, 1) @ back @ R_b[1:])
    r = np.column_stack([steps.t - (back @ v[..., None])[..., 0], -turned])
    sigmas = steps.sigmas * scale
    # d(p_b) = shift - [arm] turn, and R' v changes by R' [v] with the turn of the earlier pose.
    before, after = np.zeros((len(v), 6, 6)), np.zeros((len(v), 6, 6))
    before[:, :3, :3], after[:, :3, :3] = -back, back
    before[:, :3, 3:] = back @ (skew(arm[:-1]) + skew(v))
    after[:, :3, 3:] = -back @ skew(arm[1:])
    forward = R_b[1:].transpose(0, 2, 1)
    before[:, 3:, 3:], after[:, 3:, 3:] = -forward, forward
    by_sigma = 1 / sigmas[..., None]
    by_parameters = -steps.by_parameters * by_sigma
    return StandardMotions(before * by_sigma, after * by_sigma, r / sigmas, steps.parameters, by_parameters, sigmas)


def weighed(motions: StandardMotions, slip_sigma: float) -> MotionRows:
    """Motions with robust weights, for a loss with this scale in standard deviations."""
    squared = (motions.residuals**2).sum(axis=1) / 6
    root = np.sqrt(cauchy_weight(squared, slip_sigma))
    before, after, K = (
        values * root[:, None, None] for values in (motions.before, motions.after, motions.by_parameters)
    )
    cost = float(6 * cauchy_cost(squared, slip_sigma).sum())
    return MotionRows(before, after, motions.residuals * root[:, None], motions.parameters, K, root, cost)


def add_motions(equations: ChainEquations, motions: MotionRows, motion: Motion, parameters: FloatArray) -> float:
    """Add motions to equations whose first shared unknowns are the odometry's errors; their cost.

    Args:
        motion: prior of those errors.
        parameters: (P,) current values.
    """
    before, after, r, K = motions.before, motions.after, motions.residuals, motions.by_parameters
    equations.add_between(before, after, r)
    count = len(parameters)
    if not count:
        return motions.cost
    own, earlier = slice(0, count), np.arange(len(r))
    equations.add_shared(earlier, before, motions.parameters, K, r)
    equations.add_across(earlier + 1, after, motions.parameters, K)
    off = (motion.nominal - parameters) / motion.prior_sigma
    equations.corner[own, own] += np.diag(motion.prior_sigma**-2)
    equations.shared_gradient[own] += off / motion.prior_sigma
    return motions.cost + float((off**2).sum())


def noise_factors(motions: StandardMotions, states: FloatArray, across: FloatArray) -> FloatArray:
    """(6,) factors of the standard deviations, from the agreement of motions with the observations.

    One step of expectation maximization.  Where the cameras give little information, motion agrees with itself; only
    motions with enough camera information are used.

    Args:
        states, across: (N,6,6), (N-1,6,6) covariances of poses and of neighbors.
    """
    before, after, r = motions.before, motions.after, motions.residuals
    own = (before @ states[:-1] + after @ across.transpose(0, 2, 1)) @ before.transpose(0, 2, 1)
    own += (before @ across + after @ states[1:]) @ after.transpose(0, 2, 1)
    left, scales = np.einsum("nii->ni", own), np.ones(6)
    for k in range(6):
        determined = left[:, k] < KNOWN_BELOW
        if determined.sum() >= LEAST_TO_WEIGH:
            scale = np.sqrt(np.mean(np.minimum(r[determined, k] ** 2, SLIP_SIGMA**2) + left[determined, k]))
            scales[k] = np.clip(scale, 0.3, 3.0)
    return scales
