"""Planar smoothing of a whole recording: poses, odometry errors and, optionally, landmarks.

Least squares over all frames (batch smoothing; Dellaert and Kaess 2006), with Cauchy's loss on readings and on
motions, so that neither a wrong code nor a slip biases it.  The recording is solved piece by piece, each started from
the end of the previous one, because dead reckoning of the whole recording drifts too far.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lmkit.arrays import FloatArray, IntArray
from lmkit.geometry.planar import between, follow, wrap_angle
from lmkit.localization.range_bearing import locate_planar
from lmkit.localization.range_bearing_noise import DRIVE_NOISE, ReadingNoise
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.observation import RangeBearing
from lmkit.model.pose_status import PoseStatus
from lmkit.odometry.wheel_odometry import NOMINAL, PARAMETERS, PRIOR_SIGMA, MotionModel
from lmkit.optim.block_chain import ChainEquations
from lmkit.optim.levenberg_marquardt import Damping, minimize
from lmkit.optim.robust_loss import cauchy_cost, cauchy_weight

DAMPING = Damping(most=1e6)
SLIP_SIGMA = 10.0  # scale of the loss of motions: wheels have steady errors and rare slips
PIECE = 400  # frames added at once
STEPS_A_PIECE, STEPS_AT_END = 4, 40
CONVERGED = 1e-4
ANYWHERE = 1e-3  # information of the first pose, 1/m^2 and 1/rad^2, if readings do not determine it
EXACT = 1e-12  # m^2: variance of an exact landmark
ODOMETRY = len(PARAMETERS)
OWN = ODOMETRY + 1  # of the shared unknowns, before the landmarks: the last is the scale of ranges


@dataclass(frozen=True, eq=False)
class PlanarTrack:
    """A smoothed recording.

    Attributes:
        times_s: (N,) of the frames.
        states: (N,3) x, y (m), heading (rad).
        covariances: (N,3,3).
        parameters, parameter_sigmas: (6,) as ``motion.PARAMETERS``, and standard deviations.
        range_scale: measured over true ranges, and its standard deviation.
        ids, places, place_covariances: (L), (L,2), (L,2,2) of the landmarks.
        weights: (R,) of the readings, 1 for inliers, near 0 for outliers.
        squared, nis_dof: (R,) their squared errors in standard deviations, and degrees of freedom.
        frames, landmarks: (R,) of the readings; landmarks as indices into ``ids``.
    """

    times_s: FloatArray
    states: FloatArray
    covariances: FloatArray
    parameters: FloatArray
    parameter_sigmas: FloatArray
    range_scale: tuple[float, float]
    ids: tuple[LandmarkId, ...]
    places: FloatArray
    place_covariances: FloatArray
    weights: FloatArray
    squared: FloatArray
    nis_dof: FloatArray
    frames: IntArray
    landmarks: IntArray


@dataclass(eq=False)
class _Readings:
    """Readings as arrays: frame and landmark of each, range and bearing, and their deviations."""

    frames: IntArray
    landmarks: IntArray
    values: FloatArray  # (R,2) range, bearing
    sigmas: FloatArray

    def first(self, frames: int) -> _Readings:
        rows = self.frames < frames
        return _Readings(self.frames[rows], self.landmarks[rows], self.values[rows], self.sigmas[rows])


def smooth_planar(
    times_s: FloatArray,
    readings: Sequence[Sequence[RangeBearing]],
    motion: MotionModel,
    landmarks: LandmarkMap | None,
    noise: ReadingNoise | None = None,
) -> PlanarTrack:
    """Most likely poses for readings and motion.

    Args:
        times_s: (N,) of the frames, increasing.
        readings: of every frame; may be empty.
        landmarks: the map, whose places are refined within its covariance; None: they are estimated, too, from the
            first pose at (0, 0, 0).
    """
    noise = noise or DRIVE_NOISE
    problem = PlanarProblem(times_s, readings, motion, landmarks, noise)
    problem.take_up()
    return problem.answer()


# States, parameters (7,) of the odometry and the ranges' scale (read over true), places of landmarks.
_Unknowns = tuple[FloatArray, FloatArray, FloatArray]


class PlanarProblem:
    """One recording: readings, motion, and current unknowns; arguments as for :func:`smooth_planar`."""

    def __init__(
        self,
        times_s: FloatArray,
        readings: Sequence[Sequence[RangeBearing]],
        motion: MotionModel,
        landmarks: LandmarkMap | None,
        noise: ReadingNoise,
    ) -> None:
        self.times, self.motion, self.noise = times_s, motion, noise
        self._readings_by_frame, self._map = readings, landmarks
        ids = sorted({r.id for frame in readings for r in frame if landmarks is None or r.id in landmarks})
        self.ids = ids
        index = {id_: k for k, id_ in enumerate(ids)}
        rows = [
            (k, index[r.id], r.range_m or np.nan, np.nan if r.bearing_rad is None else r.bearing_rad)
            for k, frame in enumerate(readings)
            for r in frame
            if r.id in index
        ]
        table = np.array(rows, dtype=np.float64).reshape(-1, 4)
        used = [r for frame in readings for r in frame if r.id in index]
        ranges, bearings = noise.sigmas(used)
        sigmas = np.column_stack([ranges, np.hypot(bearings, noise.common_bearing_rad)])
        at = times_s[table[:, 0].astype(np.int64)]
        self._alike = np.sqrt(_related(at, table[:, 1], noise.related_s))
        self._stated = np.array([r.range_sigma_m is not None for r in used], dtype=bool)
        sigmas *= self._alike[:, None]
        self.readings = _Readings(table[:, 0].astype(np.int64), table[:, 1].astype(np.int64), table[:, 2:], sigmas)
        self.places = np.full((len(ids), 2), np.nan)
        # (L,2,2) their prior.
        self.known = np.zeros((len(ids), 2, 2))
        mapped = [] if landmarks is None else [m for m in map(landmarks.find, ids) if m is not None]
        for k, m in enumerate(mapped):
            self.places[k] = m.T_map_landmark.t[:2]
            C = EXACT * np.eye(2) + (0.0 if m.covariance is None else m.covariance[:2, :2])
            self.known[k] = np.linalg.inv(C)
        self.mapped = self.places.copy()
        self.moves = landmarks is None or any(m.covariance is not None for m in mapped)
        self.parameters = np.append(NOMINAL, 1.0)
        self.states: FloatArray = np.zeros((0, 3))
        self.own = OWN
        self.holds_origin = landmarks is None  # the first pose is fixed

    def take_up(self) -> None:
        """Solve piece by piece to the end."""
        count = len(self.times)
        self.states = np.array([self._start()])
        while len(self.states) < count:
            self._extend(min(count, len(self.states) + PIECE))
            self._solve(STEPS_A_PIECE)
        self._solve(STEPS_AT_END)
        if self._map is None:
            self._expect_ranges()
            self._solve(STEPS_AT_END)

    def _expect_ranges(self) -> None:
        """Compute standard deviations at expected ranges: else ranges that are too short would get more weight."""
        seen, _, off = self._errors()
        expected = self.parameters[-1] * np.hypot(*off.T)
        sigmas = self.noise.range_sigma(expected) * self._alike
        seen.sigmas[:, 0] = np.where(self._stated | ~np.isfinite(expected), seen.sigmas[:, 0], sigmas)
        self.readings = seen

    def _start(self) -> FloatArray:
        if self._map is None:
            return np.zeros(3)
        for k, frame in enumerate(self._readings_by_frame):
            found = locate_planar(frame, self._map, self.noise)
            if found.status == PoseStatus.OK and found.pose is not None and found.pose.heading_rad is not None:
                state = np.array([found.pose.x_m, found.pose.y_m, found.pose.heading_rad])
                # Back along the motions to the first frame.
                path = follow(
                    np.zeros(3), self.motion.increments(self.times[: k + 1], self.parameters[:ODOMETRY]).motions
                )[-1]
                heading = state[2] - path[2]
                c, s = np.cos(heading), np.sin(heading)
                back = [c * path[0] - s * path[1], s * path[0] + c * path[1], path[2]]
                return np.asarray(state - back)
        return np.zeros(3)

    def _extend(self, count: int) -> None:
        """Add frames by dead reckoning, and the landmarks first seen there."""
        have = len(self.states)
        motions = self.motion.increments(self.times[have - 1 : count], self.parameters[:ODOMETRY]).motions
        self.states = np.concatenate([self.states, follow(self.states[-1], motions)[1:]])
        seen = self.readings.first(count)
        full = np.isfinite(seen.values).all(axis=1)
        for k in np.flatnonzero(np.isnan(self.places[:, 0])):
            rows = full & (seen.landmarks == k)
            if not rows.any():
                continue
            at = self.states[seen.frames[rows]]
            distance, bearing = seen.values[rows].T
            points = at[:, :2] + distance[:, None] * np.column_stack(
                [np.cos(at[:, 2] + bearing), np.sin(at[:, 2] + bearing)]
            )
            self.places[k] = np.median(points, axis=0)

    def _solve(self, steps: int) -> None:
        """Levenberg-Marquardt from the current unknowns."""
        start = (self.states, self.parameters, self.places)
        self._restore(minimize(self, start, steps, CONVERGED, DAMPING, least_share=CONVERGED).state)

    @property
    def size(self) -> int:
        """Unknowns of one landmark."""
        return 2

    @property
    def landmark_ids(self) -> tuple[LandmarkId, ...]:
        """Ids in the order of the unknowns."""
        return tuple(self.ids)

    def own_state(self) -> tuple[FloatArray, ...]:
        """Snapshot of states and odometry errors."""
        return self.states, self.parameters

    def restore_own(self, state: tuple[FloatArray, ...]) -> None:
        """Restore states and odometry errors."""
        self.states, self.parameters = state

    def own_moved(self, states: FloatArray, own: FloatArray) -> tuple[FloatArray, ...]:
        """The snapshot after a step of states and odometry errors."""
        return self.states + states, self.parameters + own

    def landmark_poses(self) -> tuple[FloatArray, FloatArray]:
        """(L,3,3), (L,3) of the landmarks, at height 0."""
        count = len(self.places)
        return np.repeat(np.eye(3)[None], count, axis=0), np.column_stack([self.places, np.zeros(count)])

    def put_landmarks(self, R: FloatArray, p: FloatArray) -> None:
        """Set the places of all landmarks."""
        self.places = p[:, :2].copy()

    def equations(self) -> tuple[ChainEquations, float]:
        """Normal equations and cost at the current state."""
        return self._equations()[:2]

    def transform(self, turn_rad: float, shift: FloatArray) -> None:
        """Transform states and landmarks, x -> R x + t."""
        c, s = np.cos(turn_rad), np.sin(turn_rad)
        R = np.array([[c, -s], [s, c]])
        self.places = self.places @ R.T + shift
        self.states = np.column_stack([self.states[:, :2] @ R.T + shift, self.states[:, 2] + turn_rad])

    def linearize(self, state: _Unknowns) -> tuple[ChainEquations, float]:
        """Normal equations and cost at a state."""
        self._restore(state)
        equations, cost, _ = self._equations()
        return equations, cost

    def solve(self, equations: ChainEquations, damping: float) -> tuple[FloatArray, FloatArray]:
        """Steps of the states and of the shared unknowns."""
        return equations.solve(damping)

    def retract(self, state: _Unknowns, step: tuple[FloatArray, FloatArray]) -> _Unknowns:
        """The state moved by a step."""
        self._restore(state)
        self._move(*step)
        return self.states, self.parameters, self.places

    def _restore(self, state: _Unknowns) -> None:
        self.states, self.parameters, self.places = state

    def _move(self, step: FloatArray, shared: FloatArray) -> None:
        self.states = self.states + step
        self.parameters = self.parameters + shared[:OWN]
        if self.moves:
            self.places = self.places + shared[OWN:].reshape(-1, 2)

    def _errors(self) -> tuple[_Readings, FloatArray, FloatArray]:
        """Readings so far, their standardized errors (R,2), 0 where not measured, and places of the landmarks."""
        seen = self.readings.first(len(self.states))
        at = self.states[seen.frames]
        off = self.places[seen.landmarks] - at[:, :2]
        distance = np.hypot(off[:, 0], off[:, 1])
        direction = np.arctan2(off[:, 1], off[:, 0]) - at[:, 2]
        ranges = (seen.values[:, 0] - self.parameters[-1] * distance) / seen.sigmas[:, 0]
        bearings = wrap_angle(seen.values[:, 1] - direction) / seen.sigmas[:, 1]
        return seen, np.nan_to_num(np.column_stack([ranges, bearings])), off

    def _motion_errors(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(N-1,3) standardized, their deviations, and derivatives of the motions with the parameters."""
        motions = self.motion.increments(self.times[: len(self.states)], self.parameters[:ODOMETRY])
        # Noise in meters as measured by the wheels: else a smaller map, with smaller deviations, is more likely.
        sigmas = motions.sigmas * [self.parameters[0], self.parameters[0], 1.0]
        return (motions.motions - between(self.states)) / sigmas, sigmas, motions.by_parameters

    def _equations(self) -> tuple[ChainEquations, float, FloatArray]:
        count, shared = len(self.states), OWN + 2 * len(self.ids) * self.moves
        equations = ChainEquations.zeros(count, 3, shared)
        seen, errors, off = self._errors()
        squared = (errors**2).sum(axis=1)
        weights = cauchy_weight(squared)
        root = np.sqrt(weights)[:, None]
        J = _reading_jacobian(off, seen.sigmas) * root[..., None]
        J[:, 0] *= self.parameters[-1]
        J = np.where(np.isfinite(seen.values)[..., None] & np.isfinite(off[:, :1, None]), J, 0.0)
        residuals = errors * root
        equations.add_to_states(seen.frames, J, residuals)
        by_scale = np.zeros((len(J), 2, 1))
        by_scale[:, 0, 0] = np.nan_to_num(np.hypot(*off.T) / seen.sigmas[:, 0] * root[:, 0])
        by_scale[~np.isfinite(seen.values[:, 0])] = 0.0
        if self.moves:
            columns = OWN + 2 * seen.landmarks[:, None] + np.arange(2)
            columns = np.column_stack([np.full(len(J), ODOMETRY), columns])
            equations.add_shared(seen.frames, J, columns, np.dstack([by_scale, -J[:, :, :2]]), residuals)
            unseen = np.isnan(self.places[:, 0]).repeat(2)
            equations.corner[OWN:, OWN:] += np.diag(np.where(unseen, 1.0, 1e-9))
            if self.holds_origin:
                # The pose of the map is not observed.
                equations.diagonal[0] += 1e9 * np.eye(3)
            if self._map is not None:
                self._add_map(equations)
        else:
            columns = np.full((len(J), 1), ODOMETRY)
            equations.add_shared(seen.frames, J, columns, by_scale, residuals)
        # Readings of a single landmark leave the recording free to rotate about it.
        equations.diagonal[0] += ANYWHERE * np.eye(3)
        cost = cauchy_cost(squared).sum()
        if count > 1:
            cost += self._add_motion(equations)
        sigma = np.append(PRIOR_SIGMA, self.noise.range_scale)
        off_prior = (np.append(NOMINAL, 1.0) - self.parameters) / sigma
        equations.corner[:OWN, :OWN] += np.diag(sigma**-2)
        equations.shared_gradient[:OWN] += off_prior / sigma
        return equations, float(cost + (off_prior**2).sum() + self._map_cost()), weights

    def _add_map(self, equations: ChainEquations) -> None:
        for k, (known, off) in enumerate(zip(self.known, self.mapped - self.places, strict=True)):
            rows = slice(OWN + 2 * k, OWN + 2 * k + 2)
            equations.corner[rows, rows] += known
            equations.shared_gradient[rows] += known @ off

    def _map_cost(self) -> float:
        off = np.nan_to_num(self.mapped - self.places)
        return float(np.einsum("li,lij,lj->", off, self.known, off))

    def _add_motion(self, equations: ChainEquations) -> float:
        errors, sigmas, by_parameters = self._motion_errors()
        squared = (errors**2).sum(axis=1)
        root = np.sqrt(cauchy_weight(squared, SLIP_SIGMA))[:, None]
        before, after = between_jacobians(self.states)
        scale = (root / sigmas)[..., None]
        before, after, K = before * scale, after * scale, -by_parameters * scale
        residuals = errors * root
        K[:, :2, 0] += residuals[:, :2] / self.parameters[0]
        equations.add_between(before, after, residuals)
        rows = np.arange(len(residuals))
        columns = np.tile(np.arange(ODOMETRY), (len(rows), 1))
        equations.add_shared(rows, before, columns, K, residuals)
        # The later state's share of the border; the corner has it already.
        equations.border[1:, :, :ODOMETRY] += after.transpose(0, 2, 1) @ K
        return float(cauchy_cost(squared, SLIP_SIGMA).sum())

    def answer(self) -> PlanarTrack:
        equations, _, weights = self._equations()
        covariances, _, shared = equations.covariances()
        places = np.zeros((len(self.ids), 2, 2))
        if self.moves:
            for k in range(len(self.ids)):
                places[k] = shared[OWN + 2 * k : OWN + 2 + 2 * k, OWN + 2 * k : OWN + 2 + 2 * k]
        return PlanarTrack(
            self.times,
            self.states,
            covariances,
            self.parameters[:ODOMETRY],
            np.sqrt(np.maximum(np.diag(shared)[:ODOMETRY], 0.0)),
            (float(self.parameters[-1]), float(np.sqrt(shared[ODOMETRY, ODOMETRY]))),
            tuple(self.ids),
            self.places,
            places,
            weights,
            (self._errors()[1] ** 2).sum(axis=1),
            np.isfinite(self.readings.values).sum(axis=1).astype(np.float64),
            self.readings.frames,
            self.readings.landmarks,
        )


def _related(times_s: FloatArray, landmarks: FloatArray, related_s: float) -> FloatArray:
    """(R,) number of readings of the same landmark around each: their errors are correlated, and count as one."""
    like = np.ones(len(times_s))
    for landmark in np.unique(landmarks):
        rows = np.flatnonzero(landmarks == landmark)
        at = times_s[rows]
        like[rows] = np.searchsorted(at, at + related_s / 2) - np.searchsorted(at, at - related_s / 2)
    return np.maximum(like, 1.0)


def _reading_jacobian(off: FloatArray, sigmas: FloatArray) -> FloatArray:
    """(R,2,3) of expected range and bearing with x, y, heading, in standard deviations."""
    squared = np.maximum((off**2).sum(axis=1), 1e-12)
    distance = np.sqrt(squared)
    J = np.zeros((len(off), 2, 3))
    J[:, 0, :2] = -off / distance[:, None]
    J[:, 1, 0], J[:, 1, 1] = off[:, 1] / squared, -off[:, 0] / squared
    J[:, 1, 2] = -1
    return J / sigmas[..., None]


def between_jacobians(states: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(N-1,3,3) of the motion between neighbors with the earlier and the later state."""
    d = np.diff(states, axis=0)
    c, s = np.cos(states[:-1, 2]), np.sin(states[:-1, 2])
    zero, one = np.zeros_like(c), np.ones_like(c)
    before = np.array([[-c, -s, -s * d[:, 0] + c * d[:, 1]], [s, -c, -c * d[:, 0] - s * d[:, 1]], [zero, zero, -one]])
    after = np.array([[c, s, zero], [-s, c, zero], [zero, zero, one]])
    return before.transpose(2, 0, 1), after.transpose(2, 0, 1)
