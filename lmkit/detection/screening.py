"""A quick look at every candidate at once: does anything like a landmark fill this square?

All candidates are sampled on one grid of the landmark's plane.  There the coverage of every part
is known beforehand, so reading all candidates is one matrix product, and so is moving their
corners to where the pattern fits better (Gauss-Newton with the drawing's own gradient, after
Baker and Matthews 2004).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from lmkit.arrays import Float32Array, FloatArray, IntArray
from lmkit.detection.hypotheses import InkSolver, frame_selection, pattern_selections, red_over_blue
from lmkit.detection.pattern_model import QUARTERS, LandmarkPattern
from lmkit.geometry.homography import homographies_from_points
from lmkit.model.landmark import LandmarkFamily

GRID = 25
SPREAD_STEPS_MM = (4.0, 6.0, 9.0, 13.0)
# One pyramid step down for every doubling of the side beyond this.
FULL_DETAIL_SIDE_PX = 40.0
# Blur on the grid, in pixels of the pyramid level: the picture's own, and what a corner off by
# half a pixel does.
BLUR_PX = 1.2


@dataclass(frozen=True)
class ScreeningThresholds:
    """What a candidate must show; the strict test comes after registration.

    Attributes:
        white_over_dark: how much brighter white is than red and than blue, as a ratio.
        white_over_ground: than blue alone.
        red_over_blue: see :func:`lmkit.detection.hypotheses.red_over_blue`.
        contrast: share by which blue is darker than white, in the channel where that is least.
        turn: log ratio of what the best reading and the best in another quarter turn leave unexplained.
    """

    white_over_dark: float = 1.15
    white_over_ground: float = 1.15
    red_over_blue: float = 0.2
    contrast: float = 0.05
    turn: float = 0.0


FIRST_THRESHOLDS = ScreeningThresholds()
# Of the development rooms' landmarks none fails here, of the other aligned squares three in four.
ALIGNED_THRESHOLDS = ScreeningThresholds(white_over_ground=1.8, red_over_blue=0.3, contrast=0.3, turn=0.03)


@dataclass(frozen=True)
class Screened:
    """Candidates, and how much more a landmark explains of them than a plain framed square.

    Attributes:
        quads: (N,4,2) corners, px.
        pattern: (N,) share of what a framed square leaves unexplained that rings and triangle explain.
    """

    quads: FloatArray
    pattern: FloatArray

    def best_first(self, at_least: float, per_place: int, at_most: int) -> Screened:
        """Those above a share, in falling order, at most ``per_place`` of the same place and size."""
        order = np.argsort(-self.pattern, kind="stable")
        order = order[self.pattern[order] >= at_least]
        centres = self.quads.mean(axis=1)
        sides = np.sqrt(areas(self.quads))
        kept: list[int] = []
        for index in order:
            near = np.linalg.norm(centres[kept] - centres[index], axis=1) < 0.25 * sides[index]
            ratio = sides[kept] / sides[index]
            if np.sum(near & (ratio > 0.7) & (ratio < 1.4)) < per_place:
                kept.append(int(index))
                if len(kept) == at_most:
                    break
        return Screened(self.quads[kept], self.pattern[kept])


@dataclass(frozen=True)
class _Design:
    """What is known beforehand of one blur on the grid.

    Attributes:
        columns: (K,C) coverage.
        gradients: (K,C,8) of the columns with the corners' coordinates, per mm.
        products: (C,C,8,8) sums over the grid of products of two gradients.
        readings, frame: solvers for all readings, and for the framed square.
    """

    columns: FloatArray
    gradients: FloatArray
    products: FloatArray
    readings: InkSolver
    frame: InkSolver


def linear_pyramid(linear: Float32Array) -> list[Float32Array]:
    """The picture in linear light at full, half, quarter ... resolution."""
    levels = [linear]
    while min(levels[-1].shape[:2]) > 48 and len(levels) < 6:
        levels.append(np.asarray(cv2.pyrDown(levels[-1]), dtype=np.float32))
    return levels


def screen_candidates(pyramid: list[Float32Array], quads: FloatArray, family: LandmarkFamily) -> Screened:
    """Score all candidates where they are; misshapen ones are dropped.

    Args:
        pyramid: of the picture in linear light, from :func:`linear_pyramid`.
        quads: (N,4,2) corners, px, clockwise.
    """
    return align_candidates(pyramid, quads, family, rounds=0, look=FIRST_THRESHOLDS)


def align_candidates(
    pyramid: list[Float32Array], quads: FloatArray, family: LandmarkFamily, rounds: int, look: ScreeningThresholds
) -> Screened:
    """Move the corners of all candidates ``rounds`` times towards a better fit, then score them by ``look``."""
    quads = quads[_well_shaped(quads)]
    pattern = np.zeros(len(quads))
    for turn in range(rounds + 1):
        if len(quads) == 0:
            break
        level, step = _level_and_step(quads, pyramid, family)
        samples = _sample(pyramid, quads, level, family)
        moved = np.zeros((len(quads), 4, 2))
        for s, spread in enumerate(SPREAD_STEPS_MM):
            chosen = np.flatnonzero(step == s)
            if len(chosen) == 0:
                continue
            design = _design(family, spread)
            wanted = look if turn == rounds else FIRST_THRESHOLDS
            pattern[chosen], coefficients = _read(samples[chosen], design, family, wanted)
            if turn < rounds:
                moved[chosen] = _corner_moves(samples[chosen], coefficients, design)
        if turn < rounds:
            limit = 0.12 * family.side_mm
            H = homographies_from_points(family.corners_mm, quads)
            target = family.corners_mm + np.clip(moved, -limit, limit)
            mapped = np.concatenate([target, np.ones((len(quads), 4, 1))], axis=2) @ H.transpose(0, 2, 1)
            quads = mapped[:, :, :2] / mapped[:, :, 2:]
            fair = _well_shaped(quads)
            quads, pattern = quads[fair], pattern[fair]
    return Screened(quads, pattern)


def pyramid_level(sides: FloatArray, count: int) -> IntArray:
    """(N,) the level at which squares of these sides, px, are looked at."""
    doublings = np.log2(np.maximum(sides, 1.0) / FULL_DETAIL_SIDE_PX)
    return np.asarray(np.clip(np.ceil(doublings), 0, count - 1).astype(np.int64))


def _level_and_step(
    quads: FloatArray, pyramid: list[Float32Array], family: LandmarkFamily
) -> tuple[IntArray, IntArray]:
    sides = np.sqrt(areas(quads))
    level = pyramid_level(sides, len(pyramid))
    spread_mm = BLUR_PX * family.side_mm / (sides / 2.0**level)
    return level, np.abs(np.log(np.array(SPREAD_STEPS_MM)[:, None] / spread_mm)).argmin(axis=0)


def _read(
    samples: FloatArray, design: _Design, family: LandmarkFamily, look: ScreeningThresholds
) -> tuple[FloatArray, FloatArray]:
    """For (N,K,3) samples: pattern share (N,), 0 where the look is wrong; coefficients of the columns (N,C,3)."""
    n, count, _ = samples.shape
    projections = (design.columns.T @ samples.transpose(1, 0, 2).reshape(count, n * 3)).reshape(-1, n, 3)
    energy = np.sum(samples**2, axis=(1, 2))
    explained = design.readings.explained_energy(projections)
    best = explained.argmax(axis=0)
    left = np.maximum(energy - explained[best, np.arange(n)], 1e-9)
    left_by_frame = energy - design.frame.explained_energy(projections)[0]
    pattern = 1 - left / np.maximum(left_by_frame, 1e-9)

    inks = design.readings.inks(best, projections)
    white, red, blue = (inks[:, k].mean(axis=1) for k in range(3))
    fair = white > look.white_over_dark * np.maximum(red, blue)
    fair &= white > look.white_over_ground * blue
    fair &= red_over_blue(inks) > look.red_over_blue
    fair &= (1 - inks[:, 2] / np.maximum(inks[:, 0], 1e-3)).min(axis=1) > look.contrast
    if look.turn > 0:
        by_turn = explained.reshape(QUARTERS, -1, n).max(axis=1)
        by_turn[best // family.code_count, np.arange(n)] = -np.inf
        fair &= np.log((energy - by_turn.max(axis=0)) / left) > look.turn
    return np.where(fair, pattern, 0.0), pattern_selections(family)[best] @ inks


def _corner_moves(samples: FloatArray, coefficients: FloatArray, design: _Design) -> FloatArray:
    """(N,4,2) where the corners should go, mm of the landmark's plane."""
    n, count, _ = samples.shape
    coefficients = coefficients.astype(np.float32)
    drawn = design.columns @ coefficients.transpose(1, 0, 2).reshape(-1, n * 3)
    residual = samples.transpose(1, 0, 2).reshape(count, n * 3) - drawn
    flat = design.gradients.reshape(count, -1)
    correlation = (flat.T @ residual).reshape(-1, 8, n, 3)
    gradient = (correlation * coefficients.transpose(1, 0, 2)[:, None]).sum(axis=(0, 3)).T
    pairs = (coefficients @ coefficients.transpose(0, 2, 1)).reshape(n, -1)
    normal = (pairs @ design.products.reshape(-1, 64)).reshape(n, 8, 8)
    trace = np.trace(normal, axis1=1, axis2=2)
    normal += (0.02 * trace / 8 + 1e-12)[:, None, None] * np.eye(8)
    # The pattern moved by d shows T(u - d): the gradient works against the move.
    return -np.linalg.solve(normal, gradient[:, :, None]).reshape(n, 4, 2)


@lru_cache(maxsize=32)
def _design(family: LandmarkFamily, spread_mm: float) -> _Design:
    points = _grid(family)
    spread = np.tile([spread_mm**2, 0.0, spread_mm**2], (len(points), 1))
    pattern = LandmarkPattern(family)
    columns = pattern.coverage(points, spread).columns
    delta = 0.05
    slopes = np.stack(
        [(pattern.coverage(points + e, spread).columns - columns) / delta for e in np.eye(2) * delta],
        axis=2,
    )  # (K,C,2)
    # How a point of the plane moves with each corner coordinate.
    corners = family.corners_mm
    changed = homographies_from_points(corners, corners + delta * np.eye(8).reshape(8, 4, 2))
    mapped = np.einsum("pij,kj->kpi", changed, np.column_stack([points, np.ones(len(points))]))
    moves = (mapped[:, :, :2] / mapped[:, :, 2:] - points[:, None]) / delta  # (K,8,2)
    gradients = np.einsum("kcx,kpx->kcp", slopes, moves)
    products = np.einsum("kcp,kdq->cdpq", gradients, gradients, optimize=True)
    gram = columns.T @ columns
    # Single precision from here on: a look, not a measurement, and twice as fast.
    return _Design(
        columns.astype(np.float32),
        gradients.astype(np.float32),
        products.astype(np.float32),
        InkSolver.prepare(gram, pattern_selections(family)).in_single_precision(),
        InkSolver.prepare(gram, frame_selection(family)).in_single_precision(),
    )


@lru_cache(maxsize=8)
def _grid(family: LandmarkFamily) -> FloatArray:
    reach = family.half_mm + 0.6 * family.margin_mm
    steps = np.linspace(-reach, reach, GRID)
    x, y = np.meshgrid(steps, -steps)
    return np.column_stack([x.ravel(), y.ravel()])


def _sample(pyramid: list[Float32Array], quads: FloatArray, level: IntArray, family: LandmarkFamily) -> FloatArray:
    """(N,K,3) colours of the pyramid at the grid of every candidate."""
    H = homographies_from_points(family.corners_mm, quads)
    mapped = H @ np.vstack([_grid(family).T, np.ones(GRID * GRID)])
    pixels = mapped[:, :2] / mapped[:, 2:]
    samples = np.empty((len(quads), GRID * GRID, 3), dtype=np.float32)
    for number, picture in enumerate(pyramid):
        chosen = np.flatnonzero(level == number)
        # remap takes pictures of less than 2^15 rows.
        for start in range(0, len(chosen), 8192):
            some = chosen[start : start + 8192]
            # pyrDown centres pixel u of a level on pixel 2u of the one before.
            x, y = (pixels[some] / 2.0**number).astype(np.float32).transpose(1, 0, 2)
            samples[some] = cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return samples


def areas(quads: FloatArray) -> FloatArray:
    """(N,) areas of (N,4,2) clockwise quads, px^2."""
    x, y = quads[:, :, 0], quads[:, :, 1]
    return np.asarray(0.5 * np.sum(x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1), axis=1))


def _well_shaped(quads: FloatArray) -> FloatArray:
    """True where a candidate is convex and not needle-thin."""
    edges = np.roll(quads, -1, axis=1) - quads
    following = np.roll(edges, -1, axis=1)
    turn = edges[:, :, 0] * following[:, :, 1] - edges[:, :, 1] * following[:, :, 0]
    lengths = np.linalg.norm(edges, axis=2)
    fair = (turn > 0.05 * lengths * np.roll(lengths, -1, axis=1)).all(axis=1)
    return np.asarray(fair & (lengths.min(axis=1) > 0.15 * lengths.max(axis=1)) & (lengths.min(axis=1) > 3))
