"""How a robot on wheels moved, from odometry and gyro, with what is wrong with both.

Six numbers say what is wrong (:data:`PARAMETERS`): the scale of the way, the scale of the turns, a turn that grows
with time (the gyro's bias) or with the way (wheels of unequal size), how much of the way is lost while turning
(wheels that cannot do both as told: MRCLAM's robots lose 30 to 40 % at 0.4 rad/s), and by how many seconds the robot
lags behind what its sensors report.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from lmkit.arrays import BoolArray, FloatArray
from lmkit.errors import InputError
from lmkit.model.drive import Gyro, Odometry
from lmkit.model.pose import Pose

PARAMETERS = ("forward_scale", "turn_scale", "turn_per_s", "turn_per_m", "slowing_s", "delay_s")
NOMINAL = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.1])
# What they may be before anything is seen, as standard deviations.
PRIOR_SIGMA = np.array([0.1, 0.1, 0.02, 0.1, 0.3, 0.15])
STEPS = np.array([1e-4, 1e-4, 1e-5, 1e-5, 1e-4, 1e-3])
UNLIKELY_SIGMA = 3.5  # of a parameter against its prior
LONGEST_STEP_S = 0.5  # of time between rows: more is a gap, in which nothing is known
# A rig of which no odometry says how it moved.
SPEED_MPS, SPEED_RADPS = 0.5, 0.7
LEAST_STEP_M, LEAST_STEP_RAD = 0.02, 0.02
# A robot on wheels keeps its height and its level between two moments, but for the floor.
LIFT_M, LIFT_PER_ROOT_M = 0.002, 0.003
LEAN_RAD, LEAN_PER_ROOT_M = 0.002, 0.004


@dataclass(frozen=True)
class MotionNoise:
    """How far motion strays from odometry, as standard deviations that grow with the root of way, turn or time.

    Attributes:
        along_per_root_m: along the way, metres per root of a metre.
        across_per_root_m: across it.
        turn_per_root_m, turn_per_root_rad: of the heading, rad per root of a metre and of a radian.
        turn_per_root_s, place_per_root_s: what grows with time alone.
        unknown_mps, unknown_radps: how fast the robot may move where odometry has a gap.
    """

    along_per_root_m: float = 0.06
    across_per_root_m: float = 0.03
    turn_per_root_m: float = 0.04
    turn_per_root_rad: float = 0.15
    turn_per_root_s: float = 0.01
    place_per_root_s: float = 0.006
    unknown_mps: float = 1.0
    unknown_radps: float = 1.5


@dataclass(frozen=True, eq=False)
class Increments:
    """Planar motions between consecutive times, in the frame of the earlier pose.

    Attributes:
        motions: (K-1,3) forward, left (m), turn (rad).
        by_parameters: (K-1,3,6) derivatives.
        sigmas: (K-1,3) standard deviations.
        known: (K-1,) False where odometry has a gap.
    """

    motions: FloatArray
    by_parameters: FloatArray
    sigmas: FloatArray
    known: BoolArray


@dataclass(frozen=True, eq=False)
class Steps:
    """Motions in space between consecutive times, in the frame of the earlier pose of the robot's base.

    Attributes:
        R, t: (K-1,3,3), (K-1,3) metres.
        by_parameters: (K-1,6,P) derivatives of the way and of the turn, a rotation vector in the later frame.
        sigmas: (K-1,6) standard deviations.
        known: (K-1,) False where there is a gap.
    """

    R: FloatArray
    t: FloatArray
    by_parameters: FloatArray
    sigmas: FloatArray
    known: BoolArray

    def of_camera(self, T_base_left: Pose) -> tuple[FloatArray, FloatArray]:
        """(K-1,3,3), (K-1,3) how a camera moves that sits there: T_left_base T_base_base' T_base_left."""
        T = T_base_left
        return T.R.T @ self.R @ T.R, (self.t + self.R @ T.t - T.t) @ T.R


class Motion(Protocol):
    """What carries a robot from moment to moment in space: wheels (`MotionModel`) or poses (`pose_motion.py`).

    Attributes:
        names: of the numbers that say what is wrong with it.
        nominal, prior_sigma: (P,) what they are taken to be before anything is seen.
        of_base: it moves the robot's base, so that the rig must say where the camera sits on it.
    """

    @property
    def names(self) -> tuple[str, ...]: ...
    @property
    def nominal(self) -> FloatArray: ...
    @property
    def prior_sigma(self) -> FloatArray: ...
    @property
    def of_base(self) -> bool: ...

    def require_overlap(self, times_s: FloatArray) -> None:
        """Refuse another time."""

    def steps(self, times_s: FloatArray, parameters: FloatArray) -> Steps:
        """Motions between consecutive times (K,), seconds of the landmarks' clock."""


class MotionModel:
    """Odometry, with the gyro's turns in place of the wheels' where there is a gyro."""

    names, nominal, prior_sigma, of_base = PARAMETERS, NOMINAL, PRIOR_SIGMA, True

    def __init__(self, odometry: Odometry, gyro: Gyro | None = None, noise: MotionNoise | None = None) -> None:
        self.noise = noise or MotionNoise()
        self._times = odometry.times_s
        turn = odometry.turn_rad
        if gyro is not None:
            turned = gyro.turned(odometry.times_s)
            inside = (odometry.times_s >= gyro.times_s[0]) & (odometry.times_s <= gyro.times_s[-1])
            turn = np.where(inside, np.diff(turned, prepend=turned[:1]), turn)
        seconds = np.diff(self._times, prepend=self._times[:1])
        gap = seconds > LONGEST_STEP_S
        # A row after a gap tells what was travelled in it, but not when.
        self._seconds, self._forward, self._turn = seconds, odometry.forward_m, turn
        self._rate = np.abs(turn) / np.maximum(seconds, 1e-9)
        self._rate[seconds <= 0] = 0.0
        self._gap = np.cumsum(np.where(gap, seconds, 0.0))
        self._way = np.cumsum(np.abs(odometry.forward_m))
        self._turned = np.cumsum(np.abs(turn))

    def require_overlap(self, times_s: FloatArray) -> None:
        """Refuse odometry of another time.

        Raises:
            InputError: it shares no time with the moments.
        """
        require_common_times(self._times, times_s)

    def steps(self, times_s: FloatArray, parameters: FloatArray) -> Steps:
        """Motions on a floor that is nearly flat, between consecutive times (K,)."""
        increments = self.increments(times_s, parameters)
        forward, left, turn = increments.motions.T
        zero = np.zeros_like(turn)
        way = np.sqrt(np.abs(forward))
        lift, lean = np.hypot(LIFT_M, LIFT_PER_ROOT_M * way), np.hypot(LEAN_RAD, LEAN_PER_ROOT_M * way)
        s = increments.sigmas
        by_parameters = np.zeros((len(turn), 6, len(PARAMETERS)))
        by_parameters[:, [0, 1, 5]] = increments.by_parameters
        return Steps(
            Rotation.from_rotvec(np.column_stack([zero, zero, turn])).as_matrix().reshape(-1, 3, 3),
            np.column_stack([forward, left, zero]),
            by_parameters,
            np.column_stack([s[:, 0], s[:, 1], lift, lean, lean, s[:, 2]]),
            increments.known,
        )

    def increments(self, times_s: FloatArray, parameters: FloatArray) -> Increments:
        """Motions between consecutive times (K,), seconds of the landmarks' clock."""
        # The parameters as they are, and each moved a little.
        moved = np.tile(parameters, (1 + len(PARAMETERS), 1))
        moved[1:] += np.diag(STEPS)
        all_motions = self._motions(times_s, moved)
        motions = all_motions[0]
        by_parameters = ((all_motions[1:] - motions) / STEPS[:, None, None]).transpose(1, 2, 0)
        own = times_s - parameters[5]
        seconds = np.diff(times_s)
        way, turned, gap = (
            np.diff(np.interp(own, self._times, total)) for total in (self._way, self._turned, self._gap)
        )
        outside = np.diff(np.clip(own, None, self._times[0])) + np.diff(np.clip(own, self._times[-1], None))
        gap = gap + outside
        n = self.noise
        place = n.place_per_root_s**2 * seconds + (n.unknown_mps * gap) ** 2
        variances = np.column_stack(
            [
                n.along_per_root_m**2 * way + place,
                n.across_per_root_m**2 * way + place,
                n.turn_per_root_m**2 * way
                + n.turn_per_root_rad**2 * turned
                + n.turn_per_root_s**2 * seconds
                + (n.unknown_radps * gap) ** 2,
            ]
        )
        return Increments(motions, by_parameters, np.sqrt(variances), gap < LONGEST_STEP_S)

    def _motions(self, times_s: FloatArray, parameters: FloatArray) -> FloatArray:
        """(P,K-1,3) of (P,6) parameters."""
        scale, turn_scale, per_s, per_m, slowing, delay = parameters.T[:, :, None]
        forward = scale * self._forward * (1 - slowing * self._rate)
        turn = turn_scale * self._turn + per_s * self._seconds + per_m * forward
        heading = np.cumsum(turn, axis=1)
        middle = heading - turn / 2
        path = np.stack(
            [np.cumsum(forward * np.cos(middle), axis=1), np.cumsum(forward * np.sin(middle), axis=1), heading]
        )
        own = np.clip(times_s - delay, self._times[0], self._times[-1])
        after = np.searchsorted(self._times, own).clip(1, len(self._times) - 1)
        share = (own - self._times[after - 1]) / (self._times[after] - self._times[after - 1])
        sets = np.arange(len(parameters))[:, None]
        x, y, at = path[:, sets, after - 1] * (1 - share) + path[:, sets, after] * share
        dx, dy = np.diff(x, axis=1), np.diff(y, axis=1)
        c, s = np.cos(at[:, :-1]), np.sin(at[:, :-1])
        return np.stack([c * dx + s * dy, -s * dx + c * dy, np.diff(at, axis=1)], axis=2)


class NoLeaps:
    """A `Motion` for a rig without odometry: it does not leap from one moment to the next."""

    names: tuple[str, ...] = ()
    nominal, prior_sigma, of_base = np.zeros(0), np.zeros(0), False

    def require_overlap(self, times_s: FloatArray) -> None:
        """Any time will do."""

    def steps(self, times_s: FloatArray, parameters: FloatArray) -> Steps:
        """No motion, give or take what a slow robot travels."""
        seconds = np.diff(times_s)
        count = len(seconds)
        place, turn = np.hypot(LEAST_STEP_M, SPEED_MPS * seconds), np.hypot(LEAST_STEP_RAD, SPEED_RADPS * seconds)
        return Steps(
            np.repeat(np.eye(3)[None], count, axis=0),
            np.zeros((count, 3)),
            np.zeros((count, 6, 0)),
            np.repeat(np.column_stack([place, turn]), 3, axis=1),
            np.ones(count, dtype=bool),
        )


def require_common_times(own_s: FloatArray, times_s: FloatArray) -> None:
    """Refuse odometry of another time.

    Raises:
        InputError: it shares no time with the moments.
    """
    if own_s[-1] < times_s[0] or own_s[0] > times_s[-1]:
        raise InputError(
            "no_common_times",
            f"odometry runs from {own_s[0]:.3f} to {own_s[-1]:.3f} s, landmarks were seen from "
            f"{times_s[0]:.3f} to {times_s[-1]:.3f} s",
            "give both in seconds of one clock",
        )


def describe_odometry(motion: Motion, parameters: FloatArray) -> str | None:
    """A sentence where odometry is not to be believed: wrong units, another clock, another robot; else None."""
    far = np.abs(parameters - motion.nominal) / motion.prior_sigma
    worst = int(np.argmax(far))
    if far[worst] < UNLIKELY_SIGMA:
        return None
    return (
        f"odometry does not agree with what was seen: {motion.names[worst]} comes out as {parameters[worst]:.3g}; "
        "check its units, its clock and where the sensor sits on the robot"
    )


def follow(state: FloatArray, motions: FloatArray) -> FloatArray:
    """(K+1,3) x, y, heading: the state, and where each of (K,3) motions leads."""
    path = np.zeros((1 + len(motions), 3))
    path[0] = state
    path[1:, 2] = state[2] + np.cumsum(motions[:, 2])
    c, s = np.cos(path[:-1, 2]), np.sin(path[:-1, 2])
    path[1:, 0] = state[0] + np.cumsum(c * motions[:, 0] - s * motions[:, 1])
    path[1:, 1] = state[1] + np.cumsum(s * motions[:, 0] + c * motions[:, 1])
    return path


def between(states: FloatArray) -> FloatArray:
    """(N-1,3) forward, left, turn from each of (N,3) states to the next."""
    d = np.diff(states, axis=0)
    c, s = np.cos(states[:-1, 2]), np.sin(states[:-1, 2])
    return np.column_stack([c * d[:, 0] + s * d[:, 1], -s * d[:, 0] + c * d[:, 1], d[:, 2]])
