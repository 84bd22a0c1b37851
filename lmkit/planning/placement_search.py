"""Selection of landmarks from many candidates: greedy, with swaps.

1. The information that each candidate gives at every pose is computed once (`visibility.py`).
2. Greedy: the candidate is added that brings places nearest to the demand, until enough of them are covered.  For a
   demand of counts alone this is submodular cover, and greedy needs at most 1 + ln(places) times the optimal number
   (Wolsey 1982); for a demand with errors there is no such bound, so the result is checked at other places.
3. Landmarks that are not needed are removed; then two are replaced by one at another place, within the time limit.
4. Each landmark shrinks to the smallest size with which the demand is still met.
"""

from __future__ import annotations

import heapq
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from lmkit.arrays import BoolArray, FloatArray, IntArray
from lmkit.errors import NegativeAnswer
from lmkit.geometry.rig import AnyRig
from lmkit.kernels.pose_coverage import HELD, Coverage, change_coverage
from lmkit.model.floor_plan import FloorPlan
from lmkit.model.landmark_map import MappedLandmark
from lmkit.planning.coverage import BLIND_M, Demand, all_states, places_on
from lmkit.planning.mounting_sites import Mount, crowded
from lmkit.planning.visibility import (
    IN_VIEW,
    base_to_camera,
    find_sights,
    known_of_pose,
    planar_covariances,
    planar_errors,
)

MOST_PLACES = 900
LEAST_GAIN = 1e-6
NEIGHBOURS_M = 4.0


@dataclass(frozen=True, eq=False)
class Site:
    """A candidate: (R,) the poses that may read it, (R,6,6) its information there, (R,) whether it is in view."""

    mount: Mount
    rows: IntArray
    information: FloatArray
    shown: BoolArray


def _resized(mount: Mount, size_m: float) -> Mount:
    return replace(mount, landmark=replace(mount.landmark, size_m=size_m))


class Search:
    """Candidates, their information at every pose, and which are mounted."""

    def __init__(
        self,
        floor: FloorPlan,
        existing: Sequence[MappedLandmark],
        mounts: Sequence[Mount],
        rig: AnyRig,
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
        known = find_sights(self.states, existing, rig, floor)
        self.coverage = Coverage(
            known.information_at(len(self.states)),
            known.in_view_at(len(self.states)),
            base_to_camera(self.states, self.T_base_left),
            known_of_pose(),
            self.turns,
            self.enough,
            demand.in_view,
            demand.error_m,
            demand.heading_rad,
            BLIND_M,
        )
        self.spots = [
            Site(mount, *information) for mount, information in zip(mounts, self._sights_of(mounts), strict=True)
        ]
        landmarks = [mount.landmark for mount in mounts]
        self.crowds = crowded(landmarks, landmarks)
        self.chosen: list[int] = []

    def _sights_of(self, mounts: Sequence[Mount]) -> list[tuple[IntArray, FloatArray, BoolArray]]:
        """For each candidate: the poses that may read it, its information there, and whether it counts as in view."""
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
        """Share of the places that are covered."""
        return float((self.coverage.held >= HELD).mean())

    def require_possible(self) -> None:
        """Refuse a demand that landmarks at all candidates together would not meet.

        Raises:
            NegativeAnswer: names the best possible result.
        """
        for k in range(len(self.spots)):
            if not self._crowded(k):
                self.put(k)
        self.possible = self.share
        errors = planar_errors(planar_covariances(self.coverage.information, self.states, self.T_base_left))[0]
        errors[self.coverage.in_view < self.demand.in_view] = np.inf
        for k in list(self.chosen):
            self.take(k)
        if self.possible >= self.demand.share:
            return
        best = np.sort(errors.reshape(-1, self.turns), axis=1)[:, self.enough - 1]
        error = float(np.quantile(best, self.demand.share, method="higher"))
        or_else = f", or {1000 * error:.2g} mm over {self.demand.share:.0%}" if error < BLIND_M else ""
        raise NegativeAnswer(
            "impossible_demand",
            f"even with a landmark at every possible place, the requirement holds on {self.possible:.0%} of the "
            f"floor, {self.demand.share:.0%} are required",
            f"at most --share {np.floor(100 * self.possible):.0f} is possible{or_else}; larger landmarks (--size), "
            "fewer headings (headings, --headings) or one landmark in view (in_view=1, --in-view 1) make it easier",
        )

    def fill(self, target: float, on_step: Callable[[int, float], None]) -> None:
        """Greedy selection; gains are computed again only where they may be the best (Minoux 1978)."""
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

    def swap(self, target: float, seconds: float) -> None:
        """Replace two landmarks by one, within the time limit."""
        until = time.monotonic() + seconds
        target = min(target, self.share)
        better = True
        while better and time.monotonic() < until:
            better = False
            for k in sorted(self.chosen, key=self._loss):
                near = self._neighbors(k)
                self.take(k)
                # The best candidate in its place may make another landmark unnecessary.
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
        """Gain of a candidate in the scores of all places."""
        return self._change(k, 1, apply=False)[0]

    def put(self, k: int) -> None:
        """Mount a candidate."""
        self.chosen.append(k)
        self._add(k, 1)

    def take(self, k: int) -> None:
        """Remove a mounted candidate."""
        self.chosen.remove(k)
        self._add(k, -1)

    def _add(self, k: int, sign: int) -> None:
        self._change(k, sign, apply=True)

    def _change(self, k: int, sign: int, apply: bool) -> tuple[float, int]:
        """Effect of adding or removing a landmark: sum of the places' scores, and places that meet the demand."""
        spot = self.spots[k]
        return change_coverage(self.coverage, spot.rows, spot.information, spot.shown, sign, apply)

    def _loss(self, k: int) -> float:
        return -self._change(k, -1, apply=False)[0]

    def _needless(self, k: int, target: float) -> bool:
        held = self.coverage.held
        left = int((held >= HELD).sum()) + self._change(k, -1, apply=False)[1]
        return left / len(held) >= target

    def prune(self, target: float) -> None:
        """Remove landmarks that are not needed."""
        for k in sorted(self.chosen, key=self._loss):
            if self._needless(k, target):
                self.take(k)

    def shrink(self, target: float, sizes_m: Sequence[float]) -> None:
        """Make each landmark as small as the demand allows, the least needed first."""
        target = min(target, self.share)
        for k in sorted(self.chosen, key=self._loss):
            was = self.spots[k]
            smaller = [_resized(was.mount, size) for size in sorted(sizes_m) if size < was.mount.landmark.size_m]
            for mount, information in zip(smaller, self._sights_of(smaller), strict=True):
                self.take(k)
                self.spots[k] = Site(mount, *information)
                self.put(k)
                if self.share >= target:
                    break
                self.take(k)
                self.spots[k] = was
                self.put(k)

    def mounted_now(self) -> dict[int, Site]:
        """Mounted landmarks, by candidate."""
        return {k: self.spots[k] for k in self.chosen}

    def mount(self, spots: Mapping[int, Site]) -> None:
        """Mount exactly these candidates."""
        for k in list(self.chosen):
            self.take(k)
        for k, spot in spots.items():
            self.spots[k] = spot
            self.put(k)

    def _crowded(self, k: int) -> bool:
        """Whether a landmark is already mounted too close to a candidate."""
        return bool(self.crowds[k, self.chosen].any())

    def _neighbors(self, k: int) -> list[int]:
        """Candidates near a landmark to be replaced, with room once it is removed."""
        here = self.spots[k].mount.landmark.T_map_landmark.t
        others = [i for i in self.chosen if i != k]
        return [
            j
            for j, spot in enumerate(self.spots)
            if j not in self.chosen
            and np.linalg.norm(spot.mount.landmark.T_map_landmark.t - here) < NEIGHBOURS_M
            and not self.crowds[j, others].any()
        ]
