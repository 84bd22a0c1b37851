"""Normal equations of a board seen by cameras, for fits of one, two or more cameras.

All frames share unknowns (lenses, poses of cameras, board warp); every frame adds six for the board's pose, which are
eliminated (Schur complement).  Corners that do not fit are down-weighted by a Cauchy loss, whose scale is constant
during one step.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Generic, TypeVar

import numpy as np

from lmkit.arrays import BoolArray, FloatArray, IntArray
from lmkit.optim.levenberg_marquardt import Damping
from lmkit.optim.robust_loss import cauchy_weight

State = TypeVar("State")
WARP = 2
POSE = 6
DAMPING = Damping(start=1e-3, grow=10.0, first_grown=0.0)
CONVERGED = 1e-7  # relative gain; with some thousand residuals, a thousandth of a standard deviation of any parameter
LEAST_PAIRS = 3  # for an estimate of the scatter between pairs
LOSS_WIDTH = 3.0  # standard deviations at which the Cauchy loss halves its weight


def _warp_shapes(object_points: FloatArray) -> FloatArray:
    """(N,2) displacement of the board's points by a bow along each axis: parabolas, 1 at the center, 0 at the rim."""
    middle = (object_points.max(axis=0) + object_points.min(axis=0)) / 2
    half = np.maximum((object_points.max(axis=0) - object_points.min(axis=0)) / 2, 1e-9)
    scaled = (object_points - middle)[:, :2] / half[:2]
    return np.asarray(1 - scaled**2)


class CameraCorners:
    """Corners that one camera observed in all pairs, concatenated."""

    def __init__(
        self, seen: Sequence[tuple[IntArray, FloatArray]], object_points: FloatArray, sigma: FloatArray
    ) -> None:
        self.ids = np.concatenate([ids for ids, _ in seen])
        self.pixels = np.concatenate([pixels for _, pixels in seen])
        counts = np.array([len(ids) for ids, _ in seen])
        self.pair = np.repeat(np.arange(len(seen)), counts)
        self.ends = np.cumsum(counts)
        self.sigma = sigma[self.pair][:, None]
        self.object_points = object_points[self.ids]
        self.shapes = _warp_shapes(object_points)[self.ids]

    def per_pair(self, values: FloatArray) -> list[FloatArray]:
        """Rows of ``values`` split by pair."""
        return np.split(values, self.ends[:-1])


@dataclass(frozen=True, eq=False)
class AtScale(Generic[State]):
    """A calibration problem with a fixed robust scale.

    Attributes:
        cost: of a state.
        equations: the normal equations at a state.
        moved: the state after steps of the shared unknowns and of the boards' poses.
        fitted: (G,) whether each shared unknown is estimated.
    """

    cost: Callable[[State], float]
    equations: Callable[[State], Blocks]
    moved: Callable[[State, FloatArray, FloatArray], State]
    fitted: BoolArray

    def linearize(self, state: State) -> tuple[Callable[[], Blocks], float]:
        """The normal equations, computed when a step is first asked for, and the cost."""
        return cache(lambda: self.equations(state)), self.cost(state)

    def solve(self, equations: Callable[[], Blocks], damping: float) -> tuple[FloatArray, FloatArray]:
        """Steps of the shared unknowns and of the boards' poses."""
        return solve_step(equations(), self.fitted, damping)

    def retract(self, state: State, step: tuple[FloatArray, FloatArray]) -> State:
        """The state moved by a step.

        Raises:
            numpy.linalg.LinAlgError: the new state is not a valid camera.
        """
        return self.moved(state, *step)


@dataclass(frozen=True, eq=False)
class Blocks:
    """Normal equations, pair by pair: shared (P,G,G), mixed (P,G,6), poses (P,6,6), and the gradients; the prior."""

    shared: FloatArray
    mixed: FloatArray
    poses: FloatArray
    shared_gradient: FloatArray
    pose_gradient: FloatArray
    prior: FloatArray
    prior_gradient: FloatArray

    @classmethod
    def empty(cls, size: int, count: int) -> Blocks:
        shapes = ((count, size, size), (count, size, POSE), (count, POSE, POSE), (count, size), (count, POSE))
        return cls(*(np.zeros(shape) for shape in (*shapes, (size, size), (size,))))

    def add(
        self,
        camera: CameraCorners,
        columns: IntArray,
        shared: FloatArray,
        pose: FloatArray,
        residual: FloatArray,
        scale: float,
    ) -> None:
        """Add the equations of one camera.

        Args:
            camera: its corners.
            columns: (C,) the shared unknowns that its pixels depend on.
            shared: (N,2,C) derivatives by these, px.
            pose: (N,2,6) derivatives by the board's pose, px.
            residual: (N,2) observed minus projected, px.
            scale: the robust scale.
        """
        weight = robust_weight(residual / camera.sigma, scale)[:, None] / camera.sigma**2
        rows = np.concatenate([shared, pose, residual[:, :, None]], axis=2)
        rows *= np.sqrt(weight)[:, :, None]
        starts = np.concatenate([[0], camera.ends[:-1]])
        own, width = len(columns), len(columns) + POSE
        products = np.zeros((len(starts), width + 1, width + 1))
        for p, (a, b) in enumerate(zip(starts, camera.ends, strict=True)):
            J = rows[a:b].reshape(-1, width + 1)
            products[p] = J.T @ J  # BLAS knows that it is symmetric
        normal, gradient = products[:, :width, :width], products[:, :width, width]
        self.shared[:, columns[:, None], columns] += normal[:, :own, :own]
        self.mixed[:, columns] += normal[:, :own, own:]
        self.poses[:] += normal[:, own:, own:]
        self.shared_gradient[:, columns] += gradient[:, :own]
        self.pose_gradient[:] += gradient[:, own:]


def reduced_equations(
    blocks: Blocks, fitted: BoolArray, damping: float
) -> tuple[FloatArray, tuple[FloatArray, FloatArray]]:
    """The normal matrix of the fitted shared unknowns with the poses eliminated, and terms for back-substitution."""
    camera = np.arange(POSE)
    poses = blocks.poses.copy()
    poses[:, camera, camera] *= 1 + damping
    poses[:, camera, camera] += 1e-12
    inverse = np.linalg.inv(poses)
    mixed = blocks.mixed[:, fitted]
    back = mixed @ inverse
    shared = (blocks.shared.sum(axis=0) + blocks.prior)[np.ix_(fitted, fitted)]
    shared = shared + np.diag(damping * np.diag(shared) + 1e-12 * (damping > 0))
    return shared - np.tensordot(back, mixed, axes=((0, 2), (0, 2))), (inverse, back)


def solve_step(blocks: Blocks, fitted: BoolArray, damping: float) -> tuple[FloatArray, FloatArray]:
    """The damped step of the shared unknowns (G,) and of the poses (P,6)."""
    reduced, (inverse, back) = reduced_equations(blocks, fitted, damping)
    gradient = (blocks.shared_gradient.sum(axis=0) + blocks.prior_gradient)[fitted]
    gradient = gradient - np.einsum("pgi,pi->g", back, blocks.pose_gradient)
    shared = np.zeros(len(fitted))
    if fitted.any():
        try:
            shared[fitted] = np.linalg.solve(reduced, gradient)
        except np.linalg.LinAlgError:
            shared[fitted] = np.linalg.lstsq(reduced, gradient, rcond=None)[0]
    remaining = blocks.pose_gradient - np.einsum("pgi,g->pi", blocks.mixed, shared)
    return shared, np.einsum("pij,pj->pi", inverse, remaining)


@dataclass(frozen=True, eq=False)
class Scatter:
    """Scatter of the solution between pairs, over what independent corners cause; (F,) of the fitted unknowns.

    Attributes:
        ratios: variance between pairs over the variance that independent corners cause.
        corner_shares: share of each variance that corners cause; the rest is the prior's.
        pairs: number of pairs.
    """

    ratios: FloatArray
    corner_shares: FloatArray
    pairs: int

    @property
    def design_effect(self) -> float:
        """Factor of the variances by errors that corners of one image share, at least 1 (Kish 1965)."""
        return max(1.0, float(np.median(self.ratios)))

    @property
    def factors(self) -> FloatArray:
        """(F,) factors of the variances, at least 1.

        The ratio of a single unknown is noisy, so each is at least the median of all.
        """
        # With few pairs, the variance of Student's distribution replaces the normal one; of less than five pairs, the
        # jackknife itself is too large.
        student = (self.pairs - 1) / (self.pairs - 3) if self.pairs > 5 else 2.0
        ratios = student * self.ratios
        ratios = np.maximum(ratios, max(1.0, float(np.median(ratios))))
        return np.asarray(1 + (ratios - 1) * self.corner_shares)


def scatter_between_pairs(blocks: Blocks, fitted: BoolArray, reduced: FloatArray, variance: float) -> Scatter | None:
    """Scatter between pairs; None if it cannot be computed.

    The corners of one image have correlated errors (light, focus, lens model), so they carry less information than
    independent corners.  The pairs are independent: the changes of the solution when each is left out (the jackknife
    for clustered data, Bell and McCaffrey 2002) are compared with the covariance from the corners alone.

    Args:
        reduced: (F,F) normal matrix.
        variance: of a corner's coordinate, in units of the normal matrix.
    """
    if blocks.poses.shape[0] < LEAST_PAIRS or not fitted.any():
        return None
    inverse = np.linalg.inv(blocks.poses + 1e-12 * np.eye(POSE))
    back = blocks.mixed[:, fitted] @ inverse
    own = blocks.shared[:, fitted][:, :, fitted] - back @ blocks.mixed[:, fitted].transpose(0, 2, 1)
    pull = blocks.shared_gradient[:, fitted] - np.einsum("pgi,pi->pg", back, blocks.pose_gradient)
    try:
        moved = np.linalg.solve(reduced - own, pull[:, :, None])[:, :, 0]
    except np.linalg.LinAlgError:
        return None
    cofactors = np.linalg.pinv(reduced, hermitian=True)
    of_corners = np.diag(cofactors) - np.diag(cofactors @ blocks.prior[np.ix_(fitted, fitted)] @ cofactors)
    pairs = len(moved)
    between = (moved**2).sum(axis=0) * (pairs - 1) / pairs
    ratios = between / np.maximum(variance * of_corners, 1e-300)
    return Scatter(ratios, of_corners / np.maximum(np.diag(cofactors), 1e-300), pairs)


def widened(covariance: FloatArray, factors: FloatArray) -> FloatArray:
    """The covariance with its variances multiplied, its correlations kept."""
    root = np.sqrt(factors)
    return np.asarray(covariance * root[:, None] * root)


def robust_weight(whitened: FloatArray, scale: float) -> FloatArray:
    """(N,) Cauchy weights of residuals (N,2), px, at a robust scale."""
    return cauchy_weight(np.sum(whitened**2, axis=1), LOSS_WIDTH * scale)


def board_and_turned(camera: CameraCorners, warp: FloatArray, rotations: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(N,3) points of the bowed board, and the same turned by its pose."""
    board = camera.object_points.copy()
    board[:, 2] += camera.shapes @ warp
    return board, np.einsum("nij,nj->ni", rotations[camera.pair], board)


def derivatives_by_warp(camera: CameraCorners, by_point: FloatArray, rotations: FloatArray) -> FloatArray:
    """(N,2,2) px per meter of bow, from (N,2,3) px per meter in the frame of the boards' poses."""
    return np.asarray((by_point @ rotations[camera.pair][:, :, 2:]) * camera.shapes[:, None])


def derivatives_by_pose(by_point: FloatArray, turned: FloatArray) -> FloatArray:
    """(N,2,6) derivative with a rotation vector applied on the left and with a shift."""
    # d(w x p)/dw = -skew(p), so that row v becomes p x v.
    p, v = turned[:, None, :], by_point
    turn = [p[..., k] * v[..., m] - p[..., m] * v[..., k] for k, m in ((1, 2), (2, 0), (0, 1))]
    return np.concatenate([np.stack(turn, axis=2), by_point], axis=2)
