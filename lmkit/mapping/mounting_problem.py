"""Equations of `base_mounting.py`: the robot's path, odometry, the floor, the cameras' places and clocks, the map.

Poses of the base are a chain in the order of time; all other unknowns are its border.  If the cameras' clocks are to
be estimated, every exposure has its own pose, at its time stamp plus the current offset of its camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lmkit.arrays import FloatArray, IntArray
from lmkit.geometry.planar import between
from lmkit.geometry.pose_array import PoseArray
from lmkit.geometry.rig import Rig
from lmkit.geometry.rotations import rotation_exp, rotation_log, skew
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.kernels import landmark_bundle as kernel
from lmkit.mapping.base_mounting_start import MountingStart
from lmkit.mapping.observation_arrays import ObservationArrays
from lmkit.mapping.planar_smoother import between_jacobians
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.recording import RigFrame
from lmkit.odometry.motion_model import determined_by_poses, noise_correction
from lmkit.odometry.wheel_odometry import NOMINAL, PARAMETERS, PRIOR_SIGMA, MotionModel
from lmkit.optim.block_chain import ChainEquations
from lmkit.optim.border_blocks import BlockPattern
from lmkit.optim.levenberg_marquardt import Damping, minimize
from lmkit.optim.robust_loss import CAUCHY_SCALE, cauchy_cost, cauchy_weight

Group = tuple[str, Rig | StereoRig, list[int]]  # cameras with fixed relative poses: name, rig, lists of detections

OWN = len(NOMINAL)  # of the shared unknowns; then the floor, the cameras, their clocks, the landmarks
FLOOR = 3  # tilts about x and y (rad), height (m)
TILT_RAD, HEIGHT_M = 0.1, 1.0  # prior of the floor
STATED_M = 0.002  # standard deviation of a stated height
MOUNT_M, MOUNT_RAD = 3.0, 3.0
CLOCK_S = 0.5  # prior of a clock offset, relative to the rig file
SLIP_SIGMA = 10.0
EXACT = 1e-12
DAMPING = Damping(grow=50.0)
ROUNDS, STEPS, CORRECTIONS = 5, 30, 3
OUTLIER_SIGMA = 4.5
APART_S = 1e-5  # between simultaneous exposures: the noise of the motion must not be zero
# To both sides, for derivatives with a clock: over less, noise from row to row looks like changes of speed.
CLOCK_SPAN_S = 0.03


@dataclass(frozen=True, eq=False)
class MountingState:
    """The unknowns: path (N,3), odometry's errors (6,), floor (3,), cameras' places, clocks (C-1,), landmarks."""

    path: FloatArray
    parameters: FloatArray
    floor: FloatArray
    mount_R: FloatArray
    mount_t: FloatArray
    offsets: FloatArray
    lm_R: FloatArray
    lm_p: FloatArray


class MountingProblem:
    """A recording, and the current values of the unknowns.

    Args:
        frames: as the robot's poses: start.path belongs to them.
        groups: cameras with fixed relative poses.
        clocks: (N,) group whose clock stamps each frame; the first group's is the recording's.
        offsets_s: (C-1,) clock offsets of the rig file, which are estimated; empty: stamps are right.
        height_m: of the first camera above the base, if stated.
    """

    def __init__(
        self,
        frames: Sequence[RigFrame],
        groups: Sequence[Group],
        landmarks: LandmarkMap,
        motion: MotionModel,
        start: MountingStart,
        clocks: IntArray,
        offsets_s: FloatArray,
        height_m: float | None,
    ) -> None:
        self.stamps = np.array([frame.time_s for frame in frames])
        self.clocks, self.stated_offsets = clocks, offsets_s
        self.motion, self.height_m = motion, height_m
        self.names = [name for name, _, _ in groups]
        seen_ids = {o.id for frame in frames for o in frame.detections}
        self.mapped = [m for m in landmarks if m.id in seen_ids]
        ids = [m.id for m in self.mapped]
        self.seen = [
            ObservationArrays.collect(
                [replace(frame, seen=tuple(frame.seen[k] for k in which)) for frame in frames], group, ids
            )
            for _, group, which in groups
        ]
        self.used = [np.ones(len(seen), dtype=bool) for seen in self.seen]
        self.arms = np.array([(m.corners_map - m.T_map_landmark.t) @ m.T_map_landmark.R for m in self.mapped])
        self.moves = any(m.covariance is not None for m in self.mapped)
        self.mounts = OWN + FLOOR
        self.first_offset = self.mounts + 6 * len(groups)
        self.first_landmark = self.first_offset + len(offsets_s)
        self.shared = self.first_landmark + (6 * len(self.mapped) if self.moves else 0)
        self.known = [
            np.linalg.inv(EXACT * np.eye(6) + (0.0 if m.covariance is None else m.covariance)) for m in self.mapped
        ]
        self.motion_scale = np.ones(3)
        self.state = MountingState(
            start.path,
            np.array([*NOMINAL[:-1], start.delay_s]),
            np.zeros(FLOOR),
            start.mount_R,
            start.mount_t,
            start.offsets_s[: len(offsets_s)],
            np.array([m.T_map_landmark.R for m in self.mapped]),
            np.array([m.T_map_landmark.t for m in self.mapped]),
        )

    def times(self, state: MountingState) -> FloatArray:
        """(N,) of the poses, on the first camera's clock."""
        return np.asarray(self.stamps + np.append(0.0, state.offsets)[self.clocks])

    def optimize(self) -> None:
        """Solve, and leave out outliers."""
        for _ in range(ROUNDS):
            self._sort()
            self.state = minimize(self, self.state, STEPS, 1e-3, DAMPING).state
            self._weigh_motion()
            self.used = [np.sqrt(chi2 / 8) < OUTLIER_SIGMA for chi2 in self._chi2()]
        # The optimum of the weights whose covariance is reported.
        self._sort()
        self.state = minimize(self, self.state, STEPS, 1e-3, DAMPING).state
        self._correct()

    def _sort(self) -> None:
        """Sort the poses by time, and compute the motion noise between them."""
        order = np.argsort(self.times(self.state), kind="stable")
        if (np.diff(order) < 0).any():
            everything = range(len(self.mapped))
            self.seen = [seen.only(order.tolist(), everything) for seen in self.seen]
            self.stamps, self.clocks = self.stamps[order], self.clocks[order]
            self.state = replace(self.state, path=self.state.path[order])
        spread = APART_S * np.arange(len(order))
        times = np.maximum.accumulate(self.times(self.state) - spread) + spread
        self.sigmas = self.motion.increments(times, self.state.parameters).sigmas * self.motion_scale

    def linearize(self, state: MountingState) -> tuple[ChainEquations, float]:
        """Normal equations and cost at a state."""
        equations = ChainEquations.zeros(len(self.stamps), 3, self.shared)
        cost = sum(self._add_camera(equations, state, k) for k in range(len(self.seen)))
        cost += self._add_motion(equations, state) + self._add_known(equations, state)
        return equations, cost

    def solve(self, equations: ChainEquations, damping: float) -> tuple[FloatArray, FloatArray]:
        """Steps of the path and of the shared unknowns."""
        return equations.solve(damping)

    def retract(self, state: MountingState, step: tuple[FloatArray, FloatArray]) -> MountingState:
        """The state moved by a step."""
        path, shared = step
        mounts = shared[self.mounts : self.first_offset].reshape(-1, 6)
        lm_R, lm_p = state.lm_R, state.lm_p
        if self.moves:
            moved = shared[self.first_landmark :].reshape(-1, 6)
            lm_R, lm_p = rotation_exp(moved[:, 3:]) @ lm_R, lm_p + moved[:, :3]
        return MountingState(
            state.path + path,
            state.parameters + shared[:OWN],
            state.floor + shared[OWN : self.mounts],
            rotation_exp(mounts[:, 3:]) @ state.mount_R,
            state.mount_t + mounts[:, :3],
            state.offsets + shared[self.first_offset : self.first_landmark],
            lm_R,
            lm_p,
        )

    def _poses(self, state: MountingState, camera: int) -> tuple[PoseArray, FloatArray, FloatArray]:
        """T_map_camera of every frame, and (N,6,3), (N,6,9) derivatives with the path, and with floor and mount."""
        floor = rotation_exp(np.array([[*state.floor[:2], 0.0]]))[0]
        count = len(state.path)
        heading = rotation_exp(np.column_stack([np.zeros((count, 2)), state.path[:, 2]]))
        base = floor @ heading
        arm = base @ state.mount_t[camera]
        flat = np.column_stack([state.path[:, :2], np.zeros(count)]) @ floor.T
        places = flat + arm
        up = floor[:, 2]
        by_path = np.zeros((count, 6, 3))
        by_path[:, :3, :2] = floor[:, :2]
        by_path[:, :3, 2] = np.cross(np.tile(up, (count, 1)), arm)
        by_path[:, 3:, 2] = up
        by_rest = np.zeros((count, 6, FLOOR + 6))
        by_rest[:, :3, :2] = -skew(places)[:, :, :2]
        by_rest[:, 3:, :2] = np.eye(3)[:, :2]
        by_rest[:, 2, 2] = 1.0
        by_rest[:, :3, 3:6] = base
        by_rest[:, 3:, 6:9] = base
        places = places + np.array([0.0, 0.0, state.floor[2]])
        return PoseArray("map", "left", base @ state.mount_R[camera], places), by_path, by_rest

    def _bundle(self, state: MountingState, camera: int, poses: PoseArray) -> kernel.Bundle:
        return self.seen[camera].bundle(poses, PoseArray("map", "landmark", state.lm_R, state.lm_p), self.arms)

    def _add_camera(self, e: ChainEquations, state: MountingState, camera: int) -> float:
        poses, J, K = self._poses(state, camera)
        landmarks = 6 * len(self.mapped) if self.moves else 0
        seen = self.seen[camera]
        pattern, place = (
            BlockPattern.of_pairs(seen.at, seen.of, len(self.stamps), 0, 6) if self.moves else (None, None)
        )
        own = ChainEquations.zeros(len(self.stamps), 6, landmarks, pattern)
        blocks = np.zeros((0, 6, 6)) if own.blocks is None else own.blocks.values
        arrays = own.diagonal, own.gradient, own.border, blocks, own.corner, own.shared_gradient
        cost = kernel.add_bundle_equations(
            self._bundle(state, camera, poses), self.used[camera], CAUCHY_SCALE, kernel.Sums(*arrays, 0, place)
        )
        columns = np.concatenate([OWN + np.arange(FLOOR), self.mounts + 6 * camera + np.arange(6)])
        at = np.unique(seen.at)
        D, gradient, K = own.diagonal[at], own.gradient[at, :, None], K[at]
        Jt, Kt = J[at].transpose(0, 2, 1), K.transpose(0, 2, 1)
        DK = D @ K
        e.diagonal[at] += Jt @ D @ J[at]
        e.gradient[at] += (Jt @ gradient)[..., 0]
        e.border[at[:, None, None], np.arange(3)[:, None], columns] += Jt @ DK
        e.corner[columns[:, None], columns] += (Kt @ DK).sum(axis=0)
        e.shared_gradient[columns] += (Kt @ gradient).sum(axis=0)[:, 0]
        if self.moves:
            rows, border = slice(self.first_landmark, None), own.dense_border()[at]
            e.border[at, :, rows] += Jt @ border
            across = (Kt @ border).sum(axis=0)
            e.corner[columns, rows] += across
            e.corner[rows, columns] += across.T
            e.corner[rows, rows] += own.corner
            e.shared_gradient[rows] += own.shared_gradient
        return cost

    def _add_motion(self, e: ChainEquations, state: MountingState) -> float:
        residuals, before, after, K, cost = self._motion_rows(state)
        e.add_between(before, after, residuals)
        columns = np.append(np.arange(OWN), np.arange(self.first_offset, self.first_landmark))
        e.add_shared(np.arange(len(residuals)), before, np.tile(columns, (len(residuals), 1)), K, residuals)
        e.border[1:, :, columns] += after.transpose(0, 2, 1) @ K
        return cost

    def _motion_rows(self, state: MountingState) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, float]:
        """(N-1,3) standardized errors of the motions, derivatives with the poses around them and with odometry and
        clocks, all robustly weighed, and their cost."""
        times = self.times(state)
        steps = self.motion.increments(times, state.parameters)
        by_clocks = [self._by_clock(times, k + 1, state) for k in range(len(state.offsets))]
        by_shared = np.concatenate([steps.by_parameters, *(column[..., None] for column in by_clocks)], axis=2)
        errors = (steps.motions - between(state.path)) / self.sigmas
        squared = (errors**2).sum(axis=1)
        root = np.sqrt(cauchy_weight(squared, SLIP_SIGMA))[:, None]
        scale = (root / self.sigmas)[..., None]
        before, after = between_jacobians(state.path)
        cost = float(cauchy_cost(squared, SLIP_SIGMA).sum())
        return errors * root, before * scale, after * scale, -by_shared * scale, cost

    def _by_clock(self, times: FloatArray, clock: int, state: MountingState) -> FloatArray:
        """(N-1,3) derivatives of the motions with one clock's offset."""
        span = CLOCK_SPAN_S * (self.clocks == clock)
        later, earlier = (
            self.motion.planar_between(t[:-1], t[1:], state.parameters) for t in (times + span, times - span)
        )
        return np.asarray((later - earlier) / (2 * CLOCK_SPAN_S))

    def _weigh_motion(self) -> None:
        """Update the wheel noise from its agreement with the cameras."""
        states, across, _ = self.linearize(self.state)[0].covariances()
        residuals, before, after, _, _ = self._motion_rows(self.state)
        correction = noise_correction(residuals, determined_by_poses(before, after, states, across))
        self.motion_scale *= correction

    def _add_known(self, e: ChainEquations, state: MountingState) -> float:
        """Add the priors: odometry, floor, stated height, clocks, landmarks."""
        sigma = np.array([TILT_RAD, TILT_RAD, HEIGHT_M if self.height_m is None else 10 * HEIGHT_M])
        rows = np.arange(OWN, self.mounts)
        cost = _add_prior(e, rows, -state.floor, sigma)
        if self.height_m is not None:
            z = np.array([self.mounts + 2])
            cost += _add_prior(e, z, np.array([self.height_m - state.mount_t[0, 2]]), np.array([STATED_M]))
        cost += _add_prior(e, np.arange(OWN), NOMINAL - state.parameters, PRIOR_SIGMA)
        clocks = np.arange(self.first_offset, self.first_landmark)
        cost += _add_prior(e, clocks, self.stated_offsets - state.offsets, np.full(len(clocks), CLOCK_S))
        free = np.arange(self.mounts, self.first_offset)
        e.corner[free, free] += np.tile([MOUNT_M**-2] * 3 + [MOUNT_RAD**-2] * 3, len(self.names)) * 1e-4
        diagonal = np.arange(3)
        e.diagonal[:, diagonal, diagonal] += 1e-9
        if not self.moves:
            return cost
        for k, (m, information) in enumerate(zip(self.mapped, self.known, strict=True)):
            at = slice(self.first_landmark + 6 * k, self.first_landmark + 6 * k + 6)
            turn = rotation_log(m.T_map_landmark.R @ state.lm_R[k].T)
            off = np.concatenate([m.T_map_landmark.t - state.lm_p[k], turn])
            e.corner[at, at] += information
            e.shared_gradient[at] += information @ off
            cost += float(off @ information @ off)
        return cost

    def _chi2(self) -> list[FloatArray]:
        return [chi2 for chi2, _ in self.squared_errors()]

    def squared_errors(self) -> list[tuple[FloatArray, FloatArray]]:
        """Squared errors of each group's observations: in standard deviations and in pixels, of eight numbers."""
        poses = (self._poses(self.state, k)[0] for k in range(len(self.seen)))
        return [kernel.bundle_chi2(self._bundle(self.state, k, T)) for k, T in enumerate(poses)]

    def covariance(self) -> FloatArray:
        """(S,S) covariance of the shared unknowns, enlarged for corners that fit worse than stated, and for noise."""
        states, across, shared = self.linearize(self.state)[0].covariances()
        shift = shared @ self._noise_scores(states, across)
        chi2, used = np.concatenate(self._chi2()), np.concatenate(self.used)
        enlarge = max(1.0, float(np.mean(chi2[used])) / 8 if used.any() else 1.0)
        return np.asarray(enlarge * (shared + shared.T) / 2 + np.outer(shift, shift))

    def _correct(self) -> None:
        """Solve for the shared unknowns with the bias from noise of the measured distance subtracted."""
        for _ in range(CORRECTIONS):
            equations = self.linearize(self.state)[0]
            equations.shared_gradient += self._noise_scores(*equations.covariances()[:2])
            self.state = self.retract(self.state, equations.solve(0.0))

    def _noise_scores(self, states: FloatArray, across: FloatArray) -> FloatArray:
        """(S,) mean bias of the gradient of the shared unknowns, caused by noise of the measured distance.

        The measured distance is multiplied by ``forward_scale`` and ``slowing_s``, so its noise is in the residuals
        and in their derivatives (errors in variables): it looks like information that separates the two.  The bias is
        proportional to the information on motions from the poses.
        """
        _, before, after, _, _ = self._motion_rows(self.state)
        determined = determined_by_poses(before, after, states, across)[:, 0]
        scale = self.state.parameters[PARAMETERS.index("forward_scale")]
        slowing = self.state.parameters[PARAMETERS.index("slowing_s")]
        seconds = np.maximum(np.diff(self.times(self.state)), APART_S)
        rate = np.abs(np.diff(self.state.path[:, 2])) / seconds
        scores = np.zeros(self.shared)
        scores[PARAMETERS.index("forward_scale")] = determined.sum() / scale
        scores[PARAMETERS.index("slowing_s")] = -np.sum(determined * rate / np.maximum(1 - slowing * rate, 0.1))
        return scores


def _add_prior(e: ChainEquations, rows: IntArray, off: FloatArray, sigma: FloatArray) -> float:
    e.corner[rows, rows] += sigma**-2
    e.shared_gradient[rows] += off / sigma**2
    return float(((off / sigma) ** 2).sum())
