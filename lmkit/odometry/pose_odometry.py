"""Motion of a robot in 3D, from poses in a drifting frame: visual-inertial odometry or another SLAM."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.errors import InputError
from lmkit.geometry.rotations import quaternion_to_matrix, rotation_exp, rotation_log
from lmkit.model.trajectory import Trajectory
from lmkit.odometry.motion_model import LONGEST_STEP_S, Steps, require_common_times

DELAY_STEP_S = 1e-3
Amount = TypeVar("Amount", float, FloatArray)


@dataclass(frozen=True)
class PoseNoise:
    """Noise of visual-inertial odometry: standard deviations that grow with the root of distance or time.

    Attributes:
        place_per_root_m, place_per_root_s: in every direction.
        turn_per_root_rad, turn_per_root_s: about every axis, rad.
        unknown_mps, unknown_radps: largest speed of the robot in gaps without poses.
    """

    place_per_root_m: float = 0.015
    place_per_root_s: float = 0.002
    turn_per_root_rad: float = 0.01
    turn_per_root_s: float = 0.002
    unknown_mps: float = 1.0
    unknown_radps: float = 1.5


def pose_variances(
    noise: PoseNoise, seconds: Amount, way: Amount, turned: Amount, gap: Amount
) -> tuple[Amount, Amount]:
    """Variances of motions (m^2) and turns (rad^2), the same along and about every axis.

    Args:
        seconds, way, turned, gap: duration, distance (m), rotation (rad), and duration without poses.
    """
    n = noise
    place = n.place_per_root_m**2 * way + n.place_per_root_s**2 * seconds + (n.unknown_mps * gap) ** 2
    turn = n.turn_per_root_rad**2 * turned + n.turn_per_root_s**2 * seconds + (n.unknown_radps * gap) ** 2
    # A rotation error early in the motion shifts the rest of it sideways.
    return place + turn * way**2 / 3, turn


def pose_sigmas(
    noise: PoseNoise, seconds: FloatArray, way: FloatArray, turned: FloatArray, gap: FloatArray
) -> FloatArray:
    """(K,6) standard deviations of motions (m) and turns (rad); arguments (K,) as of :func:`pose_variances`."""
    variances = np.stack(pose_variances(noise, seconds, way, turned, gap), axis=1)
    return np.asarray(np.sqrt(np.repeat(variances, 3, axis=1)))


class PoseMotion:
    """Poses of the robot's base in a drifting frame, from visual-inertial odometry or another SLAM.

    Poses are interpolated between rows; the estimated errors are their scale, and a delay as for wheels.
    """

    names = ("scale", "delay_s")
    nominal, prior_sigma = np.array([1.0, 0.0]), np.array([0.005, 0.01])
    of_base = False  # without T_base_left they are the left camera's own

    def __init__(self, poses: Trajectory, noise: PoseNoise | None = None) -> None:
        if len(poses) < 2:
            raise InputError("too_few_poses", "odometry needs more than one pose", "give two poses or more")
        self.noise = noise or PoseNoise()
        self._times, self._places = poses.times_s, poses.positions
        self._R = quaternion_to_matrix(poses.quaternions)
        # Turn from each row to the next, in the frame of the first.
        self._turns = rotation_log(self._R[:-1].transpose(0, 2, 1) @ self._R[1:])
        seconds = np.diff(self._times)
        moved = np.linalg.norm(np.diff(self._places, axis=0), axis=1)
        turned = np.linalg.norm(self._turns, axis=1)
        gap = np.where(seconds > LONGEST_STEP_S, seconds, 0.0)
        # (N,3) way, turn and time without poses, up to each row.
        self._totals = np.vstack([np.zeros(3), np.cumsum(np.column_stack([moved, turned, gap]), axis=0)])

    def require_overlap(self, times_s: FloatArray) -> None:
        """Refuse poses that share no time with the frames."""
        require_common_times(self._times, times_s)

    def steps(self, times_s: FloatArray, parameters: FloatArray) -> Steps:
        """Motions between consecutive times (K,)."""
        scale, delay = parameters
        R, t = self._between(times_s - delay)
        later_R, later_t = self._between(times_s - delay - DELAY_STEP_S)
        by_parameters = np.zeros((len(t), 6, 2))
        by_parameters[:, :3, 0] = t
        by_parameters[:, :3, 1] = scale * (later_t - t) / DELAY_STEP_S
        by_parameters[:, 3:, 1] = rotation_log(R.transpose(0, 2, 1) @ later_R) / DELAY_STEP_S
        own = times_s - delay
        return Steps(
            R,
            scale * t,
            np.tile(np.arange(2), (len(t), 1)),
            by_parameters,
            self.sigmas(own),
            self._gaps(own) < LONGEST_STEP_S,
        )

    def between(
        self, before_s: FloatArray, after_s: FloatArray, parameters: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """(K,3,3), (K,3) motions between two times each, in either order."""
        scale, delay = parameters
        R, t = self._between(np.column_stack([before_s, after_s]).ravel() - delay)
        return R[::2], scale * t[::2]

    def sigmas(self, own_s: FloatArray) -> FloatArray:
        """(K-1,6) standard deviations of distances (m) and turns (rad) between times of the odometry's clock (K,)."""
        way, turned = (np.diff(np.interp(own_s, self._times, total)) for total in self._totals.T[:2])
        return pose_sigmas(self.noise, np.diff(own_s), way, turned, self._gaps(own_s))

    def _gaps(self, own_s: FloatArray) -> FloatArray:
        """(K-1,) seconds without poses."""
        outside = np.diff(np.clip(own_s, None, self._times[0])) + np.diff(np.clip(own_s, self._times[-1], None))
        return np.asarray(np.diff(np.interp(own_s, self._times, self._totals[:, 2])) + outside)

    def at(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(K,3,3), (K,3) poses of the odometry at times of its own clock; constant beyond its ends."""
        own = np.clip(times_s, self._times[0], self._times[-1])
        after = np.searchsorted(self._times, own).clip(1, len(self._times) - 1)
        share = ((own - self._times[after - 1]) / (self._times[after] - self._times[after - 1]))[:, None]
        places = self._places[after - 1] * (1 - share) + self._places[after] * share
        return self._R[after - 1] @ rotation_exp(share * self._turns[after - 1]), places

    def _between(self, own: FloatArray) -> tuple[FloatArray, FloatArray]:
        R, places = self.at(own)
        back = R[:-1].transpose(0, 2, 1)
        return back @ R[1:], (back @ np.diff(places, axis=0)[:, :, None])[:, :, 0]
