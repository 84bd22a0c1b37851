"""Tracking of a whole recording through a known map, from images or from ranges and bearings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lmkit.arrays import BoolArray, FloatArray, IntArray
from lmkit.geometry.planar import planar_pose
from lmkit.geometry.rig import AnyRig, at_base
from lmkit.localization.contradiction import find_cause
from lmkit.localization.range_bearing_noise import ReadingNoise
from lmkit.mapping.bundle_adjustment import Anchor
from lmkit.mapping.carried_cameras import are_synchronous, split_by_exposure, synchronous
from lmkit.mapping.planar_smoother import smooth_planar
from lmkit.mapping.range_bearing_survey import ReadingFrames
from lmkit.mapping.survey import OUTLIER_SIGMA, contradicted_landmarks, optimize_all, start_of
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.pose_status import PoseStatus
from lmkit.model.recording import Gyro, Odometry, RigFrame
from lmkit.model.tracked_trajectory import TrackedTrajectory, _six
from lmkit.odometry.motion_model import Motion, describe_odometry
from lmkit.odometry.wheel_odometry import PARAMETERS, MotionModel

LOST_M = 1.0  # a position with a larger standard deviation is not reported
OUTLIER_WEIGHT = 0.1


def track_readings(
    frames: ReadingFrames,
    odometry: Odometry,
    gyro: Gyro | None,
    landmarks: LandmarkMap,
    noise: ReadingNoise | None = None,
) -> TrackedTrajectory:
    """Track the whole recording at once, from ranges and bearings (`planar_smoother.py`)."""
    times, motion = np.array([time_s for time_s, _ in frames]), MotionModel(odometry, gyro)
    motion.require_overlap(times)
    track = smooth_planar(times, [seen for _, seen in frames], motion, landmarks, noise)
    outliers: list[tuple[LandmarkId, ...]] = [() for _ in frames]
    for row in np.flatnonzero(track.weights < OUTLIER_WEIGHT):
        outliers[track.frames[row]] += (track.ids[track.landmarks[row]],)
    C = track.covariances
    statuses = judged(C, track.frames, track.landmarks, track.weights > OUTLIER_WEIGHT)
    return TrackedTrajectory(
        times,
        [planar_pose(state) for state in track.states],
        _six(C),
        statuses,
        outliers,
        dict(zip(PARAMETERS, track.parameters.tolist(), strict=True)),
        remarks=_doubts(motion, track.parameters),
        parameter_sigmas=dict(zip(PARAMETERS, track.parameter_sigmas.tolist(), strict=True)),
        nis=_summed(len(times), track.frames, track.squared, track.nis_dof, track.weights > OUTLIER_WEIGHT),
    )


def judged(covariances: FloatArray, frames: IntArray, landmarks: IntArray, believed: BoolArray) -> list[PoseStatus]:
    """Status of every pose: it is inconsistent if most observations of its frame contradict it.

    If most frames contradict their poses, the agreement of the others is accidental.

    Args:
        covariances: (N,...) of the poses, x and y (m) first.
        frames, landmarks, believed: (R,) frame and landmark of every observation, and whether it fits.
    """
    count = len(covariances)
    pairs, of = np.unique(np.column_stack([frames, landmarks]), axis=0, return_inverse=True)
    explained = np.bincount(of.ravel(), believed, len(pairs)) > 0
    seen, fitting = (np.bincount(pairs[:, 0], weights, count) for weights in (None, explained))
    contradicted = 2 * fitting < seen
    if 2 * contradicted.sum() > (seen > 0).sum():
        contradicted[:] = True
    lost = np.sqrt(np.linalg.eigvalsh(covariances[:, :2, :2])[:, -1]) > LOST_M
    return [
        PoseStatus.LOST if far else PoseStatus.INCONSISTENT if off else PoseStatus.OK
        for far, off in zip(lost, contradicted, strict=True)
    ]


def _summed(
    count: int, frames: IntArray, squared: FloatArray, nis_dof: FloatArray, believed: BoolArray
) -> FloatArray:
    """(N,2) sums by frame of (R,) squared errors and of their degrees of freedom."""
    rows = frames[believed]
    return np.column_stack([np.bincount(rows, values[believed], count) for values in (squared, nis_dof)])


def track_images(
    frames: Sequence[RigFrame],
    rig: AnyRig,
    landmarks: LandmarkMap,
    motion: Motion | None,
) -> TrackedTrajectory:
    """Track the whole recording at once, from images: bundle adjustment with the known map.

    Landmarks without a covariance are fixed; those with a covariance are refined within it,
    so that the poses' covariance includes the uncertainty of the map.

    Raises:
        InputError: no landmark of the map is in view, or odometry without T_base_left or of another time.
    """
    if motion is None or are_synchronous(frames, rig):
        return _track(frames, rig, landmarks, motion)
    split = split_by_exposure(frames, rig)
    return _track(split, synchronous(rig), landmarks, motion).at_times(np.array([frame.time_s for frame in frames]))


def _track(
    frames: Sequence[RigFrame], rig: AnyRig, landmarks: LandmarkMap, motion: Motion | None
) -> TrackedTrajectory:
    known = {m.id: Anchor(m, m.covariance) for m in landmarks}
    start = start_of(frames, rig, {}, known, motion)
    # Exact landmarks are fixed and need no unknowns.
    exact = all(m.covariance is None for m in landmarks)
    problem = start.problem(frames, rig, motion, landmarks_fixed=exact)
    optimize_all(problem)
    bundle = problem.answer(OUTLIER_SIGMA)
    found, covariances = at_base(bundle.left_poses(), np.array(bundle.covariances), rig)
    outliers: list[tuple[LandmarkId, ...]] = [() for _ in start.rows]
    for row in np.flatnonzero(bundle.residuals > OUTLIER_SIGMA):
        outliers[bundle.frames[row]] += (bundle.ids[bundle.of[row]],)
    statuses = judged(covariances, bundle.frames, bundle.of, bundle.residuals <= OUTLIER_SIGMA)
    remarks = (*map(str, contradicted_landmarks(bundle)), *_doubts(motion, bundle.parameters))
    if PoseStatus.OK not in statuses and (cause := find_cause(frames, rig, landmarks)) is not None:
        remarks = (str(cause),)
    return TrackedTrajectory(
        bundle.times_s,
        found,
        covariances,
        statuses,
        outliers,
        {} if motion is None else dict(zip(motion.names, bundle.parameters.tolist(), strict=True)),
        rig.T_base_left is not None,
        remarks,
        _summed(
            len(start.rows),
            bundle.frames,
            8 * bundle.residuals**2,
            np.full(len(bundle.residuals), 8.0),
            bundle.residuals < OUTLIER_SIGMA,
        ),
        {} if motion is None else dict(zip(motion.names, bundle.parameter_sigmas.tolist(), strict=True)),
    )


def _doubts(motion: Motion | None, parameters: FloatArray) -> tuple[str, ...]:
    doubt = None if motion is None else describe_odometry(motion, parameters)
    return () if doubt is None else (doubt,)
