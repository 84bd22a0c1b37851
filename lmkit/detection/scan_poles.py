"""Poles of known radius in a laser scan, with covariances.

A pole is a free-standing object whose angular width fits its radius and whose ranges fit a circle.  The center
follows from the ranges (Gauss and Newton) and from which beams hit the pole and which passed beside it: at steps of a
degree, few beams hit, and the passing ones give most information on the bearing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.detection.scan_objects import ScanObject, scan_objects
from lmkit.geometry.planar import wrap_heading
from lmkit.model.scan import LaserScan, ScannedPole

STEPS = 8
SIGMAS_FREE = 5.0  # by which a pole is in front of its surroundings
WIDTH_SLACK = 0.6  # of a step, by which a pole may appear too narrow or too wide: beams are not infinitely thin
BEAM_SIGMA = 0.25  # of a step: where within a beam the echo comes from
GRAZING = 0.97  # of the radius; a beam farther out is calculated as if it hit there
CHI2_PER_BEAM = 4.0
CHI2_MORE = 8.0
STRAY_SIGMAS = 5.0  # a beam at the edge that is farther behind the circle has hit what lies behind the pole, too


@dataclass(frozen=True)
class ScanNoise:
    """Errors of a scanner, and what makes a reflector.

    Attributes:
        range_m: standard deviation of one range.
        common_range_m: standard deviation of what all ranges of one pole share (surface, scale).
        bright_from: intensity of a reflector; None: poles are found by their shape alone.
    """

    range_m: float = 0.01
    common_range_m: float = 0.003
    bright_from: float | None = None


def find_poles(scan: LaserScan, radii_m: Sequence[float], noise: ScanNoise | None = None) -> list[ScannedPole]:
    """All objects that fit a pole, once for each radius that fits.

    Args:
        radii_m: radii of the poles to look for, meters.
    """
    noise = noise or ScanNoise()
    found = []
    for place, item in enumerate(scan_objects(scan, noise.range_m, noise.bright_from)):
        for radius in sorted(set(radii_m)):
            pole = _fitted(item, radius, scan, noise, place)
            if pole is not None:
                found.append(pole)
    return found


def _fitted(item: ScanObject, radius: float, scan: LaserScan, noise: ScanNoise, place: int) -> ScannedPole | None:
    bright = noise.bright_from is not None
    if not bright and not item.stands_free(max(radius, SIGMAS_FREE * noise.range_m)):
        return None
    step = abs(scan.step_rad)
    nearest = float(item.ranges_m.min())
    most = 2 * math.asin(min(radius / (nearest + radius), 1.0)) / step + 1 + 2 * WIDTH_SLACK
    if len(item.beams) > most + 2:  # two stray beams at the edges at most
        return None
    angles, ranges = item.angles_rad, item.ranges_m
    for _ in range(3):
        fit = _Circle(angles, ranges, radius, step, noise.range_m)
        if not fit.solve():
            return None
        stray = fit.errors() > STRAY_SIGMAS
        edge = [k for k in (0, len(angles) - 1) if stray[k]]
        if not edge or len(angles) - len(edge) < 1:
            break
        keep = np.ones(len(angles), dtype=bool)
        keep[edge] = False
        angles, ranges = angles[keep], ranges[keep]
    else:
        return None
    chi2 = float((fit.errors() ** 2).sum())
    if len(angles) > 2 and chi2 > CHI2_PER_BEAM * (len(angles) - 2) + CHI2_MORE:
        return None
    covariance = fit.covariance()
    covariance[0, 0] += noise.common_range_m**2
    middle = int(item.beams[len(item.beams) // 2])
    distance, bearing = fit.state
    return ScannedPole(
        float(distance),
        wrap_heading(float(bearing)),
        covariance,
        radius,
        len(angles),
        place,
        scan.time_s + scan.beam_s * middle,
    )


class _Circle:
    """Range and bearing of the center of a circle that beams hit."""

    def __init__(self, angles: FloatArray, ranges: FloatArray, radius: float, step: float, sigma_m: float) -> None:
        self.angles, self.ranges, self.radius, self.step, self.sigma_m = angles, ranges, radius, step, sigma_m
        self.state = np.array([ranges.min() + radius, (angles.min() + angles.max()) / 2])

    def solve(self) -> bool:
        """Iterate; False where the beams that hit and passed do not fit the width."""
        for _ in range(STEPS):
            bounds = self._bounds()
            if bounds is None:
                return False
            r, J = self._linearized()
            normal = J.T @ J
            gradient = J.T @ r
            center, sigma = bounds
            normal[1, 1] += sigma**-2
            gradient[1] += (center - self.state[1]) / sigma**2
            move = np.linalg.solve(normal, gradient)
            self.state = self.state + move
            if self.state[0] < 1.02 * self.radius:
                return False
            if abs(move[0]) < 1e-7 and abs(move[1]) < 1e-8:
                break
        return self._bounds() is not None

    def covariance(self) -> FloatArray:
        """(2,2) of range and bearing."""
        _, J = self._linearized()
        normal = J.T @ J
        bounds = self._bounds()
        assert bounds is not None
        normal[1, 1] += bounds[1] ** -2
        return np.asarray(np.linalg.inv(normal))

    def errors(self) -> FloatArray:
        """(K,) measured minus expected range in standard deviations; positive behind the circle."""
        return self._linearized()[0]

    def _linearized(self) -> tuple[FloatArray, FloatArray]:
        distance, bearing = self.state
        off = self.angles - bearing
        aside = np.clip(distance * np.sin(off), -GRAZING * self.radius, GRAZING * self.radius)
        sine, cosine = aside / distance, np.sqrt(1 - (aside / distance) ** 2)
        depth = np.sqrt(self.radius**2 - aside**2)
        expected = distance * cosine - depth
        by_angle = -distance * sine + distance**2 * sine * cosine / depth
        by_distance = cosine + distance * sine**2 / depth
        sigma = np.hypot(self.sigma_m, by_angle * BEAM_SIGMA * self.step)
        return (self.ranges - expected) / sigma, np.column_stack([by_distance, -by_angle]) / sigma[:, None]

    def _bounds(self) -> tuple[float, float] | None:
        """Bearing at which just these beams hit, with its standard deviation; None where there is none."""
        first, last, step = self.angles.min(), self.angles.max(), self.step
        half = math.asin(min(self.radius / self.state[0], 1.0))
        low = max(last - half, first - step + half)
        high = min(first + half, last + step - half)
        if high - low < -2 * WIDTH_SLACK * step:
            return None
        width = max(high - low, 0.0)
        return (low + high) / 2, math.hypot(width / math.sqrt(12), BEAM_SIGMA * step)
