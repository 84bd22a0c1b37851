"""Image model of a landmark through a lens: blurred coverage of every part, in closed form.

An image of the flat pattern is the sharp drawing blurred by the point spread of lens, motion and
pixel.  :mod:`lmkit.kernels.pattern` has the formulas; this module has the edges of a family.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.kernels.pattern import INKS, QUARTERS, Drawing, coverage_columns_numpy, ink_jets_numpy
from lmkit.model.landmark import LandmarkFamily

__all__ = ["INKS", "QUARTERS", "LandmarkPattern", "PatternCoverage", "drawing_of"]


@dataclass(frozen=True)
class PatternCoverage:
    """Blurred coverage of the pattern's parts at N points of the landmark's plane.

    Attributes:
        fixed: (N,4) coverage by white, red, blue and surroundings, without triangle and with all
            rings closed.
        triangles: (N,4) the triangle turned clockwise by 0, 90, 180, 270 degrees.
        gaps: (N,G) ring coverage inside every gap position: white without a gap, blue with one.
        frame: (N,4) coverage by the four inks without rings and triangle.
    """

    fixed: FloatArray
    triangles: FloatArray
    gaps: FloatArray
    frame: FloatArray

    @property
    def columns(self) -> FloatArray:
        """(N,4+4+G+4) all of it side by side."""
        return np.concatenate([self.fixed, self.triangles, self.gaps, self.frame], axis=1)


@dataclass(frozen=True)
class LandmarkPattern:
    """Coverage model of one family; the geometry is the family's own."""

    family: LandmarkFamily

    def coverage(self, points: FloatArray, spread: FloatArray) -> PatternCoverage:
        """Coverage by every part, independent of the code.

        Args:
            points: (N,2) mm at nominal size, x right, y up.
            spread: (N,3) covariance of the point spread there: xx, xy, yy, mm^2.
        """
        columns = coverage_columns_numpy(drawing_of(self.family), points, spread).T.astype(np.float64)
        frame = columns[:, :4]
        fixed = frame + columns[:, 4:5] * np.array([1.0, 0.0, -1.0, 0.0])
        return PatternCoverage(fixed, columns[:, 5:9], columns[:, 9:], frame)

    def inks(
        self, points: FloatArray, spread: FloatArray, open_gaps: Sequence[int], quarter: int, slopes: bool = False
    ) -> FloatArray:
        """(1 or 6,N,4) coverage by white, red, blue and surroundings for one hypothesis, and its slopes.

        Args:
            points, spread: as for :meth:`coverage`.
            open_gaps: gap positions (of the quad's frame) that are open.
            quarter: quarter turns of the triangle, clockwise.
            slopes: also with x, y, Sxx, Sxy, Syy.
        """
        mask = sum(1 << int(gap) for gap in open_gaps)
        jets = ink_jets_numpy(drawing_of(self.family), points, spread, mask, quarter, slopes)
        return jets.transpose(0, 2, 1).astype(np.float64)

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


@lru_cache(maxsize=16)
def drawing_of(family: LandmarkFamily) -> Drawing:
    """Edges of a family's drawing."""
    lines = _Lines()
    gaps = []
    for number, ring in enumerate(family.rings):
        for center in ring.gap_centers_deg:
            start, end = (math.radians(center + s * ring.gap_width_deg / 2) for s in (-1, 1))
            after = lines.add(math.cos(start), -math.sin(start), 0.0)
            before = lines.add(-math.cos(end), math.sin(end), 0.0)
            gaps.append((number, *after, *before))
    triangles = [[lines.add(*side) for side in _triangle_sides(family, quarter)] for quarter in range(QUARTERS)]
    squares = (family.half_mm + family.margin_mm, family.half_mm, family.ground_half_mm)
    radii = [(ring.inner_mm, ring.outer_mm) for ring in family.rings]
    return Drawing.of(squares, radii, lines.found, np.reshape(gaps, (-1, 5)), triangles)


class _Lines:
    """Distinct lines: opposite gaps and turned triangles share theirs."""

    def __init__(self) -> None:
        self.found: list[tuple[float, float, float]] = []

    def add(self, nx: float, ny: float, offset: float) -> tuple[int, int]:
        """Number of the line, and 1, or -1 where its other side is meant."""
        for sign in (1, -1):
            line = (sign * nx, sign * ny, sign * offset)
            for number, known in enumerate(self.found):
                if all(abs(a - b) <= 1e-9 + 1e-5 * abs(b) for a, b in zip(line, known, strict=True)):
                    return number, sign
        self.found.append((nx, ny, offset))
        return len(self.found) - 1, 1


def _triangle_sides(family: LandmarkFamily, quarter: int) -> list[tuple[float, float, float]]:
    c, s = [(1, 0), (0, 1), (-1, 0), (0, -1)][quarter]
    corners = family.triangle_vertices_mm @ np.array([[c, s], [-s, c]], dtype=np.float64).T
    sides = []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        # The vertices run clockwise, so the inside lies to the right of each edge.
        edge = (b - a) / np.linalg.norm(b - a)
        normal = np.array([edge[1], -edge[0]])
        sides.append((float(normal[0]), float(normal[1]), float(a @ normal)))
    return sides
