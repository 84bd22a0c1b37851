"""Fast screening of candidates: whether a square may contain a landmark.

:mod:`lmkit.kernels.screening` has the formulas; this module has the precomputed data of a family, the requirements
for a square, and the choice between several squares at one place.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.detection.hypotheses import RIDGE, words_of
from lmkit.detection.pattern_model import drawing_of
from lmkit.detection.shadows import LEAST_RATIO
from lmkit.geometry.homography import homographies_from_points
from lmkit.kernels.pattern import coverage_columns_numpy
from lmkit.kernels.screening import (
    Likely,
    Pyramid,
    Screened,
    Screening,
    ScreenRules,
    ScreenTables,
    Shares,
    Thresholds,
)
from lmkit.model.landmark import LandmarkFamily

GRID = 19
SHADOW_WINDOW = 7  # grid points: wider than the ground between margin and rings
POINTS = 384  # of the compiled code's blocks
BLURS_MM = (4.0, 6.0, 9.0, 13.0)
# One halving for every doubling of the side beyond this.
FULL_DETAIL_SIDE_PX = 40.0
# Blur on the grid, in pixels of the level: the image's own, and what a corner off by half a pixel does.
BLUR_PX = 1.2
FURTHEST_MOVE = 0.12  # of the side
DAMPING = 0.02
# The gate's points: every landmark has white, red and ground there, for any family and code.
GATE_MARGIN_MM, GATE_GROUND = 5.0, (0.82, 0.75)  # beyond the border; shares of the ground's half side
# Small landmarks mix red and ground, a veil whitens both.  Of 3,158 places that are read, 5 have no square that
# passes; of the squares elsewhere a third does not.
GATE_WHITE_OVER_BORDER, GATE_WHITE_OVER_GROUND, GATE_RED_OVER_BLUE = 1.1, 1.25, -0.16


@dataclass(frozen=True)
class ScreeningThresholds:
    """Thresholds for a candidate; the strict test comes after registration.

    Attributes:
        white_over_dark: ratio of white to red, and of white to blue.
        white_over_ground: than blue alone.
        red_over_blue: see :func:`lmkit.detection.hypotheses.red_over_blue`.
        contrast: share by which blue is darker than white, in the channel where that is least.
        turn: log ratio of what the best hypothesis and the best in another quarter turn leave unexplained.
    """

    white_over_dark: float = 1.15
    white_over_ground: float = 1.15
    red_over_blue: float = 0.0
    contrast: float = 0.05
    turn: float = 0.0

    @property
    def numbers(self) -> Thresholds:
        """The thresholds as the kernel takes them."""
        return Thresholds(self.white_over_dark, self.white_over_ground, self.red_over_blue, self.contrast, self.turn)


FOUND_THRESHOLDS = ScreeningThresholds()
# Veiled and dim landmarks have as little contrast as this; acceptance tests the rest.
ALIGNED_THRESHOLDS = ScreeningThresholds(turn=0.02)


@dataclass(frozen=True)
class LikelyRule:
    """Rule for the squares that are registered.

    Attributes:
        shares: share of what a framed square leaves unexplained that rings and triangle must explain, of a square as
            it was found and of one that was moved to where it fits.
        rounds: steps of the moves.
        aligned: thresholds of moved squares.
        in_shadow: normalize the light, and leave out squares on which no shadow may end.
    """

    shares: Shares
    rounds: int
    aligned: ScreeningThresholds = ALIGNED_THRESHOLDS
    in_shadow: bool = False


def likely_squares(pyramid: Pyramid, quads: FloatArray, family: LandmarkFamily, rule: LikelyRule) -> Likely:
    """Squares that resemble landmarks of a family, aligned to the pattern, and the pattern score of all.

    Args:
        quads: (N,4,2) corners, px, clockwise; misshapen ones score -1.
    """
    window = SHADOW_WINDOW if rule.in_shadow else 0
    return _screening(family, rule.aligned).likely(pyramid, quads, rule.shares, rule.rounds, window)


def screen_candidates(
    pyramid: Pyramid,
    quads: FloatArray,
    family: LandmarkFamily,
    rounds: int = 0,
    aligned: ScreeningThresholds = ALIGNED_THRESHOLDS,
    in_shadow: bool = False,
) -> Screened:
    """Move the corners of all candidates ``rounds`` times toward a better fit, and score them.

    Args:
        quads: (N,4,2) corners, px, clockwise; misshapen ones score -1.
        aligned: thresholds of moved squares.
        in_shadow: normalize the light, and score 0 if no shadow may end on the square.
    """
    return _screening(family, aligned).screen(pyramid, quads, rounds, SHADOW_WINDOW if in_shadow else 0)


@lru_cache(maxsize=16)
def _screening(family: LandmarkFamily, aligned: ScreeningThresholds) -> Screening:
    rules = ScreenRules(
        FULL_DETAIL_SIDE_PX,
        BLUR_PX,
        RIDGE,
        DAMPING,
        FURTHEST_MOVE * family.side_mm,
        GATE_WHITE_OVER_GROUND,
        GATE_RED_OVER_BLUE,
        0.0,
        LEAST_RATIO,
        GATE_WHITE_OVER_BORDER,
        FOUND_THRESHOLDS.numbers,
        aligned.numbers,
    )
    return Screening(screen_tables(family), rules)


@lru_cache(maxsize=8)
def screen_tables(family: LandmarkFamily) -> ScreenTables:
    """Precomputed data of a family, on a grid that reaches into its margin."""
    points = _grid(family)
    used = len(points)
    drawing, delta = drawing_of(family), 0.05
    steps = delta * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    moved = np.tile((points + steps[:, None]).reshape(-1, 2), (len(BLURS_MM), 1))
    spread = np.array([[blur**2, 0.0, blur**2] for blur in BLURS_MM]).repeat(len(steps) * used, axis=0)
    covered = coverage_columns_numpy(drawing, moved, spread).reshape(-1, len(BLURS_MM), len(steps), used)
    columns = np.zeros((len(BLURS_MM), 3, drawing.column_count, POINTS))
    columns[:, 0, :, :used] = covered[:, :, 0].swapaxes(0, 1)
    for axis in (0, 1):
        slopes = (covered[:, :, 1 + 2 * axis] - covered[:, :, 2 + 2 * axis]) / (2 * delta)
        columns[:, 1 + axis, :, :used] = slopes.swapaxes(0, 1)
    # How a point of the plane moves with each corner coordinate.
    corners = family.corners_mm
    changed = homographies_from_points(corners, corners + delta * np.eye(8).reshape(8, 4, 2))
    mapped = np.einsum("pij,kj->pik", changed, np.column_stack([points, np.ones(used)]))
    moves = np.zeros((2, 8, POINTS))
    moves[:, :, :used] = ((mapped[:, :2] / mapped[:, 2:] - points.T) / delta).transpose(1, 0, 2)
    grid = np.zeros((2, POINTS))
    grid[:, :used] = points.T
    return ScreenTables.of(
        family.half_mm, grid, GRID, moves, _gate(family), np.array(BLURS_MM), columns, words_of(family)
    )


def _grid(family: LandmarkFamily) -> FloatArray:
    reach = family.half_mm + 0.6 * family.margin_mm
    steps = np.linspace(-reach, reach, GRID)
    x, y = np.meshgrid(steps, -steps)
    return np.column_stack([x.ravel(), y.ravel()])


def _gate(family: LandmarkFamily) -> FloatArray:
    """(2,30) ten points each on margin, border and ground."""
    margin = _around(family.half_mm + GATE_MARGIN_MM)
    border = _around(family.half_mm - family.border_mm / 2)
    # No ring reaches into the corners of the ground; in their middle little red or white is mixed in.
    far, near = (share * family.ground_half_mm for share in GATE_GROUND)
    ground = [(sx * far, sy * far) for sx in (-1, 1) for sy in (-1, 1)]
    ground += [(sx * far, sy * near) for sx in (-1, 1) for sy in (-1, 1)] + [(near, far), (-near, -far)]
    return np.array([*margin, *border, *ground]).T


def _around(half: float) -> list[tuple[float, float]]:
    """Ten points on a square's outline."""
    along = 0.6 * half
    sides = [(along, half), (-along, half), (along, -half), (-along, -half)]
    return [*sides, *((y, x) for x, y in sides), (0.0, half), (0.0, -half)]
