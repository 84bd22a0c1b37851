"""What a landmark looks like through a lens: blurred coverage of every part, in closed form.

A picture of the flat pattern is the sharp drawing blurred by the point spread of lens, motion and
pixel.  With a Gaussian point spread of covariance S (mm^2, in the landmark's plane) an edge whose
signed distance from a point is d (mm, positive inside) and whose unit normal is n covers the
point by ``Phi(d / sqrt(n' S n))``; parts bounded by several edges multiply.  The point spread
needs not be round, so motion blur is the same formula.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import ndtr

from lmkit.arrays import FloatArray
from lmkit.model.landmark import LandmarkFamily

INKS = 4  # white, red, blue, and whatever surrounds the white margin
QUARTERS = 4


@dataclass(frozen=True)
class Coverage:
    """Blurred coverage of the pattern's parts at N points of the landmark's plane.

    Attributes:
        fixed: (N,4) coverage by white, red, blue and surroundings, without triangle and with all
            rings closed.
        triangles: (N,4) the triangle turned clockwise by 0, 90, 180, 270 degrees.
        gaps: (N,G) ring coverage inside every gap position: white without a gap, blue with one.
    """

    fixed: FloatArray
    triangles: FloatArray
    gaps: FloatArray

    def inks(self, open_share: FloatArray, quarter: int) -> FloatArray:
        """(N,4) coverage by the four inks.

        Args:
            open_share: (G,) 1 for a gap, 0 for none, between for "unknown".
            quarter: quarter turns of the triangle, clockwise.
        """
        return with_white(self.fixed, self.triangles[:, quarter] - self.gaps @ open_share)


def with_white(fixed: FloatArray, white: FloatArray) -> FloatArray:
    """``fixed`` coverage with ``white`` (N,) more of white and as much less of blue."""
    inks = fixed.copy()
    inks[:, 0] += white
    inks[:, 2] -= white
    return inks


@dataclass(frozen=True)
class LandmarkPattern:
    """Coverage model of one family; the geometry is the family's own."""

    family: LandmarkFamily

    def coverage(
        self,
        points: FloatArray,
        spread: FloatArray,
        quarters: Sequence[int] = range(QUARTERS),
        gap_columns: Sequence[int] | None = None,
    ) -> Coverage:
        """Coverage at points of the landmark's plane.

        Args:
            points: (N,2) mm at nominal size, x right, y up.
            spread: (N,3) covariance of the point spread there: xx, xy, yy, mm^2.
            quarters, gap_columns: the triangles and gaps to work out; the other columns stay zero.
        """
        family = self.family
        x, y = points[:, 0], points[:, 1]
        sxx, sxy, syy = spread[:, 0], spread[:, 1], spread[:, 2]
        paper = _square(points, spread, family.half_mm + family.margin_mm)
        face = _square(points, spread, family.half_mm)
        ground = _square(points, spread, family.ground_half_mm)

        radius = np.sqrt(x * x + y * y) + 1e-9
        s_radial = np.sqrt(sxx * x * x + 2 * sxy * x * y + syy * y * y) / radius
        # At the very centre the radial direction has no meaning; no ring reaches there.
        s_radial = np.where(radius > 1.0, s_radial, np.sqrt(sxx))
        rings = np.zeros_like(x)
        gaps = np.zeros((len(x), family.gap_count), dtype=points.dtype)
        column = 0
        for ring in family.rings:
            band = ndtr((radius - ring.inner_mm) / s_radial) - ndtr((radius - ring.outer_mm) / s_radial)
            rings += band
            for centre in ring.gap_centres_deg:
                if gap_columns is None or column in gap_columns:
                    after = self._beside_ray(x, y, sxx, sxy, syy, centre - ring.gap_width_deg / 2, 1.0)
                    before = self._beside_ray(x, y, sxx, sxy, syy, centre + ring.gap_width_deg / 2, -1.0)
                    gaps[:, column] = band * after * before
                column += 1

        fixed = np.stack([paper - face + rings, face - ground, ground - rings, 1 - paper], axis=1)
        return Coverage(fixed, self._triangles(x, y, sxx, sxy, syy, quarters), gaps)

    def paper_only(self, points: FloatArray, spread: FloatArray) -> FloatArray:
        """(N,) coverage by the white margin alone; arguments as for :meth:`coverage`."""
        outside = _square(points, spread, self.family.half_mm + self.family.margin_mm)
        return outside - _square(points, spread, self.family.half_mm)

    @staticmethod
    def _beside_ray(
        x: FloatArray,
        y: FloatArray,
        sxx: FloatArray,
        sxy: FloatArray,
        syy: FloatArray,
        angle_deg: float,
        side: float,
    ) -> FloatArray:
        """Share on the clockwise (side = 1) or the other side (-1) of the ray at ``angle_deg``."""
        a = math.radians(angle_deg)
        nx, ny = side * math.cos(a), -side * math.sin(a)
        s = np.sqrt(nx * nx * sxx + 2 * nx * ny * sxy + ny * ny * syy)
        return np.asarray(ndtr((x * nx + y * ny) / s))

    def _triangles(
        self,
        x: FloatArray,
        y: FloatArray,
        sxx: FloatArray,
        sxy: FloatArray,
        syy: FloatArray,
        quarters: Sequence[int],
    ) -> FloatArray:
        """(N,4) the triangle at its quarter turns, each the product of its three half planes."""
        vertices = self.family.triangle_vertices_mm
        result = np.zeros((len(x), QUARTERS), dtype=x.dtype)
        for quarter in quarters:
            result[:, quarter] = 1.0
            turn = _QUARTER_TURNS[quarter]
            corners = vertices @ turn.T
            for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
                # The vertices run clockwise, so the inside lies to the right of each edge.
                edge = (b - a) / np.linalg.norm(b - a)
                # Plain floats keep single precision single.
                nx, ny, ax, ay = float(edge[1]), -float(edge[0]), float(a[0]), float(a[1])
                s = np.sqrt(nx * nx * sxx + 2 * nx * ny * sxy + ny * ny * syy)
                result[:, quarter] *= ndtr(((x - ax) * nx + (y - ay) * ny) / s)
        return result

    @cached_property
    def gap_turns(self) -> tuple[tuple[int, ...], ...]:
        """For each quarter turn, the column of ``gaps`` in which the landmark's gap k then appears."""
        turns = []
        for quarter in range(QUARTERS):
            columns: list[int] = []
            first = 0
            for ring in self.family.rings:
                shift = quarter * ring.gap_count // QUARTERS
                columns += [first + (k + shift) % ring.gap_count for k in range(ring.gap_count)]
                first += ring.gap_count
            turns.append(tuple(columns))
        return tuple(turns)


def frame_and_pattern_columns(pattern: LandmarkPattern, points: FloatArray, spread: FloatArray) -> FloatArray:
    """(N,4+4+G+4) coverage: fixed, triangles, gaps, and the inks of a square without rings or triangle."""
    cover = pattern.coverage(points, spread)
    rings = cover.fixed[:, 0] - pattern.paper_only(points, spread)
    frame = cover.fixed + np.outer(rings, [-1.0, 0.0, 1.0, 0.0])
    return np.column_stack([cover.fixed, cover.triangles, cover.gaps, frame])


def _square(points: FloatArray, spread: FloatArray, half: float) -> FloatArray:
    """(N,) blurred coverage by the square of half side ``half`` around the origin."""
    x, y = points[:, 0], points[:, 1]
    sx, sy = np.sqrt(spread[:, 0]), np.sqrt(spread[:, 2])
    inside_x = ndtr((x + half) / sx) - ndtr((x - half) / sx)
    return np.asarray(inside_x * (ndtr((y + half) / sy) - ndtr((y - half) / sy)))


def _clockwise(quarter: int) -> FloatArray:
    c, s = [(1, 0), (0, 1), (-1, 0), (0, -1)][quarter]
    return np.array([[c, s], [-s, c]], dtype=np.float64)


_QUARTER_TURNS = [_clockwise(q) for q in range(QUARTERS)]
