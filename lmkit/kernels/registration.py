"""Registration of a landmark's pattern on pixels in linear light: Gauss-Newton with the inks eliminated.

A state is (15,), see `plane.py`.
"""

from __future__ import annotations

import ctypes
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.grid_pattern import GridDrawing, jets_numpy
from lmkit.kernels.load import addresses, contiguous, function
from lmkit.kernels.mosaic import MosaicRules, mosaic_weights_numpy
from lmkit.kernels.pattern import INKS, JET, Drawing
from lmkit.kernels.plane import STATE, View, homography_numpy, light_numpy, plane_numpy, spread_in_plane

FloatArray = NDArray[np.floating[Any]]
Float32Array = NDArray[np.float32]

BLOCK = 64
BLUE_GREEN_RED = np.array([-1.0, 0.0, 1.0])  # signs of their displacement from green
TO_PLACE = 100.0  # decrease of chi2: smaller steps are not tried before the last round
EVIDENT_BLOCKS = 10  # number of pixel blocks that is sufficient to determine the place of a mosaic's colors


class Samples(NamedTuple):
    """Pixels, single precision.

    Attributes:
        at: (2,N) positions relative to the view's origin, px.
        values: (3,N) linear-light BGR.
        variance: (N,) expected variance of a value.
    """

    at: Float32Array
    values: Float32Array
    variance: Float32Array

    @classmethod
    def of(cls, at: Any, values: Any, variance: Any) -> Samples:
        """Contiguous arrays of consistent shapes.

        Raises:
            ValueError: a shape differs, or there is no pixel.
        """
        variance = contiguous(variance, (-1,), np.float32)
        if len(variance) == 0:
            raise ValueError("no pixels")
        n = len(variance)
        return cls(contiguous(at, (2, n), np.float32), contiguous(values, (3, n), np.float32), variance)


class Mosaic(NamedTuple):
    """(N,) cells of the pixels, and the weights of interpolated values of a color mosaic; see `mosaic.py`."""

    cells: Float32Array
    rules: MosaicRules


class Hypothesis(NamedTuple):
    """Bit k of ``open_gaps`` is set where gap k (of the quad's frame) is open; quarter turns of the triangle."""

    open_gaps: int
    quarter: int


class Priors(NamedTuple):
    """Standard deviations of distortion, shading, bias and shift of colors, the relative ridge of the inks, and the
    priors' weight."""

    ridge: float
    distortion: float
    shading: float
    bias: float
    weight: float
    color_shift: float


class Limits(NamedTuple):
    """Eigenvalues of the point spread (px^2), and the largest distortion, shading and bias."""

    least_spread: float
    most_spread: float
    distortion: float
    shading: float
    bias: float


class Linearization(NamedTuple):
    """(15,15) J'WJ and (15,) J'Wr with the inks eliminated, and the error per value, priors included."""

    normal: FloatArray
    gradient: FloatArray
    error: float


class Steps(NamedTuple):
    """Limits of a registration.

    Attributes:
        rounds: number of times that outliers are down-weighted; 0 keeps the weights.
        most: largest number of steps in a round.
        to_px: a round ends if no corner moves more.
        fit_distortion: also fit the radial distortion.
        negligible: decrease of chi2; a step with a smaller prediction is the last one, and is accepted without a
            check.
    """

    rounds: int
    most: int
    to_px: float
    fit_distortion: bool = False
    negligible: float = 1.0


class Registered(NamedTuple):
    """(15,) state, (N,) variance of the last weights, weight of the priors, (15,15) J'WJ there, error per value."""

    state: FloatArray
    variance: Float32Array
    prior_weight: float
    normal: FloatArray
    error: float


class Weights(NamedTuple):
    """(3,N) modeled values, (N,) variance with outliers down-weighted (Cauchy), weight of the priors."""

    drawn: Float32Array
    variance: Float32Array
    prior_weight: float


def linearize(
    drawing: Drawing | GridDrawing,
    view: View,
    samples: Samples,
    priors: Priors,
    state: FloatArray,
    hypothesis: Hypothesis,
    fit_distortion: bool,
) -> Linearization:
    """Error of a state, and its slopes; an infinite error if the inks are not determined."""
    kernel = _linearize_kernel()
    if kernel is None:
        return linearize_numpy(drawing, view, samples, priors, state, hypothesis, fit_distortion)
    normal, gradient, error = np.empty((STATE, STATE)), np.empty(STATE), np.zeros(1)
    state = contiguous(state, (STATE,))
    flat, seen, rules = drawing.flat, view.flat, np.array(priors)
    scratch = _scratch(len(samples.variance))
    arrays = addresses(flat, seen, *samples, rules, state)
    ends = addresses(scratch, normal, gradient, error)
    status = kernel(len(samples.variance), *arrays, *hypothesis, fit_distortion, *ends)
    return Linearization(normal, gradient, np.inf if status else float(error[0]))


def register(
    drawing: Drawing | GridDrawing,
    view: View,
    samples: Samples,
    priors: Priors,
    limits: Limits,
    state: FloatArray,
    hypothesis: Hypothesis,
    steps: Steps,
    mosaic: Mosaic | None = None,
) -> Registered:
    """State with a smaller error after some steps of Gauss-Newton; normal matrix and error are from before the last
    step if this step is negligible.

    If ``steps.rounds`` is 0 the samples keep their weights; otherwise outliers are down-weighted again at the
    beginning of every round.  From the second round on, interpolated values of a mosaic are down-weighted, and red
    and blue may be displaced from green, by equal amounts to opposite sides, by the lens or the demosaicer.  With a
    mosaic, the rounds before the last one end at a coarser step, `TO_PLACE`.
    """
    kernel = _register_kernel()
    if kernel is None:
        return register_numpy(drawing, view, samples, priors, limits, state, hypothesis, steps, mosaic)
    state, n = contiguous(state, (STATE,)).copy(), len(samples.variance)
    variance, ends = np.empty(n, np.float32), np.array([0.0, np.inf])
    flat, seen, rules, bounds = drawing.flat, view.flat, np.array(priors), np.array((*limits, steps.negligible))
    arrays = addresses(flat, seen, *samples, rules, bounds)
    scratch, normal = _scratch(n), np.empty((STATE, STATE))
    cells, weighing = (
        (None, None) if mosaic is None else (contiguous(mosaic.cells, (n,), np.float32), np.array(mosaic.rules))
    )
    outs = addresses(cells, weighing, scratch, state, variance, ends, normal, ends[1:])
    kernel(n, *arrays, *hypothesis, steps.fit_distortion, steps.rounds, steps.most, steps.to_px, *outs)
    return Registered(state, variance, float(ends[0]), normal, float(ends[1]))


def robust_weights(
    drawing: Drawing | GridDrawing,
    view: View,
    samples: Samples,
    priors: Priors,
    state: FloatArray,
    hypothesis: Hypothesis,
) -> Weights:
    """Predicted pixel values, and Cauchy weights on the scatter of all of them."""
    kernel = _weights_kernel()
    if kernel is None:
        return robust_weights_numpy(drawing, view, samples, priors, state, hypothesis)
    n = len(samples.variance)
    drawn, variance, weight = np.empty((3, n), np.float32), np.empty(n, np.float32), np.zeros(1)
    state = contiguous(state, (STATE,))
    flat, seen, rules, scratch = drawing.flat, view.flat, np.array(priors), _scratch(n)
    arrays = addresses(flat, seen, *samples, rules, state)
    status = kernel(n, *arrays, *hypothesis, *addresses(scratch, drawn, variance, weight))
    if status:
        return Weights(np.zeros_like(samples.values), samples.variance, 1.0)
    return Weights(drawn, variance, float(weight[0]))


def linearize_numpy(
    drawing: Drawing | GridDrawing,
    view: View,
    samples: Samples,
    priors: Priors,
    state: FloatArray,
    hypothesis: Hypothesis,
    fit_distortion: bool,
    color_roots: FloatArray | None = None,
) -> Linearization:
    """Definition of :func:`linearize`; (N,3) roots of further weights, if colors have separate weights.

    Their images may then be displaced, blue and red by equal amounts to opposite sides of green; this displacement is
    eliminated like the inks, and is not in the state.
    """
    at, values = samples.at.T.astype(np.float64), samples.values.T.astype(np.float64)
    n = len(at)
    points, spread, A, radial = plane_numpy(view, state, at)
    light = light_numpy(view, state, points)[:, None]
    jets = jets_numpy(drawing, points, spread, *hypothesis, slopes=True).transpose(0, 2, 1) * light
    design = jets[0]
    root = np.repeat(1 / np.sqrt(samples.variance.astype(np.float64))[:, None], 3, axis=1)
    root = root if color_roots is None else root * color_roots
    inks = inks_numpy(design, values, root, state[14], priors.ridge)
    blends = blending_numpy(jets, inks)
    # (6,N,3) colors and their slopes in the plane.
    drawn = jets @ inks + state[14] * blends
    residual = (values - drawn[0]) * root

    # (N,3) d model / d pixel without distortion.
    by_pixel = [drawn[1] * A[:, 0, x, None] + drawn[2] * A[:, 1, x, None] for x in (0, 1)]
    moves = _moves(view, state, points)  # (8,2,N)
    J = np.zeros((STATE, n, 3))
    # At a fixed pixel the pattern moves the other way.
    J[:8] = moves[:, 0, :, None] * by_pixel[0] + moves[:, 1, :, None] * by_pixel[1]
    for k, unit in enumerate(np.eye(3)):
        by_unit = spread_in_plane(A, *unit)
        J[8 + k] = -sum(drawn[3 + m] * by_unit[:, m, None] for m in range(3))
    if fit_distortion:
        J[11] = -(by_pixel[0] * radial[:, :1] + by_pixel[1] * radial[:, 1:])
    J[12:14] = -(drawn[0] / light) * (points.T[:, :, None] / view.half_mm)
    J[14] = -blends[0]
    if color_roots is not None:
        J = np.concatenate([J, [move * BLUE_GREEN_RED for move in by_pixel]])
    J *= root
    flat = J.reshape(len(J), n * 3)
    # Variable projection (Kaufman 1975): remove the part explained by the inks.
    weighted = design * root.T[:, :, None]  # (3,N,4)
    gram = _with_ridge(weighted.transpose(0, 2, 1) @ weighted, priors.ridge)
    seen = np.linalg.solve(np.linalg.cholesky(gram), weighted.transpose(0, 2, 1) @ J.transpose(2, 1, 0))
    by_inks = seen.transpose(2, 0, 1).reshape(len(J), -1)
    normal = flat @ flat.T - by_inks @ by_inks.T
    gradient = flat @ residual.ravel()
    shifts, fall = normal[STATE:, :STATE], 0.0
    if len(shifts):
        # With a bias the inks are not exactly the best ones: the part that they could explain is not a shift's.
        left = np.linalg.solve(np.linalg.cholesky(gram), weighted.transpose(0, 2, 1) @ residual.T[:, :, None])
        gradient[STATE:] -= by_inks[STATE:] @ left.ravel()
        own = normal[STATE:, STATE:] + priors.weight / priors.color_shift**2 * np.eye(2)
        best = np.linalg.solve(own, np.column_stack([shifts, gradient[STATE:]]))
        fall = float(gradient[STATE:] @ best[:, -1])
        gradient = gradient[:STATE] - shifts.T @ best[:, -1]
        normal = normal[:STATE, :STATE] - shifts.T @ best[:, :-1]
    precision = priors.weight / np.array([priors.distortion, priors.shading, priors.shading, priors.bias]) ** 2
    if not fit_distortion:
        precision[0] = 0.0
        normal[11, 11] = 1e12
    normal[range(11, 15), range(11, 15)] += precision
    gradient[11:] += precision * state[11:]
    normal[range(11), range(11)] += np.repeat([1e-6, 1e-3], [8, 3])
    prior = (state[11] / priors.distortion) ** 2 + np.sum((state[12:14] / priors.shading) ** 2)
    prior += (state[14] / priors.bias) ** 2
    error = (np.sum(residual**2) - fall + priors.weight * prior) / residual.size
    return Linearization(normal, gradient, float(error))


def register_numpy(
    drawing: Drawing | GridDrawing,
    view: View,
    samples: Samples,
    priors: Priors,
    limits: Limits,
    state: FloatArray,
    hypothesis: Hypothesis,
    steps: Steps,
    mosaic: Mosaic | None = None,
) -> Registered:
    """Definition of :func:`register`."""
    weighted, roots = samples, None
    for k in range(max(steps.rounds, 1)):
        if steps.rounds > 0:
            weights = robust_weights_numpy(drawing, view, samples, priors, state, hypothesis)
            weighted = samples._replace(variance=weights.variance)
            priors = priors._replace(weight=weights.prior_weight)
        if mosaic is not None and k > 0:
            roots = _color_roots(drawing, view, samples, priors, state, hypothesis, mosaic)
        # With a mosaic, rounds before the last one only move the drawing to its place.
        here = steps._replace(negligible=TO_PLACE) if mosaic is not None and k + 1 < steps.rounds else steps
        state, normal, error = _gauss_newton(drawing, view, weighted, priors, limits, state, hypothesis, here, roots)
    return Registered(state, weighted.variance, priors.weight, normal, error)


def _gauss_newton(
    drawing: Drawing | GridDrawing,
    view: View,
    samples: Samples,
    priors: Priors,
    limits: Limits,
    state: FloatArray,
    hypothesis: Hypothesis,
    steps: Steps,
    color_roots: FloatArray | None,
) -> tuple[FloatArray, FloatArray, float]:
    def linearized(at: FloatArray) -> Linearization:
        return linearize_numpy(drawing, view, samples, priors, at, hypothesis, steps.fit_distortion, color_roots)

    here = linearized(state)
    damping = 1e-3
    for _ in range(steps.most):
        for times in range(4):
            step = -np.linalg.solve(here.normal + damping * np.diag(np.diag(here.normal)), here.gradient)
            # No corner moves more than a quarter of the side in one step.
            step *= min(1.0, 0.25 * _mean_side(state) / max(np.abs(step[:8]).max(), 1e-9))
            trial = _moved(state, step, limits)
            if _is_sane(trial):
                if times == 0 and -here.gradient @ step < steps.negligible * here.error:
                    return trial, here.normal, here.error
                there = linearized(trial)
                if there.error < here.error:
                    break
            damping *= 10
        else:
            break
        gain = 1 - there.error / here.error
        here, state = there, trial
        damping = max(damping * 0.1, 1e-6)
        if np.abs(step[:8]).max() < steps.to_px or gain < 1e-5:
            break
    return state, here.normal, here.error


def _color_roots(
    drawing: Drawing | GridDrawing,
    view: View,
    samples: Samples,
    priors: Priors,
    state: FloatArray,
    hypothesis: Hypothesis,
    mosaic: Mosaic,
) -> FloatArray:
    """(N,3) roots of the weights of blue, green and red in the cells of a color mosaic."""
    values, root = samples.values.T.astype(np.float64), 1 / np.sqrt(samples.variance.astype(np.float64))[:, None]
    points, spread, A, _ = plane_numpy(view, state, samples.at.T.astype(np.float64))
    light = light_numpy(view, state, points)[:, None]
    jets = jets_numpy(drawing, points, spread, *hypothesis, slopes=True).transpose(0, 2, 1) * light
    inks = inks_numpy(jets[0], values, np.repeat(root, 3, axis=1), state[14], priors.ridge)
    drawn = jets @ inks
    residuals = (values - drawn[0] - state[14] * blending_numpy(jets[:1], inks)[0]) * root
    scale = max(float(np.sqrt(np.median(np.mean(residuals**2, axis=1)))), 1e-6)
    # A slope by the point spread is half a second derivative.
    across, down = (
        np.einsum("knc,nk->nc", drawn[3:], spread_in_plane(A, *unit)) * root / scale
        for unit in ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    )
    blocks = np.arange(len(root)) // BLOCK
    looked_at = blocks % (1 + -(-len(root) // BLOCK) // EVIDENT_BLOCKS) == 0
    residuals, across, down = (array[looked_at] for array in (residuals / scale, across, down))
    weights = mosaic_weights_numpy(residuals, across, down, mosaic.cells[looked_at], mosaic.rules)
    return np.asarray(weights[:, mosaic.cells.astype(int)].T)


def robust_weights_numpy(
    drawing: Drawing | GridDrawing,
    view: View,
    samples: Samples,
    priors: Priors,
    state: FloatArray,
    hypothesis: Hypothesis,
) -> Weights:
    """Definition of :func:`robust_weights`."""
    values, variance = samples.values.T.astype(np.float64), samples.variance.astype(np.float64)
    points, spread, _, _ = plane_numpy(view, state, samples.at.T.astype(np.float64))
    light = light_numpy(view, state, points)[:, None]
    design = jets_numpy(drawing, points, spread, *hypothesis, slopes=False)[0].T * light
    inks = inks_numpy(design, values, np.repeat(1 / np.sqrt(variance)[:, None], 3, axis=1), state[14], priors.ridge)
    drawn = design @ inks + state[14] * blending_numpy(design[None], inks)[0]
    chi2 = np.mean((values - drawn) ** 2, axis=1) / variance
    median = float(np.median(chi2))
    scale = 2.5 * max(float(np.sqrt(median)), 1e-6)
    variance = variance * (1 + chi2 / scale**2)
    return Weights(drawn.T.astype(np.float32), variance.astype(np.float32), median / 0.79)


def inks_numpy(design: FloatArray, values: FloatArray, root: FloatArray, bias: float, ridge: float) -> FloatArray:
    """(4,3) the inks that explain values best, channels independent, weighted by (N,3) ``root`` squared."""
    weighted = (design * root.T[:, :, None]).transpose(0, 2, 1)  # (3,4,N)
    gram = _with_ridge(weighted @ weighted.transpose(0, 2, 1), ridge)

    def best(wanted: FloatArray) -> FloatArray:
        return np.asarray(np.linalg.solve(gram, weighted @ (wanted * root).T[:, :, None])[:, :, 0].T)

    inks = best(values)
    return inks if bias == 0.0 else best(values - bias * blending_numpy(design[None], inks)[0])


def blending_numpy(jets: FloatArray, inks: FloatArray) -> FloatArray:
    """(...,N,3) where inks blend: the variance of the light within a pixel's view, over the white's.

    If the image's tone curve differs from the inverted one, a blend of two inks does not have the
    mean of their values.  To second order it is off by half the curve's second derivative times
    this, for any curve: white spreads over dark, or dark over white, and the square shrinks or
    grows.

    Args:
        jets: (J,N,4) coverage by the inks and, behind it, its slopes.
        inks: (4,3) linear-light BGR.
    """
    white = np.maximum(inks[0], 1e-3)
    mean, square = jets @ inks, jets @ inks**2
    spread = square - mean[:1] * np.where(np.arange(len(jets))[:, None, None] == 0, 1.0, 2.0) * mean
    return np.asarray(spread / white)


def _with_ridge(gram: FloatArray, ridge: float) -> FloatArray:
    trace = np.trace(gram, axis1=-2, axis2=-1)[..., None, None]
    return np.asarray(gram + ridge * trace / INKS * np.eye(INKS))


def _moves(view: View, state: FloatArray, points: FloatArray) -> FloatArray:
    """(8,2,N) motion of a pattern's point in the image by every corner coordinate."""
    delta = 1e-3
    corners = state[:8] - np.tile(view.origin, 4)
    steps = delta * np.eye(8)
    h = np.vstack([points.T, np.ones(len(points))])
    ends = []
    for step in (steps, -steps):
        mapped = np.stack([homography_numpy((corners + s).reshape(4, 2), view.half_mm) @ h for s in step])
        ends.append(mapped[:, :2] / mapped[:, 2:])
    return np.asarray((ends[0] - ends[1]) / (2 * delta))


def _moved(state: FloatArray, step: FloatArray, limits: Limits) -> FloatArray:
    moved = state + step
    # If edges are along the axes, the point spread's xy is poorly determined, and a long step in it
    # ruins the fit.
    largest = 0.5 * (state[8] + state[10])
    moved[9] = state[9] + np.clip(step[9], -largest, largest)
    values, vectors = np.linalg.eigh(np.array([[moved[8], moved[9]], [moved[9], moved[10]]]))
    S = vectors @ np.diag(np.clip(values, limits.least_spread, limits.most_spread)) @ vectors.T
    moved[8:11] = S[0, 0], S[0, 1], S[1, 1]
    most = np.array([limits.distortion, limits.shading, limits.shading, limits.bias])
    moved[11:] = np.clip(moved[11:], -most, most)
    return moved


def _edges(state: FloatArray) -> FloatArray:
    corners = state[:8].reshape(4, 2)
    return np.roll(corners, -1, axis=0) - corners


def _mean_side(state: FloatArray) -> float:
    return float(np.linalg.norm(_edges(state), axis=1).mean())


def _is_sane(state: FloatArray) -> bool:
    """Convex, clockwise, and not collapsed."""
    edges = _edges(state)
    following = np.roll(edges, -1, axis=0)
    turn = edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0]
    lengths = np.linalg.norm(edges, axis=1)
    return bool((turn > 0.02 * lengths * np.roll(lengths, -1)).all() and lengths.min() > 2)


def _scratch(n: int) -> Float32Array:
    return np.empty(scratch_floats(n), dtype=np.float32)


def scratch_floats(n: int) -> int:
    """Number of floats of workspace for the registration of n pixels."""
    return (n + BLOCK - 1) // BLOCK * BLOCK * (INKS * JET + 4)


_POINTER, _COUNT, _NUMBER = ctypes.c_void_p, ctypes.c_int64, ctypes.c_double


@lru_cache(maxsize=1)
def _linearize_kernel() -> Any:
    return function("lmkit_linearize", _COUNT, *[_POINTER] * 7, *[_COUNT] * 3, *[_POINTER] * 4)


@lru_cache(maxsize=1)
def _register_kernel() -> Any:
    numbers = [*[_COUNT] * 5, _NUMBER]
    return function("lmkit_register", _COUNT, *[_POINTER] * 7, *numbers, *[_POINTER] * 8)


@lru_cache(maxsize=1)
def _weights_kernel() -> Any:
    return function("lmkit_robust_weights", _COUNT, *[_POINTER] * 7, *[_COUNT] * 2, *[_POINTER] * 4)
