"""A planar pose from range and bearing to any number of landmarks.

Every two landmarks whose readings close their triangle give a pose (`two_landmarks.py`); the one
that most readings agree with starts a weighted least squares over all that do.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.locate.two_landmarks import PlanarPose, closure_m, locate_by_two
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.observation import RangeBearing


@dataclass(frozen=True)
class ReadingNoise:
    """What the sensor's readings scatter by, and where they stop being believed."""

    range_m: float = 0.1
    bearing_rad: float = math.radians(1.0)
    outlier_sigma: float = 4.0


@dataclass(frozen=True, eq=False)
class PlanarEstimate:
    """A planar pose with its covariance.

    Attributes:
        status: ``ok``; ``no_landmarks`` (fewer than two of the map's landmarks were read);
            ``inconsistent`` (no pose explains two of them and most of the readings).
        covariance: (3,3) of x y (m) and heading (rad).
        inlier_codes, outlier_codes: landmarks that the pose explains, and those that it does not.
    """

    status: str
    pose: PlanarPose | None = None
    covariance: FloatArray | None = None
    inlier_codes: tuple[int, ...] = ()
    outlier_codes: tuple[int, ...] = ()


def locate_planar(
    readings: Sequence[RangeBearing], landmarks: LandmarkMap, noise: ReadingNoise | None = None
) -> PlanarEstimate:
    """The sensor's pose from readings of one moment."""
    noise = noise or ReadingNoise()
    known = [(r, found.T_map_landmark.t[:2]) for r in readings if (found := landmarks.find(r.code)) is not None]
    if len({r.code for r, _ in known}) < 2:
        return PlanarEstimate("no_landmarks", outlier_codes=tuple(sorted({r.code for r, _ in known})))
    best: tuple[int, float, FloatArray] | None = None
    for (a, A), (b, B) in combinations(known, 2):
        if a.code == b.code or abs(_closure(a, A, b, B)) > _closure_limit(a, b, noise):
            continue
        start = locate_by_two(A, B, a.range_m, b.range_m, a.bearing_rad, b.bearing_rad)
        state = np.array([start.x_m, start.y_m, start.heading_rad])
        sizes = np.abs(_standardised(state, known, noise)).reshape(-1, 2).max(axis=1)
        limit = noise.outlier_sigma
        score = (int(np.sum(sizes < limit)), -float(np.minimum(sizes, limit).sum()), state)
        if best is None or score[:2] > best[:2]:
            best = score
    if best is None:
        return PlanarEstimate("inconsistent", outlier_codes=tuple(sorted({r.code for r, _ in known})))
    state, inlying = best[2], known
    for _ in range(4):
        sizes = np.abs(_standardised(state, known, noise)).reshape(-1, 2).max(axis=1)
        inlying = [entry for entry, size in zip(known, sizes, strict=True) if size < noise.outlier_sigma]
        if len(inlying) < 2 or 2 * len(inlying) < len(known):
            return PlanarEstimate("inconsistent", outlier_codes=tuple(sorted({r.code for r, _ in known})))
        state = _refined(state, inlying, noise)
    J = _jacobian(state, inlying, noise)
    inliers = {r.code for r, _ in inlying}
    return PlanarEstimate(
        "ok",
        PlanarPose(float(state[0]), float(state[1]), _wrapped(float(state[2]))),
        np.asarray(np.linalg.inv(J.T @ J)),
        tuple(sorted(inliers)),
        tuple(sorted({r.code for r, _ in known} - inliers)),
    )


def _closure(a: RangeBearing, A: FloatArray, b: RangeBearing, B: FloatArray) -> float:
    return closure_m(A, B, a.range_m, b.range_m, a.bearing_rad, b.bearing_rad)


def _closure_limit(a: RangeBearing, b: RangeBearing, noise: ReadingNoise) -> float:
    """How far a true pair of readings may miss the distance between its landmarks, metres."""
    sideways = max(a.range_m, b.range_m) * noise.bearing_rad
    return noise.outlier_sigma * math.sqrt(2) * math.hypot(noise.range_m, sideways)


_Known = Sequence[tuple[RangeBearing, FloatArray]]


def _refined(state: FloatArray, known: _Known, noise: ReadingNoise) -> FloatArray:
    """Gauss-Newton on ranges and bearings in units of their noise."""
    for _ in range(8):
        J = _jacobian(state, known, noise)
        step = np.linalg.solve(J.T @ J, J.T @ _standardised(state, known, noise))
        state = state + step
        if np.abs(step).max() < 1e-9:
            break
    return state


def _standardised(state: FloatArray, known: _Known, noise: ReadingNoise) -> FloatArray:
    """(2N,) measured minus expected range and bearing, in standard deviations."""
    rows = []
    for reading, place in known:
        dx, dy = place[0] - state[0], place[1] - state[1]
        rows.append((reading.range_m - math.hypot(dx, dy)) / noise.range_m)
        rows.append(_wrapped(reading.bearing_rad - math.atan2(dy, dx) + float(state[2])) / noise.bearing_rad)
    return np.array(rows)


def _jacobian(state: FloatArray, known: _Known, noise: ReadingNoise) -> FloatArray:
    """(2N,3) of the expected range and bearing with x, y and heading, in standard deviations."""
    rows = []
    for _, place in known:
        dx, dy = place[0] - state[0], place[1] - state[1]
        r2 = max(dx * dx + dy * dy, 1e-12)
        r = math.sqrt(r2)
        rows.append(np.array([-dx / r, -dy / r, 0.0]) / noise.range_m)
        rows.append(np.array([dy / r2, -dx / r2, -1.0]) / noise.bearing_rad)
    return np.array(rows)


def _wrapped(angle: float) -> float:
    return math.atan2(math.sin(angle), math.cos(angle))
