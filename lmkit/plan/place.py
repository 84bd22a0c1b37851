"""Where to hang landmarks so that a robot knows where it is: greedy with exchange.

1. Candidates stand along all usable walls; what each would tell every pose is worked out once (`sight.py`).
2. Greedy: the candidate is added that brings places nearest to the demand, until enough of them are covered.  For a
   demand of counts alone this is submodular cover, and greedy needs at most 1 + ln(places) times the fewest landmarks
   (Wolsey 1982); with errors in it there is no such bound, so what the result holds is measured, on other places.
3. Landmarks that are not needed are taken down; then two are taken down for one hung elsewhere, while time lasts.
4. Where several sizes may hang, all this is done with the largest that fits; then each landmark shrinks to the
   smallest with which the demand still holds.
"""

from __future__ import annotations

import heapq
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from lmkit.arrays import BoolArray, FloatArray, IntArray
from lmkit.errors import InputError, NegativeAnswer
from lmkit.model.floor_plan import FloorPlan, Wall
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark, wall_pose
from lmkit.model.stereo_rig import StereoRig
from lmkit.plan.codes import assign_codes
from lmkit.plan.coverage import (
    BLIND_M,
    Coverage,
    Demand,
    all_states,
    places_on,
    predict_coverage,
    promised_errors,
)
from lmkit.plan.sight import IN_VIEW, find_sights, planar_covariances, planar_errors

CANDIDATE_M = 0.4  # between places along a wall
EDGE_M = 0.08  # of free wall beside a landmark's face
MOST_PLACES = 900
MARGIN = 0.005  # of the share, for places between those that were looked at
LEAST_GAIN = 1e-6
REMEDIES = 5
MOST_PROMISED = 2000  # poses that the promised error is taken over
CHECKED_STEP = 0.7  # of the search's step between places: those that check the result are others
NEIGHBOURS_M = 4.0


@dataclass(frozen=True)
class HangOptions:
    """How landmarks may hang.

    Attributes:
        sizes_m: to choose from.
        heights_m: of their middles, to choose from; none: a little above the camera.
        family: of all of them.
        not_on: names of walls that stay bare, beside those that the floor plan says.
        exchange_s: how long to look for two landmarks that one can do for.
    """

    sizes_m: tuple[float, ...] = (0.18,)
    heights_m: tuple[float, ...] = ()
    family: str = "lm8"
    not_on: tuple[str, ...] = ()
    exchange_s: float = 10.0


@dataclass(frozen=True, eq=False)
class Mount:
    """A landmark to hang up: on which wall, how far from its left end, how high; metres to its middle."""

    landmark: MappedLandmark
    wall: Wall
    along_m: float

    def __str__(self) -> str:
        height, size_mm = self.landmark.T_map_landmark.t[2], 1000 * self.landmark.size_m
        return f"wall {self.wall.name}, {self.along_m:.2f} m from its left end, {height:.2f} m high, {size_mm:.0f} mm"

    @property
    def room_m(self) -> float:
        """Of wall that it takes."""
        return self.landmark.size_m + 2 * EDGE_M


@dataclass(frozen=True, eq=False)
class Placement:
    """Landmarks to hang, and what they hold.

    Attributes:
        mounts: the new ones.
        landmarks: those and the ones that hung before.
        coverage: on places that the search did not look at.
        share: of those places at which the demand holds.
        error_m: what the position error keeps to there, root mean square over all poses that hold.
    """

    mounts: tuple[Mount, ...]
    landmarks: LandmarkMap
    coverage: Coverage
    share: float
    error_m: float


def place_landmarks(
    floor: FloorPlan,
    hung: Sequence[MappedLandmark],
    rig: StereoRig,
    radius_m: float,
    demand: Demand,
    options: HangOptions | None = None,
    on_step: Callable[[int, float], None] = lambda count, share: None,
) -> Placement:
    """The fewest landmarks found that hold the demand, none larger than it has to be.

    Args:
        hung: landmarks that hang already and stay.
        on_step: told the number of landmarks and the share covered so far.

    Raises:
        InputError: no wall to hang anything on, or the robot fits nowhere.
        NegativeAnswer: no number of landmarks holds the demand; says what is possible.
    """
    options = options or HangOptions()
    candidates = hanging_places(floor, rig, options)
    # Where one hangs already there is no room for another.
    spots = [
        spot
        for spot in candidates
        if all(np.linalg.norm(spot.landmark.T_map_landmark.t - m.T_map_landmark.t) > 1.5 * m.size_m for m in hung)
    ]
    if not spots:
        raise InputError("no_wall", "no wall that a landmark fits on", "check --scale, --not-on and --size")
    problem = _Problem(floor, hung, spots, rig, radius_m, demand)
    problem.require_possible()
    target = min(demand.share + MARGIN, 1.0)
    for _ in range(REMEDIES):
        problem.fill(target, on_step)
        problem.prune(target)
        placement = _finish(problem, floor, hung, rig, radius_m, demand, options)
        if placement.share >= demand.share or target >= problem.possible:
            break
        target = min(target + demand.share - placement.share + MARGIN, problem.possible)
    improvements = [partial(problem.exchange, target, options.exchange_s)]
    if len(set(options.sizes_m)) > 1:
        improvements.append(partial(problem.shrink, target, options.sizes_m))
    for improve in improvements:
        before = problem.hung_now()
        improve()
        improved = _finish(problem, floor, hung, rig, radius_m, demand, options)
        if improved.share >= min(placement.share, demand.share):
            placement = improved
        else:
            problem.hang(before)
    return placement


def hanging_places(floor: FloorPlan, rig: StereoRig, options: HangOptions) -> list[Mount]:
    """Where a landmark of the largest size that fits may hang on the usable walls, without codes yet.

    Raises:
        InputError: a wall is named that is not there.
    """
    known = {wall.name for wall in floor.walls}
    for name in options.not_on:
        if name not in known:
            raise InputError("unknown_wall", f"no wall {name!r}", f"walls: {', '.join(sorted(known))}")
    assert rig.T_base_left is not None
    heights = options.heights_m or (float(rig.T_base_left.t[2]) + 0.25,)
    mounts = []
    for wall in floor.walls:
        fitting = [size for size in options.sizes_m if size + 2 * EDGE_M <= wall.length_m]
        if not wall.usable or wall.name in options.not_on or not fitting:
            continue
        size = max(fitting)
        half = size / 2 + EDGE_M
        step = max(CANDIDATE_M, 2 * half)
        count = int((wall.length_m - 2 * half) / step) + 1
        rest = wall.length_m - 2 * half - (count - 1) * step
        out = np.array([np.cos(wall.facing_rad), np.sin(wall.facing_rad)])
        for along in half + rest / 2 + step * np.arange(count):
            middle = wall.left + along * wall.along
            beside = middle + np.array([-half, 0.0, half])[:, None] * wall.along + 2 * floor.cell_m * out
            if floor.is_free(beside).all():
                for height in heights:
                    T = wall_pose([*middle, height], wall.facing_rad)
                    mounts.append(Mount(MappedLandmark(0, options.family, size, T), wall, float(along)))
    return mounts


@dataclass(frozen=True, eq=False)
class _Spot:
    """A candidate, (R,) the poses that may read it, (R,6,6) what it tells there, (R,) whether it is in view."""

    mount: Mount
    rows: IntArray
    told: FloatArray
    shown: BoolArray


def _resized(mount: Mount, size_m: float) -> Mount:
    return replace(mount, landmark=replace(mount.landmark, size_m=size_m))


class _Problem:
    """Candidates, what each tells every pose, and which are hung."""

    def __init__(
        self,
        floor: FloorPlan,
        hung: Sequence[MappedLandmark],
        spots: Sequence[Mount],
        rig: StereoRig,
        radius_m: float,
        demand: Demand,
    ) -> None:
        assert rig.T_base_left is not None
        self.floor, self.rig, self.demand, self.T_base_left = floor, rig, demand, rig.T_base_left
        places, step_m = places_on(floor, radius_m)
        if len(places) > MOST_PLACES:
            places, step_m = places_on(floor, radius_m, step_m * np.sqrt(len(places) / MOST_PLACES))
        self.states, headings = all_states(places)
        self.step_m, self.turns = step_m, len(headings)
        self.enough = max(1, int(np.ceil(demand.headings * self.turns - 1e-9)))
        known = find_sights(self.states, hung, rig, floor)
        self.information = known.information_at(len(self.states))
        self.in_view = known.in_view_at(len(self.states))
        self.spots = [_Spot(mount, *told) for mount, told in zip(spots, self._told([*spots]), strict=True)]
        places_hung = np.array([spot.landmark.T_map_landmark.t for spot in spots])
        rooms = np.array([spot.room_m for spot in spots])
        apart = np.linalg.norm(places_hung[:, None] - places_hung[None], axis=2)
        self.crowds = apart < (rooms[:, None] + rooms[None]) / 2 - 1e-9
        self.chosen: list[int] = []
        self.scores = self._scores(np.arange(len(self.states)), self.information, self.in_view)

    def _told(self, mounts: Sequence[Mount]) -> list[tuple[IntArray, FloatArray, BoolArray]]:
        """Of each: the poses that may read it, what it tells there, and whether it counts as in view."""
        sights = find_sights(self.states, [mount.landmark for mount in mounts], self.rig, self.floor)
        order = np.argsort(sights.landmarks, kind="stable")
        bounds = np.searchsorted(sights.landmarks[order], np.arange(len(mounts) + 1))
        return [
            (
                sights.poses[part],
                sights.probability[part, None, None] * sights.information[part],
                sights.probability[part] >= IN_VIEW,
            )
            for part in (order[a:b] for a, b in pairwise(bounds))
        ]

    @property
    def share(self) -> float:
        """Of the places that are covered."""
        return float((self._places(self.scores) >= 1 - 1e-9).mean())

    def require_possible(self) -> None:
        """Refuse what even a landmark at every candidate would not hold.

        Raises:
            NegativeAnswer: says what is possible.
        """
        for k in range(len(self.spots)):
            self.put(k)
        self.possible = self.share
        errors = self._errors(np.arange(len(self.states)), self.information)[0]
        errors[self.in_view < self.demand.in_view] = np.inf
        for k in range(len(self.spots)):
            self.take(k)
        if self.possible >= self.demand.share:
            return
        best = np.sort(errors.reshape(-1, self.turns), axis=1)[:, self.enough - 1]
        error = float(np.quantile(best, self.demand.share, method="higher"))
        or_else = f", or {1000 * error:.2g} mm over {self.demand.share:.0%}" if error < BLIND_M else ""
        raise NegativeAnswer(
            "impossible_demand",
            f"with a landmark every {CANDIDATE_M} m of wall the demand holds at {self.possible:.0%} of the floor, "
            f"{self.demand.share:.0%} are asked",
            f"possible: {np.floor(100 * self.possible):.0f} %{or_else}; larger landmarks (--size), fewer directions "
            "(--headings) or one landmark in view (--in-view 1) ask less",
        )

    def fill(self, target: float, on_step: Callable[[int, float], None]) -> None:
        """Greedy, with gains looked at again only where they may be the best (Minoux 1978)."""
        heap = [(-np.inf, k) for k in range(len(self.spots)) if k not in self.chosen]
        while self.share < target and heap:
            best = None
            while heap:
                k = heapq.heappop(heap)[1]
                if self._crowded(k):
                    continue
                gain = self.gain(k)
                if not heap or gain >= -heap[0][0] - 1e-12:
                    best = (gain, k)
                    break
                heapq.heappush(heap, (-gain, k))
            if best is None or best[0] < LEAST_GAIN:
                return
            self.put(best[1])
            on_step(len(self.chosen), self.share)

    def exchange(self, target: float, seconds: float) -> None:
        """Two for one, while time lasts."""
        until = time.monotonic() + seconds
        target = min(target, self.share)
        better = True
        while better and time.monotonic() < until:
            better = False
            for k in sorted(self.chosen, key=self._loss):
                near = self._neighbours(k)
                self.take(k)
                # What helps most in its place: does another one become needless then?
                gains = sorted(((self.gain(j), j) for j in near), reverse=True)[:3]
                for _, j in gains:
                    self.put(j)
                    least = sorted(self.chosen, key=self._loss)[:4]
                    spare = next((i for i in least if i != j and self._needless(i, target)), None)
                    if spare is not None and self.share >= target:
                        self.take(spare)
                        self.prune(target)
                        better = True
                        break
                    self.take(j)
                if better or time.monotonic() > until:
                    if not better:
                        self.put(k)
                    break
                self.put(k)

    def gain(self, k: int) -> float:
        """What a candidate adds to the scores of all places."""
        spot = self.spots[k]
        rows = spot.rows
        after = self._scores(rows, self.information[rows] + spot.told, self.in_view[rows] + spot.shown)
        places = np.unique(rows // self.turns)
        scores = self.scores.reshape(-1, self.turns)[places]
        changed = scores.copy()
        changed[np.searchsorted(places, rows // self.turns), rows % self.turns] = after
        return float((self._places(changed) - self._places(scores)).sum())

    def put(self, k: int) -> None:
        """Hang it."""
        self.chosen.append(k)
        self._add(k, 1)

    def take(self, k: int) -> None:
        """Take it down."""
        self.chosen.remove(k)
        self._add(k, -1)

    def _add(self, k: int, sign: int) -> None:
        spot = self.spots[k]
        rows = spot.rows
        self.information[rows] += sign * spot.told
        self.in_view[rows] += sign * spot.shown
        self.scores[rows] = self._scores(rows, self.information[rows], self.in_view[rows])

    def _loss(self, k: int) -> float:
        before = self._places(self.scores).sum()
        self.take(k)
        after = self._places(self.scores).sum()
        self.put(k)
        return float(before - after)

    def _needless(self, k: int, target: float) -> bool:
        self.take(k)
        enough = self.share >= target
        self.put(k)
        return enough

    def prune(self, target: float) -> None:
        """Take down what is not needed."""
        for k in sorted(self.chosen, key=self._loss):
            if self._needless(k, target):
                self.take(k)

    def shrink(self, target: float, sizes_m: Sequence[float]) -> None:
        """Each as small as the demand allows, what is least needed first."""
        target = min(target, self.share)
        for k in sorted(self.chosen, key=self._loss):
            was = self.spots[k]
            smaller = [_resized(was.mount, size) for size in sorted(sizes_m) if size < was.mount.landmark.size_m]
            for mount, told in zip(smaller, self._told(smaller), strict=True):
                self.take(k)
                self.spots[k] = _Spot(mount, *told)
                self.put(k)
                if self.share >= target:
                    break
                self.take(k)
                self.spots[k] = was
                self.put(k)

    def hung_now(self) -> dict[int, _Spot]:
        """What hangs, by candidate."""
        return {k: self.spots[k] for k in self.chosen}

    def hang(self, spots: Mapping[int, _Spot]) -> None:
        """That, and nothing else."""
        for k in list(self.chosen):
            self.take(k)
        for k, spot in spots.items():
            self.spots[k] = spot
            self.put(k)

    def _crowded(self, k: int) -> bool:
        """Does something hang there already?"""
        return bool(self.crowds[k, self.chosen].any())

    def _neighbours(self, k: int) -> list[int]:
        """Candidates near one that is to be replaced, where there is room without it."""
        here = self.spots[k].mount.landmark.T_map_landmark.t
        others = [i for i in self.chosen if i != k]
        return [
            j
            for j, spot in enumerate(self.spots)
            if j not in self.chosen
            and np.linalg.norm(spot.mount.landmark.T_map_landmark.t - here) < NEIGHBOURS_M
            and not self.crowds[j, others].any()
        ]

    def _errors(self, rows: IntArray, information: FloatArray) -> tuple[FloatArray, FloatArray]:
        return planar_errors(planar_covariances(information, self.states[rows], self.T_base_left))

    def _scores(self, rows: IntArray, information: FloatArray, in_view: IntArray) -> FloatArray:
        """How near each pose is to the demand: 1 where it holds; half for landmarks in view, half for the errors."""
        error_m, heading_rad = self._errors(rows, information)
        worst = np.maximum(error_m / self.demand.error_m, heading_rad / self.demand.heading_rad)
        near = 1 - np.log(np.maximum(worst, 1.0)) / np.log(BLIND_M / self.demand.error_m)
        asked = self.demand.in_view
        seen = np.minimum(in_view, asked) / asked if asked else np.ones(len(in_view))
        return np.asarray((seen + near.clip(0, 1)) / 2)

    def _places(self, scores: FloatArray) -> FloatArray:
        """(N,) 1 where enough directions hold: the mean of the best ones."""
        best = np.sort(scores.reshape(-1, self.turns), axis=1)[:, -self.enough :]
        return np.asarray(best.mean(axis=1))


def _finish(
    problem: _Problem,
    floor: FloorPlan,
    hung: Sequence[MappedLandmark],
    rig: StereoRig,
    radius_m: float,
    demand: Demand,
    options: HangOptions,
) -> Placement:
    """Codes, and what holds at places that the search did not look at."""
    spots = [problem.spots[k].mount for k in sorted(problem.chosen)]
    codes = assign_codes([spot.landmark.T_map_landmark.t for spot in spots], hung, options.family)
    mounts = tuple(
        replace(spot, landmark=replace(spot.landmark, code=code)) for spot, code in zip(spots, codes, strict=True)
    )
    landmarks = LandmarkMap([*hung, *(mount.landmark for mount in mounts)])
    coverage = predict_coverage(floor, list(landmarks), rig, radius_m, problem.step_m * CHECKED_STEP)
    holds = coverage.holds(demand)
    states, _ = all_states(coverage.places)
    states = states[holds.ravel()]
    states = states[:: 1 + len(states) // MOST_PROMISED]
    errors = promised_errors(find_sights(states, list(landmarks), rig, floor), states, rig)
    errors = errors[np.isfinite(errors)]
    error_m = float(np.sqrt(np.mean(errors**2))) if len(errors) else float("inf")
    return Placement(mounts, landmarks, coverage, float(coverage.covered(demand).mean()), error_m)
