"""A planar pose from readings of any number of landmarks: ranges, bearings, or both.

1. Starts: every two landmarks in closed form (`two_landmarks.py`), circles around two landmarks with only a
   range, three bearings by resection (Pierlot and Van Droogenbroeck 2014), and points
   around one landmark if there is nothing else.
2. The start that the readings agree with best (Cauchy) is refined by weighted least squares with
   the same loss, so that a wrong reading does not bias it.
3. Readings within the gate give the covariance; another place that explains them as well makes the
   answer ambiguous.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from lmkit.arrays import BoolArray, FloatArray
from lmkit.geometry.planar import wrap_angle, wrap_heading
from lmkit.localization.range_bearing_noise import ReadingNoise
from lmkit.localization.two_landmarks import PlanarPose, locate_by_two
from lmkit.model.landmark_id import LandmarkId, ids_text
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.observation import RangeBearing
from lmkit.model.pose_status import PoseStatus
from lmkit.optim.levenberg_marquardt import Damping, minimize
from lmkit.optim.robust_loss import cauchy_cost, cauchy_weight

BEARING_ALONE_M = 2.0  # assumed distance of a landmark without a range
AROUND = 16  # starts around one landmark
MOST_STARTS = 60
AMBIGUOUS_BELOW = 5.0  # log likelihood ratio
SAME_PLACE_M = 0.25
STEPS = 15
HOPELESS = 115.0  # loss of a start over that of the best place
MOST_PLACES = 4


@dataclass(frozen=True, eq=False)
class PlanarEstimate:
    """A planar pose with its covariance.

    Attributes:
        status: ``ok``; ``ambiguous`` (another place, in ``alternatives``, explains the readings almost as
            well); ``no_landmarks`` (too few of the map's landmarks were read); ``inconsistent`` (no pose
            explains two landmarks and at least half of those read).
        pose: its heading is None where no bearing was read.
        covariance: (3,3) of x y (m) and heading (rad), (2,2) of x y where the heading is unknown.
        inliers, outliers: landmarks that the pose explains, and those that it does not.
        alternatives: other poses, best first, with the log likelihood ratio to the answer.
    """

    status: PoseStatus
    pose: PlanarPose | None = None
    covariance: FloatArray | None = None
    inliers: tuple[LandmarkId, ...] = ()
    outliers: tuple[LandmarkId, ...] = ()
    alternatives: tuple[tuple[PlanarPose, float], ...] = ()


@dataclass(frozen=True, eq=False)
class Readings:
    """Readings of mapped landmarks as arrays; NaN where a range or bearing is not there.

    Attributes:
        ids: (N) the landmarks.
        places: (N,2) of the landmarks, meters.
        ranges, bearings: (N,) meters, rad.
        range_sigma, bearing_sigma: (N,) their standard deviations, and what the map leaves open of the landmarks.
    """

    ids: tuple[LandmarkId, ...]
    places: FloatArray
    ranges: FloatArray
    bearings: FloatArray
    range_sigma: FloatArray
    bearing_sigma: FloatArray

    @classmethod
    def of(cls, readings: Sequence[RangeBearing], landmarks: LandmarkMap, noise: ReadingNoise) -> Readings:
        """Readings of landmarks that are in the map."""
        known = [(r, found) for r in readings if (found := landmarks.find(r.id)) is not None]
        ranges = np.array([np.nan if r.range_m is None else r.range_m for r, _ in known])
        bearings = np.array([np.nan if r.bearing_rad is None else r.bearing_rad for r, _ in known])
        places = np.array([found.T_map_landmark.t[:2] for _, found in known]).reshape(-1, 2)
        # Isotropic, because the direction of view is not yet known.
        open_m = np.array(
            [0.0 if m.covariance is None else math.sqrt(np.trace(m.covariance[:2, :2]) / 2) for _, m in known]
        )
        range_sigma, bearing_sigma = noise.sigmas([r for r, _ in known])
        aside = open_m / np.where(np.isfinite(ranges), ranges, BEARING_ALONE_M)
        return cls(
            tuple(r.id for r, _ in known),
            places,
            ranges,
            bearings,
            np.hypot(range_sigma, open_m),
            np.hypot(bearing_sigma, aside),
        )

    def only(self, rows: BoolArray) -> Readings:
        """Some of them."""
        ids = tuple(id_ for id_, kept in zip(self.ids, rows, strict=True) if kept)
        arrays = (self.places, self.ranges, self.bearings, self.range_sigma, self.bearing_sigma)
        return Readings(ids, *(values[rows] for values in arrays))

    @property
    def turnable(self) -> bool:
        """Whether there is a bearing, so that the heading is determined."""
        return bool(np.isfinite(self.bearings).any())

    def standardized(self, states: FloatArray) -> FloatArray:
        """(S,N,2) measured minus expected range and bearing of (S,3) states, in standard deviations; 0 where none."""
        off = self.places - states[:, None, :2]
        ranges = (self.ranges - np.hypot(off[..., 0], off[..., 1])) / self.range_sigma
        directions = np.arctan2(off[..., 1], off[..., 0]) - states[:, None, 2]
        bearings = wrap_angle(self.bearings - directions) / self.bearing_sigma
        return np.nan_to_num(np.stack([ranges, bearings], axis=2))

    def jacobian(self, state: FloatArray) -> FloatArray:
        """(N,2,3) of the expected range and bearing with x, y and heading, in standard deviations; 0 where none."""
        off = self.places - state[:2]
        squared = np.maximum((off**2).sum(axis=1), 1e-12)
        distance = np.sqrt(squared)
        J = np.zeros((len(off), 2, 3))
        J[:, 0, :2] = -off / distance[:, None] / self.range_sigma[:, None]
        J[:, 1, 0] = off[:, 1] / squared / self.bearing_sigma
        J[:, 1, 1] = -off[:, 0] / squared / self.bearing_sigma
        J[:, 1, 2] = -1 / self.bearing_sigma
        J[~np.isfinite(self.ranges), 0] = 0
        J[~np.isfinite(self.bearings), 1] = 0
        return J


def locate_planar(
    readings: Sequence[RangeBearing], landmarks: LandmarkMap, noise: ReadingNoise | None = None
) -> PlanarEstimate:
    """The sensor's pose from readings of one frame.

    Two landmarks with range and bearing are enough, or a range of one and ranges of two others, or
    bearings of three; with less, no pose is returned.
    """
    noise = noise or ReadingNoise()
    seen = Readings.of(readings, landmarks, noise)
    named = tuple(sorted(set(seen.ids)))
    if not _enough(seen):
        return PlanarEstimate(PoseStatus.NO_LANDMARKS, outliers=named)
    starts, unique = _starts(seen)
    if not len(starts):
        return PlanarEstimate(PoseStatus.INCONSISTENT, outliers=named)
    cost = cauchy_cost(_squared(seen, starts)).sum(axis=1)
    found: list[tuple[float, FloatArray]] = []
    for k in np.argsort(cost, kind="stable"):
        # The best start and, if the readings leave a choice, the other plausible ones.
        if found and (unique or cost[k] > found[0][0] + HOPELESS or len(found) >= MOST_PLACES):
            break
        if any(_near(starts[k], state) for _, state in found):
            continue
        state = refined(seen, starts[k])
        if not any(_near(state, other) for _, other in found):
            found.append((_loss(seen, state), state))
    found.sort(key=lambda entry: entry[0])
    return _judged(seen, found, noise, named)


def _judged(
    seen: Readings, found: Sequence[tuple[float, FloatArray]], noise: ReadingNoise, named: tuple[LandmarkId, ...]
) -> PlanarEstimate:
    state = found[0][1]
    gate = noise.outlier_sigma**2
    for _ in range(2):
        # Readings outside the gate must not have any influence.
        explained = _squared(seen, state[None])[0] < gate
        if explained.all() or explained.sum() < 2:
            break
        state = refined(seen.only(explained), state)
    explained = _squared(seen, state[None])[0] < gate
    inliers = {id_ for id_, good in zip(seen.ids, explained, strict=True) if good}
    if len(inliers) < 2 or 2 * explained.sum() < len(seen.ids):
        return PlanarEstimate(PoseStatus.INCONSISTENT, outliers=named)
    known = 3 if seen.turnable else 2
    J = seen.jacobian(state)[explained].reshape(-1, 3)[:, :known]
    normal = J.T @ J
    if not np.isfinite(normal).all() or np.linalg.cond(normal) > 1e12:
        return PlanarEstimate(PoseStatus.INCONSISTENT, outliers=named)
    covariance = np.linalg.inv(normal)
    if known == 3:
        covariance[2, 2] += noise.common_bearing_rad**2
    # The likelihood is Gaussian within the gate; an unexplained reading costs as much as the gate.
    likelihood = [np.minimum(_squared(seen, other[None])[0], gate).sum() / 2 for _, other in found]
    others = sorted(
        (float(likelihood[k] - likelihood[0]), k) for k in range(1, len(found)) if likelihood[k] - likelihood[0] < 25
    )
    status = PoseStatus.AMBIGUOUS if others and others[0][0] < AMBIGUOUS_BELOW else PoseStatus.OK
    return PlanarEstimate(
        status,
        _pose(state, seen),
        covariance,
        tuple(sorted(inliers)),
        tuple(sorted(set(seen.ids) - inliers)),
        tuple((_pose(found[k][1], seen), ratio) for ratio, k in others),
    )


@dataclass(frozen=True, eq=False)
class _PlanarProblem:
    """Readings, with Cauchy's loss, as a problem in x, y and heading."""

    seen: Readings

    def linearize(self, state: FloatArray) -> tuple[tuple[FloatArray, FloatArray], float]:
        errors = self.seen.standardized(state[None])[0]
        squared = (errors**2).sum(axis=1)
        J = self.seen.jacobian(state)
        weighted = cauchy_weight(squared)[:, None, None] * J
        normal = np.einsum("nij,nik->jk", weighted, J)
        return (normal, np.einsum("nij,ni->j", weighted, errors)), float(cauchy_cost(squared).sum())

    def solve(self, equations: tuple[FloatArray, FloatArray], damping: float) -> FloatArray:
        normal, gradient = equations
        return np.asarray(np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-9), gradient))

    def retract(self, state: FloatArray, step: FloatArray) -> FloatArray:
        return np.asarray(state + step)


def refined(seen: Readings, start: FloatArray) -> FloatArray:
    """(3,) the state that the readings agree with best, from a start nearby."""
    state = minimize(_PlanarProblem(seen), start, STEPS, 1e-9, Damping(first_grown=1e-4)).state
    return np.array([state[0], state[1], wrap_heading(state[2])])


def _loss(seen: Readings, state: FloatArray) -> float:
    return float(cauchy_cost(_squared(seen, state[None])).sum())


def _squared(seen: Readings, states: FloatArray) -> FloatArray:
    """(S,N) of every reading of every state: squared error in standard deviations, range and bearing together."""
    return np.asarray((seen.standardized(states) ** 2).sum(axis=2))


def _enough(seen: Readings) -> bool:
    """Whether the readings have enough values, from enough landmarks, for a pose."""
    ranged = {c for c, r in zip(seen.ids, seen.ranges, strict=True) if np.isfinite(r)}
    turned = {c for c, b in zip(seen.ids, seen.bearings, strict=True) if np.isfinite(b)}
    numbers = len(ranged) + len(turned) - (1 if turned else 0)
    return len(ranged | turned) >= 2 and numbers >= 2 and (bool(ranged) or len(turned) >= 3)


def _starts(seen: Readings) -> tuple[FloatArray, bool]:
    """(S,3) states to start from, and whether they are guesses of one place: ranges with bearings leave no choice."""
    full = np.flatnonzero(np.isfinite(seen.ranges) & np.isfinite(seen.bearings))
    ranged, turned = np.flatnonzero(np.isfinite(seen.ranges)), np.flatnonzero(np.isfinite(seen.bearings))
    starts: list[FloatArray] = []
    for a, b in combinations(full.tolist(), 2):
        A, B = seen.places[a], seen.places[b]
        if np.hypot(*(B - A)) > 1e-6 and len(starts) < MOST_STARTS:
            pose = locate_by_two(A, B, *seen.ranges[[a, b]], *seen.bearings[[a, b]])
            starts.append(np.array([pose.x_m, pose.y_m, pose.heading_rad]))
    if starts:
        return np.array(starts), True
    places = [place for a, b in combinations(ranged.tolist(), 2) for place in _crossings(seen, a, b)]
    places += [
        place for triple in combinations(turned[:8].tolist(), 3) if (place := _resection(seen, triple)) is not None
    ]
    if (len(ranged) and not places) or (len(ranged) == 1):
        a = int(ranged[0])
        angles = np.arange(AROUND) / AROUND * 2 * np.pi
        places += list(seen.places[a] + seen.ranges[a] * np.column_stack([np.cos(angles), np.sin(angles)]))
    return np.array([[*place, _heading(seen, place)] for place in places[:MOST_STARTS]]).reshape(-1, 3), False


def _crossings(seen: Readings, a: int, b: int) -> list[FloatArray]:
    """Intersections of the circles around two landmarks, or their closest points."""
    A, B, ra, rb = seen.places[a], seen.places[b], seen.ranges[a], seen.ranges[b]
    d = float(np.hypot(*(B - A)))
    if d < 1e-6:
        return []
    u = (B - A) / d
    along = (ra**2 - rb**2 + d**2) / (2 * d)
    across = math.sqrt(max(ra**2 - along**2, 0.0))
    n = np.array([-u[1], u[0]])
    return [A + along * u + across * n, A + along * u - across * n]


def _resection(seen: Readings, triple: tuple[int, ...]) -> FloatArray | None:
    """The place from three bearings; None on the circle through the three landmarks, where there is none."""
    (P1, P2, P3), (t1, t2, t3) = seen.places[list(triple)], seen.bearings[list(triple)]
    one, three = P1 - P2, P3 - P2
    with np.errstate(divide="ignore", invalid="ignore"):
        cot12, cot23 = 1 / np.tan(t2 - t1), 1 / np.tan(t3 - t2)
        cot31 = (1 - cot12 * cot23) / (cot12 + cot23)
        c12 = np.array([one[0] + cot12 * one[1], one[1] - cot12 * one[0]])
        c23 = np.array([three[0] - cot23 * three[1], three[1] + cot23 * three[0]])
        c31 = np.array(
            [one[0] + three[0] + cot31 * (three[1] - one[1]), one[1] + three[1] - cot31 * (three[0] - one[0])]
        )
        k31 = one @ three + cot31 * (one[0] * three[1] - three[0] * one[1])
        D = (c12[0] - c23[0]) * (c23[1] - c31[1]) - (c12[1] - c23[1]) * (c23[0] - c31[0])
        place = P2 + k31 * np.array([c12[1] - c23[1], c23[0] - c12[0]]) / D
    return np.asarray(place) if np.isfinite(place).all() and np.abs(place - P2).max() < 1e4 else None


def _heading(seen: Readings, place: FloatArray) -> float:
    """Mean heading from the bearings, 0 if there is none."""
    turned = np.isfinite(seen.bearings)
    if not turned.any():
        return 0.0
    off = seen.places[turned] - place
    headings = np.arctan2(off[:, 1], off[:, 0]) - seen.bearings[turned]
    return float(np.arctan2(np.sin(headings).sum(), np.cos(headings).sum()))


def _near(a: FloatArray, b: FloatArray) -> bool:
    return bool(np.hypot(*(a - b)[:2]) < SAME_PLACE_M and abs(wrap_heading(a[2] - b[2])) < math.radians(10))


def _pose(state: FloatArray, seen: Readings) -> PlanarPose:
    return PlanarPose(float(state[0]), float(state[1]), float(state[2]) if seen.turnable else None)


def planar_dict(estimate: PlanarEstimate, path: Path, time_s: float, source: str = "readings") -> dict[str, Any]:
    """JSON of one planar result (docs/formats.md).

    Args:
        source: key of the path.
    """
    pose, covariance = estimate.pose, estimate.covariance
    result: dict[str, Any] = {
        source: str(path),
        "time_s": time_s,
        "status": estimate.status,
        "position": None,
        "heading_rad": None,
        "covariance": None if covariance is None else covariance.tolist(),
        "codes": [i.code for i in estimate.inliers],
        "ids": [str(i) for i in estimate.inliers],
        "outlier_codes": [i.code for i in estimate.outliers],
        "outlier_ids": [str(i) for i in estimate.outliers],
        "alternatives": [
            {"position": [other.x_m, other.y_m], "heading_rad": other.heading_rad, "log_likelihood_ratio": ratio}
            for other, ratio in estimate.alternatives
        ],
    }
    if pose is not None:
        result["position"] = [pose.x_m, pose.y_m]
        result["heading_rad"] = pose.heading_rad
    return result


def planar_line(estimate: PlanarEstimate) -> str:
    """One planar result as text."""
    outliers = f", outliers {ids_text(estimate.outliers)}" if estimate.outliers else ""
    if estimate.pose is None:
        return f"{estimate.status}{outliers}"
    pose = estimate.pose
    heading = "unknown" if pose.heading_rad is None else f"{math.degrees(pose.heading_rad):.2f} deg"
    where = f"x {pose.x_m:.3f} y {pose.y_m:.3f} m, heading {heading}"
    return f"{estimate.status}, {where}, codes {ids_text(estimate.inliers)}{outliers}"
