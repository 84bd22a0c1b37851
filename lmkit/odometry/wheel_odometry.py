"""Motion of a robot on wheels, from odometry and gyro, with the errors of both.

The errors have six parameters (:data:`PARAMETERS`): the scale of distances, the scale of rotations, a rotation that
grows with time (the gyro's bias) or with distance (wheels of unequal size), the share of distance that is lost while
turning (wheels that cannot do both as commanded: MRCLAM's robots lose 30 to 40 % at 0.4 rad/s), and the delay in
seconds of the robot behind its sensors.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lmkit.arrays import BoolArray, FloatArray
from lmkit.geometry.rotations import rotation_exp
from lmkit.kernels.wheel_motion import Moves, WheelRows, wheel_motions, wheel_steps
from lmkit.model.recording import Gyro, Odometry
from lmkit.odometry.motion_model import LONGEST_STEP_S, Steps, require_common_times

PARAMETERS = ("forward_scale", "turn_scale", "turn_per_s", "turn_per_m", "slowing_s", "delay_s")
NOMINAL = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.1])
# Priors of the parameters, standard deviations.
PRIOR_SIGMA = np.array([0.1, 0.1, 0.02, 0.1, 0.3, 0.15])
STEPS = (1e-4, 1e-4, 1e-5, 1e-5, 1e-4)  # but of the delay
# Half width of the difference for the derivative with the delay: with less, noise from row to row looks like changes
# of speed that determine the delay (errors in variables), and the delay is biased toward its start value.
DELAY_SPAN_S = 0.2
MOVES = Moves(STEPS, DELAY_SPAN_S, LONGEST_STEP_S)
# A robot on wheels keeps its height and tilt between two frames, except for an uneven floor.
LIFT_M, LIFT_PER_ROOT_M = 0.002, 0.003
LEAN_RAD, LEAN_PER_ROOT_M = 0.002, 0.004
_Amount = float | FloatArray  # a number, or (K,) of them


@dataclass(frozen=True)
class MotionNoise:
    """Noise of odometry: standard deviations that grow with the root of distance, rotation or time.

    Attributes:
        along_per_root_m: along the path, meters per root of a meter that the wheels travel.
        across_per_root_m: across it.
        turn_per_root_m, turn_per_root_rad: of the heading, rad per root of a meter and of a radian.
        turn_per_root_s, place_per_root_s: parts that grow with time alone.
        unknown_mps, unknown_radps: largest speed of the robot in a gap of odometry.
        wheels_per_rad: distance that the wheels travel while the robot turns, meters per radian: half their track.
    """

    along_per_root_m: float = 0.06
    across_per_root_m: float = 0.03
    turn_per_root_m: float = 0.04
    turn_per_root_rad: float = 0.15
    turn_per_root_s: float = 0.01
    place_per_root_s: float = 0.006
    unknown_mps: float = 1.0
    unknown_radps: float = 1.5
    wheels_per_rad: float = 0.15


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


class Rows(NamedTuple):
    """Rows of odometry that were checked when they arrived: `Odometry` without its checks.

    Attributes:
        times_s, forward_m, turn_rad: (N,) finite; times increase.
    """

    times_s: FloatArray
    forward_m: FloatArray
    turn_rad: FloatArray


class MotionModel:
    """Wheel odometry, with the gyro's rotation instead of the wheels' at all times that the gyro covers."""

    names, nominal, prior_sigma, of_base = PARAMETERS, NOMINAL, PRIOR_SIGMA, True

    def __init__(self, odometry: Odometry | Rows, gyro: Gyro | None = None, noise: MotionNoise | None = None) -> None:
        self.noise = noise or MotionNoise()
        self._times = odometry.times_s
        turn = odometry.turn_rad
        if gyro is not None:
            turned = gyro.turned(odometry.times_s)
            turn = np.where(gyro.covers(odometry.times_s), np.diff(turned, prepend=turned[:1]), turn)
        seconds = np.zeros(len(turn))
        seconds[1:] = self._times[1:] - self._times[:-1]
        rate = np.where(seconds > 0, np.abs(turn) / np.maximum(seconds, 1e-9), 0.0)
        self._rows = WheelRows(self._times, odometry.forward_m, turn, seconds, rate)

    def require_overlap(self, times_s: FloatArray) -> None:
        """Refuse odometry of another time.

        Raises:
            InputError: it shares no time with the frames.
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
            rotation_exp(np.column_stack([zero, zero, turn])),
            np.column_stack([forward, left, zero]),
            np.tile(np.arange(len(PARAMETERS)), (len(turn), 1)),
            by_parameters,
            np.column_stack([s[:, 0], s[:, 1], lift, lean, lean, s[:, 2]]),
            increments.known,
        )

    def between(
        self, before_s: FloatArray, after_s: FloatArray, parameters: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """(K,3,3), (K,3) motions between two times each, in either order."""
        forward, left, turn = self.planar_between(before_s, after_s, parameters).T
        zero = np.zeros_like(turn)
        return rotation_exp(np.column_stack([zero, zero, turn])), np.column_stack([forward, left, zero])

    def planar_between(self, before_s: FloatArray, after_s: FloatArray, parameters: FloatArray) -> FloatArray:
        """(K,3) forward, left (m), turn (rad) between two times each, in either order."""
        return wheel_motions(self._rows, np.column_stack([before_s, after_s]).ravel(), parameters[None])[0, ::2]

    def increments(self, times_s: FloatArray, parameters: FloatArray) -> Increments:
        """Motions between times (K,) that follow each other, seconds of the landmarks' clock."""
        motions, by_parameters, grown = wheel_steps(self._rows, times_s, parameters, MOVES)
        # A filter computes one step at a time, for which numbers are faster than arrays.
        seconds, way, turned, gap = grown[0].tolist() if len(grown) == 1 else grown.T
        variances = np.array(self._variances(seconds, way, turned, gap)).reshape(3, -1).T
        return Increments(motions, by_parameters, np.sqrt(variances), np.atleast_1d(gap < LONGEST_STEP_S))

    def _variances(self, seconds: _Amount, way: _Amount, turned: _Amount, gap: _Amount) -> list[_Amount]:
        """Variances of forward, left and turn; ``gap`` of the ``seconds`` are without odometry."""
        n = self.noise
        place = n.place_per_root_s**2 * seconds + (n.unknown_mps * gap) ** 2
        return [
            n.along_per_root_m**2 * (way + n.wheels_per_rad * turned) + place,
            n.across_per_root_m**2 * way + place,
            n.turn_per_root_m**2 * way
            + n.turn_per_root_rad**2 * turned
            + n.turn_per_root_s**2 * seconds
            + (n.unknown_radps * gap) ** 2,
        ]
