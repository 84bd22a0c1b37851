"""Joint adjustment of several cameras: all intrinsics, all poses of cameras, every board pose, board warp.

The unknowns that all frames share are, in this order: the intrinsics of every camera, T_camera_left of every camera
but the first (rotation, shift), two numbers of board warp.  Equations are those of `board_equations.py`, for any
number of cameras of which each sees the board in some frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.calibration.board_equations import (
    CONVERGED,
    DAMPING,
    LOSS_WIDTH,
    POSE,
    WARP,
    AtScale,
    Blocks,
    CameraCorners,
    board_and_turned,
    derivatives_by_pose,
    derivatives_by_warp,
    reduced_equations,
    robust_weight,
    scatter_between_pairs,
    widened,
)
from lmkit.calibration.intrinsics import intrinsics_prior, intrinsics_vector, with_intrinsics
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.rotations import rotation_exp
from lmkit.optim.levenberg_marquardt import minimize_rescaled
from lmkit.optim.robust_loss import cauchy_cost

ITERATIONS = 40


@dataclass(frozen=True, eq=False)
class RigSolution:
    """Values of all unknowns.

    Attributes:
        models: the cameras.
        R, t: (C,3,3), (C,3) of T_camera_left; those of the first camera are the identity.
        warp: (2,) bow of the board, meters.
        rotations, translations: (P,3,3), (P,3) T_left_board of every frame.
        covariance: (G,G) of the shared unknowns, or None.
    """

    models: tuple[CameraModel, ...]
    R: FloatArray
    t: FloatArray
    warp: FloatArray
    rotations: FloatArray
    translations: FloatArray
    covariance: FloatArray | None = None


class RigProblem:
    """Corners of all cameras in all frames; estimates all other unknowns.

    Args:
        cameras: the corners of every camera; frames that it does not see have none.
        frames: number of frames.
    """

    def __init__(self, cameras: Sequence[CameraCorners], frames: int) -> None:
        self.cameras, self.frames = cameras, frames

    def residuals(self, s: RigSolution) -> list[FloatArray]:
        """Per camera (N,2) observed minus projected pixels."""
        return [
            seen.pixels
            - model.project((board_and_turned(seen, s.warp, s.rotations)[1] + s.translations[seen.pair]) @ R.T + t)
            for seen, model, R, t in zip(self.cameras, s.models, s.R, s.t, strict=True)
        ]

    def solve(self, start: RigSolution) -> RigSolution:
        """Levenberg-Marquardt from ``start``; the result has its covariance."""
        prior = np.concatenate([*(intrinsics_prior(m) for m in start.models), np.zeros(self._poses(start) + WARP)])
        fitted = np.ones(len(prior), dtype=bool)
        current, scale = minimize_rescaled(
            lambda scale: AtScale(
                lambda s: self._cost(s, scale, prior), lambda s: self._equations(s, scale, prior), _moved, fitted
            ),
            self._scale,
            start,
            ITERATIONS,
            CONVERGED,
            DAMPING,
        )
        blocks = self._equations(current, scale, prior)
        reduced, _ = reduced_equations(blocks, fitted, 0.0)
        off = np.concatenate(self.residuals(current))
        weight = robust_weight(off, scale)
        degrees = max(2 * weight.sum() - len(fitted) - POSE * self.frames, 1.0)
        variance = float((weight[:, None] * off**2).sum() / degrees)
        covariance = np.linalg.pinv(reduced, hermitian=True) * variance
        scatter = scatter_between_pairs(blocks, fitted, reduced, variance)
        return replace(current, covariance=covariance if scatter is None else widened(covariance, scatter.factors))

    def _poses(self, s: RigSolution) -> int:
        return POSE * (len(s.models) - 1)

    def _scale(self, s: RigSolution) -> float:
        """Robust standard deviation of one pixel coordinate."""
        return max(float(np.median(np.abs(np.concatenate(self.residuals(s))))) / 0.6745, 1e-6)

    def _cost(self, s: RigSolution, scale: float, prior: FloatArray) -> float:
        squared = np.sum(np.concatenate(self.residuals(s)) ** 2, axis=1) / (LOSS_WIDTH * scale) ** 2
        total = float(cauchy_cost(squared, 1.0).sum() + np.sum((prior * _shared(s)) ** 2) / LOSS_WIDTH**2)
        return total if np.isfinite(total) else np.inf

    def _equations(self, s: RigSolution, scale: float, prior: FloatArray) -> Blocks:
        counts = [len(intrinsics_vector(model)) for model in s.models]
        starts, first = np.concatenate([[0], np.cumsum(counts)]), sum(counts) - POSE
        size = sum(counts) + self._poses(s) + WARP
        blocks = Blocks.empty(size, self.frames)
        for k, (seen, model, R, t) in enumerate(zip(self.cameras, s.models, s.R, s.t, strict=True)):
            _, turned = board_and_turned(seen, s.warp, s.rotations)
            there = (turned + s.translations[seen.pair]) @ R.T
            pixels, by_point, by_camera = model.project_with_jacobian(there + t)
            by_left_point = by_point @ R
            columns, shared = [np.arange(starts[k], starts[k + 1])], [by_camera]
            if k > 0:
                columns.append(first + POSE * k + np.arange(POSE))
                shared.append(derivatives_by_pose(by_point, there))
            columns.append(np.arange(size - WARP, size))
            shared.append(derivatives_by_warp(seen, by_left_point, s.rotations))
            by_pose = derivatives_by_pose(by_left_point, turned)
            blocks.add(
                seen, np.concatenate(columns), np.concatenate(shared, axis=2), by_pose, seen.pixels - pixels, scale
            )
        blocks.prior[:] = np.diag((prior * scale) ** 2)
        blocks.prior_gradient[:] = -((prior * scale) ** 2) * _shared(s)
        return blocks


def _moved(s: RigSolution, shared: FloatArray, poses: FloatArray) -> RigSolution:
    """The solution after a step.

    Raises:
        numpy.linalg.LinAlgError: the intrinsics are not valid.
    """
    models, at = [], 0
    try:
        for model in s.models:
            vector = intrinsics_vector(model)
            models.append(with_intrinsics(model, vector + shared[at : at + len(vector)]))
            at += len(vector)
    except ValueError as error:
        raise np.linalg.LinAlgError(str(error)) from None
    steps = np.concatenate([np.zeros((1, POSE)), shared[at:-WARP].reshape(-1, POSE)])
    return RigSolution(
        tuple(models),
        np.array([rotation_exp(step[:3]) @ R for step, R in zip(steps, s.R, strict=True)]),
        s.t + steps[:, 3:],
        s.warp + shared[-WARP:],
        np.array([rotation_exp(step[:3]) @ R for step, R in zip(poses, s.rotations, strict=True)]),
        s.translations + poses[:, 3:],
    )


def _shared(s: RigSolution) -> FloatArray:
    """The shared unknowns for the prior: camera poses have no prior."""
    intrinsics = [intrinsics_vector(model) for model in s.models]
    return np.concatenate([*intrinsics, np.zeros(POSE * (len(s.models) - 1)), s.warp])
