"""Live tracking: each pose uses only the data up to its time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.geometry.planar import planar_pose
from lmkit.geometry.rig import AnyRig, at_base
from lmkit.localization.absolute_pose import locate_rig
from lmkit.mapping.carried_cameras import are_synchronous, split_by_exposure, synchronous
from lmkit.mapping.range_bearing_survey import ReadingFrames
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.pose_status import PoseStatus
from lmkit.model.recording import Gyro, Odometry, RigFrame
from lmkit.model.tracked_trajectory import TrackedTrajectory, _six
from lmkit.model.trajectory import Trajectory
from lmkit.odometry.online_wheel_odometry import Wheels
from lmkit.odometry.pose_odometry import PoseMotion
from lmkit.odometry.wheel_odometry import PARAMETERS, MotionModel
from lmkit.tracking.planar_stereo_filter import RigFilter
from lmkit.tracking.range_bearing_filter import PlanarFilter, TrackedPose
from lmkit.tracking.spatial_stereo_filter import PoseFilter, SpacePose

CORNER_NUMBERS, READING_NUMBERS = 8, 2  # of one observation: corner coordinates; range and bearing
FLOOR_LOOKS, OFF_FLOOR_M = 5, 0.1


def track_live(
    frames: ReadingFrames, odometry: Odometry, gyro: Gyro | None, landmarks: LandmarkMap
) -> TrackedTrajectory:
    """Track frame by frame (`range_bearing_filter.py`); frames before the first fix are left out."""
    filter_ = PlanarFilter(landmarks)
    times = [time_s for time_s, _ in frames]
    answers = run_live(times, lambda k: filter_.observe(*frames[k]), filter_.wheels, odometry, gyro)
    return tracked_planar(answers, filter_.parameters, READING_NUMBERS)


def track_images_live(
    frames: Sequence[RigFrame], rig: AnyRig, landmarks: LandmarkMap, odometry: Odometry, gyro: Gyro | None
) -> TrackedTrajectory:
    """Track frame by frame on a level floor, from the corners of all cameras (`planar_stereo_filter.py`).

    Raises:
        InputError: the rig has no T_base_left, or odometry of another time.
    """
    if not are_synchronous(frames, rig):
        own = np.array([frame.time_s for frame in frames])
        split = split_by_exposure(frames, rig)
        return track_images_live(split, synchronous(rig), landmarks, odometry, gyro).at_times(own)
    filter_ = RigFilter(landmarks, rig)
    times = [frame.time_s for frame in frames]

    def observe(k: int) -> TrackedPose:
        return filter_.observe(times[k], frames[k].seen)

    answers = run_live(times, observe, filter_.wheels, odometry, gyro)
    tracked = tracked_planar(answers, filter_.parameters, CORNER_NUMBERS)
    return replace(tracked, remarks=(*_floor_doubt(frames, rig, landmarks), *tracked.remarks))


def track_poses_live(
    frames: Sequence[RigFrame], rig: AnyRig, landmarks: LandmarkMap, odometry: Trajectory
) -> TrackedTrajectory:
    """Track frame by frame in 3D, from corners and odometry's poses (`spatial_stereo_filter.py`).

    Frames before the first fix are left out.

    Raises:
        InputError: odometry of another time.
    """
    if not are_synchronous(frames, rig):
        own = np.array([frame.time_s for frame in frames])
        return track_poses_live(split_by_exposure(frames, rig), synchronous(rig), landmarks, odometry).at_times(own)
    PoseMotion(odometry).require_overlap(np.array([frame.time_s for frame in frames]))
    filter_, given, answers = PoseFilter(landmarks, rig), 0, []
    for frame in frames:
        while given < len(odometry) and odometry.times_s[given] <= frame.time_s:
            filter_.add_odometry(float(odometry.times_s[given]), odometry.pose(given, "odometry", "base"))
            given += 1
        answer = filter_.observe(frame.time_s, frame.seen)
        if answer.T_map_left is not None:
            answers.append(answer)
    poses, covariances = at_base(
        [answer.T_map_left for answer in answers if answer.T_map_left is not None],
        np.array([answer.covariance for answer in answers]).reshape(-1, 6, 6),
        rig,
    )
    return TrackedTrajectory(
        np.array([answer.time_s for answer in answers]),
        poses,
        covariances,
        [_status(answer, CORNER_NUMBERS) for answer in answers],
        [answer.outliers for answer in answers],
        of_base=rig.T_base_left is not None,
        remarks=_carried_off(answers, "odometry"),
        nis=_nis(answers),
    )


def run_live(
    times_s: Sequence[float],
    observe: Callable[[int], TrackedPose],
    wheels: Wheels,
    odometry: Odometry,
    gyro: Gyro | None,
) -> list[TrackedPose]:
    """Rows and frames in the order of time; frames before the first fix are left out."""
    MotionModel(odometry, gyro).require_overlap(np.array(times_s))
    rows = [
        (float(t), 0, float(f), float(w))
        for t, f, w in zip(odometry.times_s, odometry.forward_m, odometry.turn_rad, strict=True)
    ]
    if gyro is not None:
        rows += [(float(t), 1, float(rate), 0.0) for t, rate in zip(gyro.times_s, gyro.rate_radps, strict=True)]
    rows.sort()
    given, answers = 0, []
    for k, time_s in enumerate(times_s):
        while given < len(rows) and rows[given][0] <= time_s:
            time, kind, a, b = rows[given]
            if kind == 0:
                wheels.add_odometry(time, a, b)
            else:
                wheels.add_gyro(time, a)
            given += 1
        answer = observe(k)
        if answer.state is not None and answer.covariance is not None:
            answers.append(answer)
    return answers


def tracked_planar(answers: Sequence[TrackedPose], parameters: FloatArray, numbers: int) -> TrackedTrajectory:
    """Trajectory of planar answers.

    Args:
        parameters: errors of the odometry.
        numbers: of one observation.
    """
    return TrackedTrajectory(
        np.array([answer.time_s for answer in answers]),
        [planar_pose(answer.state) for answer in answers if answer.state is not None],
        _six(np.array([answer.covariance for answer in answers]).reshape(-1, 3, 3)),
        [_status(answer, numbers) for answer in answers],
        [answer.outliers for answer in answers],
        dict(zip(PARAMETERS, parameters.tolist(), strict=True)),
        remarks=_carried_off(answers, "wheels"),
        nis=_nis(answers),
    )


def _status(answer: TrackedPose | SpacePose, numbers: int) -> PoseStatus:
    """Status of a pose: if most observations contradict it, it is not ``ok``, however small its covariance.

    Args:
        numbers: of one observation.
    """
    contradicted = len(answer.outliers) > answer.nis_dof / numbers
    return PoseStatus.INCONSISTENT if contradicted and answer.status == PoseStatus.OK else answer.status


def _nis(answers: Sequence[TrackedPose] | Sequence[SpacePose]) -> FloatArray:
    return np.array([(answer.nis, answer.nis_dof) for answer in answers]).reshape(-1, 2)


def _carried_off(answers: Sequence[TrackedPose] | Sequence[SpacePose], prediction: str) -> tuple[str, ...]:
    return tuple(
        f"at {answer.time_s:.2f} s the robot was not where its {prediction} put it: was it carried?"
        for answer in answers[1:]
        if answer.restarted
    )


def _floor_doubt(frames: Sequence[RigFrame], rig: AnyRig, landmarks: LandmarkMap) -> tuple[str, ...]:
    """A sentence if the robot is not on the map's floor, according to the frames with most detections."""
    assert rig.T_base_left is not None
    base = rig.T_base_left.inverse().t  # in the left camera
    heights = []
    for frame in sorted(frames, key=lambda frame: -len(frame.detections))[:FLOOR_LOOKS]:
        found = locate_rig(frame.seen, rig, landmarks)
        if found.status == PoseStatus.OK and found.T_map_camera is not None:
            heights.append(float((found.T_map_camera.t + found.T_map_camera.R @ base)[2]))
    if not heights or abs(np.median(heights)) < OFF_FLOOR_M:
        return ()
    return (
        f"the robot is at z = {np.median(heights):.2f} m in the map, but live tracking with wheels assumes that the "
        "floor is z = 0; shift the map's heights, or track without live (--live)",
    )
