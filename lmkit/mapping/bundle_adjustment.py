"""Bundle adjustment of a recording: rig poses, landmark poses and odometry errors, jointly.

Every corner of every landmark in both cameras is an equation (Triggs et al. 2000), whitened by its own covariance and
down-weighted where it does not fit (Cauchy); odometry connects each pose to the next.  Poses form a chain; landmarks
and odometry parameters form its border (`optim/block_chain.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from lmkit.arrays import BoolArray, FloatArray, IntArray
from lmkit.geometry.pose import Pose
from lmkit.geometry.pose_array import PoseArray
from lmkit.geometry.rig import AnyRig
from lmkit.geometry.rotations import orthonormal, rotation_exp, rotation_log
from lmkit.kernels import landmark_bundle as kernel
from lmkit.kernels.face_swelling import SIZE as SWELLING
from lmkit.kernels.face_swelling import FaceSums
from lmkit.mapping.bundle_results import Bundle
from lmkit.mapping.camera_relations import CameraRelations
from lmkit.mapping.carried_cameras import are_synchronous, carry_frames
from lmkit.mapping.face_swelling import SwellingPrior, hold_swelling, with_swelling, without_swelling
from lmkit.mapping.motion_rows import (
    LEAST_TO_WEIGH,
    SLIP_SIGMA,
    MotionRows,
    StandardMotions,
    add_motions,
    noise_factors,
    standard_motions,
    weighed,
)
from lmkit.mapping.observation_arrays import ObservationArrays, StoredObservations
from lmkit.mapping.rig_jumps import jumps_by_odometry, jumps_by_speed
from lmkit.mapping.stated_equations import StatedEquations
from lmkit.mapping.wall_constraints import LandmarkConstraint, add_constraint
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.model.recording import RigFrame
from lmkit.model.trajectory import Trajectory
from lmkit.odometry.motion_model import BoundedMotion, Motion
from lmkit.odometry.pose_odometry import PoseMotion
from lmkit.optim.block_chain import ChainEquations
from lmkit.optim.border_blocks import BlockPattern
from lmkit.optim.levenberg_marquardt import Damping, minimize
from lmkit.optim.robust_loss import CAUCHY_SCALE, cauchy_cost, cauchy_weight

CONVERGED = 1e-2  # of the cost: a last step of a tenth of a standard deviation
DAMPING = Damping(grow=50.0)
EXACT = 1e-12  # m^2, rad^2: variance of exact values


@dataclass(frozen=True, eq=False)
class Anchor:
    """A landmark with a known pose and its covariance (6,6); None: the pose is exact."""

    landmark: MappedLandmark
    covariance: FloatArray | None


@dataclass(frozen=True, eq=False)
class State:
    """A snapshot of the unknowns."""

    R: FloatArray
    p: FloatArray
    lm_R: FloatArray
    lm_p: FloatArray
    parameters: FloatArray
    relations: CameraRelations
    swelling: FloatArray


OwnState = tuple[FloatArray, FloatArray, FloatArray, CameraRelations, FloatArray]


class BundleProblem:
    """Correspondences of a recording, and the current values of the unknowns.

    Args:
        frames: in the order of time.
        start: T_map_left of every frame.
        landmarks: initial poses; observations of other landmarks are left out.
        anchors: known landmarks, by id.
        landmarks_fixed: no landmark moves.
        constraints: walls and heights that landmarks are declared to share.
        seen: the observations as arrays, if they exist; numbered as the frames and landmarks here.
    """

    def __init__(
        self,
        frames: Sequence[RigFrame],
        rig: AnyRig,
        start: PoseArray,
        landmarks: LandmarkMap,
        anchors: Mapping[LandmarkId, Anchor],
        motion: Motion | None = None,
        landmarks_fixed: bool = False,
        constraints: Sequence[LandmarkConstraint] = (),
        seen: ObservationArrays | None = None,
    ) -> None:
        self.times = np.array([frame.time_s for frame in frames])
        self.motion: Motion = motion or BoundedMotion(self.times)
        self.landmarks_fixed = landmarks_fixed
        self.R, self.p = start.R.copy(), start.t.copy()
        self.mapped = list(landmarks)
        self.anchors, self.constraints = dict(anchors), constraints
        self._frames, self._rig = frames, rig
        observed = seen or ObservationArrays.collect(frames, rig, [m.id for m in self.mapped])
        self.seen: ObservationArrays | StoredObservations = observed
        self._swelling_prior = SwellingPrior.of(observed.variance)
        self.lm_R = np.array([m.T_map_landmark.R for m in self.mapped])
        self.lm_p = np.array([m.T_map_landmark.t for m in self.mapped])
        self.arms = np.array([(m.corners_map - m.T_map_landmark.t) @ m.T_map_landmark.R for m in self.mapped])
        self.used = np.ones(len(self.seen), dtype=bool)
        self.parameters = np.array(self.motion.nominal)
        self.relations = CameraRelations.of_rig(rig)
        self.swelling: FloatArray = np.zeros(SWELLING)
        self.faces: FloatArray = np.zeros((len(self.mapped), SWELLING))  # swelling of each landmark relative to that
        # Of the shared unknowns, before the landmarks.
        self.own = len(self.parameters) + self.relations.unknowns + SWELLING
        self.motion_scale = np.ones(6)
        self.slip_sigma = SLIP_SIGMA  # scale of the loss of motions
        self.shared = self.own + (0 if landmarks_fixed else 6 * len(self.mapped))
        T = rig.T_base_left
        T_left_base = Pose.identity("left", "base") if T is None else T.inverse()
        self.base_R, self.base_t = T_left_base.R, T_left_base.t
        self._put_back: tuple[tuple[Any, ...], FloatArray] | None = None
        self._blocks: tuple[BlockPattern, IntArray] | None = None
        self._linearized: tuple[tuple[Any, ...], tuple[ChainEquations, float]] | None = None
        self._converged: tuple[Any, ...] | None = None  # unknowns and weights at which an adjustment ended

    def carry(self) -> bool:
        """Update the motion between frame and exposure of each camera; False if all are synchronous.

        The motion comes from odometry or, without odometry, from the current poses of the rig.
        """
        if are_synchronous(self._frames, self._rig):
            return False
        motion, parameters = self.motion, self.parameters
        rig = self._rig
        if isinstance(motion, BoundedMotion):
            if len(self.times) < 2:
                return False
            quaternions = Rotation.from_matrix(self.R).as_quat()
            motion, rig = PoseMotion(Trajectory(self.times, self.p, quaternions)), replace(rig, T_base_left=None)
            parameters = motion.nominal
        carried = carry_frames(self._frames, rig, motion, parameters)
        self.seen = ObservationArrays.collect(carried, self._rig, [m.id for m in self.mapped])
        self._blocks = None
        return True

    def forget_frames(self) -> None:
        """Release the frames: observations are arrays, and the motion to exposures is no longer updated."""
        self._frames = ()

    def forget_equations(self) -> None:
        """Release the normal equations of the last state; they are computed again when needed."""
        self._linearized = self._put_back = None

    def store_observations(self, path: Path) -> None:
        """Move the observations to a file, from which they are read when needed."""
        if isinstance(self.seen, ObservationArrays):
            self.seen = StoredObservations.write(self.seen, path)

    def optimize(self, steps: int, least_share: float = 0.0, until: Callable[[State], bool] | None = None) -> None:
        """Levenberg-Marquardt from the current unknowns.

        Args:
            steps: largest number of steps.
            least_share: of the cost; a step that is predicted to lower it by less is the last one.
            until: a state that needs no further step.
        """
        if _are_same(self._converged, self._arrays()):
            return
        end = minimize(self, self.state(), steps, CONVERGED, DAMPING, least_share, until, _predicted_gain)
        self.restore(end.state)
        self._converged = self._arrays() if end.gain is not None and end.gain < CONVERGED else None

    def linearize(self, state: State) -> tuple[ChainEquations, float]:
        """Normal equations and cost at a state; callers must not change them, because they are cached."""
        self.restore(state)
        at = self._arrays()
        if self._linearized is None or not _are_same(self._linearized[0], at):
            self._linearized = None
            self._linearized = at, self._equations()
        return self._linearized[1]

    def _arrays(self) -> tuple[Any, ...]:
        """The unknowns and everything else on which the equations depend; arrays are replaced, never changed."""
        weights = self.faces, self.used, self.motion_scale, self.seen, self.slip_sigma
        return (*self.own_state(), self.lm_R, self.lm_p, *weights)

    def solve(self, equations: ChainEquations, damping: float) -> tuple[FloatArray, FloatArray]:
        """Steps of the poses and of the shared unknowns."""
        return equations.solve(damping)

    def retract(self, state: State, step: tuple[FloatArray, FloatArray]) -> State:
        """The state moved by a step."""
        self.restore(state)
        self._move(*step)
        return self.state()

    def state(self) -> State:
        """Snapshot of the unknowns."""
        return State(self.R, self.p, self.lm_R, self.lm_p, self.parameters, self.relations, self.swelling)

    def restore(self, state: State) -> None:
        """Restore a snapshot."""
        self.R, self.p, self.lm_R, self.lm_p = state.R, state.p, state.lm_R, state.lm_p
        self.parameters, self.relations, self.swelling = state.parameters, state.relations, state.swelling

    @property
    def size(self) -> int:
        """Unknowns of one landmark."""
        return 6

    @property
    def landmark_ids(self) -> tuple[LandmarkId, ...]:
        """Ids in the order of the unknowns."""
        return tuple(m.id for m in self.mapped)

    def own_state(self) -> OwnState:
        """Snapshot of poses, odometry errors, relative camera poses and face swelling."""
        return self.R, self.p, self.parameters, self.relations, self.swelling

    def restore_own(self, state: OwnState) -> None:
        """Restore such a snapshot."""
        self.R, self.p, self.parameters, self.relations, self.swelling = state

    def own_moved(self, states: FloatArray, own: FloatArray) -> OwnState:
        """The snapshot after a step of everything but the landmarks."""
        turned, moved = rotation_exp(states[:, 3:]) @ self.R, self.p + states[:, :3]
        odometry, cameras, swelling = np.split(own, [self._odometry, self.own - SWELLING])
        # If fixed, it stays the same array, so that the observations need not be corrected again.
        swollen = self.swelling + swelling if swelling.any() else self.swelling
        return turned, moved, self.parameters + odometry, self.relations.moved(cameras), swollen

    @property
    def _odometry(self) -> int:
        """Number of odometry parameters, the first shared unknowns."""
        return len(self.parameters)

    def landmark_poses(self) -> tuple[FloatArray, FloatArray]:
        """(L,3,3), (L,3) T_map_landmark."""
        return self.lm_R, self.lm_p

    def put_landmarks(self, R: FloatArray, p: FloatArray) -> None:
        """Set the poses of all landmarks."""
        self.lm_R, self.lm_p = R, p

    def equations(self) -> tuple[ChainEquations, float]:
        """Normal equations and cost of the current unknowns, with fixed face swelling."""
        return self._equations()

    def stated_equations(self, noise: float) -> tuple[StatedEquations, float]:
        """Normal equations of all unknowns, whose inverse is the stated covariance, and cost.

        Args:
            noise: factor of the observations' variances.
        """
        held, cost = self._equations(noise)
        weights = cauchy_weight(self.residuals() ** 2 / noise, CAUCHY_SCALE) * self.used / noise
        pattern, place = self._pattern()
        cameras = self.relations.unknowns // 6
        sums = FaceSums.zeros(place, self.seen.camera, len(pattern.states), len(self.mapped), cameras)
        swollen = self.swelling, self.faces, self._swelling_prior
        return with_swelling(held, self._correspondences(), weights, sums, pattern, self.own, *swollen), cost

    def find_swelling(self, noise: float, landmarks: FloatArray | None = None) -> None:
        """One step of the face swelling together with all unknowns; solve for the other unknowns again afterwards.

        The other unknowns move as well if that lowers the cost, unless other recordings observe the landmarks, too.

        Args:
            noise: factor of the observations' variances.
            landmarks: (6L,) step of their poses, if other recordings observe them as well.
        """
        stated = self.stated_equations(noise)[0]
        states, shared, faces = stated.solve() if landmarks is None else stated.solve_around(landmarks, self.own)
        common = slice(self.own - SWELLING, self.own)
        self.swelling, self.faces = self.swelling + shared[common], self.faces + faces
        if landmarks is not None:
            return
        before, cost = self.state(), self.cost()
        shared[common] = 0.0
        self._move(states, shared)
        if self.cost() > cost:
            self.restore(before)

    def cost(self) -> float:
        """Cost of the current unknowns."""
        return self.linearize(self.state())[1]

    def put(self, landmark: int, R: FloatArray, p: FloatArray) -> None:
        """Set the pose of one landmark."""
        self.lm_R, self.lm_p = self.lm_R.copy(), self.lm_p.copy()
        self.lm_R[landmark], self.lm_p[landmark] = R, p

    def transform(self, R: FloatArray, t: FloatArray) -> None:
        """Transform everything, x -> R x + t, including the anchors."""
        self.R, self.p = R @ self.R, self.p @ R.T + t
        self.lm_R, self.lm_p = R @ self.lm_R, self.lm_p @ R.T + t
        turn = np.kron(np.eye(2), R)
        for key, anchor in self.anchors.items():
            T = anchor.landmark.T_map_landmark
            moved = Pose(T.to_frame, T.from_frame, orthonormal(R @ T.R), R @ T.t + t)
            C = None if anchor.covariance is None else turn @ anchor.covariance @ turn.T
            self.anchors[key] = Anchor(replace(anchor.landmark, T_map_landmark=moved), C)

    def base_poses(self) -> tuple[FloatArray, FloatArray]:
        """(N,3,3), (N,3) T_map_base of the robot."""
        return self.R @ self.base_R, self.p + self.R @ self.base_t

    def is_fixed(self, landmark: int) -> bool:
        """Whether a landmark's pose is known exactly."""
        m = self.mapped[landmark]
        anchor = self.anchors.get(m.id)
        return anchor is not None and anchor.covariance is None

    def landmark_costs(self) -> FloatArray:
        """(L,) cost of each landmark's observations."""
        squared = self.residuals() ** 2
        cost = 8 * cauchy_cost(squared) * self.used
        return np.asarray(np.bincount(self.seen.of, cost, len(self.mapped)), dtype=np.float64)

    def landmark_steps(self) -> tuple[FloatArray, FloatArray]:
        """(L,6) step of each landmark alone, with fixed rig poses, and (L,) the gain that the equations predict."""
        e = self._equations()[0]
        rows = self.own + 6 * np.arange(len(self.mapped))[:, None] + np.arange(6)
        blocks, gradients = e.corner[rows[:, :, None], rows[:, None]], e.shared_gradient[rows]
        steps = np.linalg.solve(blocks, gradients[..., None])[..., 0]
        return steps, (steps * gradients).sum(axis=1)

    def seen_along(self) -> FloatArray:
        """(L,3) unit vectors from landmarks to the mean position of the cameras that saw them."""
        away = self.p[self.seen.at] - self.lm_p[self.seen.of]
        away = away / np.linalg.norm(away, axis=1, keepdims=True) * self.used[:, None]
        total = np.zeros((len(self.mapped), 3))
        np.add.at(total, self.seen.of, away)
        return np.asarray(total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-12))

    def drop_outliers(self, sigma: float) -> int:
        """Leave out gross outliers: even down-weighted, many of them together bias the solution."""
        used = self.residuals() < sigma
        if (used != self.used).any():
            self.used = used
        return int((~used).sum())

    def weigh_motion(self) -> None:
        """Update the odometry noise from its agreement with the observations."""
        if len(self.times) < LEAST_TO_WEIGH:
            return
        states, across, _ = self.linearize(self.state())[0].covariances()
        self.motion_scale = self.motion_scale * noise_factors(self._motions(), states, across)

    def _move(self, step: FloatArray, shared: FloatArray) -> None:
        self.restore_own(self.own_moved(step, shared[: self.own]))
        if not self.landmarks_fixed:
            moved = shared[self.own :].reshape(-1, 6)
            self.lm_p = self.lm_p + moved[:, :3]
            self.lm_R = rotation_exp(moved[:, 3:]) @ self.lm_R

    def _poses(self) -> PoseArray:
        return PoseArray("map", "left", self.R, self.p)

    def _correspondences(self) -> kernel.Bundle:
        landmarks = PoseArray("map", "landmark", self.lm_R, self.lm_p)
        bundle = self.seen.bundle(self._poses(), landmarks, self.arms, self.relations)
        if not (self.swelling.any() or self.faces.any()):
            return bundle
        by = self.seen, self.swelling, self.faces
        if self._put_back is None or not _are_same(self._put_back[0], by):
            self._put_back = by, without_swelling(bundle, self.swelling, self.faces)
        return replace(bundle, rays=self._put_back[1])

    def _equations(self, noise: float = 1.0) -> tuple[ChainEquations, float]:
        pattern = None if self.landmarks_fixed else self._pattern()[0]
        equations = ChainEquations.zeros(len(self.times), 6, self.shared, pattern)
        sums = self._sums(equations)
        cost = kernel.add_bundle_equations(self._correspondences(), self.used, CAUCHY_SCALE, sums, noise)
        cost += self.relations.add_prior(equations, self._odometry)
        hold_swelling(equations, self.own - SWELLING, self._swelling_prior)
        if not self.landmarks_fixed:
            cost += self._add_anchors(equations)
            for constraint in self.constraints:
                members = self.members(constraint)
                cost += add_constraint(equations, constraint, members, self.lm_R, self.lm_p, self.own)
        if len(self.times) > 1:
            cost += add_motions(equations, self.motion_rows(), self.motion, self.parameters)
        # Never singular, also for poses and landmarks without observations.
        for matrix in (equations.diagonal, equations.corner[None]):
            diagonal = np.arange(matrix.shape[1])
            matrix[:, diagonal, diagonal] += 1e-9
        return equations, cost

    def _pattern(self) -> tuple[BlockPattern, IntArray]:
        """Sparsity: the landmarks that each pose sees, and the block of every observation."""
        if self._blocks is None:
            self._blocks = BlockPattern.of_pairs(self.seen.at, self.seen.of, len(self.times), self.own, 6)
        return self._blocks

    def _sums(self, e: ChainEquations) -> kernel.Sums:
        """The arrays of equations, to which observations are added: on poses, landmarks and cameras."""
        place = None if self.landmarks_fixed else self._pattern()[1]
        blocks = np.zeros((0, 6, 6)) if e.blocks is None else e.blocks.values
        arrays = e.diagonal, e.gradient, e.border, blocks, e.corner, e.shared_gradient
        return kernel.Sums(*arrays, self.own, place, self.seen.camera, self._odometry)

    def _add_anchors(self, equations: ChainEquations) -> float:
        cost = 0.0
        for k, landmark in enumerate(self.mapped):
            anchor = self.anchors.get(landmark.id)
            if anchor is None:
                continue
            T = anchor.landmark.T_map_landmark
            turned = rotation_log(T.R @ self.lm_R[k].T)
            off = np.concatenate([T.t - self.lm_p[k], turned])
            information = np.linalg.inv(EXACT * np.eye(6) + (0.0 if anchor.covariance is None else anchor.covariance))
            rows = self._rows_of(k)
            equations.corner[rows, rows] += information
            equations.shared_gradient[rows] += information @ off
            cost += float(off @ information @ off)
        return cost

    def members(self, constraint: LandmarkConstraint) -> list[int]:
        """Rows of those landmarks of a constraint that the recording contains."""
        return [k for k, landmark in enumerate(self.mapped) if landmark.id in constraint.ids]

    def motion_rows(self) -> MotionRows:
        """Equations of the motions at the current state."""
        return weighed(self._motions(), self.slip_sigma)

    def _motions(self) -> StandardMotions:
        steps = self.motion.steps(self.times, self.parameters)
        return standard_motions(steps, self.motion_scale, self.base_poses(), self.R @ self.base_t)

    def _rows_of(self, landmark: int) -> slice:
        return slice(self.own + 6 * landmark, self.own + 6 * landmark + 6)

    def landmark_information(self) -> FloatArray:
        """(6L,6L) information of the observations on the landmarks, with the rig poses eliminated."""
        e = self._equations()[0]
        across = e.dense_border()[:, :, self.own :]
        determined = np.einsum("nia,nij,njb->ab", across, np.linalg.inv(e.diagonal), across)
        return np.asarray(e.corner[self.own :, self.own :] - determined)

    def residuals(self) -> FloatArray:
        """(S,) root mean square of each observation's eight standardized coordinates."""
        return np.asarray(np.sqrt(kernel.bundle_chi2(self._correspondences())[0] / 8))

    def whitened_errors(self) -> FloatArray:
        """(S,8) standardized errors of each observation's coordinates."""
        return kernel.whitened_errors(self._correspondences())

    def landmarks(self, covariance: FloatArray | None = None) -> LandmarkMap:
        """The current map."""
        mapped = []
        for k, m in enumerate(self.mapped):
            C = None
            if covariance is not None and not self.landmarks_fixed:
                rows = self._rows_of(k)
                C = (covariance[rows, rows] + covariance[rows, rows].T) / 2
            T = Pose("map", "landmark", orthonormal(self.lm_R[k]), self.lm_p[k])
            mapped.append(replace(m, T_map_landmark=T, covariance=m.covariance if self.landmarks_fixed else C))
        return LandmarkMap(mapped)

    def answer(
        self,
        believed_below: float,
        spread: Mapping[int, FloatArray] | None = None,
        known: FloatArray | None = None,
        noise: float = 1.0,
    ) -> Bundle:
        """The solution with covariances.

        Args:
            believed_below: residual below which an observation is an inlier.
            spread: (6,6) to add to the covariance of landmarks, by row.
            known: (6L,6L) information on the landmarks from other recordings.
            noise: factor of the observations' variances.
        """
        equations, _ = self.stated_equations(noise)
        if known is not None:
            equations.add_known(known)
        states, shared = equations.covariances()
        for k, more in (spread or {}).items():
            shared[self._rows_of(k), self._rows_of(k)] += more
        residuals = self.residuals()
        believed: BoolArray = residuals < believed_below
        pixels = kernel.bundle_chi2(self._correspondences())[1][believed]
        rms = float(np.sqrt(pixels.mean() / 4)) if believed.any() else float("nan")
        return Bundle(
            self.times,
            self._poses(),
            states,
            self.landmarks(shared),
            shared[self.own :, self.own :],
            self.parameters,
            np.sqrt(np.maximum(np.diag(shared)[: self._odometry], 0.0)),
            residuals,
            tuple(m.id for m in self.mapped),
            self.seen.of,
            self.seen.at,
            rms,
            self._jumps(states),
        )

    def _jumps(self, covariances: FloatArray) -> tuple[tuple[float, float, float], ...]:
        """Jumps that contradict the odometry or, without odometry, the largest speed of the rig."""
        if len(self.times) < 2:
            return ()
        if isinstance(self.motion, BoundedMotion):
            jumps, off = jumps_by_speed(self.times, self.p, covariances)
        else:
            jumps, off = jumps_by_odometry(self._motions())
        return tuple((float(self.times[k]), float(self.times[k + 1]), float(off[k])) for k in jumps)


def _are_same(one: tuple[Any, ...] | None, other: tuple[Any, ...]) -> bool:
    """Whether all arrays are the same objects."""
    return one is not None and all(a is b for a, b in zip(one, other, strict=True))


def _predicted_gain(equations: ChainEquations, step: tuple[FloatArray, FloatArray]) -> float:
    """Decrease of the cost by a step, according to the equations."""
    return float(np.vdot(equations.gradient, step[0]) + np.vdot(equations.shared_gradient, step[1]))
