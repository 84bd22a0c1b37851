"""Drive a robot to a goal with landmarks: locate, follow the route, avoid obstacles, or stop with a reason.

Every 0.2 s the filter (`tracking/planar_stereo_filter.py`) takes the wheel odometry and the detections of both
cameras; its estimate steers the robot.  The robot has arrived when 95 % of the pose distribution lies within the
tolerance of the goal.  While the estimate is too uncertain, the robot turns on the spot to look around; if that does
not help, it stops.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.errors import LmkitError
from lmkit.geometry.planar import wrap_heading
from lmkit.geometry.rig import AnyRig
from lmkit.localization.correspondences import CORNER_FLOOR_PX
from lmkit.model.floor_plan import FloorPlan
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.observation import Detection
from lmkit.model.pose_status import PoseStatus
from lmkit.odometry.wheel_odometry import MotionNoise
from lmkit.planning.coverage import Demand, PoseCoverage
from lmkit.planning.route import Goal, Route, plan_route
from lmkit.tracking.planar_stereo_filter import RigFilter
from lmkit.tracking.range_bearing_filter import TrackedPose
from lmkit.units import length_text

PERIOD_S = 0.2
FASTEST_MPS, FASTEST_RADPS = 0.35, 0.7
LOOK_AHEAD_M = 0.35
TURN_FIRST_RAD = 0.5
NEAR_GOAL_M = 0.3
SPARE_M = 0.07  # of clearance beyond the radius, if the route allows it
SURE = 2.45  # standard deviations of 95 % in two dimensions
SURE_1D = 1.96
UNSURE_M = 0.12  # of the position, from which on the robot looks around
TURNS = 1.15  # full turns of a look around
MOST_WAITS = 15  # frames at the goal
MOST_GOES = 5
FINE = 0.05  # share of the angular tolerance for the control error; the rest is for the uncertainty
MOST_STEPS = 150  # to the goal once it is near
STOP_SHORT_M = 0.35  # an obstacle nearer than that blocks the route
SEEN_AT_M = 0.25  # largest distance between a wall of the plan and its observed place
OBSTACLE_M = 0.15
MOST_TIMES_UNSURE = 25
# For wheels with a gyro: rotations are far more accurate than with wheels alone.
WITH_GYRO = MotionNoise(
    along_per_root_m=0.02,
    across_per_root_m=0.005,
    turn_per_root_m=0.006,
    turn_per_root_rad=0.01,
    turn_per_root_s=0.002,
    place_per_root_s=0.0005,
)
MOST_REPLANS = 12
MOST_SECONDS = 900.0


class Robot(Protocol):
    """Interface of a robot; `simulation/robot.py` implements it."""

    time_s: float

    def drive(self, forward_mps: float, turn_radps: float, seconds: float) -> list[tuple[float, float, float, float]]:
        """Drive with these velocities; returns rows of time, distance, rotation and the gyro's rate."""

    def look(self) -> Sequence[Sequence[Detection]]:
        """Detections of every camera of the rig."""

    def obstacle_ahead(self, reach_m: float) -> FloatArray | None:
        """(2,) nearest obstacle ahead, forward and left of the robot."""


@dataclass(frozen=True, eq=False)
class Site:
    """The surroundings of a robot: floor, landmarks, rig and expected errors.

    Attributes:
        floor: the floor plan; other obstacles are found while driving.
        landmarks, rig: the map, and the cameras with their T_base_left.
        radius_m: of the robot.
        demand, coverage: required and expected accuracy of the pose.
        corner_floor_px: see `LocateOptions`; 0 for simulated corners without lens errors.
    """

    floor: FloorPlan
    landmarks: LandmarkMap
    rig: AnyRig
    radius_m: float
    demand: Demand
    coverage: PoseCoverage
    corner_floor_px: float = CORNER_FLOOR_PX


@dataclass(frozen=True)
class Tolerance:
    """Tolerance of the goal."""

    place_m: float = 0.05
    heading_rad: float = np.deg2rad(3.0)


@dataclass(eq=False)
class Journey:
    """Result of driving to a goal.

    Attributes:
        status: ``arrived``, ``lost`` (pose unknown), ``unsure`` (pose too uncertain for the goal),
            ``blocked`` (no route left) or ``late``.
        why: in words.
        poses: estimated pose at every frame.
        routes: the planned ones, the first and those around obstacles.
    """

    status: str = "late"
    why: str = ""
    poses: list[TrackedPose] = field(default_factory=list)
    routes: list[Route] = field(default_factory=list)


def drive_to(
    robot: Robot,
    site: Site,
    goal: Goal,
    tolerance: Tolerance | None = None,
    on_pose: Callable[[TrackedPose], None] = lambda pose: None,
) -> Journey:
    """Drive until the robot has arrived or must stop; ``on_pose`` is called with every estimated pose."""
    return _Navigator(robot, site, goal, tolerance or Tolerance(), on_pose).run()


def surely_there(pose: TrackedPose, goal: Goal, tolerance: Tolerance) -> bool:
    """Whether 95 % of the pose distribution is within the tolerance of the goal."""
    if pose.state is None or pose.covariance is None or pose.status != PoseStatus.OK:
        return False
    off = float(np.hypot(goal.x_m - pose.state[0], goal.y_m - pose.state[1]))
    if off + SURE * _widest_m(pose.covariance) > tolerance.place_m:
        return False
    if goal.heading_rad is None:
        return True
    turn = abs(wrap_heading(goal.heading_rad - pose.state[2]))
    return bool(turn + SURE_1D * np.sqrt(pose.covariance[2, 2]) < tolerance.heading_rad)


class _Navigator:
    """The control loop over the pose estimate."""

    def __init__(
        self,
        robot: Robot,
        site: Site,
        goal: Goal,
        tolerance: Tolerance,
        on_pose: Callable[[TrackedPose], None],
    ) -> None:
        self.robot, self.site, self.goal, self.tolerance = robot, site, goal, tolerance
        self.on_pose = on_pose
        self.filter = RigFilter(site.landmarks, site.rig, WITH_GYRO, site.corner_floor_px)
        self.journey = Journey()
        self.obstacles: list[FloatArray] = []

    def run(self) -> Journey:
        """Locate, drive and turn until the goal is reached."""
        if not self.look_around():
            return self.stop("lost", "no landmark of the map determines the pose; mount more, or check the map")
        while self.robot.time_s < MOST_SECONDS:
            if len(self.obstacles) > MOST_REPLANS:
                return self.stop("blocked", "the way was blocked again and again")
            if len(self.journey.routes) > MOST_REPLANS + MOST_TIMES_UNSURE:
                return self.stop("lost", "the pose is lost again and again on this way; mount more landmarks")
            try:
                route = self.plan()
            except LmkitError as error:
                return self.stop("blocked", error.message)
            self.journey.routes.append(route)
            outcome = self.follow(route.waypoints)
            if outcome == "there":
                outcome = self.wait_until_known()
            if outcome == "arrived":
                return self.stop("arrived", "")
            if outcome == "lost":
                sigma = length_text(self.sigma_m())
                return self.stop("lost", f"the position is uncertain by {sigma}, and looking around does not help")
            if outcome == "unsure":
                return self.stop("unsure", f"near the goal, but {self.doubts()}")
        return self.stop("late", f"not there after {MOST_SECONDS:.0f} s")

    def plan(self) -> Route:
        """Plan a route from the estimated pose, with additional clearance if possible."""
        site, floor = self.site, self.site.floor
        if self.obstacles:
            floor = floor.blocked(np.array(self.obstacles), OBSTACLE_M)
        try:
            return self.plan_at(floor, site.radius_m + SPARE_M)
        except LmkitError:
            return self.plan_at(floor, site.radius_m)

    def plan_at(self, floor: FloorPlan, radius_m: float) -> Route:
        """Plan a route for a robot of that radius; if it is too close to a wall, start beside the wall."""
        site, start = self.site, self.state[:2]
        if floor.clearance_at(start) < radius_m:
            rows, columns = np.nonzero(floor.clearance_m >= radius_m)
            middles = floor.middles(rows, columns)
            if len(middles):
                start = middles[np.argmin(np.linalg.norm(middles - start, axis=1))]
        spot = Goal(float(start[0]), float(start[1]))
        return plan_route(floor, site.landmarks, site.rig, radius_m, spot, self.goal, site.demand, site.coverage)

    def follow(self, waypoints: FloatArray) -> str:
        """Pure pursuit (Coulter 1992): ``there``, ``again`` (plan anew), ``lost`` or ``late``."""
        way = _Way(waypoints)
        while self.robot.time_s < MOST_SECONDS:
            if self.sigma_m() > UNSURE_M or self.pose.status != PoseStatus.OK:
                if not self.look_around():
                    return "lost"
                return "again"
            obstacle = self.robot.obstacle_ahead(STOP_SHORT_M)
            ahead = way.ahead(self.state[:2], LOOK_AHEAD_M)
            to_end = float(np.linalg.norm(way.end - self.state[:2]))
            off = wrap_heading(np.arctan2(*(ahead - self.state[:2])[::-1]) - self.state[2])
            if to_end < NEAR_GOAL_M and way.left_m < 2 * NEAR_GOAL_M:
                return "there"
            if obstacle is not None and abs(off) < TURN_FIRST_RAD and self.note_obstacle(obstacle):
                return "again"
            if abs(off) > TURN_FIRST_RAD:
                self.step(0.0, float(np.clip(1.5 * off, -FASTEST_RADPS, FASTEST_RADPS)))
                continue
            slower = 1.0 if obstacle is None else 0.4
            speed = slower * FASTEST_MPS * max(np.cos(2 * off), 0.2) * min(1.0, 0.3 + to_end)
            self.step(speed, float(np.clip(1.6 * off, -FASTEST_RADPS, FASTEST_RADPS)))
        return "late"

    def wait_until_known(self) -> str:
        """The last steps: to the point, then to the heading, until certainly within tolerance."""
        end = np.array([self.goal.x_m, self.goal.y_m])
        for go in range(MOST_GOES):
            self.go_to(end)
            if self.goal.heading_rad is not None:
                self.turn_to(self.goal.heading_rad)
            for _ in range(MOST_WAITS):
                self.step(0.0, 0.0)
                if surely_there(self.pose, self.goal, self.tolerance):
                    return "arrived"
                if self.sure_enough():
                    break
            else:
                # Landmarks on one side may be closer to the goal's heading; the last rotation ends at the goal.
                if go < MOST_GOES - 1:
                    self.look_around(0.3 * self.tolerance.place_m / SURE, to_left=go % 2 == 0)
        return "unsure"

    def go_to(self, end: FloatArray) -> None:
        """Straight to a near point, backwards where that is nearer."""
        for _ in range(MOST_STEPS):
            off = end - self.state[:2]
            distance = float(np.linalg.norm(off))
            if distance < 0.3 * self.tolerance.place_m:
                return
            bearing = wrap_heading(np.arctan2(off[1], off[0]) - self.state[2])
            back = abs(bearing) > np.pi / 2
            bearing = wrap_heading(bearing + np.pi) if back else bearing
            if abs(bearing) > 0.25 and distance > 0.02:
                self.step(0.0, float(np.clip(1.5 * bearing, -0.5, 0.5)))
            else:
                speed = min(0.15, max(0.03, 0.8 * distance))
                self.step(-speed if back else speed, float(np.clip(bearing, -0.5, 0.5)))

    def turn_to(self, heading_rad: float) -> None:
        """Turn on the spot."""
        for _ in range(MOST_STEPS):
            turn = wrap_heading(heading_rad - self.state[2])
            if abs(turn) < FINE * self.tolerance.heading_rad:
                return
            self.step(0.0, float(np.clip(1.5 * turn, -0.5, 0.5)))

    def sure_enough(self) -> bool:
        """Whether the pose is accurate enough to drive on instead of looking around."""
        return bool(
            SURE * self.sigma_m() < 0.6 * self.tolerance.place_m
            and SURE_1D * self.sigma_rad() < 0.6 * self.tolerance.heading_rad
        )

    def doubts(self) -> str:
        """Possible (95 %) and allowed distance and rotation from the goal, as text."""
        off_m = float(np.hypot(self.goal.x_m - self.state[0], self.goal.y_m - self.state[1])) + SURE * self.sigma_m()
        place = f"perhaps {length_text(off_m)} off ({length_text(self.tolerance.place_m)} allowed)"
        if self.goal.heading_rad is None:
            return place
        turn = abs(wrap_heading(self.goal.heading_rad - self.state[2])) + SURE_1D * self.sigma_rad()
        allowed = np.rad2deg(self.tolerance.heading_rad)
        return f"{place} and {np.rad2deg(turn):.1f} deg turned ({allowed:.2g} deg allowed)"

    def look_around(self, wanted_m: float = 0.15 * UNSURE_M, to_left: bool = True) -> bool:
        """Turn on the spot until the pose is this accurate; False if a full turn does not help."""
        rate = 0.7 * FASTEST_RADPS if to_left else -0.7 * FASTEST_RADPS
        steps = int(TURNS * 2 * np.pi / abs(rate) / PERIOD_S)
        for k in range(steps):
            self.step(0.0, 0.0 if k == 0 else rate)
            if self.pose.status == PoseStatus.OK and self.sigma_m() < wanted_m:
                return True
        return bool(self.pose.status == PoseStatus.OK and self.sigma_m() < UNSURE_M)

    def note_obstacle(self, at: FloatArray) -> bool:
        """Add the obstacle ahead to the plan; False if it is a wall of the plan."""
        c, s = np.cos(self.state[2]), np.sin(self.state[2])
        place = self.state[:2] + np.array([c * at[0] - s * at[1], s * at[0] + c * at[1]])
        if self.site.floor.clearance_at(place) < SEEN_AT_M:
            return False
        # Obstacles that were noted before are avoided already.
        if any(np.linalg.norm(place - known) < 0.5 * OBSTACLE_M for known in self.obstacles):
            return False
        self.obstacles.append(place)
        return True

    def step(self, forward_mps: float, turn_radps: float) -> None:
        """Drive for one period, detect, and update the filter."""
        for time_s, forward_m, turn_rad, rate in self.robot.drive(forward_mps, turn_radps, PERIOD_S):
            self.filter.wheels.add_odometry(time_s, forward_m, turn_rad)
            self.filter.wheels.add_gyro(time_s, rate)
        self.pose = self.filter.observe(self.robot.time_s, self.robot.look())
        self.journey.poses.append(self.pose)
        self.on_pose(self.pose)

    @property
    def state(self) -> FloatArray:
        """(3,) estimated state."""
        assert self.pose.state is not None
        return self.pose.state

    def sigma_m(self) -> float:
        """Standard deviation of the position along its least certain direction."""
        return float("inf") if self.pose.covariance is None else _widest_m(self.pose.covariance)

    def sigma_rad(self) -> float:
        """Standard deviation of the heading."""
        return float("inf") if self.pose.covariance is None else float(np.sqrt(self.pose.covariance[2, 2]))

    def stop(self, status: str, why: str) -> Journey:
        """Stop, with the status and reason."""
        self.robot.drive(0.0, 0.0, PERIOD_S)
        self.journey.status, self.journey.why = status, why
        return self.journey


class _Way:
    """Straight lines to follow, and the progress along them."""

    def __init__(self, waypoints: FloatArray) -> None:
        self.points = waypoints
        legs = np.linalg.norm(np.diff(waypoints, axis=0), axis=1)
        self.at = np.concatenate([[0.0], np.cumsum(legs)])
        self.come = 0.0

    @property
    def end(self) -> FloatArray:
        """(2,) the last point."""
        return np.asarray(self.points[-1])

    @property
    def left_m(self) -> float:
        """Remaining distance."""
        return float(self.at[-1] - self.come)

    def ahead(self, here: FloatArray, far_m: float) -> FloatArray:
        """(2,) the point at that distance beyond the nearest point of the route; progress never decreases."""
        steps = np.arange(self.come, min(self.come + 1.0, self.at[-1]) + 1e-9, 0.02)
        along = self.place(steps)
        self.come = float(steps[np.argmin(np.linalg.norm(along - here, axis=1))])
        return np.asarray(self.place(np.array([min(self.come + far_m, self.at[-1])]))[0])

    def place(self, along: FloatArray) -> FloatArray:
        """(N,2) points at distances along the route."""
        return np.column_stack([np.interp(along, self.at, self.points[:, k]) for k in (0, 1)])


def _widest_m(covariance: FloatArray) -> float:
    return float(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1]))
