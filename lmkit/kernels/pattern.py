"""Blurred coverage of a landmark's parts at points of its plane, with slopes; `pattern.h` does so in blocks.

An edge at signed distance d (mm, positive inside) with unit normal n covers a point by ``Phi(d / sqrt(n' S n))``,
S the covariance of the point spread; parts bounded by several edges multiply.  Jets are arrays whose first axis
holds the value and its slopes with x, y and the point spread's xx, xy, yy; products obey Leibniz's rule.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.load import contiguous

FloatArray = NDArray[np.floating[Any]]
Float32Array = NDArray[np.float32]

INKS = 4  # white, red, blue, and the surroundings of the white margin
QUARTERS = 4
JET = 6  # value, d/dx, d/dy, d/dSxx, d/dSxy, d/dSyy
FRAME, RING, TRIANGLE, GAP = 0, 4, 5, 9  # first column of each kind
MAX_RINGS, MAX_LINES, MAX_GAPS = 4, 40, 16  # sizes of the compiled code's blocks


class _Parts(NamedTuple):
    squares: FloatArray
    radii: FloatArray
    lines: FloatArray
    gaps: FloatArray
    triangles: FloatArray


class Drawing(_Parts):
    """The edges of one family's drawing.

    Attributes:
        squares: (3,) half sides of paper, face and ground, mm.
        radii: (R,2) inner and outer radius of every ring, mm.
        lines: (L,3) unit normal and offset (mm) of every straight edge of gaps and triangles.
        gaps: (G,5) ring, line, sign, line, sign: a gap is the ring between two lines; -1 is a line's other side.
        triangles: (4,3,2) line and sign of the triangle's sides, turned clockwise by 0, 90, 180, 270 degrees.
    """

    @classmethod
    def of(cls, squares: Any, radii: Any, lines: Any, gaps: Any, triangles: Any) -> Drawing:
        """Arrays of consistent shapes.

        Raises:
            ValueError: a shape or an index is wrong, or there are more parts than the compiled code holds.
        """
        drawing = cls(
            contiguous(squares, (3,)),
            contiguous(radii, (-1, 2)),
            contiguous(lines, (-1, 3)),
            contiguous(gaps, (-1, 5)),
            contiguous(triangles, (QUARTERS, 3, 2)),
        )
        counts = (len(drawing.radii), len(drawing.lines), len(drawing.gaps))
        if any(have > most for have, most in zip(counts, (MAX_RINGS, MAX_LINES, MAX_GAPS), strict=True)):
            raise ValueError(f"{counts} rings, lines and gaps are too many")
        used = np.concatenate([drawing.gaps[:, [1, 3]].ravel(), drawing.triangles[:, :, 0].ravel()])
        if not ((used >= 0) & (used < counts[1])).all() or not (drawing.gaps[:, 0] < max(counts[0], 1)).all():
            raise ValueError("a line or a ring that is not there")
        return drawing

    @cached_property
    def flat(self) -> Float32Array:
        """The data in the order of `pattern.h`."""
        head = np.array([len(self.radii), len(self.lines), len(self.gaps)], dtype=np.float64)
        return np.concatenate([head, *(part.ravel() for part in self)]).astype(np.float32)

    @property
    def column_count(self) -> int:
        """Columns of :func:`coverage_columns_numpy`."""
        return GAP + len(self.gaps)


def coverage_columns_numpy(drawing: Drawing, points: FloatArray, spread: FloatArray) -> Float32Array:
    """(C,N) coverage: frame by the four inks, closed rings, triangle at four quarter turns, gaps.

    Args:
        points: (N,2) mm at nominal size, x right, y up.
        spread: (N,3) covariance of the point spread there: xx, xy, yy, mm^2.
    """
    jets = _Jets(points, spread, slopes=False)
    paper, face, ground = jets.squares(drawing)
    rings = jets.rings(drawing)
    lines = jets.lines(drawing.lines)
    columns = [(paper - face)[0], (face - ground)[0], ground[0], 1 - paper[0], rings.sum(axis=1)[0]]
    columns += [_triangle(jets, lines, sides)[0] for sides in drawing.triangles]
    columns += [jets.product(rings[:, int(gap[0])], _sector(jets, lines, gap))[0] for gap in drawing.gaps]
    return np.stack(columns)


def ink_jets_numpy(
    drawing: Drawing, points: FloatArray, spread: FloatArray, open_gaps: int, quarter: int, slopes: bool
) -> Float32Array:
    """(1 or 6,4,N) coverage by white, red, blue and surroundings for one hypothesis, and its slopes.

    Args:
        points, spread: as for :func:`coverage_columns_numpy`.
        open_gaps: bit k is set where gap k is open.
        quarter: quarter turns of the triangle, clockwise.
    """
    jets = _Jets(points, spread, slopes)
    paper, face, ground = jets.squares(drawing)
    rings = jets.rings(drawing)
    lines = jets.lines(drawing.lines)
    white = rings.sum(axis=1) + _triangle(jets, lines, drawing.triangles[quarter])
    for k, gap in enumerate(drawing.gaps):
        if open_gaps >> k & 1:
            white = white - jets.product(rings[:, int(gap[0])], _sector(jets, lines, gap))
    surroundings = -paper
    surroundings[0] += 1
    return np.stack([paper - face + white, face - ground, ground - white, surroundings], axis=1)


def _signed(lines: Float32Array, number: float, sign: float) -> Float32Array:
    jet = np.float32(sign) * lines[:, int(number)]
    if sign < 0:
        jet[0] += 1
    return jet


def _triangle(jets: _Jets, lines: Float32Array, sides: FloatArray) -> Float32Array:
    a, b, c = (_signed(lines, *side) for side in sides)
    return jets.product(jets.product(a, b), c)


def _sector(jets: _Jets, lines: Float32Array, gap: FloatArray) -> Float32Array:
    return jets.product(_signed(lines, gap[1], gap[2]), _signed(lines, gap[3], gap[4]))


class _Jets:
    """Edges seen from N points, in single precision: 1e-7 of a coverage, at a fifth of the time."""

    def __init__(self, points: FloatArray, spread: FloatArray, slopes: bool) -> None:
        self.points = np.ascontiguousarray(points.T, dtype=np.float32)
        self.spread = np.ascontiguousarray(spread.T, dtype=np.float32)
        self.slopes = slopes

    def squares(self, drawing: Drawing) -> list[Float32Array]:
        """Jets of the paper with its margin, the face, and the blue ground with its parts."""
        found = []
        for half in drawing.squares:
            edges = self.lines(np.array([[1, 0, -half], [1, 0, half], [0, 1, -half], [0, 1, half]]))
            found.append(self.product(edges[:, 0] - edges[:, 1], edges[:, 2] - edges[:, 3]))
        return found

    def lines(self, lines: FloatArray) -> Float32Array:
        """(J,L,N) coverage by the half planes n p > offset."""
        n = lines[:, :2].astype(np.float32)
        distance = n @ self.points - lines[:, 2:].astype(np.float32)
        weights = np.stack([n[:, 0] ** 2, 2 * n[:, 0] * n[:, 1], n[:, 1] ** 2], axis=1)
        return self._edges(distance, weights @ self.spread, n.T[:, :, None], weights.T[:, :, None])

    def rings(self, drawing: Drawing) -> Float32Array:
        """(J,R,N) the closed rings.

        A sideways step t increases the radius by t^2 / 2r, so with the variance T along the circle the point
        averages its surroundings at a radius larger by T / 2r: blur makes rings smaller.
        """
        x, y = self.points
        # At the center there is no direction, and no ring.
        radius = np.maximum(np.hypot(x, y), np.float32(1.0))
        nx, ny = x / radius, y / radius
        sxx, sxy, syy = self.spread
        across = np.stack([nx * nx, 2 * nx * ny, ny * ny])
        along = np.stack([ny * ny, -2 * nx * ny, nx * nx])
        variance = np.maximum((across * self.spread).sum(axis=0), 0.01 * (sxx + syy))
        # Not if the blur is as wide as the circle, where the series is not valid.
        outward = np.minimum((sxx + syy - variance) / (2 * radius), 0.3 * radius)
        # d(n'Sn)/dp = 2 (S n - (n'Sn) n) / r: both variances turn with the point.
        turning = np.stack([sxx * nx + sxy * ny - variance * nx, sxy * nx + syy * ny - variance * ny]) * (2 / radius)

        def outside(radii: FloatArray) -> Float32Array:
            distance = radius + outward - radii.astype(np.float32)[:, None]
            jets = self._edges(distance, variance, np.stack([nx, ny])[:, None], across[:, None])
            if self.slopes:
                by_variance = jets[3] + jets[5]  # nx^2 + ny^2 = 1
                by_distance = jets[1] * nx + jets[2] * ny
                jets[1:3] *= 1 - outward / radius
                jets[1:3] += (by_variance - by_distance / (2 * radius)) * turning[:, None]
                jets[3:] += by_distance / (2 * radius) * along[:, None]
            return jets

        return np.asarray(outside(drawing.radii[:, 0]) - outside(drawing.radii[:, 1]))

    def product(self, a: Float32Array, b: Float32Array) -> Float32Array:
        """Product of two jets, by Leibniz's rule."""
        result = a * b[:1]
        result[1:] += a[:1] * b[1:]
        return result

    def _edges(
        self, distance: Float32Array, variance: Float32Array, normal: Float32Array, weights: Float32Array
    ) -> Float32Array:
        """(J,K,N) from (K,N) distance and variance across the edge, and their slopes."""
        s = np.sqrt(variance)
        share, density = normal_distribution(np.asarray(distance / s, dtype=np.float32))
        if not self.slopes:
            return share[None]
        jets = np.empty((JET, *share.shape), dtype=np.float32)
        jets[0] = share
        density /= s
        np.multiply(density, normal, out=jets[1:3])
        density *= distance
        density /= -2 * variance
        np.multiply(density, weights, out=jets[3:])
        return jets


def normal_distribution(a: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Distribution and density of the standard normal (Abramowitz and Stegun 26.2.17, to 1e-7).

    Five times as fast as a library's, because the density is needed anyway.
    """
    density = np.exp(np.float32(-0.5) * a * a)
    density *= np.float32(1 / math.sqrt(2 * math.pi))
    t = np.abs(a)
    t *= np.float32(0.2316419)
    t += np.float32(1)
    np.reciprocal(t, out=t)
    tail = t * np.float32(1.330274429)
    for coefficient in (-1.821255978, 1.781477937, -0.356563782, 0.319381530):
        tail += np.float32(coefficient)
        tail *= t
    tail *= density
    return np.where(a > 0, np.float32(1) - tail, tail), density
