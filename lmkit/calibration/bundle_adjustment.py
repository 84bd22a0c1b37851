"""Joint bundle adjustment of a stereo camera: both cameras, their relative pose, every board pose, board warp.

The unknowns that all pairs share are, in this order: left intrinsics, right intrinsics, T_right_left
(rotation, shift), two numbers of board warp; every pair adds six for the board's pose in the left
camera.  Levenberg-Marquardt on the normal equations, the poses eliminated (Schur complement), with
derivatives from OpenCV's own projection, weighted by a Cauchy loss.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lmkit.arrays import BoolArray, FloatArray, IntArray
from lmkit.calibration.board_equations import (
    CONVERGED,
    DAMPING,
    LOSS_WIDTH,
    POSE,
    WARP,
    AtScale,
    Blocks,
    CameraCorners,
    Scatter,
    board_and_turned,
    derivatives_by_pose,
    derivatives_by_warp,
    reduced_equations,
    robust_weight,
    scatter_between_pairs,
    widened,
)
from lmkit.calibration.intrinsics import KnownIntrinsics, intrinsics_prior, intrinsics_vector, with_intrinsics
from lmkit.errors import InputError
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.rotations import rotation_exp
from lmkit.model.observation import PairView
from lmkit.optim.levenberg_marquardt import minimize_rescaled
from lmkit.optim.robust_loss import cauchy_cost

# A fit that another one continues, and a fit from an optimum of nearly the same problem.
ROUGHLY, NEARBY = 1e-4, 1e-7  # relative gain of its last step; damping of its first step
OWN_NOISE = 0.25  # share of the median image's variance that is the scatter of its own corners
MOST_NOISE = 10.0  # of an image's corners, over the median's


@dataclass(frozen=True)
class Solution:
    """Values of all unknowns, and the covariance.

    Attributes:
        left, right: cameras.
        R, t: of T_right_left.
        warp: (2,) bow of the board along x and y at its middle, meters.
        rotations, translations: (P,3,3), (P,3) T_left_board of every pair.
        covariance: (G,G) of left, right intrinsics, T_right_left and warp, or None.
    """

    left: CameraModel
    right: CameraModel
    R: FloatArray
    t: FloatArray
    warp: FloatArray
    rotations: FloatArray
    translations: FloatArray
    covariance: FloatArray | None = None

    def with_poses(self, rows: IntArray) -> Solution:
        """A copy with the board poses of some pairs."""
        return replace(self, rotations=self.rotations[rows], translations=self.translations[rows])


@dataclass(frozen=True)
class FitOptions:
    """Unknowns that are fitted besides the board poses.

    Attributes:
        intrinsics: of both cameras.
        relation: T_right_left.
        warp: the board's bow.
        iterations: at most.
        converged: relative gain below which a step is the last.
        damping: of the first step; small if the start is the optimum of nearly the same problem.
        known: a prior of the intrinsics, in place of the wide one for any lens.
        covariance: whether to compute the covariance, if any shared unknown is fitted.
    """

    intrinsics: bool = True
    relation: bool = True
    warp: bool = True
    iterations: int = 40
    converged: float = CONVERGED
    damping: float = DAMPING.start
    known: KnownIntrinsics | None = None
    covariance: bool = True


class StereoProblem:
    """The pairs and the board; estimates all other unknowns.

    If the right camera sees no view, only the left camera is fitted.

    Args:
        object_points: (N,3) corners of the board, meters.
        views: the pairs.
    """

    def __init__(self, object_points: FloatArray, views: Sequence[PairView]) -> None:
        self.count = len(views)
        self._last: tuple[Solution, tuple[FloatArray, FloatArray]] | None = None
        noise = np.array([[np.nan if n is None else n for n in (v.noise_left, v.noise_right)] for v in views])
        known = noise[np.isfinite(noise)]
        middle = float(np.median(known)) if len(known) else 1.0
        # Relative to the median image; the common noise follows from the residuals.  Most of the residuals
        # come from other sources, though: the lens model, the board, the light.
        relative = np.where(np.isfinite(noise), noise / max(middle, 1e-9), 1.0)
        relative = np.sqrt(OWN_NOISE * np.minimum(relative, MOST_NOISE) ** 2 + 1 - OWN_NOISE)
        self.left = CameraCorners([(v.ids_left, v.left) for v in views], object_points, relative[:, 0])
        self.right = CameraCorners([(v.ids_right, v.right) for v in views], object_points, relative[:, 1])

    def residuals(self, s: Solution) -> list[tuple[FloatArray, FloatArray]]:
        """Per pair, observed minus projected pixels of the left (N,2) and right (M,2) image."""
        left, right = self._residuals(s)
        return list(zip(self.left.per_pair(left), self.right.per_pair(right), strict=True))

    def mean_error(self, s: Solution) -> float:
        """Mean distance, px, of all corners from their projections."""
        return float(np.linalg.norm(np.concatenate(self._residuals(s)), axis=1).mean())

    def rms(self, s: Solution) -> FloatArray:
        """(P,) root mean square distance of each pair's corners, px, as if all images were equally sharp."""
        left, right = (
            camera.per_pair(r) for camera, r in zip((self.left, self.right), self._whitened(s), strict=True)
        )
        both = [np.concatenate(pair) for pair in zip(left, right, strict=True)]
        return np.array([np.sqrt(np.mean(np.sum(r**2, axis=1))) for r in both])

    def solve(self, start: Solution, options: FitOptions) -> Solution:
        """Levenberg-Marquardt from ``start``; the result has the covariance of the shared unknowns."""
        prior = _Prior.of(start, options.known)
        fitted = _fitted(start, options)
        if not len(self.right.ids):
            count = len(intrinsics_vector(start.left))
            fitted[count : len(fitted) - WARP] = False
        current, scale = self._minimize(start, options, prior, fitted)
        if not (options.covariance and fitted.any()):
            return current
        linear = self._linearized(current, scale, prior, fitted)
        if options.known is not None and linear.scatter is not None:
            # Corners share errors, so that they count less beside what is known of the lenses.
            prior = prior.beside_corners(linear.scatter.design_effect)
            current, scale = self._minimize(current, replace(options, damping=NEARBY), prior, fitted)
            linear = self._linearized(current, scale, prior, fitted)
        return replace(current, covariance=_covariance(linear, prior, fitted))

    def _minimize(
        self, start: Solution, options: FitOptions, prior: _Prior, fitted: BoolArray
    ) -> tuple[Solution, float]:
        """The solution without its covariance, and the robust scale."""
        return minimize_rescaled(
            lambda scale: AtScale(
                lambda s: self._cost(s, scale, prior),
                lambda s: self._normal_equations(s, scale, prior),
                _moved,
                fitted,
            ),
            self._scale,
            start,
            options.iterations,
            options.converged,
            replace(DAMPING, start=options.damping),
        )

    def _residuals(self, s: Solution) -> tuple[FloatArray, FloatArray]:
        """Left (N,2) and right (M,2); cached, since every step needs the cost and the scale of its state."""
        if self._last is None or self._last[0] is not s:
            in_left = _to_left(self.left, s)
            in_right = _to_left(self.right, s) @ s.R.T + s.t
            off = self.left.pixels - s.left.project(in_left), self.right.pixels - s.right.project(in_right)
            self._last = s, off
        return self._last[1]

    def _whitened(self, s: Solution) -> tuple[FloatArray, FloatArray]:
        left, right = self._residuals(s)
        return left / self.left.sigma, right / self.right.sigma

    def _scale(self, s: Solution) -> float:
        """Robust standard deviation of one pixel coordinate of the middle image."""
        return max(float(np.median(np.abs(np.concatenate(self._whitened(s))))) / 0.6745, 1e-6)

    def _cost(self, s: Solution, scale: float, prior: _Prior) -> float:
        squared = np.sum(np.concatenate(self._whitened(s)) ** 2, axis=1) / (LOSS_WIDTH * scale) ** 2
        total = float(cauchy_cost(squared, 1.0).sum() + np.sum(prior.pull(s) ** 2) / LOSS_WIDTH**2)
        return total if np.isfinite(total) else np.inf

    def _normal_equations(self, s: Solution, scale: float, prior: _Prior) -> Blocks:
        nl, nr = len(intrinsics_vector(s.left)), len(intrinsics_vector(s.right))
        size = nl + nr + POSE + WARP
        blocks = Blocks.empty(size, self.count)

        # Left camera: a pose step turns and shifts the board in the left camera's frame.
        camera, warp = self.left, np.arange(size - WARP, size)
        turned = board_and_turned(camera, s.warp, s.rotations)[1]
        pixels, by_point, by_camera = s.left.project_with_jacobian(turned + s.translations[camera.pair])
        shared = np.concatenate([by_camera, derivatives_by_warp(camera, by_point, s.rotations)], axis=2)
        columns = np.concatenate([np.arange(nl), warp])
        blocks.add(camera, columns, shared, derivatives_by_pose(by_point, turned), camera.pixels - pixels, scale)

        camera = self.right
        if not len(camera.ids):
            return self._with_prior(blocks, s, scale, prior)
        turned = board_and_turned(camera, s.warp, s.rotations)[1]
        in_right_turned = (turned + s.translations[camera.pair]) @ s.R.T
        pixels, by_point, by_camera = s.right.project_with_jacobian(in_right_turned + s.t)
        by_left_point = by_point @ s.R
        shared = np.concatenate(
            [
                by_camera,
                derivatives_by_pose(by_point, in_right_turned),
                derivatives_by_warp(camera, by_left_point, s.rotations),
            ],
            axis=2,
        )
        columns, by_pose = np.arange(nl, size), derivatives_by_pose(by_left_point, turned)
        blocks.add(camera, columns, shared, by_pose, camera.pixels - pixels, scale)

        return self._with_prior(blocks, s, scale, prior)

    def _with_prior(self, blocks: Blocks, s: Solution, scale: float, prior: _Prior) -> Blocks:
        blocks.prior[:] = prior.root.T @ prior.root * scale**2
        blocks.prior_gradient[:] = -prior.root.T @ prior.pull(s) * scale**2
        return blocks

    def _linearized(self, s: Solution, scale: float, prior: _Prior, fitted: BoolArray) -> _Linearized:
        """The normal matrix at a solution, and how corners scatter about it."""
        blocks = self._normal_equations(s, scale, prior)
        try:
            reduced, _ = reduced_equations(blocks, fitted, 0.0)
        except np.linalg.LinAlgError:
            raise InputError(
                "not_determined",
                "no fit near this rig explains the pairs",
                "check the values in the rig file, or calibrate again",
            ) from None
        residuals = np.concatenate(self._whitened(s))
        weight = robust_weight(residuals, scale)
        degrees = max(2 * weight.sum() - fitted.sum() - POSE * self.count, 1.0)
        variance = float(np.sum(weight[:, None] * residuals**2) / degrees) * prior.design_effect
        return _Linearized(reduced, variance, scatter_between_pairs(blocks, fitted, reduced, variance))


@dataclass(frozen=True, eq=False)
class _Linearized:
    """The (F,F) normal matrix of the fitted unknowns, the variance of a corner's coordinate, the scatter of pairs."""

    reduced: FloatArray
    variance: float
    scatter: Scatter | None


def _covariance(linear: _Linearized, prior: _Prior, fitted: BoolArray) -> FloatArray:
    """(G,G) covariance of the shared unknowns; rows of what was not fitted are zero."""
    covariance = np.linalg.pinv(linear.reduced, hermitian=True) * linear.variance
    if linear.scatter is not None:
        factors = np.minimum(linear.scatter.factors, prior.most_widened(fitted, covariance))
        covariance = widened(covariance, factors)
    full = np.zeros((len(fitted), len(fitted)))
    full[np.ix_(fitted, fitted)] = covariance
    return full


@dataclass(frozen=True, eq=False)
class _Prior:
    """Prior of the shared unknowns.

    Attributes:
        mean: (G,) values.
        root: (G,G) root of the information, beside corners that count as if they were independent.
        stated: (G,) variances, None for the wide prior of any lens.
        design_effect: variance that corners cause, over that of independent corners.
    """

    mean: FloatArray
    root: FloatArray
    stated: FloatArray | None = None
    design_effect: float = 1.0

    @classmethod
    def of(cls, s: Solution, known: KnownIntrinsics | None) -> _Prior:
        others = np.zeros(POSE + WARP)
        if known is not None:
            count = len(known.mean)
            root = np.zeros((count + len(others), count + len(others)))
            root[:count, :count] = known.root
            variances = np.concatenate([np.diag(known.covariance), np.full(len(others), np.inf)])
            return cls(np.concatenate([known.mean, others]), root, variances)
        weight = np.concatenate([intrinsics_prior(s.left), intrinsics_prior(s.right), others])
        return cls(np.zeros(len(weight)), np.diag(weight))

    def beside_corners(self, design_effect: float) -> _Prior:
        """The prior beside corners whose errors are correlated."""
        return replace(self, root=self.root * np.sqrt(design_effect), design_effect=design_effect)

    def pull(self, s: Solution) -> FloatArray:
        """(G,) distances from the values, in standard deviations."""
        return np.asarray(self.root @ (_shared_vector(s) - self.mean))

    def most_widened(self, fitted: BoolArray, covariance: FloatArray) -> FloatArray:
        """(F,) largest factors of the variances: no variance exceeds its prior."""
        if self.stated is None:
            return np.full(int(fitted.sum()), np.inf)
        return np.asarray(np.maximum(self.stated[fitted] / np.diag(covariance), 1.0))


def _fitted(s: Solution, options: FitOptions) -> BoolArray:
    counts = [len(intrinsics_vector(s.left)) + len(intrinsics_vector(s.right)), POSE, WARP]
    return np.repeat([options.intrinsics, options.relation, options.warp], counts)


def _moved(s: Solution, shared: FloatArray, poses: FloatArray) -> Solution:
    """The solution after a step.

    Raises:
        numpy.linalg.LinAlgError: the intrinsics are not valid.
    """
    left, right = intrinsics_vector(s.left), intrinsics_vector(s.right)
    nl, nr = len(left), len(right)
    try:
        new_left = with_intrinsics(s.left, left + shared[:nl])
        new_right = with_intrinsics(s.right, right + shared[nl : nl + nr])
    except ValueError as error:
        raise np.linalg.LinAlgError(str(error)) from None
    relation = shared[nl + nr : nl + nr + POSE]
    return Solution(
        new_left,
        new_right,
        rotation_exp(relation[:3]) @ s.R,
        s.t + relation[3:],
        s.warp + shared[-WARP:],
        rotation_exp(poses[:, :3]) @ s.rotations,
        s.translations + poses[:, 3:],
    )


def _shared_vector(s: Solution) -> FloatArray:
    """The shared unknowns for the prior: the relative pose has no prior."""
    return np.concatenate([intrinsics_vector(s.left), intrinsics_vector(s.right), np.zeros(POSE), s.warp])


def _to_left(camera: CameraCorners, s: Solution) -> FloatArray:
    return np.asarray(board_and_turned(camera, s.warp, s.rotations)[1] + s.translations[camera.pair])
