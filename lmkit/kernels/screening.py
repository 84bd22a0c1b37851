"""Screening of squares: all are sampled on one grid of the landmark's plane, scored, and moved to a better fit.

On the grid the coverage of every part is precomputed, so reading a square is a matrix product, and so is moving
its corners (Gauss-Newton with the drawing's own gradient, after Baker and Matthews 2004).
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.hypotheses import Words, explained_energy_numpy, selection_matrices
from lmkit.kernels.load import address, addresses, contiguous, function
from lmkit.kernels.pattern import INKS, QUARTERS
from lmkit.kernels.plane import homography_numpy
from lmkit.kernels.workspace import Workspace

FloatArray = NDArray[np.floating[Any]]
Float32Array = NDArray[np.float32]

STILL = 0.006  # of the side
SAME = 0.05  # of the side: nearer squares are the same
# Shares with a smaller difference are the same: squares of one landmark move to one place, and their shares differ
# by rounding of sums.
SAME_SHARE = 1 / 256
LOOK = 15  # 64-bit numbers per sampled square
GATE = 30  # points of the gate: a third each on margin, border and ground


@dataclass(frozen=True, eq=False)
class Pyramid:
    """An image at full, half, quarter ... resolution; each level the mean of 2 x 2 code values of the level before.

    Attributes:
        levels: (H,W,3) BGR, 8 bit, contiguous.
        linear: (256,) linear light of the code values.
    """

    levels: tuple[NDArray[np.uint8], ...]
    linear: Float32Array

    @cached_property
    def table(self) -> NDArray[np.int64]:
        """(L,3) height, width and address of every level, for kernels."""
        return np.array([[*level.shape[:2], address(level)] for level in self.levels], dtype=np.int64)


class ScreenTables(NamedTuple):
    """Precomputed data of a family.

    Attributes:
        half: half side of the face, mm.
        grid: (2,K) points, mm, row by row of a square; beyond that they only fill up.
        side: points in a row.
        moves: (2,8,K) how a point moves with every corner coordinate.
        gate: (2,30) points on margin, border and ground.
        blurs: (S,) standard deviation of the point spread, mm.
        columns: (S,3,C,K) coverage, and its slopes with x and y; 0 beyond the grid.
        grams: (S,C,C) products of the columns.
        words: the family's codes.
    """

    half: float
    grid: Float32Array
    side: int
    moves: Float32Array
    gate: Float32Array
    blurs: FloatArray
    columns: Float32Array
    grams: FloatArray
    words: Words

    @classmethod
    def of(
        cls, half: float, grid: Any, side: int, moves: Any, gate: Any, blurs: Any, columns: Any, words: Words
    ) -> ScreenTables:
        """Contiguous arrays of consistent shapes.

        Raises:
            ValueError: a shape differs.
        """
        gaps = words.gaps
        columns = contiguous(columns, (-1, 3, 9 + gaps, -1), np.float32)
        grid = contiguous(grid, (2, columns.shape[3]), np.float32)
        points = grid.shape[1]
        if points % 64 or points > 1024 or side**2 > points or not 3 <= side <= 32 or not 0 < len(columns) <= 16:
            raise ValueError(f"{points} points, {len(columns)} blurs")
        value = columns[:, 0].astype(np.float64)
        return cls(
            half,
            grid,
            side,
            contiguous(moves, (2, 8, points), np.float32),
            contiguous(gate, (2, GATE), np.float32),
            contiguous(blurs, (len(columns),)),
            columns,
            np.ascontiguousarray(value @ value.transpose(0, 2, 1)),
            words,
        )


class Thresholds(NamedTuple):
    """Thresholds of a square: white over dark and over ground (ratios), log ratio of red over blue, least contrast
    of white and ground in a channel, log ratio of the residuals of the best hypothesis and the best in another
    turn."""

    white_over_dark: float
    white_over_ground: float
    red_over_blue: float
    contrast: float
    turn: float


class ScreenRules(NamedTuple):
    """Parameters of the screening.

    Attributes:
        full_detail_px: squares of up to this side are sampled at full resolution, larger ones in halved images.
        blur_px: standard deviation of the point spread that is assumed, px of the level.
        ridge: of the inks, relative.
        damping: of a step, relative.
        furthest_mm: largest motion of a corner in one step.
        gate_white, gate_red: white over ground in green and red, and red over blue, at the points of the gate.
        least_pattern: squares whose pattern explains less are not moved.
        shadow_ratio: least ratio of the lights on a square with a shadow's edge.
        gate_border: white over border at the points of the gate.
        first, moved: thresholds of original squares, and of moved ones.
    """

    full_detail_px: float
    blur_px: float
    ridge: float
    damping: float
    furthest_mm: float
    gate_white: float
    gate_red: float
    least_pattern: float
    shadow_ratio: float
    gate_border: float
    first: Thresholds
    moved: Thresholds


class Screened(NamedTuple):
    """(N,4,2) corners, px, and (N,) the share of a framed square's residual energy that rings and triangle
    explain; 0 if a threshold is not reached, -1 if the square is misshapen, fails at the gate, or is a
    duplicate."""

    quads: FloatArray
    pattern: FloatArray


class Shares(NamedTuple):
    """Least shares explained by the pattern for a square to be moved, and for a moved one to be kept."""

    found: float
    moved: float


class Likely(NamedTuple):
    """(N,) pattern of all original squares; (M,4,2) moved squares that look like landmarks, best first."""

    pattern: FloatArray
    quads: FloatArray


class _Task(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("grid", "moves", "gate", "columns", "blurs", "grams", "masks")),
        *((name, ctypes.c_int64) for name in ("points", "side", "gaps", "blur_count", "codes")),
        ("rules", ctypes.c_double * 21),
    )


class Screening:
    """Screens squares for one family.

    Attributes:
        tables: data of the family.
        rules: parameters of the screening.
    """

    def __init__(self, tables: ScreenTables, rules: ScreenRules) -> None:
        self.tables, self.rules = tables, rules
        masks = tables.words.masks
        numbers = (tables.half, *rules[:-2], *rules.first, *rules.moved)
        self._task = _Task(
            *addresses(tables.grid, tables.moves, tables.gate, tables.columns, tables.blurs, tables.grams, masks),
            *(tables.grid.shape[1], tables.side, tables.words.gaps, len(tables.blurs), masks.shape[1]),
            (ctypes.c_double * 21)(*numbers),
        )

    def screen(self, pyramid: Pyramid, quads: FloatArray, rounds: int, window: int = 0) -> Screened:
        """Move squares (N,4,2), clockwise, ``rounds`` times, and score them.

        With a ``window`` (points of the grid), values are divided by the white around them, and squares without
        a shadow's edge score 0.
        """
        kernel = _kernel()
        if kernel is None:
            return screen_numpy(pyramid, self.tables, self.rules, quads, rounds, window)
        quads = contiguous(quads, (-1, 4, 2)).copy()
        pattern = np.empty(len(quads))
        image = self._image(pyramid)
        kernel(*image, len(quads), address(quads), rounds, window, self._subsets(), address(pattern))
        return Screened(quads, pattern)

    def likely(self, pyramid: Pyramid, quads: FloatArray, shares: Shares, rounds: int, window: int = 0) -> Likely:
        """Screen squares (N,4,2), move the best of every place, and return the best of these, one per place and size.

        Args:
            rounds: steps of the moves.
            window: as in :meth:`screen`.
        """
        kernel = _likely_kernel()
        quads = contiguous(quads, (-1, 4, 2))
        if kernel is None:
            return likely_numpy(pyramid, self.tables, self.rules, quads, shares, rounds, window)
        count = len(quads)
        pattern, likely, found = np.empty(count), np.empty((count, 4, 2)), np.zeros(1, np.int64)
        room = _WORKSPACE.floats("room", 2 * (13 + LOOK) * count)
        image, least = self._image(pyramid), np.array(shares)
        given = (count, address(quads), address(least), rounds, window, self._subsets(), room)
        kernel(*image, *given, *addresses(pattern, likely, found))
        return Likely(pattern, likely[: int(found[0])])

    def _image(self, pyramid: Pyramid) -> tuple[int, ...]:
        levels = pyramid.table
        return ctypes.addressof(self._task), address(levels), len(levels), address(pyramid.linear)

    def _subsets(self) -> int:
        return _WORKSPACE.floats("subsets", 2 * (7 << self.tables.words.gaps))


_WORKSPACE = Workspace()


def screen(
    pyramid: Pyramid, tables: ScreenTables, rules: ScreenRules, quads: FloatArray, rounds: int, window: int = 0
) -> Screened:
    """See :meth:`Screening.screen`."""
    return Screening(tables, rules).screen(pyramid, quads, rounds, window)


def likely(
    pyramid: Pyramid,
    tables: ScreenTables,
    rules: ScreenRules,
    quads: FloatArray,
    shares: Shares,
    rounds: int,
    window: int = 0,
) -> Likely:
    """See :meth:`Screening.likely`."""
    return Screening(tables, rules).likely(pyramid, quads, shares, rounds, window)


def screen_numpy(
    pyramid: Pyramid,
    tables: ScreenTables,
    rules: ScreenRules,
    quads: FloatArray,
    rounds: int,
    window: int = 0,
) -> Screened:
    """Definition of :func:`screen`."""
    quads = contiguous(quads, (-1, 4, 2)).copy()
    pattern = np.zeros(len(quads))
    for k, quad in enumerate(quads):
        is_duplicate = rounds == 0 and _has_duplicate(quads[k], quads[:k][pattern[:k] >= 0])
        pattern[k] = -1.0 if is_duplicate else _screen_one(pyramid, tables, rules, quad, rounds, window)
    return Screened(quads, pattern)


def likely_numpy(
    pyramid: Pyramid,
    tables: ScreenTables,
    rules: ScreenRules,
    quads: FloatArray,
    shares: Shares,
    rounds: int,
    window: int = 0,
) -> Likely:
    """Definition of :func:`likely`."""
    found = screen_numpy(pyramid, tables, rules, quads, 0, window)
    best = best_first_numpy(found, shares.found, 2)
    moved = screen_numpy(pyramid, tables, rules, best, rounds, window)
    return Likely(found.pattern, best_first_numpy(moved, shares.moved, 1))


def best_first_numpy(squares: Screened, at_least: float, per_place: int) -> FloatArray:
    """(M,4,2) squares above a share, in falling order, at most ``per_place`` of the same place and size.

    Shares in the same step of `SAME_SHARE` are equal, and the earlier square comes first.
    """
    kept: list[tuple[FloatArray, float]] = []
    chosen: list[int] = []
    for k in np.argsort(-np.floor(squares.pattern / SAME_SHARE), kind="stable").tolist():
        quad = squares.quads[k]
        middle, diagonals = quad.mean(axis=0), quad[2:] - quad[:2]
        side = float(np.sqrt(abs(diagonals[0, 0] * diagonals[1, 1] - diagonals[0, 1] * diagonals[1, 0]) / 2))
        same = [np.linalg.norm(at - middle) < 0.25 * side and 0.7 * side < s < 1.4 * side for at, s in kept]
        if squares.pattern[k] >= at_least and sum(same) < per_place:
            kept.append((middle, side))
            chosen.append(k)
    return squares.quads[chosen]


def _screen_one(
    pyramid: Pyramid,
    tables: ScreenTables,
    rules: ScreenRules,
    quad: FloatArray,
    rounds: int,
    window: int,
) -> float:
    if not _well_shaped(quad):
        return -1.0
    still = False
    for turn in range(rounds + 1):
        side = float(np.sqrt(_area(quad)))
        doublings = np.ceil(np.log2(max(side, 1e-9) / rules.full_detail_px))
        level = int(np.clip(doublings, 0, len(pyramid.levels) - 1))
        H = homography_numpy(quad, tables.half)
        if turn == 0 and (passed := _gate(_sample(pyramid, level, H, tables.gate), rules, window)) <= 0:
            return passed
        blur = rules.blur_px * 2 * tables.half / (side / 2**level)
        design = int(np.abs(np.log(tables.blurs / blur)).argmin())
        samples = np.zeros((tables.grid.shape[1], 3))
        used = tables.side**2
        samples[:used] = _sample(pyramid, level, H, tables.grid[:, :used])
        if window > 0:
            white = _local_white(samples[:used].mean(axis=1).reshape(tables.side, tables.side), window)
            samples[:used] /= white.reshape(-1, 1)
        last = turn == rounds or still
        pattern, colors = _look(samples, tables, design, rules, rules.moved if rounds > 0 and last else rules.first)
        if last:
            break
        if turn == 0 and pattern < rules.least_pattern:
            return 0.0
        before = quad.copy()
        quad[:] = _aligned(samples, colors, tables, design, rules, H)
        if not _well_shaped(quad):
            return 0.0
        # If it hardly moves, one more sampling scores it.
        still = float(np.abs(quad - before).max()) < STILL * side
    return pattern


def _has_duplicate(quad: FloatArray, earlier: FloatArray) -> bool:
    """Whether one of the earlier squares has the same corners, starting at any corner."""
    close = SAME * np.sqrt(abs(_area(quad)))
    turned = [np.roll(earlier, turn, axis=1) for turn in range(4)]
    return any(bool((np.abs(some - quad).max(axis=(1, 2)) < close).any()) for some in turned)


def _look(
    samples: FloatArray, tables: ScreenTables, design: int, rules: ScreenRules, thresholds: Thresholds
) -> tuple[float, FloatArray]:
    """Pattern, and (C,3) colors of the columns under the best hypothesis."""
    columns, gram = tables.columns[design, 0].astype(np.float64), tables.grams[design]
    seen, energy = columns @ samples, float((samples**2).sum())
    ridge = rules.ridge * np.trace(gram[:INKS, :INKS]) / INKS * np.eye(INKS)
    selections = selection_matrices(tables.words, len(gram))
    left = energy - explained_energy_numpy(selections, gram, seen, ridge).reshape(QUARTERS, -1)
    turn, code = divmod(int(left.argmin()), left.shape[1])
    M = selections[turn * left.shape[1] + code]
    inks = np.linalg.solve(M.T @ gram @ M + ridge, M.T @ seen)
    frame = np.eye(len(gram))[None, :, :INKS]
    by_frame = energy - float(explained_energy_numpy(frame, gram, seen, ridge)[0])
    best = max(float(left[turn, code]), 1e-9)
    turned = max(float(np.delete(left, turn, axis=0).min()), best)
    white, red, blue, _ = inks.mean(axis=1)
    fair = (
        white > thresholds.white_over_dark * max(red, blue)
        and white > thresholds.white_over_ground * blue
        and red_over_blue_numpy(inks) > thresholds.red_over_blue
        and (1 - inks[2] / np.maximum(inks[0], 1e-3)).min() > thresholds.contrast
        and np.log(turned / best) > thresholds.turn - 1e-12
    )
    return 1 - best / max(by_frame, 1e-9) if fair else 0.0, M @ inks


def _aligned(
    samples: FloatArray, colors: FloatArray, tables: ScreenTables, design: int, rules: ScreenRules, H: FloatArray
) -> FloatArray:
    value, by_x, by_y = np.einsum("jck,cb->jkb", tables.columns[design].astype(np.float64), colors)
    moves = tables.moves.astype(np.float64)
    J = moves[0, :, :, None] * by_x + moves[1, :, :, None] * by_y  # (8,K,3)
    flat = J.reshape(8, -1)
    normal = flat @ flat.T
    normal += (rules.damping * np.trace(normal) / 8 + 1e-12) * np.eye(8)
    # The pattern moved by d is T(u - d): the gradient has the opposite sign of the motion.
    step = -np.linalg.solve(normal, flat @ (samples - value).ravel()).reshape(4, 2)
    h = tables.half
    target = np.array([[-h, h], [h, h], [h, -h], [-h, -h]]) + np.clip(step, -rules.furthest_mm, rules.furthest_mm)
    mapped = np.column_stack([target, np.ones(4)]) @ H.T
    return np.asarray(mapped[:, :2] / mapped[:, 2:])


def _sample(pyramid: Pyramid, level: int, H: FloatArray, grid: FloatArray) -> FloatArray:
    """(K,3) colors in linear light, bilinear."""
    image = pyramid.levels[level]
    mapped = H @ np.vstack([grid, np.ones(grid.shape[1])])
    x, y = (mapped[:2] / mapped[2] + 0.5) / 2**level - 0.5
    x, y = np.clip(x, 0, image.shape[1] - 1), np.clip(y, 0, image.shape[0] - 1)
    x0, y0 = x.astype(np.int64), y.astype(np.int64)
    x1, y1 = np.minimum(x0 + 1, image.shape[1] - 1), np.minimum(y0 + 1, image.shape[0] - 1)
    fx, fy = (x - x0)[:, None], (y - y0)[:, None]

    def at(rows: NDArray[np.int64], columns: NDArray[np.int64]) -> FloatArray:
        return pyramid.linear[image[rows, columns]].astype(np.float64)

    top = at(y0, x0) * (1 - fx) + at(y0, x1) * fx
    return np.asarray(top * (1 - fy) + (at(y1, x0) * (1 - fx) + at(y1, x1) * fx) * fy)


def _local_white(gray: FloatArray, window: int) -> FloatArray:
    """Morphological closing: the minimum of the maxima around every point."""
    for sign in (1, -1):
        for axis in (0, 1):
            ends = [(window // 2, window // 2) if k == axis else (0, 0) for k in range(2)]
            padded = np.pad(sign * gray, ends, constant_values=-np.inf)
            gray = sign * np.lib.stride_tricks.sliding_window_view(padded, window, axis=axis).max(axis=-1)
    return np.maximum(gray, 1e-3)


def _gate(seen: FloatArray, rules: ScreenRules, window: int) -> float:
    """1; 0 if there is no shadow's edge on the square; -1 if it is not a landmark."""
    inks = seen.reshape(3, -1, 3).mean(axis=1)
    # The ground is blue: green and red distinguish it from white.
    over_border = inks[0].sum() > rules.gate_border * inks[1].sum()
    over_ground = inks[0, 1:].sum() > rules.gate_white * inks[2, 1:].sum()
    if not (over_border and over_ground and red_over_blue_numpy(inks) > rules.gate_red):
        return -1.0
    # A shadow's edge on the landmark also crosses its margin.
    margin = seen[: len(seen) // 3].sum(axis=1)
    return float(window == 0 or margin.max() > rules.shadow_ratio * margin.min())


def red_over_blue_numpy(inks: FloatArray) -> float:
    """Log ratio of red over blue between border and ground, relative to the white.

    Args:
        inks: (3 or 4,3) linear-light BGR of white, red, blue.
    """
    white = np.maximum(inks[0], 1e-3)
    red = np.clip(inks[1] / white, 0.0, 1.5) + 0.03
    blue = np.clip(inks[2] / white, 0.0, 1.5) + 0.03
    return float(np.log(red[2] / red[0]) - np.log(blue[2] / blue[0]))


def _area(quad: FloatArray) -> float:
    x, y = quad.T
    return float(0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def _well_shaped(quad: FloatArray) -> bool:
    """Convex, clockwise and not needle-thin."""
    edges = np.roll(quad, -1, axis=0) - quad
    following = np.roll(edges, -1, axis=0)
    turn = edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0]
    lengths = np.linalg.norm(edges, axis=1)
    convex = (turn > 0.05 * lengths * np.roll(lengths, -1)).all()
    return bool(convex and lengths.min() > max(0.15 * lengths.max(), 3))


@lru_cache(maxsize=1)
def _kernel() -> Any:
    p, n = ctypes.c_void_p, ctypes.c_int64
    return function("lmkit_screen", p, p, n, p, n, p, n, n, p, p)


@lru_cache(maxsize=1)
def _likely_kernel() -> Any:
    p, n = ctypes.c_void_p, ctypes.c_int64
    return function("lmkit_likely_squares", p, p, n, p, n, p, p, n, n, *[p] * 5)
