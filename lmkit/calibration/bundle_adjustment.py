"""Joint bundle adjustment of a stereo camera: both cameras, their relation, every board pose, board warp.

The unknowns that all pairs share are, in this order: left intrinsics, right intrinsics, T_right_left
(rotation, shift), two numbers of board warp; every pair adds six for the board's pose in the left
camera.  Levenberg-Marquardt on the normal equations, the poses eliminated (Schur complement), with
derivatives from OpenCV's own projection, weighted by a Cauchy loss.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Generic, TypeVar

import numpy as np

from lmkit.arrays import BoolArray, FloatArray, IntArray
from lmkit.calibration.intrinsics import KnownIntrinsics, intrinsics_prior, intrinsics_vector, with_intrinsics
from lmkit.errors import InputError
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.rotations import rotation_exp
from lmkit.model.observation import PairView
from lmkit.optim.levenberg_marquardt import Damping, minimize_rescaled
from lmkit.optim.robust_loss import cauchy_cost, cauchy_weight

State = TypeVar("State")
WARP = 2
POSE = 6
OWN_NOISE = 0.25  # share of a middling image's variance that is the scatter of its own corners
MOST_NOISE = 10.0  # of an image's corners, over the median's
DAMPING = Damping(start=1e-3, grow=10.0, first_grown=0.0)
CONVERGED = 1e-7  # relative gain; of some thousand residuals, a thousandth of a standard deviation of anything
LEAST_PAIRS = 8  # for the scatter between pairs to tell anything
LOSS_WIDTH = 3.0  # standard deviations at which the Cauchy loss halves its weight


@dataclass(frozen=True)
class Solution:
    """A point in the space of unknowns, and how well it explains the images.

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
        converged: the relative gain of the last step.
        known: a prior of the intrinsics, in place of the wide one for any lens.
    """

    intrinsics: bool = True
    relation: bool = True
    warp: bool = True
    iterations: int = 40
    converged: float = CONVERGED
    known: KnownIntrinsics | None = None


def _warp_shapes(object_points: FloatArray) -> FloatArray:
    """(N,2) how far a bow along each axis of the board lifts its points: parabolas, 1 at the center, 0 at the rim."""
    middle = (object_points.max(axis=0) + object_points.min(axis=0)) / 2
    half = np.maximum((object_points.max(axis=0) - object_points.min(axis=0)) / 2, 1e-9)
    scaled = (object_points - middle)[:, :2] / half[:2]
    return np.asarray(1 - scaled**2)


class CameraCorners:
    """Corners that one camera observed in all pairs, end to end."""

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


class StereoProblem:
    """The pairs and the board; solves for everything else.

    Views that the right camera never sees are those of one camera: then only the left one is fitted.

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
        # Relative to the middle image: how noisy they are all together, the residuals tell.  Most of what they
        # show comes from what no image tells, though: the lens model, the board, the light.
        relative = np.where(np.isfinite(noise), noise / max(middle, 1e-9), 1.0)
        relative = np.sqrt(OWN_NOISE * np.minimum(relative, MOST_NOISE) ** 2 + 1 - OWN_NOISE)
        self.left = CameraCorners([(v.ids_left, v.left) for v in views], object_points, relative[:, 0])
        self.right = CameraCorners([(v.ids_right, v.right) for v in views], object_points, relative[:, 1])

    def residuals(self, s: Solution) -> list[tuple[FloatArray, FloatArray]]:
        """Per pair, observed minus projected pixels of the left (N,2) and right (M,2) image."""
        left, right = self._residuals(s)
        return list(zip(self.left.per_pair(left), self.right.per_pair(right), strict=True))

    def mean_error(self, s: Solution) -> float:
        """Mean distance, px, of all corners from where the solution puts them."""
        return float(np.linalg.norm(np.concatenate(self._residuals(s)), axis=1).mean())

    def rms(self, s: Solution) -> FloatArray:
        """(P,) root mean square distance of each pair's corners, px, as if all images were equally sharp."""
        left, right = (
            camera.per_pair(r) for camera, r in zip((self.left, self.right), self._whitened(s), strict=True)
        )
        both = [np.concatenate(pair) for pair in zip(left, right, strict=True)]
        return np.array([np.sqrt(np.mean(np.sum(r**2, axis=1))) for r in both])

    def solve(self, start: Solution, options: FitOptions) -> Solution:
        """Levenberg-Marquardt from ``start``; the result carries the covariance of what is shared."""
        prior = _Prior.of(start, options.known)
        fitted = _fitted(start, options)
        if not len(self.right.ids):
            count = len(intrinsics_vector(start.left))
            fitted[count : len(fitted) - WARP] = False
        current, scale = minimize_rescaled(
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
            DAMPING,
        )
        if not fitted.any():
            return current
        return replace(current, covariance=self._covariance(current, scale, prior, fitted))

    def _residuals(self, s: Solution) -> tuple[FloatArray, FloatArray]:
        """Left (N,2) and right (M,2); kept, since every step asks for the cost and for the scale of its state."""
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

    def _covariance(self, s: Solution, scale: float, prior: _Prior, fitted: BoolArray) -> FloatArray:
        """(G,G) covariance of the shared unknowns; rows of what was not fitted are zero."""
        blocks = self._normal_equations(s, scale, prior)
        try:
            reduced, _ = reduced_equations(blocks, fitted, 0.0)
        except np.linalg.LinAlgError:
            raise InputError(
                "not_determined",
                "no fit near this rig explains the pairs",
                "check the rig's numbers, or calibrate anew",
            ) from None
        residuals = np.concatenate(self._whitened(s))
        weight = robust_weight(residuals, scale)
        degrees = max(2 * weight.sum() - fitted.sum() - POSE * self.count, 1.0)
        variance = float(np.sum(weight[:, None] * residuals**2) / degrees)
        covariance = np.linalg.pinv(reduced, hermitian=True) * variance
        full = np.zeros((len(fitted), len(fitted)))
        factors = scatter_between_pairs(blocks, fitted, reduced, covariance)
        factors = np.minimum(factors, prior.most_widened(fitted, covariance))
        full[np.ix_(fitted, fitted)] = widened(covariance, factors)
        return full


@dataclass(frozen=True, eq=False)
class _Prior:
    """Shared unknowns as known before anything was seen: (G,) values, (G,G) root of the information, variances."""

    mean: FloatArray
    root: FloatArray
    stated: FloatArray | None = None

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

    def pull(self, s: Solution) -> FloatArray:
        """(G,) distances from the values, in standard deviations."""
        return np.asarray(self.root @ (_shared_vector(s) - self.mean))

    def most_widened(self, fitted: BoolArray, covariance: FloatArray) -> FloatArray:
        """(F,) largest factors of the variances: nothing is known worse than was stated before."""
        if self.stated is None:
            return np.full(int(fitted.sum()), np.inf)
        return np.asarray(np.maximum(self.stated[fitted] / np.diag(covariance), 1.0))


@dataclass(frozen=True, eq=False)
class AtScale(Generic[State]):
    """A problem of calibration with its robust scale held.

    Attributes:
        cost: of a state.
        equations: the normal equations at a state.
        moved: the state after steps of what is shared and of the boards' poses.
        fitted: (G,) which of the shared unknowns are solved for.
    """

    cost: Callable[[State], float]
    equations: Callable[[State], Blocks]
    moved: Callable[[State, FloatArray, FloatArray], State]
    fitted: BoolArray

    def linearize(self, state: State) -> tuple[Callable[[], Blocks], float]:
        """The normal equations, computed when a step is first asked for, and the cost."""
        return cache(lambda: self.equations(state)), self.cost(state)

    def solve(self, equations: Callable[[], Blocks], damping: float) -> tuple[FloatArray, FloatArray]:
        """Steps of what is shared and of the boards' poses."""
        return solve_step(equations(), self.fitted, damping)

    def retract(self, state: State, step: tuple[FloatArray, FloatArray]) -> State:
        """The state moved by a step.

        Raises:
            numpy.linalg.LinAlgError: it leaves what a camera can be.
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
        """Add what one camera says.

        Args:
            camera: its corners.
            columns: (C,) the shared unknowns that its pixels depend on.
            shared: (N,2,C) derivatives by these, px.
            pose: (N,2,6) derivatives by the board's pose, px.
            residual: (N,2) observed minus projected, px.
            scale: the robust scale.
        """
        weight = robust_weight(residual / camera.sigma, scale)[:, None] / camera.sigma**2
        both = np.concatenate([shared, pose], axis=2)
        weighted = weight[:, :, None] * both
        starts = np.concatenate([[0], camera.ends[:-1]])
        own, width = len(columns), len(columns) + POSE
        normal, gradient = np.zeros((len(starts), width, width)), np.zeros((len(starts), width))
        for p, (a, b) in enumerate(zip(starts, camera.ends, strict=True)):
            WJ = weighted[a:b].reshape(-1, width)
            normal[p], gradient[p] = WJ.T @ both[a:b].reshape(-1, width), WJ.T @ residual[a:b].ravel()
        self.shared[:, columns[:, None], columns] += normal[:, :own, :own]
        self.mixed[:, columns] += normal[:, :own, own:]
        self.poses[:] += normal[:, own:, own:]
        self.shared_gradient[:, columns] += gradient[:, :own]
        self.pose_gradient[:] += gradient[:, own:]


def _fitted(s: Solution, options: FitOptions) -> BoolArray:
    counts = [len(intrinsics_vector(s.left)) + len(intrinsics_vector(s.right)), POSE, WARP]
    return np.repeat([options.intrinsics, options.relation, options.warp], counts)


def reduced_equations(
    blocks: Blocks, fitted: BoolArray, damping: float
) -> tuple[FloatArray, tuple[FloatArray, FloatArray]]:
    """The normal matrix of the fitted shared unknowns with the poses eliminated, and what leads back to them."""
    camera = np.arange(POSE)
    poses = blocks.poses.copy()
    poses[:, camera, camera] *= 1 + damping
    poses[:, camera, camera] += 1e-12
    inverse = np.linalg.inv(poses)
    mixed = blocks.mixed[:, fitted]
    back = mixed @ inverse
    shared = (blocks.shared.sum(axis=0) + blocks.prior)[np.ix_(fitted, fitted)]
    shared = shared + np.diag(damping * np.diag(shared) + 1e-12 * (damping > 0))
    return shared - np.einsum("pgi,phi->gh", back, mixed), (inverse, back)


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


def scatter_between_pairs(
    blocks: Blocks, fitted: BoolArray, reduced: FloatArray, covariance: FloatArray
) -> FloatArray:
    """(F,) how many times larger each variance is when the pairs speak for themselves, at least 1.

    The corners of one image err together (light, focus, what the lens model leaves over), so that they count for
    less than as many independent ones.  The pairs are independent: what the solution does when each of them is left
    out (the jackknife, as Bell and McCaffrey 2002 have it for clustered data), over what the corners alone promise.
    A single number's ratio is noisy, so none counts for less than the median of all.
    """
    count = int(fitted.sum())
    if blocks.poses.shape[0] < LEAST_PAIRS or not count:
        return np.ones(count)
    inverse = np.linalg.inv(blocks.poses + 1e-12 * np.eye(POSE))
    back = blocks.mixed[:, fitted] @ inverse
    own = blocks.shared[:, fitted][:, :, fitted] - back @ blocks.mixed[:, fitted].transpose(0, 2, 1)
    pull = blocks.shared_gradient[:, fitted] - np.einsum("pgi,pi->pg", back, blocks.pose_gradient)
    try:
        moved = np.linalg.solve(reduced - own, pull[:, :, None])[:, :, 0]
    except np.linalg.LinAlgError:
        return np.ones(count)
    pairs = len(moved)
    # So few of them have the tails of Student's distribution: its variance, in place of the normal one's.
    variance = (moved**2).sum(axis=0) * (pairs - 1) / pairs * (pairs - 1) / (pairs - 3)
    ratios = variance / np.maximum(np.diag(covariance), 1e-300)
    return np.asarray(np.maximum(ratios, max(1.0, float(np.median(ratios)))))


def widened(covariance: FloatArray, factors: FloatArray) -> FloatArray:
    """The covariance with its variances multiplied, its correlations kept."""
    root = np.sqrt(factors)
    return np.asarray(covariance * root[:, None] * root)


def _moved(s: Solution, shared: FloatArray, poses: FloatArray) -> Solution:
    """The solution after a step.

    Raises:
        numpy.linalg.LinAlgError: no camera has such intrinsics.
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
        np.array([rotation_exp(p[:3]) @ R for p, R in zip(poses, s.rotations, strict=True)]),
        s.translations + poses[:, 3:],
    )


def _shared_vector(s: Solution) -> FloatArray:
    """The shared unknowns as the prior sees them: no relation is likelier than another."""
    return np.concatenate([intrinsics_vector(s.left), intrinsics_vector(s.right), np.zeros(POSE), s.warp])


def robust_weight(whitened: FloatArray, scale: float) -> FloatArray:
    """(N,) Cauchy weights of residuals (N,2), px, at a robust scale."""
    return cauchy_weight(np.sum(whitened**2, axis=1), LOSS_WIDTH * scale)


def board_and_turned(camera: CameraCorners, warp: FloatArray, rotations: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(N,3) points of the bowed board, and the same turned by its pose."""
    board = camera.object_points.copy()
    board[:, 2] += camera.shapes @ warp
    return board, np.einsum("nij,nj->ni", rotations[camera.pair], board)


def _to_left(camera: CameraCorners, s: Solution) -> FloatArray:
    return np.asarray(board_and_turned(camera, s.warp, s.rotations)[1] + s.translations[camera.pair])


def derivatives_by_warp(camera: CameraCorners, by_point: FloatArray, rotations: FloatArray) -> FloatArray:
    """(N,2,2) px per meter of bow, from (N,2,3) px per meter in the frame of the boards' poses."""
    return np.asarray((by_point @ rotations[camera.pair][:, :, 2:]) * camera.shapes[:, None])


def derivatives_by_pose(by_point: FloatArray, turned: FloatArray) -> FloatArray:
    """(N,2,6) derivative with a rotation vector applied on the left and with a shift."""
    # d(w x p)/dw = -skew(p), so that row v becomes p x v.
    p, v = turned[:, None, :], by_point
    turn = [p[..., k] * v[..., m] - p[..., m] * v[..., k] for k, m in ((1, 2), (2, 0), (0, 1))]
    return np.concatenate([np.stack(turn, axis=2), by_point], axis=2)
