"""The landmark map from range and bearing readings and odometry."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.geometry.planar import planar_pose
from lmkit.geometry.pose import Pose
from lmkit.mapping.planar_smoother import smooth_planar
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark, wall_pose
from lmkit.model.observation import RangeBearing
from lmkit.model.pose_status import PoseStatus
from lmkit.model.recording import Gyro, Odometry
from lmkit.model.tracked_trajectory import TrackedTrajectory, _six
from lmkit.odometry.wheel_odometry import MotionModel

ReadingFrames = Sequence[tuple[float, Sequence[RangeBearing]]]


UNSEEN_M, UNSEEN_RAD = 1.0, 1.0  # heights and directions, which ranges and bearings do not determine


def survey_readings(
    frames: ReadingFrames, odometry: Odometry, gyro: Gyro | None, size_m: float
) -> tuple[LandmarkMap, TrackedTrajectory]:
    """Survey landmarks from ranges and bearings alone; the map's origin is the robot's first pose.

    Heights and directions are not observed: landmarks are put at height 0, facing the center of the recording, with
    large covariances.
    """
    times, motion = np.array([time_s for time_s, _ in frames]), MotionModel(odometry, gyro)
    motion.require_overlap(times)
    track = smooth_planar(times, [seen for _, seen in frames], motion, None)
    middle = track.states[:, :2].mean(axis=0)
    poses = [planar_pose(state) for state in track.states]
    return (
        planar_map(track.ids, track.places, track.place_covariances, middle, size_m),
        planar_trajectory(times, poses, track.covariances),
    )


def planar_map(
    ids: Sequence[LandmarkId], places: FloatArray, covariances: FloatArray, middle: FloatArray, size_m: float
) -> LandmarkMap:
    """Landmarks at places (L,2) with covariances (L,2,2); those without a place are left out.

    Args:
        middle: (2,) of the recording, which all of them face.
    """
    mapped = []
    for id_, place, C in zip(ids, places, covariances, strict=True):
        if not np.isfinite(place).all():
            continue
        toward = middle - place
        covariance = np.diag([0.0, 0.0, UNSEEN_M**2, *[UNSEEN_RAD**2] * 3])
        covariance[:2, :2] = C
        T = wall_pose([*place, 0.0], float(np.arctan2(toward[1], toward[0])))
        mapped.append(MappedLandmark(id_, size_m, T, covariance))
    return LandmarkMap(mapped)


def planar_trajectory(times_s: FloatArray, poses: Sequence[Pose], covariances: FloatArray) -> TrackedTrajectory:
    """Trajectory of a survey in the plane, covariances (N,3,3)."""
    return TrackedTrajectory(times_s, poses, _six(covariances), [PoseStatus.OK] * len(poses), [()] * len(poses))


def planar_map_dict(landmarks: LandmarkMap, frames: int, output: Path) -> dict[str, Any]:
    """The JSON result (docs/formats.md).

    Args:
        frames: number of times at which there were readings.
        output: the map file.
    """
    entries = [
        {
            "id": str(m.id),
            "code": m.code,
            "position": m.T_map_landmark.t.tolist(),
            "sigma_m": _sigma_m(m),
        }
        for m in landmarks
    ]
    return {"map": str(output), "landmarks": entries, "frames": frames}


def planar_map_lines(landmarks: LandmarkMap, frames: int, output: Path) -> list[str]:
    """A table of the landmarks, and a summary, as lines of text."""
    lines = []
    for m in landmarks:
        x, y, _ = m.T_map_landmark.t
        lines.append(f"{m.id!s:8} {x:8.3f} {y:8.3f}   +- {1000 * _sigma_m(m):.0f} mm")
    return [*lines, f"{len(landmarks)} landmarks in the plane, {frames} frames -> {output}"]


def _sigma_m(landmark: MappedLandmark) -> float:
    """Standard deviation of the position in the plane, both axes together."""
    assert landmark.covariance is not None
    return math.sqrt(landmark.covariance[0, 0] + landmark.covariance[1, 1])
