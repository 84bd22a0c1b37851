"""A simulated robot on wheels: it slips, its gyro drifts, and walls hide landmarks from its cameras."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.geometry.planar import planar_pose
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import AnyRig
from lmkit.model.floor_plan import FloorPlan
from lmkit.model.landmark_map import LandmarkMap
from lmkit.simulation.observations import Seen, look
from lmkit.simulation.recording import WheelErrors

Cameras = Callable[[float, Pose], tuple[Seen, ...]]
STEP_S = 0.02
SLIP_M, SLIP_RAD = 0.05, 0.08
LEAN_RAD, LIFT_M = np.deg2rad(0.3), 0.004
TOUCH_CELLS = 1.0  # walls have a resolution of one cell


class SimulatedRobot:
    """The true state of a robot, and its sensors.

    Attributes:
        state: (3,) true x, y (m), heading (rad).
        time_s: current time.
        touched: whether it has hit a wall or an obstacle.

    Args:
        cameras: function from time and pose of the base to detections; None: corners and detection as measured
            (`model/detector_model.py`).
    """

    def __init__(
        self,
        floor: FloorPlan,
        landmarks: LandmarkMap,
        rig: AnyRig,
        state: FloatArray,
        radius_m: float,
        errors: WheelErrors,
        seed: int,
        cameras: Cameras | None = None,
    ) -> None:
        self.floor, self.landmarks, self.rig, self.radius_m, self.errors = floor, landmarks, rig, radius_m, errors
        self.state = np.array(state, dtype=np.float64)
        self.time_s = 0.0
        self.touched = False
        self._cameras = cameras
        self._rng = np.random.default_rng([seed, 5])
        self._late = deque([self.state], maxlen=1 + round(errors.delay_s / STEP_S))
        self._slip_at = np.sort(self._rng.uniform(2.0, 60.0, errors.slips)).tolist()
        self._bias = errors.gyro_bias

    def drive(self, forward_mps: float, turn_radps: float, seconds: float) -> list[tuple[float, float, float, float]]:
        """Move the robot; returns rows of time, distance and turn from the wheels, and the gyro's rate."""
        rows = []
        for _ in range(max(1, round(seconds / STEP_S))):
            self.time_s += STEP_S
            e, rng = self.errors, self._rng
            root = np.sqrt(abs(forward_mps) * STEP_S)
            forward = e.forward_scale * forward_mps * STEP_S + e.noise_per_root_m * root * rng.normal()
            turn = e.turn_scale * turn_radps * STEP_S + e.turn_noise_per_root_m * root * rng.normal()
            if self._slip_at and self.time_s >= self._slip_at[0] and abs(forward_mps) > 0.05:
                self._slip_at.pop(0)
                forward += rng.uniform(-SLIP_M, SLIP_M)
                turn += rng.uniform(-SLIP_RAD, SLIP_RAD)
            middle = self.state[2] + turn / 2
            self.state = self.state + np.array([forward * np.cos(middle), forward * np.sin(middle), turn])
            self._late.append(self.state)
            clear = self.floor.clearance_at(self.state[None, :2])[0]
            self.touched |= bool(clear < self.radius_m - TOUCH_CELLS * self.floor.cell_m)
            rate = turn / STEP_S + self._bias + e.gyro_noise * rng.normal()
            rows.append((self.time_s, forward_mps * STEP_S, turn_radps * STEP_S, rate))
        return rows

    @property
    def seen_from(self) -> FloatArray:
        """(3,) true state at the exposure of the images that :meth:`look` returns now."""
        return self._late[0]

    def look(self) -> tuple[Seen, ...]:
        """Detections of all cameras; images come ``delay_s`` late."""
        # Small tilts: floors are not level, and robots move on their suspension.
        turn = np.append(self._rng.normal(0, LEAN_RAD, 2), 0.0)
        lean = Pose.from_rvec("base", "base", turn, np.array([0.0, 0.0, self._rng.normal(0, LIFT_M)]))
        T_map_base = planar_pose(self.seen_from) @ lean
        if self._cameras is not None:
            return self._cameras(self.time_s, T_map_base)
        return look(self.landmarks, self.rig, T_map_base, None, self._rng, self.floor)

    def obstacle_ahead(self, reach_m: float) -> FloatArray | None:
        """(2,) nearest obstacle in a strip of the robot's width, m forward and left; None if there is none."""
        ahead = np.arange(self.radius_m, self.radius_m + reach_m, 0.5 * self.floor.cell_m)
        aside = np.linspace(-self.radius_m, self.radius_m, 9)
        points = np.array([(a, b) for a in ahead for b in aside])
        c, s = np.cos(self.state[2]), np.sin(self.state[2])
        there = points @ np.array([[c, s], [-s, c]]) + self.state[:2]
        hit = np.flatnonzero(~self.floor.is_free(there))
        return None if len(hit) == 0 else points[hit[0]]
