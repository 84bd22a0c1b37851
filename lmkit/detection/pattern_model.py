"""What a landmark looks like through a lens: blurred coverage of every part, in closed form.

A picture of the flat pattern is the sharp drawing blurred by the point spread of lens, motion and
pixel.  With a Gaussian point spread of covariance S (mm^2, in the landmark's plane) an edge whose
signed distance from a point is d (mm, positive inside) and whose unit normal is n covers the
point by ``Phi(d / sqrt(n' S n))``; parts bounded by several edges multiply.  The point spread
needs not be round, so motion blur is the same formula.

Everything is carried as jets: arrays whose first axis holds the value and, where asked for, its
slopes with x, y and the point spread's xx, xy, yy, so that products obey Leibniz's rule in one line.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lmkit.arrays import Float32Array, FloatArray
from lmkit.model.landmark import LandmarkFamily

INKS = 4  # white, red, blue, and whatever surrounds the white margin
QUARTERS = 4
JET = 6  # value, d/dx, d/dy, d/dSxx, d/dSxy, d/dSyy


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
    """PatternCoverage model of one family; the geometry is the family's own."""

    family: LandmarkFamily

    def coverage(self, points: FloatArray, spread: FloatArray) -> PatternCoverage:
        """PatternCoverage by every part, whatever the code.

        Args:
            points: (N,2) mm at nominal size, x right, y up.
            spread: (N,3) covariance of the point spread there: xx, xy, yy, mm^2.
        """
        jets = _Jets(points, spread, slopes=False)
        paper, face, ground = self._squares(jets)
        rings = self._rings(jets)
        gaps = np.stack([g[0] for _, g in self._gaps(jets, rings, range(self.family.gap_count))], axis=1)
        triangles = np.stack([self._triangle(jets, quarter)[0] for quarter in range(QUARTERS)], axis=1)
        frame = np.stack([(paper - face)[0], (face - ground)[0], ground[0], 1 - paper[0]], axis=1)
        fixed = frame + rings.sum(axis=1)[0][:, None] * np.array([1, 0, -1, 0], dtype=np.float32)
        return PatternCoverage(*(part.astype(np.float64) for part in (fixed, triangles, gaps, frame)))

    def inks(
        self, points: FloatArray, spread: FloatArray, open_gaps: Sequence[int], quarter: int, slopes: bool = False
    ) -> FloatArray:
        """(1 or 6,N,4) coverage by white, red, blue and surroundings for one reading, and its slopes.

        Args:
            points, spread: as for :meth:`coverage`.
            open_gaps: gap positions (of the quad's frame) that are open.
            quarter: quarter turns of the triangle, clockwise.
            slopes: also with x, y, Sxx, Sxy, Syy.
        """
        jets = _Jets(points, spread, slopes)
        paper, face, ground = self._squares(jets)
        rings = self._rings(jets)
        white = rings.sum(axis=1) + self._triangle(jets, quarter)
        for _, gap in self._gaps(jets, rings, open_gaps):
            white = white - gap
        surroundings = -paper
        surroundings[0] += 1
        inks = [paper - face + white, face - ground, ground - white, surroundings]
        return np.stack(inks, axis=2).astype(np.float64)

    def _squares(self, jets: _Jets) -> tuple[Float32Array, ...]:
        """Paper with its margin, face, and blue ground with all that is on it."""
        halves = [self.family.half_mm + self.family.margin_mm, self.family.half_mm, self.family.ground_half_mm]
        normals, offsets = [], []
        for axis in ((1.0, 0.0), (0.0, 1.0)):
            for side in (-1, 1):
                normals += [axis] * len(halves)
                offsets += [side * half for half in halves]
        left, right, below, above = np.split(jets.half_planes(normals, offsets), 4, axis=1)
        squares = jets.product(left - right, below - above)
        return tuple(squares[:, k] for k in range(len(halves)))

    def _rings(self, jets: _Jets) -> Float32Array:
        """(J,R,N) the closed rings."""
        inner = jets.outside_circles([ring.inner_mm for ring in self.family.rings])
        return np.asarray(inner - jets.outside_circles([ring.outer_mm for ring in self.family.rings]))

    def _gaps(self, jets: _Jets, rings: Float32Array, columns: Sequence[int]) -> list[tuple[int, Float32Array]]:
        """Gap position and (J,N) the ring's coverage inside it, for the wanted positions."""
        wanted = [(column, *self._gap_rays[column]) for column in columns]
        if not wanted:
            return []
        normals = [ray for _, _, after, before in wanted for ray in (after, before)]
        rays = jets.half_planes(normals, [0.0] * len(normals))
        sectors = jets.product(rays[:, 0::2], rays[:, 1::2])
        of_ring = rings[:, [ring for _, ring, _, _ in wanted]]
        gaps = jets.product(of_ring, sectors)
        return [(column, gaps[:, k]) for k, (column, *_) in enumerate(wanted)]

    @cached_property
    def _gap_rays(self) -> list[tuple[int, tuple[float, float], tuple[float, float]]]:
        """For each gap position: its ring, and the normals of the rays that bound it, pointing inside."""
        rays = []
        for number, ring in enumerate(self.family.rings):
            for centre in ring.gap_centres_deg:
                start, end = (math.radians(centre + s * ring.gap_width_deg / 2) for s in (-1, 1))
                rays.append((number, (math.cos(start), -math.sin(start)), (-math.cos(end), math.sin(end))))
        return rays

    def _triangle(self, jets: _Jets, quarter: int) -> Float32Array:
        """(J,N) the triangle at one quarter turn, the product of its three half planes."""
        corners = self.family.triangle_vertices_mm @ _QUARTER_TURNS[quarter].T
        normals, offsets = [], []
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            # The vertices run clockwise, so the inside lies to the right of each edge.
            edge = (b - a) / np.linalg.norm(b - a)
            normal = (float(edge[1]), -float(edge[0]))
            normals.append(normal)
            offsets.append(float(a @ normal))
        sides = jets.half_planes(normals, offsets)
        return jets.product(jets.product(sides[:, 0], sides[:, 1]), sides[:, 2])

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


@dataclass(frozen=True)
class _Jets:
    """Edges seen from N points, in single precision: 1e-7 of a coverage, at a fifth of the time."""

    points: FloatArray
    spread: FloatArray
    slopes: bool

    def half_planes(self, normals: Sequence[tuple[float, float]], offsets: Sequence[float]) -> Float32Array:
        """(J,K,N) coverage by the half planes n p > offset."""
        n = np.array(normals, dtype=np.float32)
        distance = n @ self._points - np.array(offsets, dtype=np.float32)[:, None]
        weights = np.stack([n[:, 0] ** 2, 2 * n[:, 0] * n[:, 1], n[:, 1] ** 2], axis=1)
        return self._edges(distance, weights @ self._spread, n.T[:, :, None], weights.T[:, :, None])

    def outside_circles(self, radii: Sequence[float]) -> Float32Array:
        """(J,K,N) coverage by what lies outside circles around the origin.

        A step aside by t leads outwards by t^2 / 2r, so with the variance T along the circle the point
        sees its surroundings, in the mean, from T / 2r further out: blur makes rings smaller.
        """
        x, y = self._points
        # At the very centre there is no direction; no ring reaches there.
        radius = np.maximum(np.hypot(x, y), np.float32(1.0))
        nx, ny = x / radius, y / radius
        sxx, sxy, syy = self._spread
        across = np.stack([nx * nx, 2 * nx * ny, ny * ny])
        along = np.stack([ny * ny, -2 * nx * ny, nx * nx])
        variance = np.maximum((across * self._spread).sum(axis=0), 0.01 * (sxx + syy))
        sideways = sxx + syy - variance
        # Not where the blur is as wide as the circle, and the series ends.
        outwards = np.minimum(sideways / (2 * radius), 0.3 * radius)
        distance = radius + outwards - np.array(radii, dtype=np.float32)[:, None]
        jets = self._edges(distance, variance, np.stack([nx, ny])[:, None], across[:, None])
        if self.slopes:
            # Both variances turn with the point: d(n'Sn)/dp = 2 (S n - (n'Sn) n) / r.
            turning = np.stack([sxx * nx + sxy * ny - variance * nx, sxy * nx + syy * ny - variance * ny]) * (
                2 / radius
            )
            by_variance = jets[3] + jets[5]  # nx^2 + ny^2 = 1
            by_distance = jets[1] * nx + jets[2] * ny
            jets[1:3] *= 1 - outwards / radius
            jets[1:3] += (by_variance - by_distance / (2 * radius)) * turning[:, None]
            jets[3:] += by_distance / (2 * radius) * along[:, None]
        return jets

    def product(self, a: Float32Array, b: Float32Array) -> Float32Array:
        """Of two jets, by Leibniz's rule."""
        result = a * b[:1]
        result[1:] += a[:1] * b[1:]
        return result

    def _edges(
        self, distance: Float32Array, variance: Float32Array, normal: Float32Array, weights: Float32Array
    ) -> Float32Array:
        """(J,K,N) from (K,N) distance and variance across the edge, and what those change with."""
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

    @cached_property
    def _points(self) -> Float32Array:
        return np.ascontiguousarray(self.points.T, dtype=np.float32)

    @cached_property
    def _spread(self) -> Float32Array:
        return np.ascontiguousarray(self.spread.T, dtype=np.float32)


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


def _clockwise(quarter: int) -> FloatArray:
    c, s = [(1, 0), (0, 1), (-1, 0), (0, -1)][quarter]
    return np.array([[c, s], [-s, c]], dtype=np.float64)


_QUARTER_TURNS = [_clockwise(q) for q in range(QUARTERS)]
