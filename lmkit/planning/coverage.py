"""Expected accuracy of a robot's pose, at every place of a floor and for every heading."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from lmkit.arrays import BoolArray, FloatArray, IntArray
from lmkit.errors import InputError
from lmkit.geometry.rig import AnyRig
from lmkit.localization.absolute_pose import LocateOptions
from lmkit.model.floor_plan import FloorPlan
from lmkit.model.landmark_map import MappedLandmark
from lmkit.planning.visibility import Sights, find_sights, planar_covariances, planar_errors
from lmkit.units import counted, length_text

BLIND_M = 10.0  # errors this large are not reported
# Errors from this size on are `ambiguous` or `imprecise` for `locate`.
AMBIGUOUS_M = LocateOptions.far_m / np.sqrt(2 * LocateOptions.ambiguous_below)
PROMISE_DRAWS = 32
HEADINGS = 16
MOST_PLACES = 4000
FINEST_M, COARSEST_M = 0.25, 2.0
LEAST_FAILING_M2 = 0.5
MOST_NAMED = 8  # failing places that a summary lists

# Largest value of each number of a demand, and the hint of its error.
DEMAND_RANGES = (
    ("error_m", BLIND_M, "give meters, such as 0.05"),
    ("heading_rad", math.pi, "give radians, such as math.radians(2)"),
    ("headings", 1.0, "give a share, such as 0.25 for 25 %"),
    ("share", 1.0, "give a share, such as 0.9 for 90 %"),
)
MOST_IN_VIEW = 20


@dataclass(frozen=True)
class Demand:
    """Required accuracy of a robot's pose.

    Attributes:
        error_m: of the position, root mean square.
        heading_rad: of the heading.
        in_view: landmarks that must be in view at the same time.
        headings: share of the headings that must meet the requirement at a place.
        share: share of all places that must meet it.

    Raises:
        InputError: a number out of range; names it.

    Examples:
        >>> import lmkit
        >>> print(lmkit.Demand(error_m=0.03, in_view=3))
        3 cm and 2 deg with 3 landmarks in view for 25% of the headings
    """

    error_m: float = 0.05
    heading_rad: float = np.deg2rad(2.0)
    in_view: int = 2
    headings: float = 0.25
    share: float = 0.9

    def __post_init__(self) -> None:
        for name, most, hint in DEMAND_RANGES:
            value = getattr(self, name)
            if not (isinstance(value, (int, float, np.number)) and 0 < value <= most):
                raise InputError("out_of_range", f"{name} of the demand is {value!r}, outside 0 to {most:.3g}", hint)
        if not (isinstance(self.in_view, (int, np.integer)) and 0 <= self.in_view <= MOST_IN_VIEW):
            what = f"in_view of the demand is {self.in_view!r}, not a number of landmarks up to {MOST_IN_VIEW}"
            raise InputError("out_of_range", what, "2 is usual")

    def __str__(self) -> str:
        landmarks = counted(self.in_view, "landmark")
        return (
            f"{length_text(self.error_m)} and {math.degrees(self.heading_rad):g} deg with {landmarks} "
            f"in view for {self.headings:.0%} of the headings"
        )


@dataclass(frozen=True, eq=False)
class PoseCoverage:
    """Places on a raster over the floor, with the expected errors for every heading.

    Attributes:
        places: (N,2) meters.
        step_m: between places.
        headings: (H,) rad.
        error_m, heading_rad: (N,H) expected errors, infinite where the pose is not determined.
        in_view: (N,H) landmarks in view.
    """

    places: FloatArray
    step_m: float
    headings: FloatArray
    error_m: FloatArray
    heading_rad: FloatArray
    in_view: IntArray

    def holds(self, demand: Demand) -> BoolArray:
        """(N,H) whether the demand is met."""
        return np.asarray(
            (self.error_m <= demand.error_m)
            & (self.heading_rad <= demand.heading_rad)
            & (self.in_view >= demand.in_view)
        )

    def covered(self, demand: Demand) -> BoolArray:
        """(N,) whether it is met for enough headings at a place."""
        return np.asarray(self.holds(demand).mean(axis=1) >= demand.headings - 1e-9)

    def typical_error_m(self, headings: float) -> FloatArray:
        """(N,) the largest error in the best headings, of that share."""
        return np.asarray(np.sort(self.error_m, axis=1)[:, self._rank(headings)])

    def typical_in_view(self, headings: float) -> IntArray:
        """(N,) the least number of landmarks in view in the best headings, of that share."""
        return np.asarray(np.sort(self.in_view, axis=1)[:, ::-1][:, self._rank(headings)])

    def _rank(self, headings: float) -> int:
        return max(int(np.ceil(headings * len(self.headings) - 1e-9)) - 1, 0)


@dataclass(frozen=True)
class FailingPlace:
    """A region where the demand is not met.

    Attributes:
        middle: (x, y) of the place deepest inside it, meters.
        area_m2: how large it is.
        in_view, error_m: landmarks in view there and expected error, infinite if the pose is not determined, at
            the worst of the headings that must meet the demand.
    """

    middle: tuple[float, float]
    area_m2: float
    in_view: int
    error_m: float

    def __str__(self) -> str:
        known = f"position error {length_text(self.error_m)}" if self.error_m < BLIND_M else "pose unknown"
        x, y = self.middle
        seen = f"{counted(self.in_view, 'landmark')} in view"
        if self.in_view == 0 and self.error_m < BLIND_M:
            seen = "landmarks read in fewer than half of the images"
        return f"{self.area_m2:.1f} m2 around ({x:.1f}, {y:.1f}) m: {seen}, {known}"

    def reason(self, demand: Demand) -> str:
        """The part of the requirement that is not met."""
        if self.in_view < demand.in_view:
            return f"{counted(demand.in_view, 'landmark')} required"
        return f"{length_text(demand.error_m)} required" if self.error_m > demand.error_m else "heading too uncertain"


def places_on(floor: FloorPlan, radius_m: float, step_m: float | None = None) -> tuple[FloatArray, float]:
    """(N,2) places where a robot of a given radius can be, on a raster, and its step.

    Args:
        step_m: None: as fine as a few thousand places allow.

    Raises:
        InputError: the robot fits nowhere.
    """
    free = floor.clearance_m >= radius_m
    if not free.any():
        raise InputError(
            "no_room",
            f"a robot of radius {radius_m:g} m fits nowhere: "
            f"the largest radius that fits is {floor.clearance_m.max():.2f} m",
            "check the plan's scale (--scale) and the radius (--radius)",
        )
    if step_m is None:
        area = free.sum() * floor.cell_m**2
        step_m = float(np.clip(np.sqrt(area / MOST_PLACES), FINEST_M, COARSEST_M))
    step = max(1, round(step_m / floor.cell_m))
    rows, columns = np.indices(free.shape)
    raster = (rows % step == step // 2) & (columns % step == step // 2) & free
    if not raster.any():
        raster = free
    at_rows, at_columns = np.nonzero(raster)
    return floor.middles(at_rows, at_columns), step * floor.cell_m


def all_states(places: FloatArray, count: int = HEADINGS) -> tuple[FloatArray, FloatArray]:
    """(N*H,3) poses at all places in all headings, and the (H,) headings."""
    headings = np.arange(count) * 2 * np.pi / count
    states = np.column_stack([np.repeat(places, count, axis=0), np.tile(headings, len(places))])
    return states, headings


def predict_coverage(
    floor: FloorPlan,
    landmarks: Sequence[MappedLandmark],
    rig: AnyRig,
    radius_m: float,
    step_m: float | None = None,
) -> PoseCoverage:
    """Predict the pose error at every place of the floor.

    Raises:
        InputError: the robot fits nowhere.
    """
    places, step_m = places_on(floor, radius_m, step_m)
    states, headings = all_states(places)
    sights = find_sights(states, landmarks, rig, floor)
    error_m, heading_rad, in_view = expected_errors(sights, states, rig)
    shape = (len(places), len(headings))
    return PoseCoverage(
        places, step_m, headings, error_m.reshape(shape), heading_rad.reshape(shape), in_view.reshape(shape)
    )


def expected_errors(sights: Sights, states: FloatArray, rig: AnyRig) -> tuple[FloatArray, FloatArray, IntArray]:
    """(P,) errors of position (m) and heading (rad), infinite where blind, and landmarks in view, at (P,3) poses."""
    assert rig.T_base_left is not None
    C = planar_covariances(sights.information_at(len(states)), states, rig.T_base_left)
    error_m, heading_rad = planar_errors(C)
    blind = error_m > BLIND_M
    return (
        np.where(blind, np.inf, error_m),
        np.where(blind, np.inf, heading_rad),
        sights.in_view_at(len(states)),
    )


def promised_errors(sights: Sights, states: FloatArray, rig: AnyRig) -> FloatArray:
    """(P,) root mean square errors of the position (m) over random sets of read landmarks; infinite if few are read.

    Landmarks in view are drawn with their probability of being read; draws that are ambiguous for `locate` are left
    out.  The search does not use this measure: rare draws without an important landmark, with ten times the error,
    dominate the mean.
    """
    assert rig.T_base_left is not None
    rng = np.random.default_rng(0)
    total, count = np.zeros(len(states)), np.zeros(len(states))
    for _ in range(PROMISE_DRAWS):
        read = rng.random(len(sights.poses)) < sights.probability
        drawn = Sights(sights.poses[read], sights.landmarks[read], np.ones(read.sum()), sights.information[read])
        C = planar_covariances(drawn.information_at(len(states)), states, rig.T_base_left)
        squared = C[:, 0, 0] + C[:, 1, 1]
        known = squared < AMBIGUOUS_M**2
        total += np.where(known, squared, 0.0)
        count += known
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(count >= PROMISE_DRAWS / 4, np.sqrt(total / count), np.inf))


def failing_places(coverage: PoseCoverage, demand: Demand) -> list[FailingPlace]:
    """Connected regions that are not covered, the largest first."""
    failing = ~coverage.covered(demand)
    at = np.round((coverage.places - coverage.places.min(axis=0)) / coverage.step_m).astype(int)
    raster = np.zeros(at.max(axis=0)[::-1] + 3, dtype=np.uint8)
    raster[at[:, 1] + 1, at[:, 0] + 1] = failing
    count, labels = cv2.connectedComponents(raster, connectivity=4)
    depth = cv2.distanceTransform(raster, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    label = labels[at[:, 1] + 1, at[:, 0] + 1]
    depth = depth[at[:, 1] + 1, at[:, 0] + 1]
    error_m, in_view = coverage.typical_error_m(demand.headings), coverage.typical_in_view(demand.headings)
    found = []
    for number in range(1, count):
        rows = np.flatnonzero(label == number)
        deepest = rows[np.argmax(depth[rows])]
        area = len(rows) * coverage.step_m**2
        if area >= LEAST_FAILING_M2:
            x, y = coverage.places[deepest].tolist()
            found.append(FailingPlace((x, y), area, int(in_view[deepest]), float(error_m[deepest])))
    return sorted(found, key=lambda place: -place.area_m2)


def coverage_dict(
    coverage: PoseCoverage, demand: Demand, failing: Sequence[FailingPlace], plan: Path
) -> dict[str, Any]:
    """The JSON result (docs/formats.md).

    Args:
        failing: from `failing_places`.
        plan: the heat map's file.
    """
    places = [
        {
            "position": list(place.middle),
            "area_m2": place.area_m2,
            "in_view": place.in_view,
            "error_m": None if math.isinf(place.error_m) else place.error_m,
        }
        for place in failing
    ]
    share = float(coverage.covered(demand).mean())
    return {"share": share, "places": len(coverage.places), "failing": places, "plan": str(plan)}


def coverage_lines(coverage: PoseCoverage, demand: Demand, failing: Sequence[FailingPlace]) -> list[str]:
    """A summary, and the largest failing places, as lines of text."""
    share = float(coverage.covered(demand).mean())
    lines = [f"{share:.0%} of {len(coverage.places)} places meet the requirement: {demand}"]
    lines += [f"failing: {place} ({place.reason(demand)})" for place in failing[:MOST_NAMED]]
    if len(failing) > MOST_NAMED:
        lines.append(f"failing: {counted(len(failing) - MOST_NAMED, 'smaller region')} more")
    return lines
