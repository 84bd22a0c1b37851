"""Places of a robot's cameras on its base, from a recording with wheel odometry through a mapped room.

Unknown are the robot's path on the floor, the errors of its odometry, how the floor lies in the map, the place of
every camera, and, as far as the map leaves them open, the landmarks.  All corners and all motions are explained at
once (Levenberg and Marquardt; the path is a chain, everything else its border).  The base is where wheels cannot slip
sideways: its x axis is the direction in which the robot drives, its origin the point that turns without moving.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lmkit.arrays import FloatArray, IntArray
from lmkit.geometry.planar import between
from lmkit.geometry.pose import Pose
from lmkit.geometry.pose_array import PoseArray
from lmkit.geometry.rig import AnyRig, MountedCamera, Rig
from lmkit.geometry.rotations import orthonormal, rotation_exp, rotation_log, skew
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.kernels import landmark_bundle as kernel
from lmkit.mapping.base_mounting_start import MountingStart, find_mounting_start
from lmkit.mapping.carried_cameras import are_synchronous, split_by_exposure
from lmkit.mapping.observation_arrays import ObservationArrays
from lmkit.mapping.planar_smoother import between_jacobians
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.recording import RigFrame
from lmkit.odometry.wheel_odometry import NOMINAL, PARAMETERS, PRIOR_SIGMA, MotionModel
from lmkit.optim.block_chain import ChainEquations
from lmkit.optim.levenberg_marquardt import Damping, minimize
from lmkit.optim.robust_loss import CAUCHY_SCALE, cauchy_cost, cauchy_weight

OWN = len(NOMINAL)  # of the shared unknowns; then the floor, the cameras, the landmarks
FLOOR = 3  # tilts about x and y (rad), height (m)
TILT_RAD, HEIGHT_M = 0.1, 1.0  # what the floor may be before anything is seen
STATED_M = 0.002  # how well a stated height is known
MOUNT_M, MOUNT_RAD = 3.0, 3.0
SLIP_SIGMA = 10.0
EXACT = 1e-12
DAMPING = Damping(grow=50.0)
ROUNDS, STEPS = 5, 30
OUTLIER_SIGMA = 4.5
KNOWN_M, KNOWN_RAD = 0.01, np.deg2rad(1.0)  # a place known worse than that is named
KNOWN_BELOW = 0.3  # share of a motion's variance that is left once the cameras have spoken
LEAST_TO_WEIGH = 20  # motions


@dataclass(frozen=True, eq=False)
class CameraOnBase:
    """Place of one camera on the robot.

    Attributes:
        name: of the camera.
        T_base_camera: its pose.
        covariance: (6,6) of x y z (m) and the rotation about the base's axes (rad).
        frames: number of frames in which it saw landmarks of the map.
        unobserved: what the recording does not determine, in words.
    """

    name: str
    T_base_camera: Pose
    covariance: FloatArray
    frames: int
    unobserved: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class BaseMounting:
    """The result.

    Attributes:
        rig: with its cameras' places on the base.
        cameras: one by one; of a stereo pair, the left one stands for both.
        floor: tilts about the map's x and y (rad), and height of the base's origin (m).
        parameters: errors of the odometry, as `lmkit.odometry.wheel_odometry.PARAMETERS`.
        rms_px: of the corners that are believed.
        outliers: number of observations that do not fit.
        states: (N,3) x, y (m), heading (rad) of the base on the floor.
    """

    rig: AnyRig
    cameras: tuple[CameraOnBase, ...]
    floor: FloatArray
    parameters: FloatArray
    rms_px: float
    outliers: int
    states: FloatArray


def find_base_mounting(
    frames: Sequence[RigFrame],
    rig: AnyRig,
    landmarks: LandmarkMap,
    motion: MotionModel,
    height_m: float | None = None,
) -> BaseMounting:
    """Find the place of every camera on the robot.

    Args:
        frames: of the recording; detections of every camera.
        rig: cameras, with intrinsics and time offsets.  A stereo pair keeps its baseline; cameras of other rigs are
            found one by one.
        motion: wheel odometry.
        height_m: of the first camera above the base's origin; None: the base is taken to lie at z = 0 of the map, and
            the heights are said to be known no better than the floor's.

    Raises:
        InputError: a camera sees too little of the map, or odometry of another time.
    """
    motion.require_overlap(np.array([frame.time_s for frame in frames]))
    if not are_synchronous(frames, rig):
        frames = split_by_exposure(frames, rig)
    groups = _groups(rig)
    start = find_mounting_start(frames, groups, landmarks, motion)
    problem = _Problem(frames, groups, landmarks, motion, start, height_m)
    problem.optimize()
    return problem.answer(rig)


def _groups(rig: AnyRig) -> list[tuple[str, Rig | StereoRig, list[int]]]:
    """Cameras that keep their places to each other: name, rig, and which of the lists of detections they are."""
    if isinstance(rig, StereoRig):
        return [("left", replace(rig, T_base_left=None), [0, 1])]
    return [(c.name, Rig.of_one(c.model, name=c.name), [k]) for k, c in enumerate(rig.cameras)]


@dataclass(frozen=True, eq=False)
class _State:
    path: FloatArray
    parameters: FloatArray
    floor: FloatArray
    mount_R: FloatArray
    mount_t: FloatArray
    lm_R: FloatArray
    lm_p: FloatArray


class _Problem:
    def __init__(
        self,
        frames: Sequence[RigFrame],
        groups: Sequence[tuple[str, Rig | StereoRig, list[int]]],
        landmarks: LandmarkMap,
        motion: MotionModel,
        start: MountingStart,
        height_m: float | None,
    ) -> None:
        self.times, self.motion, self.height_m = np.array([frame.time_s for frame in frames]), motion, height_m
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
        cameras = len(groups)
        self.mounts = OWN + FLOOR
        self.first_landmark = self.mounts + 6 * cameras
        self.shared = self.first_landmark + (6 * len(self.mapped) if self.moves else 0)
        self.known = [
            np.linalg.inv(EXACT * np.eye(6) + (0.0 if m.covariance is None else m.covariance)) for m in self.mapped
        ]
        self.motion_scale = np.ones(3)
        self.state = _State(
            start.path,
            np.array(NOMINAL),
            np.zeros(FLOOR),
            start.mount_R,
            start.mount_t,
            np.array([m.T_map_landmark.R for m in self.mapped]),
            np.array([m.T_map_landmark.t for m in self.mapped]),
        )

    def optimize(self) -> None:
        """Solve, and leave out what does not fit."""
        for _ in range(ROUNDS):
            self.state = minimize(self, self.state, STEPS, 1e-3, DAMPING).state
            self._weigh_motion()
            self.used = [np.sqrt(chi2 / 8) < OUTLIER_SIGMA for chi2 in self._chi2()]
        # The optimum of the weights whose covariance is reported.
        self.state = minimize(self, self.state, STEPS, 1e-3, DAMPING).state

    def linearize(self, state: _State) -> tuple[ChainEquations, float]:
        """Normal equations and cost at a state."""
        equations = ChainEquations.zeros(len(self.times), 3, self.shared)
        cost = sum(self._add_camera(equations, state, k) for k in range(len(self.seen)))
        cost += self._add_motion(equations, state) + self._add_known(equations, state)
        return equations, cost

    def solve(self, equations: ChainEquations, damping: float) -> tuple[FloatArray, FloatArray]:
        """Steps of the path and of all that it shares."""
        return equations.solve(damping)

    def retract(self, state: _State, step: tuple[FloatArray, FloatArray]) -> _State:
        """The state moved by a step."""
        path, shared = step
        mounts = shared[self.mounts : self.first_landmark].reshape(-1, 6)
        lm_R, lm_p = state.lm_R, state.lm_p
        if self.moves:
            moved = shared[self.first_landmark :].reshape(-1, 6)
            lm_R, lm_p = rotation_exp(moved[:, 3:]) @ lm_R, lm_p + moved[:, :3]
        return _State(
            state.path + path,
            state.parameters + shared[:OWN],
            state.floor + shared[OWN : self.mounts],
            rotation_exp(mounts[:, 3:]) @ state.mount_R,
            state.mount_t + mounts[:, :3],
            lm_R,
            lm_p,
        )

    def _poses(self, state: _State, camera: int) -> tuple[PoseArray, FloatArray, FloatArray]:
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

    def _bundle(self, state: _State, camera: int, poses: PoseArray) -> kernel.Bundle:
        return self.seen[camera].bundle(poses, PoseArray("map", "landmark", state.lm_R, state.lm_p), self.arms)

    def _add_camera(self, e: ChainEquations, state: _State, camera: int) -> float:
        poses, J, K = self._poses(state, camera)
        landmarks = 6 * len(self.mapped) if self.moves else 0
        own = ChainEquations.zeros(len(self.times), 6, landmarks)
        sums = kernel.Sums(own.diagonal, own.gradient, own.border, own.corner, own.shared_gradient, 0)
        cost = kernel.add_bundle_equations(
            self._bundle(state, camera, poses), self.used[camera], CAUCHY_SCALE, sums, self.moves
        )
        columns = np.concatenate([OWN + np.arange(FLOOR), self.mounts + 6 * camera + np.arange(6)])
        Jt, Kt, D = J.transpose(0, 2, 1), K.transpose(0, 2, 1), own.diagonal
        e.diagonal += Jt @ D @ J
        e.gradient += (Jt @ own.gradient[..., None])[..., 0]
        e.border[:, :, columns] += Jt @ D @ K
        e.corner[columns[:, None], columns] += np.einsum("nai,nij,njb->ab", Kt, D, K)
        e.shared_gradient[columns] += np.einsum("nai,ni->a", Kt, own.gradient)
        if self.moves:
            rows = slice(self.first_landmark, None)
            e.border[:, :, rows] += Jt @ own.border
            across = np.einsum("nai,nib->ab", Kt, own.border)
            e.corner[columns, rows] += across
            e.corner[rows, columns] += across.T
            e.corner[rows, rows] += own.corner
            e.shared_gradient[rows] += own.shared_gradient
        return cost

    def _add_motion(self, e: ChainEquations, state: _State) -> float:
        errors, before, after, K = self._motion_rows(state)
        squared = (errors**2).sum(axis=1)
        root = np.sqrt(cauchy_weight(squared, SLIP_SIGMA))[:, None]
        before, after, K = (values * root[..., None] for values in (before, after, K))
        residuals = errors * root
        e.add_between(before, after, residuals)
        columns = np.tile(np.arange(OWN), (len(residuals), 1))
        e.add_shared(np.arange(len(residuals)), before, columns, K, residuals)
        e.border[1:, :, :OWN] += after.transpose(0, 2, 1) @ K
        off = (NOMINAL - state.parameters) / PRIOR_SIGMA
        e.corner[:OWN, :OWN] += np.diag(PRIOR_SIGMA**-2)
        e.shared_gradient[:OWN] += off / PRIOR_SIGMA
        return float(cauchy_cost(squared, SLIP_SIGMA).sum() + (off**2).sum())

    def _motion_rows(self, state: _State) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """(N-1,3) standardized errors of the motions, and derivatives with the poses around them and the odometry."""
        steps = self.motion.increments(self.times, state.parameters)
        sigmas = steps.sigmas * self.motion_scale
        before, after = between_jacobians(state.path)
        scale = 1 / sigmas[..., None]
        errors = (steps.motions - between(state.path)) / sigmas
        return errors, before * scale, after * scale, -steps.by_parameters * scale

    def _weigh_motion(self) -> None:
        """How well these wheels count, from how they agree with the cameras (a step of expectation maximization)."""
        states, across, _ = self.linearize(self.state)[0].covariances()
        errors, before, after, _ = self._motion_rows(self.state)
        left = (before @ states[:-1] + after @ across.transpose(0, 2, 1)) @ before.transpose(0, 2, 1)
        left += (before @ across + after @ states[1:]) @ after.transpose(0, 2, 1)
        open_ = np.einsum("nii->ni", left)
        for k in range(3):
            determined = open_[:, k] < KNOWN_BELOW
            if determined.sum() >= LEAST_TO_WEIGH:
                squared = np.minimum(errors[determined, k] ** 2, SLIP_SIGMA**2) + open_[determined, k]
                self.motion_scale[k] *= float(np.clip(np.sqrt(np.mean(squared)), 0.3, 3.0))

    def _add_known(self, e: ChainEquations, state: _State) -> float:
        """Prior knowledge: floor, stated height, landmarks."""
        sigma = np.array([TILT_RAD, TILT_RAD, HEIGHT_M if self.height_m is None else 10 * HEIGHT_M])
        rows = np.arange(OWN, self.mounts)
        cost = _add_prior(e, rows, -state.floor, sigma)
        if self.height_m is not None:
            z = np.array([self.mounts + 2])
            cost += _add_prior(e, z, np.array([self.height_m - state.mount_t[0, 2]]), np.array([STATED_M]))
        free = np.arange(self.mounts, self.first_landmark)
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
        return [
            kernel.bundle_chi2(self._bundle(self.state, k, self._poses(self.state, k)[0]))[0]
            for k in range(len(self.seen))
        ]

    def _noise_shift(self, shared: FloatArray) -> FloatArray:
        """(S,) by how much noise of the reported way shifts what all frames share, to first order.

        The reported way is also what ``forward_scale`` and ``slowing_s`` multiply, so its noise is in the errors and
        in their derivatives (errors in variables): it looks like motion that tells the two apart.  All of the
        weighted errors along the way are taken for such noise, slips included, so this is rather too large.
        """
        scale = self.state.parameters[PARAMETERS.index("forward_scale")]
        slowing = self.state.parameters[PARAMETERS.index("slowing_s")]
        rate = np.abs(np.diff(self.state.path[:, 2])) / np.diff(self.times)
        gradient = np.zeros(self.shared)
        gradient[PARAMETERS.index("forward_scale")] = len(rate) / scale
        gradient[PARAMETERS.index("slowing_s")] = -np.sum(rate / np.maximum(1 - slowing * rate, 0.1))
        return -shared @ gradient

    def answer(self, rig: AnyRig) -> BaseMounting:
        """Places with covariances, enlarged where corners fit worse than they state, and by the noise shift."""
        _, _, shared = self.linearize(self.state)[0].covariances()
        shift = self._noise_shift(shared)
        chi2, used = np.concatenate(self._chi2()), np.concatenate(self.used)
        enlarge = max(1.0, float(np.mean(chi2[used])) / 8 if used.any() else 1.0)
        s = self.state
        cameras = []
        for k, name in enumerate(self.names):
            rows = slice(self.mounts + 6 * k, self.mounts + 6 * k + 6)
            C = enlarge * (shared[rows, rows] + shared[rows, rows].T) / 2 + np.outer(shift[rows], shift[rows])
            T = Pose("base", "left", orthonormal(s.mount_R[k]), s.mount_t[k])
            frames = len(np.unique(self.seen[k].at[self.used[k]]))
            cameras.append(CameraOnBase(name, T, C, frames, _unobserved(C, self.height_m is None)))
        pixels = [
            kernel.bundle_chi2(self._bundle(s, k, self._poses(s, k)[0]))[1][self.used[k]]
            for k in range(len(self.seen))
        ]
        all_pixels = np.concatenate(pixels)
        rms = float(np.sqrt(all_pixels.mean() / 4)) if len(all_pixels) else float("nan")
        return BaseMounting(
            _mounted(rig, cameras), tuple(cameras), s.floor, s.parameters, rms, int((~used).sum()), s.path
        )


def _add_prior(e: ChainEquations, rows: IntArray, off: FloatArray, sigma: FloatArray) -> float:
    e.corner[rows, rows] += sigma**-2
    e.shared_gradient[rows] += off / sigma**2
    return float(((off / sigma) ** 2).sum())


def _unobserved(C: FloatArray, height_is_assumed: bool) -> tuple[str, ...]:
    """Numbers of a camera's place that the recording does not determine."""
    sigma = np.sqrt(np.diag(C))
    words = []
    if height_is_assumed:
        words.append(
            "height (a robot on a level floor does not show it; the base is taken to be at z = 0 of the map)"
        )
    if sigma[0] > KNOWN_M:
        words.append("place along x (turn more)")
    if sigma[1] > KNOWN_M:
        words.append(
            "place along y (drive curves to both sides: one direction alone leaves it mixed with odometry's scale)"
        )
    if sigma[5] > KNOWN_RAD:
        words.append("direction (drive farther)")
    if sigma[3] > KNOWN_RAD or sigma[4] > KNOWN_RAD:
        words.append("tilt (turn more)")
    return tuple(words)


def _mounted(rig: AnyRig, cameras: Sequence[CameraOnBase]) -> AnyRig:
    """The rig with the places found."""
    first = cameras[0].T_base_camera
    if isinstance(rig, StereoRig):
        return replace(rig, T_base_left=first)
    back = first.inverse()
    mounted = []
    for k, (camera, found) in enumerate(zip(rig.cameras, cameras, strict=True)):
        T = back @ found.T_base_camera if k else None
        T_camera_left = Pose.identity("camera", "left")
        if T is not None:
            inverse = T.inverse()
            T_camera_left = Pose("camera", "left", inverse.R, inverse.t)
        known = camera.intrinsics_sigma, camera.intrinsics_correlation
        mounted.append(MountedCamera(camera.name, camera.model, T_camera_left, None, *known, camera.time_offset_s))
    return Rig(tuple(mounted), first)
