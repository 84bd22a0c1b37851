"""Route to a goal on which the pose stays known: the shortest path, with longer lengths where no landmark is seen.

1. Cells with enough clearance for the robot are connected to their eight neighbors.  A step costs its length, more
where
   the expected error exceeds the demand in the direction of travel, or where walls are close.  (Dijkstra by scipy:
   costs that depend on the direction are beyond skimage.graph; docs/decisions/0011-planning.md.)
2. Corners are left out if a straight line has no higher cost.
3. The covariance is propagated along the route: it grows with wheel odometry and shrinks with landmarks in view.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.ndimage import label
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from lmkit.arrays import BoolArray, FloatArray, IntArray
from lmkit.errors import InputError, NegativeAnswer
from lmkit.geometry.planar import planar_pose
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import AnyRig
from lmkit.model.floor_plan import FloorPlan
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.odometry.wheel_odometry import MotionNoise
from lmkit.planning.coverage import Demand, PoseCoverage, predict_coverage
from lmkit.planning.visibility import find_sights, planar_covariances, planar_errors
from lmkit.units import counted, length_text

CELL_M = 0.1
BLIND_FACTOR = 3.0  # additional length factor without landmarks
BLIND_TIMES = 20.0  # errors above this multiple of the demand cost the same
CLOSE_FACTOR = 1.0
COMFORT_M = 0.2  # of clearance beyond the radius
CHEAPER = 1.01
STEP_M = 0.25  # between poses at which landmarks are used: errors of nearer poses are correlated
BEFORE_SIGN_M = 1.0  # distance of a robot in front of a landmark that is its goal
START_SIGMA = (0.03, 0.03, np.deg2rad(1.0))
NEIGHBOURS = ((0, 1), (1, 1), (1, 0), (1, -1), (0, -1), (-1, -1), (-1, 0), (-1, 1))  # rows, columns; by 45 deg


@dataclass(frozen=True, eq=False)
class Route:
    """A planned route.

    Attributes:
        waypoints: (N,2) meters, straight lines between them.
        heading_rad: at the goal, or None.
        states: (M,3) x, y, heading along the route, dense.
        error_m, heading_sigma_rad: (M,) expected there.
    """

    waypoints: FloatArray
    heading_rad: float | None
    states: FloatArray
    error_m: FloatArray
    heading_sigma_rad: FloatArray

    @property
    def length_m(self) -> float:
        """Length of the route, meters."""
        return float(np.linalg.norm(np.diff(self.waypoints, axis=0), axis=1).sum())

    def __repr__(self) -> str:
        return (
            f"Route({self.length_m:.2f} m, {len(self.waypoints)} waypoints, "
            f"error up to {1000 * float(self.error_m.max()):.0f} mm)"
        )

    def to_dict(self) -> dict[str, Any]:
        """The result as JSON values; docs/formats.md lists the keys."""
        worst = int(self.error_m.argmax())
        return {
            "length_m": self.length_m,
            "waypoints": self.waypoints.tolist(),
            "heading_deg": None if self.heading_rad is None else math.degrees(self.heading_rad),
            "worst_error_m": float(self.error_m[worst]),
            "worst_at": self.states[worst, :2].tolist(),
            "error_at_goal_m": float(self.error_m[-1]),
        }


@dataclass(frozen=True)
class Goal:
    """A goal to drive to: meters, and a heading in rad or None."""

    x_m: float
    y_m: float
    heading_rad: float | None = None


def find_goal(text: str, floor: FloorPlan, landmarks: LandmarkMap, radius_m: float) -> Goal:
    """A goal from text: ``2.5,1``, ``2.5,1,90`` (deg), a name of the floor plan or the map, or a
    landmark (``137``, ``lm8:137``).

    With a landmark, the goal is in front of it, and the robot faces it.

    Raises:
        InputError: nothing of that name, or several landmarks.
    """
    if text in floor.places:
        return Goal(*floor.places[text])
    named = [m for m in landmarks if m.name == text]
    if len(named) > 1:
        several = f"the map has {len(named)} landmarks of the name {text!r}"
        raise InputError("ambiguous_place", several, f"give the landmark's id, such as {named[0].id}")
    sign = next(iter(named), None)
    if sign is None and (text.isdigit() or text.rpartition(":")[0] in landmarks.families):
        sign = landmarks.find(LandmarkId.parse(text, landmarks.families))
    if sign is not None:
        return _before(sign, floor, radius_m)
    try:
        values = [float(piece) for piece in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in (2, 3) or not np.isfinite(values).all():
        names = [*floor.places, *(m.name for m in landmarks if m.name)]
        known = f"; known places: {', '.join(names)}" if names else ""
        raise InputError(
            "unknown_place",
            f"no place {text!r}{known}",
            "give x,y in meters, x,y,heading in degrees, a name or a code",
        )
    return Goal(values[0], values[1], float(np.deg2rad(values[2])) if len(values) == 3 else None)


def plan_route(
    floor: FloorPlan,
    landmarks: LandmarkMap,
    rig: AnyRig,
    radius_m: float,
    start: Goal,
    goal: Goal,
    demand: Demand,
    coverage: PoseCoverage | None = None,
) -> Route:
    """The route from one place to another.

    Args:
        coverage: of this floor, if already computed.

    Raises:
        InputError: a robot of that radius cannot stand at the start or the goal; names the nearest possible place.
        NegativeAnswer: there is no route; names the nearest place that can be reached.
    """
    grid = _Grid(floor, radius_m)
    ends = [grid.node(spot, name) for spot, name in ((start, "start"), (goal, "goal"))]
    grid.require_joined(ends, goal)
    coverage = coverage or predict_coverage(floor, list(landmarks), rig, radius_m)
    cost = grid.costs(coverage, demand)
    path = grid.search(cost, ends)
    points = np.array([[start.x_m, start.y_m], *grid.middles[path[1:-1]], [goal.x_m, goal.y_m]])
    waypoints = _straightened(points, grid, coverage, demand)
    states = _dense(waypoints)
    if goal.heading_rad is not None:
        states = np.vstack([states, [*waypoints[-1], goal.heading_rad]])
    C = _carried(states, list(landmarks), rig, floor)
    return Route(waypoints, goal.heading_rad, states, *planar_errors(C))


class _Grid:
    """The cells a robot can be in."""

    def __init__(self, floor: FloorPlan, radius_m: float) -> None:
        self.floor, self.radius_m = floor, radius_m
        every = max(1, round(CELL_M / floor.cell_m))
        self.cell_m = every * floor.cell_m
        offset = every // 2
        clearance = floor.clearance_m[offset::every, offset::every]
        self.open: BoolArray = clearance >= radius_m
        self.numbers: IntArray = np.full(self.open.shape, -1)
        rows, columns = np.nonzero(self.open)
        self.numbers[rows, columns] = np.arange(len(rows))
        self.rows, self.columns = rows, columns
        self.middles = floor.middles(rows * every + offset, columns * every + offset)
        self.clearance = clearance[rows, columns]
        self.part = label(self.open, np.ones((3, 3)))[0][rows, columns]
        self.tree = cKDTree(self.middles) if len(rows) else None

    def node(self, spot: Goal, name: str) -> int:
        """The cell of a place."""
        at = np.array([spot.x_m, spot.y_m])
        if self.tree is None:
            hint = "check the radius (--radius)"
            raise InputError("no_room", f"a robot of radius {self.radius_m:g} m fits nowhere", hint)
        nearest = self.tree.query(at)[1]
        if self.floor.clearance_at(at) < self.radius_m - self.floor.cell_m:
            x, y = self.middles[nearest]
            where = "too close to a wall" if self.floor.is_free(at) else "in a wall or outside the floor"
            raise InputError(
                f"bad_{name}",
                f"{name} ({spot.x_m:g}, {spot.y_m:g}) m is {where} for a robot of radius {self.radius_m:g} m",
                f"the nearest place where it can stand is {x:.2f},{y:.2f}",
            )
        return int(nearest)

    def require_joined(self, ends: Sequence[int], goal: Goal) -> None:
        """Refuse a goal behind walls."""
        if self.part[ends[0]] == self.part[ends[1]]:
            return
        reached = self.middles[self.part == self.part[ends[0]]]
        off = np.linalg.norm(reached - np.array([goal.x_m, goal.y_m]), axis=1)
        x, y = reached[np.argmin(off)]
        raise NegativeAnswer(
            "unreachable",
            f"no route for a robot of radius {self.radius_m:g} m leads to ({goal.x_m:g}, {goal.y_m:g}) m",
            f"the nearest place that can be reached is {x:.2f},{y:.2f}, {off.min():.2f} m away; "
            "check the radius (--radius)",
        )

    def costs(self, coverage: PoseCoverage, demand: Demand) -> FloatArray:
        """(8,N) factors on the length of a step from each cell in each direction."""
        nearest = cKDTree(coverage.places).query(self.middles)[1]
        turns = np.round(np.arange(8) * len(coverage.headings) / 8).astype(int)
        known = coverage.error_m[nearest][:, turns].T
        return np.asarray(_factor(known, self.clearance - self.radius_m, demand))

    def search(self, factors: FloatArray, ends: Sequence[int]) -> IntArray:
        """(K,) cells of the cheapest path."""
        starts, stops, weights = [], [], []
        for direction, (down, right) in enumerate(NEIGHBOURS):
            rows, columns = self.rows + down, self.columns + right
            inside = (rows >= 0) & (columns >= 0) & (rows < self.open.shape[0]) & (columns < self.open.shape[1])
            to = np.where(inside, self.numbers[np.where(inside, rows, 0), np.where(inside, columns, 0)], -1)
            near = np.flatnonzero(to >= 0)
            starts.append(near)
            stops.append(to[near])
            weights.append(self.cell_m * np.hypot(down, right) * factors[direction, near])
        count = len(self.rows)
        edges = (np.concatenate(weights), (np.concatenate(starts), np.concatenate(stops)))
        _, before = dijkstra(coo_array(edges, (count, count)).tocsr(), indices=ends[0], return_predecessors=True)
        path = [ends[1]]
        while path[-1] != ends[0]:
            path.append(int(before[path[-1]]))
        return np.array(path[::-1])


def _factor(error_m: FloatArray, spare_m: FloatArray, demand: Demand) -> FloatArray:
    """Factor on lengths for an expected error and a clearance."""
    times = np.minimum(error_m / demand.error_m, BLIND_TIMES)
    blind = np.log(np.maximum(times, 1.0)) / np.log(BLIND_TIMES)
    close = np.clip(1 - spare_m / COMFORT_M, 0, 1)
    return np.asarray(1 + BLIND_FACTOR * blind + CLOSE_FACTOR * close)


def _straightened(points: FloatArray, grid: _Grid, coverage: PoseCoverage, demand: Demand) -> FloatArray:
    """(N,2) without corners that a straight line makes unnecessary."""
    places = cKDTree(coverage.places)

    def cost(a: FloatArray, b: FloatArray) -> float:
        way = b - a
        length = float(np.linalg.norm(way))
        line = a + np.linspace(0, 1, max(2, int(np.ceil(2 * length / grid.cell_m))))[:, None] * way
        turn = round(float(np.arctan2(way[1], way[0])) / (2 * np.pi) * len(coverage.headings))
        known = coverage.error_m[places.query(line)[1], turn % len(coverage.headings)]
        spare = grid.floor.clearance_at(line) - grid.radius_m
        return length * float(_factor(known, spare, demand).mean())

    def is_clear(a: FloatArray, b: FloatArray) -> bool:
        steps = int(np.ceil(2 * float(np.linalg.norm(b - a)) / grid.cell_m))
        line = a + np.linspace(0, 1, steps + 1)[1:-1, None] * (b - a)
        return bool((grid.floor.clearance_at(line) >= grid.radius_m).all())

    total = np.concatenate([[0.0], np.cumsum([cost(a, b) for a, b in pairwise(points)])])
    kept = [0]
    while kept[-1] < len(points) - 1:
        here = kept[-1]
        # The farthest point that a straight line reaches at no higher cost; it always reaches the next one.
        kept.append(
            next(
                (
                    there
                    for there in range(len(points) - 1, here + 1, -1)
                    if cost(points[here], points[there]) <= CHEAPER * (total[there] - total[here])
                    and is_clear(points[here], points[there])
                ),
                here + 1,
            )
        )
    return points[kept]


def _dense(waypoints: FloatArray) -> FloatArray:
    """(M,3) x, y, heading at every step along straight lines."""
    parts = []
    for a, b in pairwise(waypoints):
        length = float(np.linalg.norm(b - a))
        steps = np.linspace(0, 1, max(2, int(np.ceil(length / STEP_M)) + 1))[:, None]
        heading = np.full((len(steps), 1), np.arctan2(b[1] - a[1], b[0] - a[0]))
        parts.append(np.hstack([a + steps * (b - a), heading]))
    return np.concatenate(parts)


def _carried(states: FloatArray, landmarks: Sequence[MappedLandmark], rig: AnyRig, floor: FloorPlan) -> FloatArray:
    """(M,3,3) covariances along the route."""
    assert rig.T_base_left is not None
    sights = find_sights(states, landmarks, rig, floor)
    information = planar_covariances(sights.information_at(len(states)), states, rig.T_base_left)
    known = np.linalg.inv(information)
    noise = MotionNoise()
    P = np.diag(np.square(START_SIGMA))
    answer = []
    for k in range(len(states)):
        if k:
            way = float(np.linalg.norm(states[k, :2] - states[k - 1, :2]))
            turn = abs(float(np.angle(np.exp(1j * (states[k, 2] - states[k - 1, 2])))))
            c, s = np.cos(states[k, 2]), np.sin(states[k, 2])
            F = np.eye(3)
            F[0, 2], F[1, 2] = -s * way, c * way
            ahead = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
            Q = np.diag(
                [
                    noise.along_per_root_m**2 * way,
                    noise.across_per_root_m**2 * way,
                    noise.turn_per_root_m**2 * way + noise.turn_per_root_rad**2 * turn,
                ]
            )
            P = F @ P @ F.T + ahead @ Q @ ahead.T
        P = np.linalg.inv(np.linalg.inv(P) + known[k])
        answer.append(P)
    return np.array(answer)


def _before(sign: MappedLandmark, floor: FloorPlan, radius_m: float) -> Goal:
    out = sign.T_map_landmark.R[:2, 2]
    out = out / np.linalg.norm(out)
    looking = float(np.arctan2(-out[1], -out[0]))
    for far in (BEFORE_SIGN_M, 0.75 * BEFORE_SIGN_M, 1.5 * BEFORE_SIGN_M, 0.5 * BEFORE_SIGN_M):
        at = sign.T_map_landmark.t[:2] + far * out
        if floor.clearance_at(at) >= radius_m:
            return Goal(float(at[0]), float(at[1]), looking)
    x, y = sign.T_map_landmark.t[:2] + BEFORE_SIGN_M * out
    return Goal(float(x), float(y), looking)


def route_lines(route: Route) -> list[str]:
    """A summary and the waypoints, as lines of text."""
    return [
        f"{route.length_m:.2f} m in {counted(len(route.waypoints) - 1, 'straight part')}",
        *(f"  {x:.2f},{y:.2f}" for x, y in route.waypoints),
        f"expected error at the goal: {length_text(route.error_m[-1])}",
    ]


def route_warning(route: Route, demand: Demand) -> str | None:
    """A sentence if the expected error exceeds the required one somewhere; None if nowhere."""
    worst = int(route.error_m.argmax())
    if route.error_m[worst] <= demand.error_m:
        return None
    x, y = route.states[worst, :2]
    return f"near ({x:.1f}, {y:.1f}) m the error grows to {length_text(route.error_m[worst])}: add a landmark there"


def route_csv(route: Route) -> str:
    """The text of a CSV file: poses along the route with expected errors."""
    rows = zip(route.states.tolist(), route.error_m.tolist(), route.heading_sigma_rad.tolist(), strict=True)
    lines = [f"{x:.4f},{y:.4f},{math.degrees(h):.2f},{e:.4f},{math.degrees(s):.3f}\n" for (x, y, h), e, s in rows]
    return "x_m,y_m,heading_deg,error_m,heading_error_deg\n" + "".join(lines)


def route_poses(route: Route) -> list[tuple[float, Pose]]:
    """Numbered poses along the route; the numbers take the place of times."""
    return [(float(k), planar_pose(state)) for k, state in enumerate(route.states)]
