"""Interface of odometry: relative motions between times, with noise and parameters to estimate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from lmkit.arrays import BoolArray, FloatArray, IntArray
from lmkit.errors import InputError
from lmkit.geometry.pose import Pose
from lmkit.geometry.rotations import rotation_exp

UNLIKELY_SIGMA = 3.5  # of a parameter against its prior


LEAST_DETERMINED, MOST_CORRECTED = (
    20.0,
    3.0,
)  # least motions determined by poses, to estimate the noise; largest factor per step
LONGEST_STEP_S = 0.5  # of time between rows: more is a gap, in which nothing is known


# A rig without odometry.
SPEED_MPS, SPEED_RADPS = 0.5, 0.7
LEAST_STEP_M, LEAST_STEP_RAD = 0.02, 0.02
LEAST_KNOT_S, MOST_KNOTS = 4.0, 32  # between knots of its velocity, and of them


@dataclass(frozen=True, eq=False)
class Steps:
    """Motions in space between consecutive times, in the frame of the earlier pose of the robot's base.

    Attributes:
        R, t: (K-1,3,3), (K-1,3) meters.
        parameters: (K-1,c) numbers of those of the P parameters that each motion depends on.
        by_parameters: (K-1,6,c) derivatives of the way and of the turn, a rotation vector in the later frame.
        sigmas: (K-1,6) standard deviations.
        known: (K-1,) False where there is a gap.
    """

    R: FloatArray
    t: FloatArray
    parameters: IntArray
    by_parameters: FloatArray
    sigmas: FloatArray
    known: BoolArray

    def of_camera(self, T_base_left: Pose) -> tuple[FloatArray, FloatArray]:
        """(K-1,3,3), (K-1,3) how a camera moves that sits there: T_left_base T_base_base' T_base_left."""
        T = T_base_left
        return T.R.T @ self.R @ T.R, (self.t + self.R @ T.t - T.t) @ T.R


class Motion(Protocol):
    """Odometry that predicts motion between frames: wheels (`MotionModel`) or poses (`odometry/pose_odometry.py`).

    Attributes:
        names: names of the error parameters.
        nominal, prior_sigma: (P,) what they are taken to be before anything is seen.
        of_base: whether it is the motion of the robot's base, so that the rig needs T_base_left.
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

    def between(
        self, before_s: FloatArray, after_s: FloatArray, parameters: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """(K,3,3), (K,3) motions between two times each, in either order, in the frame at ``before_s``."""


class BoundedMotion:
    """A `Motion` for a rig without odometry: velocities that change slowly, and bounded departures from them.

    The parameters are the velocity (m/s) and the turn rate (rad/s) along and about the base's axes at `knots_s`,
    linear in between.  They are estimated: a rig at rest as the expected one would draw its poses together.

    Args:
        times_s: of the frames.
        most_knots: largest number of knots; with none, the rig is expected at rest.
    """

    names: tuple[str, ...] = ()  # no odometry that could be wrong
    of_base = False

    def __init__(self, times_s: FloatArray, most_knots: int = MOST_KNOTS) -> None:
        first_s, last_s = (times_s[0], times_s[-1]) if len(times_s) else (0.0, 0.0)
        count = min(1 + int((last_s - first_s) / LEAST_KNOT_S), most_knots)
        self.knots_s = np.linspace(first_s, last_s, count)
        self.nominal = np.zeros(6 * count)
        self.prior_sigma = np.tile(np.repeat([SPEED_MPS, SPEED_RADPS], 3), count)

    def require_overlap(self, times_s: FloatArray) -> None:
        """Any time will do."""

    def steps(self, times_s: FloatArray, parameters: FloatArray) -> Steps:
        """The motion at these velocities, with the uncertainty of a slow robot's; derivatives for small rotations."""
        seconds = np.diff(times_s)
        place, turn = np.hypot(LEAST_STEP_M, SPEED_MPS * seconds), np.hypot(LEAST_STEP_RAD, SPEED_RADPS * seconds)
        R, t = self.between(times_s[:-1], times_s[1:], parameters)
        knots, weights = self._weights(times_s[:-1], times_s[1:])
        wide = 6 * knots.shape[1]
        return Steps(
            R,
            t,
            (6 * knots[..., None] + np.arange(6)).reshape(len(knots), wide),
            (weights[:, None, :, None] * np.eye(6)[:, None]).reshape(len(knots), 6, wide),
            np.repeat(np.column_stack([place, turn]), 3, axis=1),
            np.ones(len(seconds), dtype=bool),
        )

    def between(
        self, before_s: FloatArray, after_s: FloatArray, parameters: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """The motion at these velocities."""
        knots, weights = self._weights(before_s, after_s)
        moved = (weights[..., None] * parameters.reshape(-1, 6)[knots]).sum(axis=1)
        return rotation_exp(moved[:, 3:]), moved[:, :3]

    def _weights(self, before_s: FloatArray, after_s: FloatArray) -> tuple[IntArray, FloatArray]:
        """(K,2) the knots around each motion's middle, and seconds for which each counts; (K,0) without knots."""
        last = len(self.knots_s) - 1
        if last < 0:
            return np.zeros((len(before_s), 0), dtype=np.int64), np.zeros((len(before_s), 0))
        at = np.interp((before_s + after_s) / 2, self.knots_s, np.arange(last + 1.0))
        first = at.astype(np.int64)
        shares = np.column_stack([1 - (at - first), at - first])
        return np.column_stack([first, np.minimum(first + 1, last)]), (after_s - before_s)[:, None] * shares


def determined_by_poses(before: FloatArray, after: FloatArray, states: FloatArray, across: FloatArray) -> FloatArray:
    """(K-1,D) share of the information on motions from poses: 1 from poses only, 0 from odometry only.

    Args:
        before, after: (K-1,D,D) derivatives of the motions, in standard deviations, with the earlier and later pose.
        states, across: (K,D,D), (K-1,D,D) covariances of poses, and of each with the next.
    """
    left = (before @ states[:-1] + after @ across.transpose(0, 2, 1)) @ before.transpose(0, 2, 1)
    left += (before @ across + after @ states[1:]) @ after.transpose(0, 2, 1)
    return np.asarray(1 - np.einsum("nii->ni", left))


def noise_correction(residuals: FloatArray, determined: FloatArray) -> FloatArray:
    """(D,) factors of the motions' noise relative to the assumed noise.

    The marginal likelihood of the noise is largest if the sum of squared residuals equals the number of motions
    determined by the poses (MacKay 1992).

    Args:
        residuals: (K-1,D) of motions between neighbors in time, in standard deviations, robustly weighted.
        determined: (K-1,D) of `determined_by_poses`.
    """
    count = determined.sum(axis=0)
    factors = np.sqrt((residuals**2).sum(axis=0) / np.maximum(count, LEAST_DETERMINED))
    return np.where(count >= LEAST_DETERMINED, np.clip(factors, 1 / MOST_CORRECTED, MOST_CORRECTED), 1.0)


def require_common_times(own_s: FloatArray, times_s: FloatArray) -> None:
    """Refuse odometry of another time.

    Raises:
        InputError: it shares no time with the frames.
    """
    if own_s[-1] < times_s[0] or own_s[0] > times_s[-1]:
        raise InputError(
            "no_common_times",
            f"odometry runs from {own_s[0]:.3f} to {own_s[-1]:.3f} s, landmarks were seen from "
            f"{times_s[0]:.3f} to {times_s[-1]:.3f} s",
            "give both in seconds of the same clock",
        )


def describe_odometry(motion: Motion, parameters: FloatArray) -> str | None:
    """A sentence where odometry is not to be believed: wrong units, another clock, another robot; else None."""
    far = np.abs(parameters - motion.nominal) / motion.prior_sigma
    worst = int(np.argmax(far))
    if far[worst] < UNLIKELY_SIGMA:
        return None
    return (
        f"odometry does not agree with the landmarks: {motion.names[worst]} is estimated as {parameters[worst]:.3g}; "
        "check its units, its clock and where the sensor sits on the robot"
    )
