"""The landmark map from range and bearing readings and odometry."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lmkit.geometry.planar import planar_pose
from lmkit.mapping.planar_smoother import smooth_planar
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark, wall_pose
from lmkit.model.observation import RangeBearing
from lmkit.model.pose_status import PoseStatus
from lmkit.model.recording import Gyro, Odometry
from lmkit.model.tracked_trajectory import TrackedTrajectory, _six
from lmkit.odometry.wheel_odometry import MotionModel

Moments = Sequence[tuple[float, Sequence[RangeBearing]]]


UNSEEN_M, UNSEEN_RAD = 1.0, 1.0  # heights and directions that ranges and bearings do not show


def survey_readings(
    moments: Moments, odometry: Odometry, gyro: Gyro | None, size_m: float
) -> tuple[LandmarkMap, TrackedTrajectory]:
    """Survey landmarks from ranges and bearings alone; the map's origin is the robot's first pose.

    Heights and directions are not observed: landmarks are put at height 0, facing the middle of the recording, with
    covariances that say so.
    """
    times, motion = np.array([time_s for time_s, _ in moments]), MotionModel(odometry, gyro)
    motion.require_overlap(times)
    track = smooth_planar(times, [seen for _, seen in moments], motion, None)
    middle = track.states[:, :2].mean(axis=0)
    hung = []
    for id_, place, C in zip(track.ids, track.places, track.place_covariances, strict=True):
        if not np.isfinite(place).all():
            continue
        towards = middle - place
        covariance = np.diag([0.0, 0.0, UNSEEN_M**2, *[UNSEEN_RAD**2] * 3])
        covariance[:2, :2] = C
        T = wall_pose([*place, 0.0], float(np.arctan2(towards[1], towards[0])))
        hung.append(MappedLandmark(id_, size_m, T, covariance))
    drive = TrackedTrajectory(
        times,
        [planar_pose(state) for state in track.states],
        _six(track.covariances),
        [PoseStatus.OK] * len(times),
        [()] * len(times),
    )
    return LandmarkMap(hung), drive
