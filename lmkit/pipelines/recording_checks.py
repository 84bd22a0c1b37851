"""Plausibility of a whole recording: odometry, gyro and landmarks against each other, before anything is solved."""

from __future__ import annotations

import warnings

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.errors import InputError, InputWarning
from lmkit.geometry.planar import planar_state
from lmkit.geometry.rig import AnyRig
from lmkit.geometry.rig_plausibility import require_plausible
from lmkit.io.readings import FARTHEST_M, LARGEST_RAD
from lmkit.localization.absolute_pose import locate_rig
from lmkit.localization.mirror import find_mirror
from lmkit.localization.range_bearing import locate_planar
from lmkit.localization.rig_contradiction import find_rig_cause, size_doubt
from lmkit.model.corner_order import require_clockwise
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.pose_status import PoseStatus
from lmkit.model.recording import Odometry, Recording
from lmkit.odometry.plausibility import (
    require_agreement,
    require_one_clock,
    require_plausible_gyro,
    require_plausible_odometry,
    require_seconds,
)

MOST_LOCATED = 80


def require_plausible_recording(
    recording: Recording,
    rig: AnyRig | None = None,
    landmarks: LandmarkMap | None = None,
    size_m: float | None = None,
) -> None:
    """Refuse a recording that contradicts itself, or the map, in a way that has a name.

    Args:
        rig: of frames; its T_base_left compares odometry with them.
        landmarks: known ones, if any.
        size_m: side of those that are not known; None: they are left out.

    Raises:
        InputError: says the unit, the sign, the order or the clock that is likely wrong.
    """
    require_seconds(recording.times_s)
    require_clockwise(o for frame in recording.frames for o in frame.detections)
    _require_plausible_readings(recording)
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
            warnings.warn(InputWarning(doubt), stacklevel=3)
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
        times_s, states = _located(recording, rig, landmarks)
        require_agreement(odometry, times_s, states)


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


def _located(recording: Recording, rig: AnyRig | None, landmarks: LandmarkMap) -> tuple[FloatArray, FloatArray]:
    """(K,), (K,3) times and planar poses of the robot by landmarks alone."""
    rows = []
    if rig is not None and rig.T_base_left is not None:
        frames, T_left_base = recording.frames, rig.T_base_left.inverse()
        for frame in frames[:: 1 + len(frames) // MOST_LOCATED]:
            found = locate_rig(frame.seen, rig, landmarks)
            if found.status == PoseStatus.OK and found.T_map_camera is not None:
                rows.append((frame.time_s, *planar_state(found.T_map_camera @ T_left_base)))
    for time_s, seen in recording.readings:
        planar = locate_planar(seen, landmarks)
        pose = planar.pose
        if planar.status == PoseStatus.OK and pose is not None and pose.heading_rad is not None:
            rows.append((time_s, pose.x_m, pose.y_m, pose.heading_rad))
    table = np.array(rows, dtype=np.float64).reshape(-1, 4)
    return table[:, 0], table[:, 1:]


def odometry_doubt(odometry: Odometry, times_s: FloatArray, states: FloatArray) -> str | None:
    """A sentence where poses (K,3), found by landmarks for the most part, contradict the odometry; else None."""
    try:
        require_agreement(odometry, times_s, states)
    except InputError as error:
        return str(error)
    return None
