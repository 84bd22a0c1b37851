"""Joint bundle adjustment of a stereo camera: both eyes, their relation, every board pose, board warp.

The unknowns are, in this order: left intrinsics, right intrinsics, T_right_left, two numbers of
board warp, then six numbers per pair for the board's pose in the left camera.  Levenberg-Marquardt
on the normal equations, with derivatives from OpenCV's own projection, weighted by a Cauchy loss.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lmkit.arrays import FloatArray, IntArray
from lmkit.model.camera import CameraModel
from lmkit.model.pose import rotation_exp, skew

WARP = 2
POSE = 6


@dataclass(frozen=True)
class PairView:
    """One stereo pair's corners.

    Attributes:
        name: of the pair.
        ids_left, ids_right: (N,), (M,) rows of the board's object points.
        left, right: (N,2), (M,2) pixels.
    """

    name: str
    ids_left: IntArray
    left: FloatArray
    ids_right: IntArray
    right: FloatArray


@dataclass(frozen=True)
class Solution:
    """A point in the space of unknowns, and how well it explains the pictures.

    Attributes:
        left, right: cameras.
        R, t: of T_right_left.
        warp: (2,) bow of the board along x and y at its middle, metres.
        rotations, translations: (P,3,3), (P,3) T_left_board of every pair.
        covariance_globals: of left, right intrinsics, T_right_left and warp, or None.
    """

    left: CameraModel
    right: CameraModel
    R: FloatArray
    t: FloatArray
    warp: FloatArray
    rotations: FloatArray
    translations: FloatArray
    covariance_globals: FloatArray | None = None


@dataclass(frozen=True)
class FitOptions:
    """What is fitted.

    Attributes:
        warp: fit the board's bow.
        iterations: at most.
    """

    warp: bool = True
    iterations: int = 40


def warped(object_points: FloatArray, warp: FloatArray) -> FloatArray:
    """Object points of a board bowed by ``warp`` along its two axes (parabolas, zero at the rim)."""
    return object_points + np.column_stack([np.zeros((len(object_points), 2)), _warp_shapes(object_points) @ warp])


def _warp_shapes(object_points: FloatArray) -> FloatArray:
    middle = (object_points.max(axis=0) + object_points.min(axis=0)) / 2
    half = np.maximum((object_points.max(axis=0) - object_points.min(axis=0)) / 2, 1e-9)
    scaled = (object_points - middle)[:, :2] / half[:2]
    return np.asarray(1 - scaled**2)


def intrinsics_vector(camera: CameraModel) -> FloatArray:
    """fx fy cx cy, then the distortion."""
    K = camera.K
    return np.concatenate([[K[0, 0], K[1, 1], K[0, 2], K[1, 2]], camera.distortion])


def with_intrinsics(camera: CameraModel, vector: FloatArray) -> CameraModel:
    """The camera with other intrinsics, see :func:`intrinsics_vector`."""
    K = np.array([[vector[0], 0, vector[2]], [0, vector[1], vector[3]], [0, 0, 1.0]])
    return CameraModel(camera.image_size, K, vector[4:], camera.model)


class StereoProblem:
    """The pairs and the board; solves for everything else."""

    def __init__(self, object_points: FloatArray, views: Sequence[PairView]) -> None:
        self.object_points = object_points
        self.views = list(views)
        self.shapes = _warp_shapes(object_points)

    def residuals(self, s: Solution) -> list[tuple[FloatArray, FloatArray]]:
        """Per pair, observed minus projected pixels of the left (N,2) and right (M,2) picture."""
        board = warped(self.object_points, s.warp)
        result: list[tuple[FloatArray, FloatArray]] = []
        for view, R, t in zip(self.views, s.rotations, s.translations, strict=True):
            left = s.left.project(board[view.ids_left] @ R.T + t)
            inside_right = (board[view.ids_right] @ R.T + t) @ s.R.T + s.t
            result.append((view.left - left, view.right - s.right.project(inside_right)))
        return result

    def solve(self, start: Solution, options: FitOptions) -> Solution:
        """Levenberg-Marquardt from ``start``; the result carries the covariance of the globals."""
        current = start
        scale = self._scale(current)
        cost = self._cost(current, scale)
        damping = 1e-3
        fitted = self._fitted(start, options)
        for _ in range(options.iterations):
            normal, gradient = self._normal_equations(current, scale)
            free = normal[np.ix_(fitted, fitted)]
            better: Solution | None = None
            for _ in range(8):
                step = np.zeros(len(normal))
                damped = free + damping * np.diag(np.diag(free) + 1e-12)
                step[fitted] = np.linalg.solve(damped, gradient[fitted])
                trial = self._moved(current, step)
                if trial is not None:
                    trial_cost = self._cost(trial, scale)
                    if trial_cost < cost:
                        better = trial
                        break
                damping *= 10
            if better is None:
                break
            gain = (cost - trial_cost) / cost
            current = better
            damping = max(damping / 10, 1e-9)
            scale = self._scale(current)
            cost = self._cost(current, scale)
            if gain < 1e-9:
                break
        return replace(current, covariance_globals=self._covariance(current, scale, fitted))

    def _fitted(self, s: Solution, options: FitOptions) -> IntArray:
        nl, nr = len(intrinsics_vector(s.left)), len(intrinsics_vector(s.right))
        keep = np.ones(nl + nr + POSE + WARP + POSE * len(self.views), dtype=bool)
        if not options.warp:
            keep[nl + nr + POSE : nl + nr + POSE + WARP] = False
        return np.flatnonzero(keep)

    def _scale(self, s: Solution) -> float:
        """Robust standard deviation of one pixel coordinate."""
        every = np.concatenate([np.abs(np.concatenate(pair).ravel()) for pair in self.residuals(s)])
        return max(float(np.median(every)) / 0.6745, 1e-6)

    def _cost(self, s: Solution, scale: float) -> float:
        total = 0.0
        for pair in self.residuals(s):
            squared = np.sum(np.concatenate(pair) ** 2, axis=1) / (LOSS_WIDTH * scale) ** 2
            total += float(np.log1p(squared).sum())
        return total if np.isfinite(total) else np.inf

    def _normal_equations(self, s: Solution, scale: float) -> tuple[FloatArray, FloatArray]:
        nl, nr = len(intrinsics_vector(s.left)), len(intrinsics_vector(s.right))
        shared = nl + nr + POSE + WARP
        size = shared + POSE * len(self.views)
        normal, gradient = np.zeros((size, size)), np.zeros(size)
        board = warped(self.object_points, s.warp)
        for index, (view, R, t) in enumerate(zip(self.views, s.rotations, s.translations, strict=True)):
            # Left eye: a pose step turns and shifts the board in the left camera's frame.
            points = board[view.ids_left]
            pixels, by_point, by_camera = s.left.project_with_jacobian(points @ R.T + t)
            J = np.zeros((len(points), 2, shared + POSE))
            J[:, :, :nl] = by_camera
            J[:, :, shared - WARP : shared] = (by_point @ R[:, 2])[:, :, None] * self.shapes[view.ids_left][:, None]
            J[:, :, shared:] = _by_pose(by_point, points @ R.T)
            self._add(normal, gradient, J, view.left - pixels, scale, shared, index)

            points = board[view.ids_right]
            in_left = points @ R.T + t
            Rr, tr = s.R @ R, s.R @ t + s.t
            pixels, by_point, by_camera = s.right.project_with_jacobian(points @ Rr.T + tr)
            J = np.zeros((len(points), 2, shared + POSE))
            J[:, :, nl : nl + nr] = by_camera
            J[:, :, nl + nr : nl + nr + POSE] = _by_pose(by_point, in_left @ s.R.T)
            J[:, :, shared - WARP : shared] = (by_point @ Rr[:, 2])[:, :, None] * self.shapes[view.ids_right][:, None]
            J[:, :, shared:] = _by_pose(by_point @ s.R, points @ R.T)
            self._add(normal, gradient, J, view.right - pixels, scale, shared, index)
        return normal, gradient

    @staticmethod
    def _add(
        normal: FloatArray,
        gradient: FloatArray,
        J: FloatArray,
        residual: FloatArray,
        scale: float,
        shared: int,
        index: int,
    ) -> None:
        weight = 1 / (1 + np.sum(residual**2, axis=1) / (LOSS_WIDTH * scale) ** 2)
        weighted = (J * weight[:, None, None]).reshape(-1, J.shape[2])
        JtJ = weighted.T @ J.reshape(-1, J.shape[2])
        Jtr = weighted.T @ residual.ravel()
        at = np.concatenate([np.arange(shared), shared + POSE * index + np.arange(POSE)])
        normal[np.ix_(at, at)] += JtJ
        gradient[at] += Jtr

    def _moved(self, s: Solution, step: FloatArray) -> Solution | None:
        """The solution after a step, or None where it leads to no camera."""
        left, right = intrinsics_vector(s.left), intrinsics_vector(s.right)
        nl, nr = len(left), len(right)
        shared = nl + nr + POSE + WARP
        try:
            new_left = with_intrinsics(s.left, left + step[:nl])
            new_right = with_intrinsics(s.right, right + step[nl : nl + nr])
        except ValueError:
            return None
        rig = step[nl + nr : nl + nr + POSE]
        poses = step[shared:].reshape(-1, POSE)
        return Solution(
            new_left,
            new_right,
            rotation_exp(rig[:3]) @ s.R,
            s.t + rig[3:],
            s.warp + step[shared - WARP : shared],
            np.array([rotation_exp(p[:3]) @ R for p, R in zip(poses, s.rotations, strict=True)]),
            s.translations + poses[:, 3:],
        )

    def _covariance(self, s: Solution, scale: float, fitted: IntArray) -> FloatArray:
        """(G,G) covariance of the shared unknowns; rows of what was not fitted are zero."""
        normal, _ = self._normal_equations(s, scale)
        shared = len(normal) - POSE * len(self.views)
        residuals = np.concatenate([np.concatenate(pair) for pair in self.residuals(s)])
        weight = 1 / (1 + np.sum(residuals**2, axis=1) / (LOSS_WIDTH * scale) ** 2)
        degrees = max(2 * weight.sum() - len(fitted), 1.0)
        variance = float(np.sum(weight[:, None] * residuals**2) / degrees)
        inverse = np.linalg.pinv(normal[np.ix_(fitted, fitted)], hermitian=True) * variance
        full = np.zeros((len(normal), len(normal)))
        full[np.ix_(fitted, fitted)] = inverse
        return full[:shared, :shared]


LOSS_WIDTH = 3.0  # standard deviations at which the Cauchy loss bends


def _by_pose(by_point: FloatArray, turned: FloatArray) -> FloatArray:
    """(N,2,6) derivative with a rotation vector applied on the left and with a shift."""
    crosses = np.stack([-skew(p) for p in turned]) if len(turned) else np.zeros((0, 3, 3))
    return np.concatenate([by_point @ crosses, by_point], axis=2)
