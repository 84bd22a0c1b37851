"""`lmkit.survey`, `lmkit.survey_recordings`, `lmkit.track` and `lmkit.evaluate`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from lmkit.api.arguments import (
    PathLike,
    as_map,
    as_meters,
    as_recording,
    as_rig,
    as_sigmas,
    as_trajectory,
    require_constraints,
    require_type,
)
from lmkit.errors import InputError
from lmkit.model.recording import Odometry, Recording
from lmkit.model.trajectory import Trajectory

if TYPE_CHECKING:
    from lmkit.evaluation.trajectory_error import TrajectoryError
    from lmkit.geometry.rig import AnyRig
    from lmkit.mapping.joint_survey import JointSurvey
    from lmkit.mapping.survey_results import Survey
    from lmkit.mapping.wall_constraints import LandmarkConstraint
    from lmkit.model.landmark_map import LandmarkMap
    from lmkit.model.tracked_trajectory import TrackedTrajectory
    from lmkit.odometry.motion_model import Motion


def survey(
    recording: Recording | PathLike,
    rig: AnyRig | PathLike,
    *,
    size: float | str = "180mm",
    known: LandmarkMap | PathLike | None = None,
    known_sigma: tuple[float, float] | None = None,
    constraints: Sequence[LandmarkConstraint] = (),
    keep_doubtful: bool = False,
) -> Survey:
    """Build the landmark map from a recording.

    Args:
        recording: frames of both cameras, with or without odometry; or the CSV of its detections.
        rig: the calibrated rig, or its file.
        size: side of the landmarks, meters or text with a unit; landmarks in ``known`` have their own.
        known: map of landmarks with known poses, at least one; it defines the map frame.
        known_sigma: standard deviation of their positions (m) and rotations (rad); None: as the map states.
        constraints: walls and heights that landmarks share.
        keep_doubtful: keep doubtful landmarks in the map; otherwise they are left out, with a warning.

    Returns:
        The map with covariances, the poses, and ``warnings`` in words.

    Raises:
        InputError: no usable frame, odometry of another time, or odometry without T_base_left in the rig.

    Examples:
        >>> import lmkit
        >>> recording = lmkit.read_recording(detections="detections.csv", odometry="odometry.csv", gyro="gyro.csv")
        >>> survey = lmkit.survey(recording, "rig.yaml")
        >>> survey
        Survey(... landmarks, ... of ... frames, ... px, ...)
    """
    import numpy as np

    from lmkit.geometry.planar import planar_state
    from lmkit.geometry.rig_plausibility import rig_warnings
    from lmkit.localization.contradiction import find_cause
    from lmkit.mapping.next_view import advise
    from lmkit.mapping.survey import anchors_of, landmark_sizes, survey_frames
    from lmkit.mapping.survey_results import base_poses, survey_warnings
    from lmkit.pipelines.recording_checks import odometry_doubt, require_plausible_recording

    cameras, size_m, sigma = as_rig(rig), as_meters(size, "size"), as_sigmas(known_sigma, known)
    recording = as_recording(recording, cameras)
    if not recording.frames:
        raise InputError("no_frames", "the recording has no frames", "give images or detections")
    motion = motion_of(recording)
    require_plausible_recording(recording, cameras, None if known is None else as_map(known), size_m)
    anchors = {} if known is None else anchors_of(as_map(known), sigma)
    frames = list(recording.frames)
    sizes = landmark_sizes(frames, size_m, anchors)
    require_constraints(constraints)
    cause = None if known is None else find_cause(frames, cameras, as_map(known))
    try:
        result = survey_frames(frames, cameras, sizes, anchors, motion, constraints, keep_doubtful)
    except InputError as error:
        if cause is None or error.code != "nothing_located":
            raise
        raise InputError(cause.code, error.message, str(cause)) from None
    texts = survey_warnings(result, motion, list(constraints), advise(result, cameras))
    if isinstance(recording.odometry, Odometry):
        bundle = result.bundle
        states = np.array([planar_state(pose) for _, pose in base_poses(bundle, cameras)])
        doubt = odometry_doubt(recording.odometry, bundle.times_s, states)
        texts = [*([doubt] if doubt else []), *texts]
    if cause is not None:
        texts.insert(0, f"the known landmarks contradict the observations: {cause}")
    texts = [*rig_warnings(cameras, "the rig"), *texts]
    return replace(result, landmarks=_with_history(result.landmarks, known), warnings=tuple(texts))


def survey_recordings(
    recordings: Mapping[str, Recording | PathLike],
    rig: AnyRig | PathLike | Mapping[str, AnyRig | PathLike],
    *,
    size: float | str = "180mm",
    known: LandmarkMap | PathLike | None = None,
    known_sigma: tuple[float, float] | None = None,
    constraints: Sequence[LandmarkConstraint] = (),
    keep_doubtful: bool = False,
) -> JointSurvey:
    """Build one landmark map from several recordings of one place.

    Each recording is surveyed alone; recordings are joined by the landmarks that they share, and adjusted jointly.
    A recording that does not fit is left out and named.  A landmark that was moved in between has two entries.

    Args:
        recordings: by name, from the earliest to the latest.
        rig: the calibrated rig, or its file; or a rig for each name.
        size, known, known_sigma, constraints, keep_doubtful: see :func:`survey`.

    Returns:
        The map with covariances, the survey of each recording, ``left_out``, ``moved``, and ``warnings`` in words.

    Raises:
        InputError: no recordings, or none of them can be surveyed.

    Examples:
        >>> import lmkit
        >>> recording = lmkit.read_recording(detections="detections.csv", odometry="odometry.csv", gyro="gyro.csv")
        >>> halves = [lmkit.Recording(frames, (), recording.odometry, recording.gyro)
        ...           for frames in (recording.frames[:75], recording.frames[75:])]
        >>> joint = lmkit.survey_recordings(dict(zip(["monday", "tuesday"], halves)), "rig.yaml")
        >>> joint
        JointSurvey(... landmarks, 2 recordings, 0 left out, ...)
    """
    from lmkit.mapping.joint_survey import joint_warnings
    from lmkit.mapping.several_recordings import NamedRecording
    from lmkit.mapping.several_recordings import survey_recordings as survey_together
    from lmkit.mapping.survey import anchors_of, landmark_sizes
    from lmkit.pipelines.recording_checks import require_plausible_recording

    require_type(recordings, Mapping, "recordings", 'give them by name, such as {"monday": monday}')
    if not recordings:
        raise InputError("no_recordings", "no recordings are given", "give at least one, by its name")
    size_m, sigma = as_meters(size, "size"), as_sigmas(known_sigma, known)
    anchors = {} if known is None else anchors_of(as_map(known), sigma)
    rigs = _rig_of_each(rig, list(recordings))
    opened = {name: as_recording(recording, rigs[name]) for name, recording in recordings.items()}
    for name, recording in opened.items():
        require_plausible_recording(recording, rigs[name], None if known is None else as_map(known), size_m)
    frames = [frame for recording in opened.values() for frame in recording.frames]
    named = [
        NamedRecording(name, recording.frames, rigs[name], motion_of(recording)) for name, recording in opened.items()
    ]
    sizes = landmark_sizes(frames, size_m, anchors)
    require_constraints(constraints)
    result = survey_together(named, sizes, anchors, constraints, keep_doubtful=keep_doubtful)
    return replace(result, landmarks=_with_history(result.landmarks, known), warnings=joint_warnings(result))


def _with_history(found: LandmarkMap, known: LandmarkMap | PathLike | None) -> LandmarkMap:
    """The surveyed map, with earlier places of landmarks from the known map."""
    return found if known is None else found.with_history_of(as_map(known))


def _rig_of_each(rig: AnyRig | PathLike | Mapping[str, AnyRig | PathLike], names: Sequence[str]) -> dict[str, AnyRig]:
    if not isinstance(rig, Mapping):
        return dict.fromkeys(names, as_rig(rig))
    if missing := [name for name in names if name not in rig]:
        hint = "give a rig for each name, or one rig for all"
        raise InputError("no_rig", f"recording {missing[0]!r} has no rig", hint)
    return {name: as_rig(rig[name]) for name in names}


def track(
    recording: Recording | PathLike,
    rig: AnyRig | PathLike | None,
    landmarks: LandmarkMap | PathLike,
    *,
    live: bool = False,
) -> TrackedTrajectory:
    """Track the robot through a known map.

    Args:
        recording: frames, or range and bearing readings with wheel odometry; or the CSV of its detections.
        rig: the calibrated rig, or its file; None for readings.
        landmarks: the landmark map, or its file.
        live: causal filtering: each pose uses only data up to its time; it needs odometry.

    Raises:
        InputError: no landmark of the map is in view, or odometry is missing or of another time.

    Examples:
        >>> import lmkit
        >>> recording = lmkit.read_recording(detections="detections.csv", odometry="odometry.csv", gyro="gyro.csv")
        >>> trajectory = lmkit.track(recording, "rig.yaml", "map.yaml")
        >>> trajectory.positions.shape[1]
        3
    """
    from lmkit.geometry.rig_plausibility import rig_warnings
    from lmkit.localization.contradiction import find_cause
    from lmkit.pipelines.recording_checks import require_plausible_recording

    mapped, known_rig = as_map(landmarks), None if rig is None else as_rig(rig)
    recording = as_recording(recording, known_rig)
    require_plausible_recording(recording, known_rig, mapped)
    mapped.require_any(recording.ids)
    if recording.readings:
        return _track_readings(recording, mapped, live)
    if known_rig is None:
        raise InputError("no_rig", "frames need a rig", "give the rig, or its file")
    cameras, frames = known_rig, list(recording.frames)
    try:
        tracked = _track_frames(recording, cameras, mapped, live)
    except InputError as error:
        if error.code != "nothing_located" or (cause := find_cause(frames, cameras, mapped)) is None:
            raise
        raise InputError(cause.code, error.message, str(cause)) from None
    remarks = tracked.remarks
    if live and not tracked.sure and (cause := find_cause(frames, cameras, mapped)) is not None:
        remarks = (str(cause), *remarks)
    return replace(tracked, remarks=(*rig_warnings(cameras, "the rig"), *remarks))


def _track_readings(recording: Recording, landmarks: LandmarkMap, live: bool) -> TrackedTrajectory:
    from lmkit.localization.range_bearing_noise import DRIVE_NOISE
    from lmkit.localization.readings_contradiction import find_readings_cause
    from lmkit.tracking.batch import track_readings
    from lmkit.tracking.online import track_live

    odometry = recording.odometry
    if not isinstance(odometry, Odometry):
        raise InputError("no_odometry", "readings need wheel odometry", "read the recording with odometry=...")
    frames = [(time_s, list(seen)) for time_s, seen in recording.readings]
    tracked = (track_live if live else track_readings)(frames, odometry, recording.gyro, landmarks)
    cause = find_readings_cause([seen for _, seen in frames], landmarks, DRIVE_NOISE)
    return tracked if cause is None else replace(tracked, remarks=(str(cause), *tracked.remarks))


def _track_frames(recording: Recording, rig: AnyRig, landmarks: LandmarkMap, live: bool) -> TrackedTrajectory:
    from lmkit.tracking.batch import track_images
    from lmkit.tracking.online import track_images_live, track_poses_live

    frames, odometry = list(recording.frames), recording.odometry
    if not live:
        return track_images(frames, rig, landmarks, motion_of(recording))
    if odometry is None:
        raise InputError("no_odometry", "live tracking needs odometry", "read the recording with odometry=...")
    if isinstance(odometry, Trajectory):
        return track_poses_live(frames, rig, landmarks, odometry)
    return track_images_live(frames, rig, landmarks, odometry, recording.gyro)


def evaluate(
    truth: Trajectory | PathLike,
    estimate: Trajectory | TrackedTrajectory | PathLike,
    *,
    align: str = "none",
    max_apart_s: float = 0.01,
) -> TrajectoryError:
    """Compare an estimated trajectory with the true one, as evo does.

    Args:
        truth, estimate: trajectories, or their files; of the result of `track`, the poses with status ``ok``.
        align: ``"none"``, ``"rigid"`` or ``"scale"`` (Umeyama 1991).
        max_apart_s: largest time difference between matched poses.

    Raises:
        InputError: no common times, or an unknown alignment.

    Examples:
        >>> import lmkit
        >>> lmkit.evaluate("truth.tum", "truth.tum").position_m.rmse
        0.0
    """
    from lmkit.evaluation.trajectory_error import compare_trajectories

    true, found = as_trajectory(truth, "truth"), as_trajectory(estimate, "estimate")
    return compare_trajectories(true, found, align, max_apart_s=max_apart_s)


def motion_of(recording: Recording) -> Motion | None:
    """Motion model of a recording's odometry; None without odometry."""
    from lmkit.odometry.pose_odometry import PoseMotion
    from lmkit.odometry.wheel_odometry import MotionModel

    if recording.odometry is None:
        return None
    if isinstance(recording.odometry, Trajectory):
        return PoseMotion(recording.odometry)
    return MotionModel(recording.odometry, recording.gyro)
