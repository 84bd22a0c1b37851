"""A recording through a known map: what `lmkit track` gives, whatever saw the landmarks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lmkit.arrays import BoolArray, FloatArray, IntArray
from lmkit.geometry.planar import planar_pose
from lmkit.geometry.stereo_rig import StereoRig, at_base
from lmkit.mapping.bundle_adjustment import Anchor
from lmkit.mapping.initialization import find_start
from lmkit.mapping.planar_smoother import smooth_planar
from lmkit.mapping.range_bearing_survey import ReadingFrames
from lmkit.mapping.survey import OUTLIER_SIGMA, contradicted_landmarks, optimize_all
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.pose_status import PoseStatus
from lmkit.model.recording import Gyro, Odometry, StereoFrame
from lmkit.model.tracked_trajectory import TrackedTrajectory, _six
from lmkit.odometry.motion_model import Motion, describe_odometry
from lmkit.odometry.wheel_odometry import PARAMETERS, MotionModel

LOST_M = 1.0  # a position less sure than that is worth no word
OUTLIER_WEIGHT = 0.1


def track_readings(
    frames: ReadingFrames, odometry: Odometry, gyro: Gyro | None, landmarks: LandmarkMap
) -> TrackedTrajectory:
    """All of the recording at once, from ranges and bearings (`planar_smoother.py`)."""
    times, motion = np.array([time_s for time_s, _ in frames]), MotionModel(odometry, gyro)
    motion.require_overlap(times)
    track = smooth_planar(times, [seen for _, seen in frames], motion, landmarks)
    outliers: list[tuple[LandmarkId, ...]] = [() for _ in frames]
    for row in np.flatnonzero(track.weights < OUTLIER_WEIGHT):
        outliers[track.frames[row]] += (track.ids[track.landmarks[row]],)
    C = track.covariances
    lost = np.sqrt(np.linalg.eigvalsh(C[:, :2, :2])[:, -1]) > LOST_M
    return TrackedTrajectory(
        times,
        [planar_pose(state) for state in track.states],
        _six(C),
        [PoseStatus.LOST if far else PoseStatus.OK for far in lost],
        outliers,
        dict(zip(PARAMETERS, track.parameters.tolist(), strict=True)),
        remarks=_doubts(motion, track.parameters),
        nis=_summed(len(times), track.frames, track.squared, track.nis_dof, track.weights > OUTLIER_WEIGHT),
    )


def _summed(
    count: int, frames: IntArray, squared: FloatArray, nis_dof: FloatArray, believed: BoolArray
) -> FloatArray:
    """(N,2) sums by frame of (R,) squared errors and of how many numbers they are of."""
    rows = frames[believed]
    return np.column_stack([np.bincount(rows, values[believed], count) for values in (squared, nis_dof)])


def track_pictures(
    frames: Sequence[StereoFrame],
    rig: StereoRig,
    landmarks: LandmarkMap,
    motion: Motion | None,
) -> TrackedTrajectory:
    """All of the recording at once, from what both cameras saw: bundle adjustment with the map held.

    Landmarks that the map knows exactly do not move; those that it knows with a covariance may, as far as that
    allows, so that what the map leaves open enters the poses' covariance.

    Raises:
        InputError: no landmark of the map is in view, or odometry without T_base_left or of another time.
    """
    known = {m.id: Anchor(m, m.covariance) for m in landmarks}
    start = find_start(frames, rig, {}, known, motion)
    # Exactly known, they are held and need no unknowns of their own.
    exact = all(m.covariance is None for m in landmarks)
    problem = start.problem(frames, rig, motion, landmarks_fixed=exact)
    optimize_all(problem)
    bundle = problem.answer(OUTLIER_SIGMA)
    found, covariances = at_base(bundle.left_poses(), np.array(bundle.covariances), rig)
    outliers: list[tuple[LandmarkId, ...]] = [() for _ in start.rows]
    for row in np.flatnonzero(bundle.residuals > OUTLIER_SIGMA):
        outliers[bundle.frames[row]] += (bundle.ids[bundle.of[row]],)
    wide = np.sqrt(np.linalg.eigvalsh(covariances[:, :2, :2])[:, -1]) > LOST_M
    return TrackedTrajectory(
        bundle.times_s,
        found,
        covariances,
        [PoseStatus.LOST if far else PoseStatus.OK for far in wide],
        outliers,
        {} if motion is None else dict(zip(motion.names, bundle.parameters.tolist(), strict=True)),
        rig.T_base_left is not None,
        (*map(str, contradicted_landmarks(bundle)), *_doubts(motion, bundle.parameters)),
        _summed(
            len(start.rows),
            bundle.frames,
            8 * bundle.residuals**2,
            np.full(len(bundle.residuals), 8.0),
            bundle.residuals < OUTLIER_SIGMA,
        ),
    )


def _doubts(motion: Motion | None, parameters: FloatArray) -> tuple[str, ...]:
    doubt = None if motion is None else describe_odometry(motion, parameters)
    return () if doubt is None else (doubt,)
