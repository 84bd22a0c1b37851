"""Start of `base_mounting`: approximate poses of cameras on the robot, in closed form, and the robot's path.

Each camera's poses in the map (from landmarks) and the odometry between them give its pose on the robot: the motion
of the camera, in its own heading, is the robot's motion rotated by the camera's yaw, plus the motion of its lever arm
(planar calibration of camera and wheels; linear in the yaw's cosine and sine and in the arm).  The delay of a
camera's clock behind the odometry's is found by correlating the rotations of both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lmkit.arrays import FloatArray, IntArray
from lmkit.errors import InputError
from lmkit.geometry.planar import between, follow, wrap_angle
from lmkit.geometry.rig import AnyRig
from lmkit.geometry.rotations import rotation_exp
from lmkit.localization.absolute_pose import locate_rig
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.pose_status import PoseStatus
from lmkit.model.recording import RigFrame
from lmkit.odometry.wheel_odometry import NOMINAL, MotionModel
from lmkit.optim.robust_loss import cauchy_cost, cauchy_weight

LEAST_LOCATED = 10
LEAST_WAY_M, LEAST_TURN_RAD = 0.3, 0.3  # of the recording
APART_S = (0.5, 1.0, 2.0, 4.0)  # between two poses of a pair
PAIR_SIGMA_M = 0.05
ROUNDS = 10
LAGS_S = np.arange(-0.9, 1.1, 0.01)  # of a camera's clock behind the odometry's
TURN_SIGMA_RAD = 0.02
LEAST_SWING_RAD = 0.1  # standard deviation of rotations, below which they do not determine the delay
FINE_S = 0.02


@dataclass(frozen=True, eq=False)
class MountingStart:
    """Approximate solution.

    Attributes:
        path: (N,3) x, y (m), heading (rad) of the base.
        mount_R, mount_t: (C,3,3), (C,3) T_base_camera.
        delay_s: of the robot behind its odometry, on the first camera's clock.
        offsets_s: (C-1,) of the other clocks.
    """

    path: FloatArray
    mount_R: FloatArray
    mount_t: FloatArray
    delay_s: float
    offsets_s: FloatArray


def find_mounting_start(
    frames: Sequence[RigFrame],
    groups: Sequence[tuple[str, AnyRig, list[int]]],
    landmarks: LandmarkMap,
    motion: MotionModel,
    clocks: IntArray | None = None,
) -> MountingStart:
    """Approximate camera poses and path.

    Args:
        clocks: (N,) group whose clock stamps each frame, to be searched; None: all are on the first one's.

    Raises:
        InputError: a camera was located too rarely, or the robot did not move.
    """
    stamps = np.array([frame.time_s for frame in frames])
    driven = _DeadReckoning.over(stamps, motion)
    driven.require_motion()
    mounts, guesses = [], []
    lags: list[float] = []
    for name, rig, which in groups:
        rows, R, p = _located(frames, rig, which, landmarks)
        if len(rows) < LEAST_LOCATED:
            raise InputError(
                "too_few_frames",
                f"camera '{name}' was located by landmarks of the map in {len(rows)} frames only",
                f"drive so that it sees two or more landmarks at once in at least {LEAST_LOCATED} frames",
            )
        headings = _headings(R)
        if clocks is not None or not lags:
            lags.append(driven.lag(stamps[rows], headings))
        yaw, arm = _yaw_and_arm(stamps[rows], driven.path_at(stamps[rows] - lags[-1]), headings, p)
        base_headings = wrap_angle(headings - yaw)
        c, s = np.cos(base_headings), np.sin(base_headings)
        base_p = p[:, :2] - np.column_stack([c * arm[0] - s * arm[1], s * arm[0] + c * arm[1]])
        back = rotation_exp(np.column_stack([np.zeros((len(rows), 2)), -base_headings]))
        mounts.append((_mean_rotation(back @ R), np.array([*arm, float(np.median(p[:, 2]))])))
        guesses.append((rows, np.column_stack([base_p, base_headings])))
    offsets = lags[0] - np.array(lags)
    times = stamps if clocks is None else stamps + offsets[clocks]
    return MountingStart(
        _path(times, guesses, driven.path_at(times - lags[0])),
        np.array([R for R, _ in mounts]),
        np.array([t for _, t in mounts]),
        lags[0],
        offsets[1:],
    )


@dataclass(frozen=True, eq=False)
class _DeadReckoning:
    """Path from dead reckoning, without delay: times (K,), states (K,3)."""

    times: FloatArray
    path: FloatArray

    @classmethod
    def over(cls, times_s: FloatArray, motion: MotionModel) -> _DeadReckoning:
        """Dead reckoning over all times, extended by the largest clock difference."""
        fine = np.arange(times_s.min() - LAGS_S[-1], times_s.max() - LAGS_S[0], FINE_S)
        exact = np.array([*NOMINAL[:-1], 0.0])
        return cls(fine, follow(np.zeros(3), motion.planar_between(fine[:-1], fine[1:], exact)))

    def path_at(self, times_s: FloatArray) -> FloatArray:
        """(N,3) states at times of the odometry's clock."""
        return np.column_stack([np.interp(times_s, self.times, column) for column in self.path.T])

    def require_motion(self) -> None:
        """Raises:
        InputError: the robot stands still.
        """
        motions = np.abs(np.diff(self.path, axis=0))
        way, turn = float(np.hypot(*motions[:, :2].T).sum()), float(motions[:, 2].sum())
        if way < LEAST_WAY_M and turn < LEAST_TURN_RAD:
            raise InputError(
                "stands_still",
                f"the odometry says that the robot moved {way:.2f} m and turned {np.rad2deg(turn):.0f} deg",
                "drive curves, so that every camera sees landmarks of the map from different headings",
            )

    def lag(self, stamps: FloatArray, headings: FloatArray) -> float:
        """Delay of a camera's clock, seconds, at which its headings (K,) change as the odometry's."""
        pairs = [_pairs(stamps, apart) for apart in APART_S]
        i, j = (np.concatenate(rows) for rows in zip(*pairs, strict=True))
        turned = headings[j] - headings[i]
        if len(turned) < LEAST_LOCATED or turned.std() < LEAST_SWING_RAD:
            return float(NOMINAL[-1])
        costs = []
        for lag in LAGS_S:
            by_wheels = np.interp(stamps - lag, self.times, self.path[:, 2])
            odometry = by_wheels[j] - by_wheels[i]
            scale = (odometry @ turned) / max(odometry @ odometry, 1e-9)
            costs.append(cauchy_cost(((turned - scale * odometry) / TURN_SIGMA_RAD) ** 2).sum())
        return float(LAGS_S[int(np.argmin(costs))])


def _pairs(times: FloatArray, apart_s: float) -> tuple[IntArray, IntArray]:
    """Pairs of rows whose times differ by about the given interval."""
    after = np.searchsorted(times, times + apart_s)
    i = np.flatnonzero(after < len(times))
    j = after[i]
    near = times[j] - times[i] < 2 * apart_s
    return i[near], j[near]


def _located(
    frames: Sequence[RigFrame], rig: AnyRig, which: Sequence[int], landmarks: LandmarkMap
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Frames in which a camera is located unambiguously, and its (K,3,3), (K,3) poses in the map."""
    rows, poses = [], []
    for k, frame in enumerate(frames):
        seen = [frame.seen[c] for c in which]
        if not any(seen):
            continue
        found = locate_rig(seen, rig, landmarks)
        if found.status == PoseStatus.OK and found.T_map_camera is not None:
            rows.append(k)
            poses.append(found.T_map_camera)
    R = np.array([T.R for T in poses]).reshape(-1, 3, 3)
    return np.array(rows, dtype=np.int64), R, np.array([T.t for T in poses]).reshape(-1, 3)


def _headings(R: FloatArray) -> FloatArray:
    """(K,) rotations about the map's z axis since the first pose, rad."""
    turned = R @ R[0].T
    return np.unwrap(np.arctan2(turned[:, 1, 0] - turned[:, 0, 1], turned[:, 0, 0] + turned[:, 1, 1]))


def _yaw_and_arm(
    times: FloatArray, path: FloatArray, headings: FloatArray, p: FloatArray
) -> tuple[float, FloatArray]:
    """Yaw of the camera's zero heading in the base, and the arm (2,) from base to camera in the base's frame."""
    rows, values = [], []
    for apart in APART_S:
        i, j = _pairs(times, apart)
        q = _turned(p[j, :2] - p[i, :2], -headings[i])
        d = _turned(path[j, :2] - path[i, :2], -path[i, 2])
        turn = headings[j] - headings[i]
        c, s = np.cos(turn) - 1, np.sin(turn)
        # q = R(-yaw) d + (R(turn) - 1) arm', with R(-yaw) d = cos d + sin (dy, -dx)
        rows.append(
            np.stack([np.column_stack([d[:, 0], d[:, 1], c, -s]), np.column_stack([d[:, 1], -d[:, 0], s, c])], 1)
        )
        values.append(q)
    A, b = np.concatenate(rows), np.concatenate(values)
    weights: FloatArray = np.ones(len(A))
    x: FloatArray = np.array([1.0, 0.0, 0.0, 0.0])
    for _ in range(ROUNDS):
        normal = np.einsum("k,kia,kib->ab", weights, A, A) + 1e-6 * np.eye(4)
        x = np.linalg.solve(normal, np.einsum("k,kia,ki->a", weights, A, b))
        errors = ((b - A @ x) ** 2).sum(axis=1) / PAIR_SIGMA_M**2
        weights = cauchy_weight(errors)
    yaw = float(np.arctan2(x[1], x[0]))
    return yaw, _turned(x[None, 2:], np.array([yaw]))[0]


def _turned(points: FloatArray, angles: FloatArray) -> FloatArray:
    c, s = np.cos(angles), np.sin(angles)
    return np.column_stack([c * points[:, 0] - s * points[:, 1], s * points[:, 0] + c * points[:, 1]])


def _mean_rotation(R: FloatArray) -> FloatArray:
    """Rotation nearest to the sum of several."""
    U, _, Vt = np.linalg.svd(R.sum(axis=0))
    return np.asarray(U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt)


def _path(times: FloatArray, guesses: Sequence[tuple[IntArray, FloatArray]], driven: FloatArray) -> FloatArray:
    """(N,3) states from the cameras where they were located, else from odometry (N,3) and the previous frame."""
    located = np.full((len(times), 3), np.nan)
    for rows, states in reversed(guesses):
        located[rows] = states
    order = np.argsort(times, kind="stable")
    path, motions = located[order], between(driven[order])
    first = int(np.flatnonzero(np.isfinite(path[:, 0]))[0])
    for k in range(first + 1, len(path)):
        if np.isnan(path[k, 0]):
            path[k] = follow(path[k - 1], motions[k - 1 : k])[-1]
    for k in range(first - 1, -1, -1):
        step = motions[k]
        heading = path[k + 1, 2] - step[2]
        c, s = np.cos(heading), np.sin(heading)
        path[k] = [path[k + 1, 0] - c * step[0] + s * step[1], path[k + 1, 1] - s * step[0] - c * step[1], heading]
    path[:, 2] = np.unwrap(path[:, 2])
    by_frame = np.empty_like(path)
    by_frame[order] = path
    return by_frame
