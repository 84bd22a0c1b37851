"""Association of poles in a scan with poles of the map, from a rough pose or from the distances between poles.

Every pair of scanned poles with the distance of a pair of the map gives a pose hypothesis of the sensor, and so does
the rough pose, if given.  Each is refined with all poles that it explains, and compared by its log likelihood ratio
to the hypothesis that all are clutter: the fit of the poles, the mapped poles that beams should have hit, and the
share of the map's area that the pose allows.  If a second pose is nearly as probable, the result is ambiguous.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lmkit.arrays import FloatArray, IntArray
from lmkit.geometry.planar import wrap_angle, wrap_heading
from lmkit.localization.range_bearing import AMBIGUOUS_BELOW, SAME_PLACE_M, PlanarEstimate
from lmkit.localization.two_landmarks import PlanarPose
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.observation import RangeBearing
from lmkit.model.pose_status import PoseStatus
from lmkit.model.scan import POLE, LaserScan, ScannedPole, ScannerMount

GATE = 13.8  # chi2 of 2 numbers, exceeded once in a thousand
PAIR_SIGMAS = 4.0
MOST_POSES = 4000  # hypotheses of one scan
MOST_REFINED = 40
FEWER = 2.5  # largest number of poles that a hypothesis may explain less than the best one
SAME_START = 0.04  # meters plus radians between starts that lead to one pose
FOUND = 0.9  # probability that a pole in view of the beams is found
REFINEMENTS = 4
PAIR_COVARIANCE = np.diag([0.05, 0.05, 0.02]) ** 2
RADIUS_M = 1e-4  # largest difference of the radii of one pole


@dataclass(frozen=True, eq=False)
class PosePriorPlanar:
    """Rough pose of the robot: (3,) x, y (m), heading (rad), and its (3,3) covariance."""

    state: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, eq=False)
class PoleAssociation:
    """The result for one scan.

    Attributes:
        estimate: pose of the base by these poles.
        readings: range and bearing of the identified poles, as seen from the base.
        scanned: number of objects in the scan that may be poles.
    """

    estimate: PlanarEstimate
    readings: tuple[RangeBearing, ...]
    scanned: int


def pole_radii(landmarks: LandmarkMap) -> list[float]:
    """Radii of the poles in the map, meters; empty where it has none."""
    return sorted({m.size_m / 2 for m in landmarks if m.family == POLE})


def associate_poles(
    poles: Sequence[ScannedPole],
    landmarks: LandmarkMap,
    rough: PosePriorPlanar | None = None,
    scan: LaserScan | None = None,
    mount: ScannerMount | None = None,
    farthest_m: float = 25.0,
) -> PoleAssociation:
    """Identify the poles of one scan, and locate the robot by them.

    Args:
        poles: in the frame of the robot's base (:meth:`ScannedPole.seen_from_base`).
        rough: pose of the base before the scan; None: nothing is known.
        scan, mount: the scan, to find beams that passed through the place of a pole; None: not considered.
        farthest_m: range of the scanner.
    """
    mount = mount or ScannerMount()
    problem = _Association(list(poles), landmarks, rough, scan, mount, farthest_m)
    return problem.answer()


@dataclass(eq=False)
class _Hypothesis:
    state: FloatArray
    matches: list[tuple[int, int]]
    log_likelihood: float
    covariance: FloatArray


class _Association:
    def __init__(
        self,
        poles: list[ScannedPole],
        landmarks: LandmarkMap,
        rough: PosePriorPlanar | None,
        scan: LaserScan | None,
        mount: ScannerMount,
        farthest_m: float,
    ) -> None:
        self.poles, self.rough, self.scan, self.mount = poles, rough, scan, mount
        self.mapped = [m for m in landmarks if m.family == POLE]
        self.places = np.array([m.T_map_landmark.t[:2] for m in self.mapped]).reshape(-1, 2)
        self.open_m = np.array(
            [0.0 if m.covariance is None else math.sqrt(np.trace(m.covariance[:2, :2]) / 2) for m in self.mapped]
        )
        self.farthest_m = farthest_m
        self.points = np.array([pole.point for pole in poles]).reshape(-1, 2)
        self.polar = np.array([(pole.range_m, pole.bearing_rad) for pole in poles]).reshape(-1, 2)
        self.covariances = np.array([pole.covariance for pole in poles]).reshape(-1, 2, 2)
        self.objects = len({pole.place for pole in poles})
        radii = np.array([pole.radius_m for pole in poles])
        sizes = np.array([m.size_m / 2 for m in self.mapped])
        self.fits = np.abs(radii[:, None] - sizes) < RADIUS_M
        self.clutter = max(self.objects, 1) / (farthest_m * 2 * math.pi)
        extent = np.ptp(self.places, axis=0) + farthest_m if len(self.places) else np.ones(2)
        self.uniform = math.log(1 / (float(np.prod(extent)) * 2 * math.pi))

    def answer(self) -> PoleAssociation:
        """The best hypothesis with its status."""
        found = self._hypotheses()
        if not found or found[0].log_likelihood < AMBIGUOUS_BELOW:
            return PoleAssociation(PlanarEstimate(PoseStatus.NO_LANDMARKS), (), self.objects)
        best = found[0]
        others = [h for h in found[1:] if best.log_likelihood - h.log_likelihood < 25]
        near = others and best.log_likelihood - others[0].log_likelihood < AMBIGUOUS_BELOW
        estimate = PlanarEstimate(
            PoseStatus.AMBIGUOUS if near else PoseStatus.OK,
            PlanarPose(*map(float, best.state)),
            best.covariance,
            tuple(sorted(self.mapped[j].id for _, j in best.matches)),
            (),
            tuple((PlanarPose(*map(float, h.state)), best.log_likelihood - h.log_likelihood) for h in others[:4]),
        )
        readings = [] if near else [self._reading(i, j) for i, j in best.matches]
        return PoleAssociation(estimate, tuple(readings), self.objects)

    def _reading(self, i: int, j: int) -> RangeBearing:
        pole, sigmas = self.poles[i], np.sqrt(np.diag(self.covariances[i]))
        return RangeBearing(
            self.mapped[j].id, pole.range_m, pole.bearing_rad, pole.time_s, float(sigmas[0]), float(sigmas[1])
        )

    def _hypotheses(self) -> list[_Hypothesis]:
        """Different poses, the most probable first."""
        if not len(self.points) or not len(self.places):
            return []
        states = self._starts()
        if not len(states):
            return []
        counts = self._explained(states)
        order = np.argsort(-counts, kind="stable")
        found: list[_Hypothesis] = []
        tried = np.zeros((0, 3))
        for k in order:
            # Each pole less costs more likelihood than ambiguity allows.
            if counts[k] < counts[order[0]] - FEWER or len(tried) >= MOST_REFINED:
                break
            off = tried - states[k]
            if (np.hypot(off[:, 0], off[:, 1]) + np.abs(wrap_angle(off[:, 2])) < SAME_START).any():
                continue
            tried = np.concatenate([tried, states[k][None]])
            refined = self._refined(states[k], self.rough is not None and k == 0)
            if refined is not None and not any(_same(refined.state, h.state) for h in found):
                found.append(refined)
        return sorted(found, key=lambda h: -h.log_likelihood)

    def _starts(self) -> FloatArray:
        """(S,3) states from pairs of poles with the distance of pairs of the map, and the rough pose."""
        starts = [] if self.rough is None else [self.rough.state[None]]
        a, b = np.triu_indices(len(self.places), 1)
        apart = np.hypot(*(self.places[b] - self.places[a]).T) if len(a) else np.zeros(0)
        order = np.argsort(apart)
        a, b, apart = a[order], b[order], apart[order]
        total = 0
        for i, j in self._pairs():
            off = self.points[j] - self.points[i]
            distance = float(np.hypot(*off))
            tolerance = PAIR_SIGMAS * self._apart_sigma(i, j) + 2 * float(self.open_m.max(initial=0.0))
            rows = slice(*np.searchsorted(apart, [distance - tolerance, distance + tolerance]))
            for one, other in ((a[rows], b[rows]), (b[rows], a[rows])):
                kept = self.fits[i, one] & self.fits[j, other]
                starts.append(self._from_pair(i, off, one[kept], other[kept]))
                total += int(kept.sum())
            if total > MOST_POSES:
                break
        states = np.concatenate(starts) if starts else np.zeros((0, 3))
        if self.rough is None or not len(states):
            return states
        off = states - self.rough.state
        off[:, 2] = wrap_angle(off[:, 2])
        squared = np.einsum("si,ij,sj->s", off, np.linalg.inv(self.rough.covariance), off)
        return np.asarray(states[squared < 25.0])

    def _pairs(self) -> list[tuple[int, int]]:
        """Pairs of different objects, the most distant first, since these give the best headings."""
        i, j = np.triu_indices(len(self.points), 1)
        places = np.array([pole.place for pole in self.poles])
        different = places[i] != places[j]
        i, j = i[different], j[different]
        order = np.argsort(-np.hypot(*(self.points[j] - self.points[i]).T), kind="stable")
        return list(zip(i[order].tolist(), j[order].tolist(), strict=True))

    def _apart_sigma(self, i: int, j: int) -> float:
        """Standard deviation of the distance of two scanned poles, at most."""
        return math.sqrt(
            sum(self.covariances[k][0, 0] + self.polar[k, 0] ** 2 * self.covariances[k][1, 1] for k in (i, j))
        )

    def _from_pair(self, i: int, off: FloatArray, one: IntArray, other: IntArray) -> FloatArray:
        between = self.places[other] - self.places[one]
        headings = wrap_angle(np.arctan2(between[:, 1], between[:, 0]) - math.atan2(off[1], off[0]))
        c, s = np.cos(headings), np.sin(headings)
        x, y = self.points[i]
        return np.column_stack([self.places[one, 0] - c * x + s * y, self.places[one, 1] - s * x - c * y, headings])

    def _explained(self, states: FloatArray) -> FloatArray:
        """(S,) number of scanned poles near a mapped one; with a rough pose, minus the state's distance from it."""
        c, s = np.cos(states[:, 2])[:, None], np.sin(states[:, 2])[:, None]
        x = states[:, :1] + c * self.points[:, 0] - s * self.points[:, 1]
        y = states[:, 1:2] + s * self.points[:, 0] + c * self.points[:, 1]
        squared = (x[..., None] - self.places[:, 0]) ** 2 + (y[..., None] - self.places[:, 1]) ** 2
        squared = np.where(self.fits, squared, np.inf).min(axis=2)
        sigma = np.sqrt(self.covariances[:, 0, 0] + self.polar[:, 0] ** 2 * self.covariances[:, 1, 1]) + 0.03
        return np.asarray(np.exp(-squared / (2 * (2 * sigma) ** 2)).sum(axis=1))

    def _refined(self, state: FloatArray, is_rough: bool) -> _Hypothesis | None:
        """The state refined with all poles that it explains, by Gauss-Newton."""
        # A start from two poles is about as uncertain as the poles.
        covariance = self.rough.covariance if is_rough and self.rough is not None else PAIR_COVARIANCE
        matches: list[tuple[int, int]] = []
        for _ in range(REFINEMENTS):
            now = self._matches(state, covariance)
            if len(now) < (2 if self.rough is None else 1):
                return None
            state, covariance = self._solved(state, now)
            if now == matches:
                break
            matches = now
        return _Hypothesis(state, matches, self._log_likelihood(state, covariance, matches), covariance)

    def _expected(self, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(M,2) range and bearing of the mapped poles, and (M,2,3) derivatives with the state."""
        off = self.places - state[:2]
        squared = np.maximum((off**2).sum(axis=1), 1e-12)
        distance = np.sqrt(squared)
        J = np.zeros((len(off), 2, 3))
        J[:, 0, :2] = -off / distance[:, None]
        J[:, 1, 0], J[:, 1, 1], J[:, 1, 2] = off[:, 1] / squared, -off[:, 0] / squared, -1
        return np.column_stack([distance, np.arctan2(off[:, 1], off[:, 0]) - state[2]]), J

    def _own(self, i: int, j: int) -> FloatArray:
        """(2,2) covariance of a scanned pole, including that of its place in the map."""
        aside = self.open_m[j] / self.polar[i, 0]
        return np.asarray(self.covariances[i] + np.diag([self.open_m[j] ** 2, aside**2]))

    def _matches(self, state: FloatArray, covariance: FloatArray) -> list[tuple[int, int]]:
        """Pairs of scanned and mapped poles within the gate, each once, the nearest first."""
        expected, J = self._expected(state)
        i, j = np.nonzero(self.fits)
        r = self.polar[i] - expected[j]
        r[:, 1] = wrap_angle(r[:, 1])
        S = self.covariances[i].copy()
        S[:, 0, 0] += self.open_m[j] ** 2
        S[:, 1, 1] += (self.open_m[j] / self.polar[i, 0]) ** 2
        S = S + J[j] @ covariance @ J[j].transpose(0, 2, 1)
        squared = np.einsum("ka,ka->k", r, np.linalg.solve(S, r[..., None])[..., 0])
        near = squared < GATE
        entries = list(zip(squared[near].tolist(), i[near].tolist(), j[near].tolist(), strict=True))
        used_places: set[int] = set()
        used_poles: set[int] = set()
        matches = []
        for _, i, j in sorted(entries):
            if self.poles[i].place not in used_places and j not in used_poles:
                used_places.add(self.poles[i].place)
                used_poles.add(j)
                matches.append((i, j))
        return sorted(matches)

    def _solved(self, state: FloatArray, matches: Sequence[tuple[int, int]]) -> tuple[FloatArray, FloatArray]:
        covariance: FloatArray = np.eye(3)
        for _ in range(5):
            expected, J = self._expected(state)
            normal: FloatArray = np.zeros((3, 3))
            gradient: FloatArray = np.zeros(3)
            if self.rough is not None:
                normal = np.linalg.inv(self.rough.covariance)
                off = self.rough.state - state
                off[2] = wrap_heading(float(off[2]))
                gradient = normal @ off
            for i, j in matches:
                r = self.polar[i] - expected[j]
                r[1] = wrap_heading(float(r[1]))
                weighted = J[j].T @ np.linalg.inv(self._own(i, j))
                normal = normal + weighted @ J[j]
                gradient = gradient + weighted @ r
            covariance = np.linalg.inv(normal)
            step = covariance @ gradient
            state = state + step
            if float(step @ normal @ step) < 1e-6:
                break
        return np.array([state[0], state[1], wrap_heading(float(state[2]))]), covariance

    def _log_likelihood(self, state: FloatArray, covariance: FloatArray, matches: Sequence[tuple[int, int]]) -> float:
        """Log likelihood ratio to the hypothesis that everything is clutter, integrated over the pose."""
        expected, _ = self._expected(state)
        total = 1.5 * math.log(2 * math.pi) + 0.5 * float(np.linalg.slogdet(covariance)[1])
        if self.rough is None:
            total += self.uniform
        else:
            off = state - self.rough.state
            off[2] = wrap_heading(float(off[2]))
            C = self.rough.covariance
            total -= 0.5 * float(off @ np.linalg.solve(C, off) + np.linalg.slogdet(2 * math.pi * C)[1])
        for i, j in matches:
            r = self.polar[i] - expected[j]
            r[1] = wrap_heading(float(r[1]))
            C = self._own(i, j)
            density = -0.5 * float(r @ np.linalg.solve(C, r) + np.linalg.slogdet(2 * math.pi * C)[1])
            total += math.log(FOUND / self.clutter) + density
        matched = {j for _, j in matches}
        return total + math.log(1 - FOUND) * sum(
            self._passed_through(state, j) for j in range(len(self.mapped)) if j not in matched
        )

    def _passed_through(self, state: FloatArray, j: int) -> bool:
        """Whether beams passed through the place of the pole."""
        if self.scan is None:
            return False
        c, s = math.cos(state[2]), math.sin(state[2])
        off = self.places[j] - state[:2]
        base = np.array([c * off[0] + s * off[1], -s * off[0] + c * off[1]]) - [self.mount.x_m, self.mount.y_m]
        distance = float(np.hypot(*base))
        beam = self.scan.beam_at(math.atan2(base[1], base[0]) - self.mount.yaw_rad)
        if beam is None or distance > self.farthest_m:
            return False
        return bool(self.scan.ranges_m[beam] > distance + 3 * self.mapped[j].size_m + 3 * self.open_m[j])


def _same(a: FloatArray, b: FloatArray) -> bool:
    return bool(np.hypot(*(a - b)[:2]) < SAME_PLACE_M and abs(wrap_heading(float(a[2] - b[2]))) < math.radians(10))
