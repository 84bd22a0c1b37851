"""Plausibility of a whole recording: odometry, gyro and landmarks against each other, before anything is solved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.errors import InputError, InputWarning, warn_caller
from lmkit.geometry.planar import planar_state
from lmkit.geometry.rig import AnyRig
from lmkit.geometry.rig_plausibility import require_plausible
from lmkit.io.readings import FARTHEST_M, LARGEST_RAD
from lmkit.localization.absolute_pose import locate_rig
from lmkit.localization.mirror import find_mirror
from lmkit.localization.range_bearing import locate_planar
from lmkit.localization.range_bearing_noise import DRIVE_NOISE
from lmkit.localization.readings_contradiction import ANOTHER_MAP, find_readings_cause
from lmkit.localization.rig_contradiction import find_rig_cause, size_doubt
from lmkit.model.corner_order import require_clockwise
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.pose_status import PoseStatus
from lmkit.model.recording import Odometry, Recording, RigFrame
from lmkit.odometry.plausibility import (
    require_agreement,
    require_one_clock,
    require_plausible_gyro,
    require_plausible_odometry,
    require_seconds,
)

MOST_LOCATED = 80
# Limits for shuffled frames: least number of frames; consecutive frames share at most this share more landmarks than
# any two frames; any two frames share at most this share; longest median interval, s, with common landmarks.
LEAST_ORDERED, IN_ORDER, MOSTLY_ALIKE, ORDERED_S = 20, 0.25, 0.7, 2.5
FLOORS_APART_M, LEAST_ON_FLOOR = 1.5, 3
LEAST_LANDMARKS = 2  # on a floor; a single landmark with a wrong height in the map also gives poses at another height


def require_plausible_recording(
    recording: Recording,
    rig: AnyRig | None = None,
    landmarks: LandmarkMap | None = None,
    size_m: float | None = None,
) -> None:
    """Refuse a recording that contradicts itself or the map, if the kind of error is recognized.

    Args:
        rig: rig of the frames; T_base_left is needed to compare odometry with frames.
        landmarks: known ones, if any.
        size_m: side of unknown landmarks; None: these are ignored.

    Raises:
        InputError: names the unit, sign, order or clock that is probably wrong.
    """
    require_seconds(recording.times_s)
    require_clockwise(o for frame in recording.frames for o in frame.detections)
    _require_plausible_readings(recording)
    if landmarks is not None:
        _require_agreeing_readings(recording, landmarks)
    if (doubt := order_doubt(recording.frames)) is not None:
        warn_caller(InputWarning(doubt))
    if rig is not None:
        require_plausible(rig, "the rig")
        if landmarks is not None and (cause := find_mirror(recording.frames, rig, landmarks)) is not None:
            what, _, hint = str(cause).partition(": ")
            raise InputError(cause.code, what, hint)
        sizes = {} if size_m is None else dict.fromkeys(recording.ids, size_m)
        sizes |= {} if landmarks is None else {m.id: m.size_m for m in landmarks}
        if (cause := find_rig_cause(recording.frames, rig, sizes)) is not None:
            what, _, hint = str(cause).partition(": ")
            raise InputError(cause.code, f"the two cameras contradict each other: {what}", hint)
        if (doubt := size_doubt(recording.frames, rig, sizes)) is not None:
            warn_caller(InputWarning(doubt))
    odometry = recording.odometry
    if odometry is None:
        return
    times_s = recording.times_s
    if len(times_s) > 1 and len(odometry.times_s) > 1:
        what = "the readings" if recording.readings else "the images"
        require_one_clock(odometry.times_s, times_s, "odometry", what)
    require_plausible_odometry(odometry)
    if not isinstance(odometry, Odometry):
        return
    if recording.gyro is not None:
        require_plausible_gyro(recording.gyro, odometry)
    if landmarks is not None:
        poses = _located(recording, rig, landmarks)
        _require_one_floor(poses)
        states = np.array([pose.state for pose in poses]).reshape(-1, 3)
        require_agreement(odometry, np.array([pose.time_s for pose in poses]), states)


def _require_plausible_readings(recording: Recording) -> None:
    for time_s, seen in recording.readings:
        for reading in seen:
            range_m, bearing_rad = reading.range_m, reading.bearing_rad
            if range_m is not None and not 0 < range_m <= FARTHEST_M:
                what = f"range of {range_m:g} m"
            elif bearing_rad is not None and not abs(bearing_rad) <= LARGEST_RAD:
                what = f"bearing of {bearing_rad:g} rad"
            else:
                continue
            hint = "give ranges in meters and bearings in radians"
            raise InputError("bad_reading", f"a {what} to {reading.id} at {time_s:g} s is not a reading", hint)


def _require_agreeing_readings(recording: Recording, landmarks: LandmarkMap) -> None:
    cause = find_readings_cause([seen for _, seen in recording.readings], landmarks, DRIVE_NOISE)
    if cause is not None and cause.code != ANOTHER_MAP:
        what, _, hint = str(cause).partition(": ")
        raise InputError(cause.code, f"the readings contradict the map: {what}", hint)


def order_doubt(frames: Sequence[RigFrame]) -> str | None:
    """A sentence if consecutive frames have no more landmarks in common than any two frames; else None.

    This may be so for single images from different places, but not for a moving robot's frames, seconds apart.
    """
    seen = [(frame.time_s, frozenset(d.id for d in frame.detections)) for frame in frames]
    seen = [(time_s, ids) for time_s, ids in seen if ids]
    if len(seen) < LEAST_ORDERED or np.median(np.diff([time_s for time_s, _ in seen])) > ORDERED_S:
        return None
    ids = [ids for _, ids in seen]
    mixed = [ids[k] for k in np.random.default_rng(0).permutation(len(ids))]
    next_to, any_two = _alike(ids), _alike(mixed)
    if any_two > MOSTLY_ALIKE or next_to > any_two + IN_ORDER * (1 - any_two):
        return None
    return (
        f"frames that follow each other share {100 * next_to:.0f} % of their landmarks, any two frames "
        f"{100 * any_two:.0f} %: are the time stamps shuffled? Give each frame the time of its own image"
    )


def _alike(ids: Sequence[frozenset[LandmarkId]]) -> float:
    """Mean ratio of the common landmarks of consecutive frames to all landmarks of both."""
    return float(np.mean([len(a & b) / len(a | b) for a, b in pairwise(ids)]))


@dataclass(frozen=True)
class _LocatedPose:
    """The robot's pose from landmarks only.

    Attributes:
        state: x, y (m) and heading (rad).
        height_m: 0 for readings, which do not determine it.
        landmarks: detected landmarks of the map.
    """

    time_s: float
    state: tuple[float, float, float]
    height_m: float
    landmarks: frozenset[LandmarkId]


def _located(recording: Recording, rig: AnyRig | None, landmarks: LandmarkMap) -> list[_LocatedPose]:
    """Poses of at most `MOST_LOCATED` of the recording's frames, and of its readings."""
    poses, known = [], frozenset(m.id for m in landmarks)
    if rig is not None and rig.T_base_left is not None:
        frames, T_left_base = recording.frames, rig.T_base_left.inverse()
        for frame in frames[:: 1 + len(frames) // MOST_LOCATED]:
            found = locate_rig(frame.seen, rig, landmarks)
            if found.status == PoseStatus.OK and found.T_map_camera is not None:
                T_map_base = found.T_map_camera @ T_left_base
                x, y, heading = planar_state(T_map_base)
                seen = known & {o.id for o in frame.detections}
                poses.append(_LocatedPose(frame.time_s, (x, y, heading), float(T_map_base.t[2]), seen))
    for time_s, readings in recording.readings:
        planar = locate_planar(readings, landmarks)
        pose = planar.pose
        if planar.status == PoseStatus.OK and pose is not None and pose.heading_rad is not None:
            seen = known & {reading.id for reading in readings}
            poses.append(_LocatedPose(time_s, (pose.x_m, pose.y_m, pose.heading_rad), 0.0, seen))
    return poses


def _require_one_floor(poses: Sequence[_LocatedPose]) -> None:
    """Refuse a robot on wheels that is on two floors.

    Raises:
        InputError: ``two_floors``, with the heights and times.
    """
    upward = sorted(poses, key=lambda pose: pose.height_m)
    steps = [above.height_m - below.height_m for below, above in pairwise(upward)]
    if max(steps, default=0.0) < FLOORS_APART_M:
        return
    cut = 1 + int(np.argmax(steps))
    floors = sorted((upward[:cut], upward[cut:]), key=lambda floor: float(np.median([pose.time_s for pose in floor])))
    for floor in floors:
        there = frozenset[LandmarkId]().union(*(pose.landmarks for pose in floor))
        if len(floor) < LEAST_ON_FLOOR or len(there) < LEAST_LANDMARKS:
            return
    where = " and ".join(
        f"{np.median([pose.height_m for pose in floor]):.1f} m high from {min(pose.time_s for pose in floor):.1f} to "
        f"{max(pose.time_s for pose in floor):.1f} s"
        for floor in floors
    )
    hint = "cut the recording where it changes floors; wheel odometry is limited to one floor, poses (TUM) are not"
    raise InputError("two_floors", f"the landmarks show the robot {where}: two floors in one recording", hint)


def odometry_doubt(odometry: Odometry, times_s: FloatArray, states: FloatArray) -> str | None:
    """A sentence if poses (K,3), mostly from landmarks, contradict the odometry; else None."""
    try:
        require_agreement(odometry, times_s, states)
    except InputError as error:
        return str(error)
    return None
