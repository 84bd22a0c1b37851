"""Placement of landmarks for a required accuracy.

Candidates are along the walls (`mounting_sites.py`).  The search takes the fewest that meet the demand
(`placement_search.py`).  The result is checked on places that the search did not use.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from lmkit.errors import InputError
from lmkit.geometry.rig import AnyRig
from lmkit.model.floor_plan import FloorPlan
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.planning.code_assignment import assign_codes
from lmkit.planning.coverage import Demand, PoseCoverage, all_states, predict_coverage, promised_errors
from lmkit.planning.mounting_sites import Mount, MountingOptions, crowded, possible_mounts
from lmkit.planning.placement_search import Search
from lmkit.planning.visibility import find_sights
from lmkit.units import counted

MARGIN = 0.005  # of the share, for places between the places of the search
REMEDIES = 5
MOST_PROMISED = 2000  # poses over which the promised error is averaged
CHECKED_STEP = 0.7  # of the search's step between places: the result is checked at other places


@dataclass(frozen=True, eq=False)
class Placement:
    """Landmarks to mount, and the accuracy that they give.

    Attributes:
        mounts: the new ones.
        landmarks: these landmarks and those that were mounted before.
        coverage: at places that the search did not use.
        share: share of the places that meet the requirement.
        error_m: position error there, root mean square over all poses that meet the demand.
    """

    mounts: tuple[Mount, ...]
    landmarks: LandmarkMap
    coverage: PoseCoverage
    share: float
    error_m: float

    def __repr__(self) -> str:
        return (
            f"Placement({counted(len(self.mounts), 'new landmark')}, {self.share:.0%} of the places, "
            f"error {1000 * self.error_m:.0f} mm)"
        )

    def to_dict(self) -> dict[str, Any]:
        """The result as JSON values; docs/formats.md lists the keys."""
        mounts = [
            {
                "id": str(mount.landmark.id),
                "family": mount.landmark.family,
                "code": mount.landmark.code,
                "wall": mount.wall.name,
                "along_m": mount.along_m,
                "height_m": float(mount.landmark.T_map_landmark.t[2]),
                "size_m": mount.landmark.size_m,
            }
            for mount in self.mounts
        ]
        return {"share": self.share, "error_m": self.error_m, "landmarks": mounts}


def place_landmarks(
    floor: FloorPlan,
    existing: Sequence[MappedLandmark],
    rig: AnyRig,
    radius_m: float,
    demand: Demand,
    options: MountingOptions,
    on_step: Callable[[int, float], None] = lambda count, share: None,
) -> Placement:
    """The fewest landmarks found that meet the demand, none larger than necessary.

    Args:
        mounted: landmarks that are already mounted, and are kept.
        on_step: called with the number of landmarks and the share covered so far.

    Raises:
        InputError: no wall for a landmark, or the robot fits nowhere.
        NegativeAnswer: no number of landmarks meets the demand; the message states what is possible.
    """
    mounts = possible_mounts(floor, rig, options)
    taken = crowded([mount.landmark for mount in mounts], existing)
    mounts = [mount for mount, there in zip(mounts, taken, strict=True) if not there.any()]
    if not mounts:
        raise InputError(
            "no_wall",
            "no wall that a landmark fits on",
            "check the plan's scale (--scale), the walls left out (--not-on) and the landmarks' size (--size)",
        )
    search = Search(floor, existing, mounts, rig, radius_m, demand)
    search.require_possible()
    target = min(demand.share + MARGIN, 1.0)
    for _ in range(REMEDIES):
        search.fill(target, on_step)
        search.prune(target)
        placement = _finish(search, floor, existing, rig, radius_m, demand, options)
        if placement.share >= demand.share or target >= search.possible:
            break
        target = min(target + demand.share - placement.share + MARGIN, search.possible)
    improvements = [partial(search.swap, target, options.swap_s)]
    if len(set(options.sizes_m)) > 1:
        improvements.append(partial(search.shrink, target, options.sizes_m))
    for improve in improvements:
        before = search.mounted_now()
        improve()
        improved = _finish(search, floor, existing, rig, radius_m, demand, options)
        if improved.share >= min(placement.share, demand.share):
            placement = improved
        else:
            search.mount(before)
    return placement


def _finish(
    search: Search,
    floor: FloorPlan,
    existing: Sequence[MappedLandmark],
    rig: AnyRig,
    radius_m: float,
    demand: Demand,
    options: MountingOptions,
) -> Placement:
    """Assign codes, and check the demand at places that the search did not use."""
    chosen = [search.spots[k].mount for k in sorted(search.chosen)]
    ids = assign_codes([mount.landmark.T_map_landmark.t for mount in chosen], existing, options.family)
    mounts = tuple(
        replace(mount, landmark=replace(mount.landmark, id=id_)) for mount, id_ in zip(chosen, ids, strict=True)
    )
    landmarks = LandmarkMap([*existing, *(mount.landmark for mount in mounts)])
    coverage = predict_coverage(floor, list(landmarks), rig, radius_m, search.step_m * CHECKED_STEP)
    holds = coverage.holds(demand)
    states, _ = all_states(coverage.places)
    states = states[holds.ravel()]
    states = states[:: 1 + len(states) // MOST_PROMISED]
    errors = promised_errors(find_sights(states, list(landmarks), rig, floor), states, rig)
    errors = errors[np.isfinite(errors)]
    error_m = float(np.sqrt(np.mean(errors**2))) if len(errors) else float("inf")
    return Placement(mounts, landmarks, coverage, float(coverage.covered(demand).mean()), error_m)
