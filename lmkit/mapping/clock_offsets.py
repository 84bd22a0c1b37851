"""Clock offsets of a rig's cameras, from a recording of a moving rig in a mapped room.

The first camera alone gives the path.  The offset of each other camera is searched along this path.  Then every
exposure is a pose of its own, connected to its neighbors in time by odometry; poses, errors of the odometry and
offsets are solved together: bundle adjustment with the current offsets alternates with Gauss-Newton steps of the
offsets, in which all other unknowns are eliminated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lmkit.arrays import BoolArray, FloatArray, IntArray
from lmkit.errors import InputError
from lmkit.geometry.pose_array import PoseArray
from lmkit.geometry.rig import AnyRig, mounted_cameras, with_time_offsets
from lmkit.geometry.rotations import rotation_log
from lmkit.kernels import landmark_bundle as kernel
from lmkit.mapping.bundle_adjustment import Anchor, BundleProblem
from lmkit.mapping.carried_cameras import motion_to, synchronous
from lmkit.mapping.initialization import Start
from lmkit.mapping.observation_arrays import ObservationArrays
from lmkit.mapping.survey import OUTLIER_SIGMA, STEPS, optimize_all, start_of
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.recording import RigFrame
from lmkit.odometry.motion_model import Motion, determined_by_poses, noise_correction
from lmkit.optim.block_chain import ChainEquations

SEARCHED_S, SEARCH_STEP_S = 0.5, 0.01  # to both sides
SEARCH_SCALE_PX = 5.0  # of the loss while searching
PRIOR_S = 0.5
ROUNDS, CONVERGED_S, CONVERGED_NOISE = 10, 1e-5, 0.05
# Scale of the loss of motions once the path is found: that of surveys, 10, lets one slip pull as twelve standard
# deviations, and clocks give way to it.
SLIP_SIGMA = 3.0
SLIPPED_SIGMA = 4.0  # root mean square over a motion's six numbers: slips, which are not used for the noise
LEAST_SCALE = 0.015  # of the noise of motions: numbers that simulated wheels leave without noise
# To both sides, for derivatives with an offset: over less, noise from row to row looks like changes of speed.
CLOCK_SPAN_S = 0.03
APART_S = 1e-6  # exposures at one time
KNOWN_S = 0.01  # an offset with a larger standard deviation is named


@dataclass(frozen=True, eq=False)
class ClockOffsets:
    """The result.

    Attributes:
        rig: with its time offsets.
        names: of all cameras but the first.
        offsets_s, sigmas_s: (C-1,) added to a camera's stamps it gives the first camera's clock; standard deviations.
        observations: (C-1,) of every camera that fit.
        rms_px: of the corners that fit.
    """

    rig: AnyRig
    names: tuple[str, ...]
    offsets_s: FloatArray
    sigmas_s: FloatArray
    observations: tuple[int, ...]
    rms_px: float

    def __repr__(self) -> str:
        rows = zip(self.names, 1000 * self.offsets_s, 1000 * self.sigmas_s, strict=True)
        cameras = ", ".join(f"{name} {offset:+z.2f} ± {sigma:.2f} ms" for name, offset, sigma in rows)
        return f"ClockOffsets({cameras}, {self.rms_px:.2f} px)"

    def to_dict(self) -> dict[str, Any]:
        """JSON of ``lmkit calibrate --clocks`` (docs/formats.md)."""
        rows = zip(self.names, self.offsets_s.tolist(), self.sigmas_s.tolist(), self.observations, strict=True)
        return {
            "cameras": [
                {"name": name, "time_offset_s": offset, "sigma_s": sigma, "observations": count}
                for name, offset, sigma, count in rows
            ],
            "rms_px": self.rms_px,
        }

    def lines(self) -> list[str]:
        """One line for each camera, and one for the fit."""
        rows = zip(self.names, self.offsets_s.tolist(), self.sigmas_s.tolist(), self.observations, strict=True)
        lines = [
            f"{name}: exposes {1000 * offset:z.2f} ± {1000 * sigma:.2f} ms after its stamps ({count} observations)"
            + ("; not determined: turn and drive faster" if sigma > KNOWN_S else "")
            for name, offset, sigma, count in rows
        ]
        return [*lines, f"fit: {self.rms_px:.2f} px"]


def find_clock_offsets(
    frames: Sequence[RigFrame], rig: AnyRig, landmarks: LandmarkMap, motion: Motion
) -> ClockOffsets:
    """Estimate exposure time minus time stamp of every camera, on the first camera's clock.

    Args:
        frames: detections of every camera; the rig moves and turns.
        rig: calibrated; its time offsets are not used.
        motion: odometry.

    Raises:
        InputError: a rig of one camera, or a camera that sees no landmark of the map.
    """
    cameras, rig = mounted_cameras(rig), synchronous(rig)
    if len(cameras) < 2:
        raise InputError("one_camera", "a rig of one camera has one clock", "give a rig of two or more cameras")
    apart = [_seen_by(frames, k, len(cameras)) for k in range(len(cameras))]
    for camera, own in zip(cameras, apart, strict=True):
        if not any(landmarks.find(o.id) for frame in own for o in frame.detections):
            hint = "drive where every camera sees landmarks of the map"
            raise InputError("nothing_seen", f"camera {camera.name} saw no landmark of the map", hint)
    start = start_of(apart[0], rig, {}, {m.id: Anchor(m, m.covariance) for m in landmarks}, motion)
    exact = all(m.covariance is None for m in landmarks)
    alone = start.problem(apart[0], rig, motion, landmarks_fixed=exact)
    optimize_all(alone)
    offsets = np.array([_searched(alone, start, own, rig, landmarks) for own in apart[1:]])
    located = [frames[k] for k in start.rows]
    solved = _Exposures.of(located, offsets, alone, rig)
    problem = alone
    for round_ in range(ROUNDS):
        problem = solved.problem(rig, landmarks, start, problem, exact)
        if round_ == 0:
            optimize_all(problem)
        else:
            problem.drop_outliers(OUTLIER_SIGMA)
            problem.slip_sigma = SLIP_SIGMA
            problem.optimize(STEPS)
        changed = _weigh_motion(problem)
        step, sigmas = _step(problem, solved.cameras, offsets)
        offsets = offsets + step
        solved = solved.moved(problem, step)
        if np.abs(step).max() < CONVERGED_S and changed < CONVERGED_NOISE:
            break
    fits = problem.residuals() <= OUTLIER_SIGMA
    counts = tuple(int(fits[solved.cameras[problem.seen.at] == k].sum()) for k in range(1, len(cameras)))
    names = tuple(camera.name for camera in cameras[1:])
    rms_px = problem.answer(OUTLIER_SIGMA).rms_px
    return ClockOffsets(with_time_offsets(rig, offsets.tolist()), names, offsets, sigmas, counts, rms_px)


@dataclass(frozen=True, eq=False)
class _Exposures:
    """Every exposure a frame of its own, in the order of time.

    Attributes:
        frames: one per exposure in which landmarks were seen, and one per exposure of the first camera.
        cameras: (M,) which camera exposes.
        R, p: (M,3,3), (M,3) T_map_left at the exposure.
    """

    frames: list[RigFrame]
    cameras: IntArray
    R: FloatArray
    p: FloatArray

    @classmethod
    def of(cls, frames: Sequence[RigFrame], offsets: FloatArray, path: BundleProblem, rig: AnyRig) -> _Exposures:
        """From the path of the first camera (N frames)."""
        count = 1 + len(offsets)
        single, cameras, rows = [], [], []
        for camera in range(count):
            for row, frame in enumerate(_seen_by(frames, camera, count)):
                if camera == 0 or frame.detections:
                    stamp = frame.stamps_s[camera] if frame.stamps_s else frame.time_s
                    single.append(
                        replace(frame, time_s=stamp + float(offsets[camera - 1] if camera else 0.0), stamps_s=())
                    )
                    cameras.append(camera)
                    rows.append(row)
        at = np.array(rows)
        times = np.array([frame.time_s for frame in single])
        R, t = motion_to(path.times[at], times, rig, path.motion, path.parameters)
        base_R, base_p = path.R[at], path.p[at]
        return cls(single, np.array(cameras), base_R @ R, base_p + (base_R @ t[..., None])[..., 0])._sorted()

    def moved(self, problem: BundleProblem, step: FloatArray) -> _Exposures:
        """Exposures with the poses of a solved problem, and offsets after a step."""
        later = np.append(0.0, step)[self.cameras].tolist()
        frames = [replace(frame, time_s=frame.time_s + s) for frame, s in zip(self.frames, later, strict=True)]
        return _Exposures(frames, self.cameras, problem.R, problem.p)._sorted()

    def _sorted(self) -> _Exposures:
        """Exposures in the order of time; simultaneous ones are moved slightly apart."""
        times = np.array([frame.time_s for frame in self.frames])
        order = np.argsort(times, kind="stable")
        spread = np.maximum.accumulate(times[order] - APART_S * np.arange(len(order))) + APART_S * np.arange(
            len(order)
        )
        frames = [replace(self.frames[k], time_s=float(t)) for k, t in zip(order.tolist(), spread, strict=True)]
        return _Exposures(frames, self.cameras[order], self.R[order], self.p[order])

    def problem(
        self, rig: AnyRig, landmarks: LandmarkMap, start: Start, before: BundleProblem, exact: bool
    ) -> BundleProblem:
        """Bundle adjustment of all exposures; odometry errors start from the previous problem."""
        seen = {o.id for frame in self.frames for o in frame.detections}
        mapped = LandmarkMap([m for m in landmarks if m.id in seen])
        poses = PoseArray("map", "left", self.R, self.p)
        problem = BundleProblem(self.frames, rig, poses, mapped, start.anchors, before.motion, exact)
        problem.parameters, problem.motion_scale = before.parameters, before.motion_scale
        problem.used = (
            problem.residuals() < OUTLIER_SIGMA if len(problem.times) == len(before.times) else problem.used
        )
        return problem


def _seen_by(frames: Sequence[RigFrame], camera: int, count: int) -> list[RigFrame]:
    """The frames with the detections of one camera."""
    return [
        replace(frame, seen=tuple(frame.seen[k] if k == camera else () for k in range(count))) for frame in frames
    ]


def _searched(
    problem: BundleProblem, start: Start, frames: Sequence[RigFrame], rig: AnyRig, landmarks: LandmarkMap
) -> float:
    """Offset at which one camera's detections fit the path best, seconds."""
    seen = ObservationArrays.collect([frames[k] for k in start.rows], rig, [m.id for m in landmarks])
    arms = np.array([(m.corners_map - m.T_map_landmark.t) @ m.T_map_landmark.R for m in landmarks])
    mounted = PoseArray.from_poses("map", "landmark", [m.T_map_landmark for m in landmarks])
    offsets = np.arange(-SEARCHED_S, SEARCHED_S + SEARCH_STEP_S / 2, SEARCH_STEP_S)
    costs = []
    for offset in offsets:
        R, t = motion_to(problem.times, problem.times + offset, rig, problem.motion, problem.parameters)
        poses = PoseArray("map", "left", problem.R @ R, problem.p + (problem.R @ t[..., None])[..., 0])
        squared = kernel.bundle_chi2(seen.bundle(poses, mounted, arms))[1] / 4
        costs.append(np.log1p(squared / SEARCH_SCALE_PX**2).sum())
    return float(offsets[int(np.argmin(costs))])


def _weigh_motion(problem: BundleProblem) -> float:
    """Update the odometry noise from its agreement with the cameras; returns the largest relative change.

    Slips are left out: with the robust loss, one slip would count as much as hundreds of motions.
    """
    states, across, _ = problem.equations()[0].covariances()
    rows = problem.motion_rows()
    steady = (rows.residuals**2).mean(axis=1) < (SLIPPED_SIGMA * rows.root_weights) ** 2
    determined = determined_by_poses(rows.before, rows.after, states, across)
    before = problem.motion_scale
    found = before * noise_correction(rows.residuals[steady], determined[steady])
    problem.motion_scale = np.maximum(found, LEAST_SCALE)
    return float(np.abs(problem.motion_scale / before - 1).max())


def _step(problem: BundleProblem, cameras: IntArray, offsets: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Gauss-Newton step of the offsets, all else eliminated, and their standard deviations (C-1,), seconds.

    If an exposure is slightly later, the next neighbor in time is nearer and the previous one farther.
    """
    e = problem.linearize(problem.state())[0]
    (count, size), shared = e.gradient.shape, len(e.corner)
    wide = ChainEquations.zeros(count, size, shared + len(offsets))
    wide.diagonal, wide.following, wide.gradient = e.diagonal, e.following, e.gradient
    wide.border[:, :, :shared], wide.corner[:shared, :shared] = e.dense_border(), e.corner
    wide.shared_gradient[:shared] = e.shared_gradient
    rows = problem.motion_rows()
    sigmas = problem.motion.steps(problem.times, problem.parameters).sigmas * problem.motion_scale
    weights = rows.root_weights[:, None] / sigmas
    K = np.stack([-_by_offset(problem, cameras == k + 1) * weights for k in range(len(offsets))], axis=2)
    columns = slice(shared, None)
    wide.border[:-1, :, columns] += rows.before.transpose(0, 2, 1) @ K
    wide.border[1:, :, columns] += rows.after.transpose(0, 2, 1) @ K
    odometry = slice(0, len(problem.parameters))
    across = np.zeros((len(problem.parameters), len(offsets)))
    np.add.at(across, rows.parameters, np.einsum("nrp,nrk->npk", rows.by_parameters, K))
    wide.corner[odometry, columns], wide.corner[columns, odometry] = across, across.T
    wide.corner[columns, columns] = np.einsum("nrj,nrk->jk", K, K) + PRIOR_S**-2 * np.eye(len(offsets))
    wide.shared_gradient[columns] = np.einsum("nrk,nr->k", K, rows.residuals) - offsets / PRIOR_S**2
    _, y = wide.solve()
    return y[shared:], np.sqrt(np.diag(wide.covariances()[2])[shared:])


def _by_offset(problem: BundleProblem, its: BoolArray) -> FloatArray:
    """(M-1,6) derivatives of the odometry's motions with one camera's offset."""
    span = CLOCK_SPAN_S * its
    later, earlier = (
        problem.motion.between(t[:-1], t[1:], problem.parameters)
        for t in (problem.times + span, problem.times - span)
    )
    turned = rotation_log(earlier[0].transpose(0, 2, 1) @ later[0])
    return np.hstack([later[1] - earlier[1], turned]) / (2 * CLOCK_SPAN_S)
