"""The filter of a live run: with wheels on a floor, with odometry poses in 3D, or with images only."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.geometry.planar import planar_pose
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import AnyRig, at_base
from lmkit.geometry.rotations import rotation_angle, rotation_exp, rotation_log
from lmkit.live.motion import GYRO, POSE, WHEELS, MotionRow
from lmkit.localization.absolute_pose import locate_rig
from lmkit.localization.pose_prior import PosePrior
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.observation import Detection
from lmkit.model.pose_status import PoseStatus
from lmkit.odometry.wheel_odometry import PARAMETERS
from lmkit.tracking.planar_stereo_filter import RigFilter
from lmkit.tracking.spatial_stereo_filter import PoseFilter

Seen = Sequence[Sequence[Detection]]
CORNER_NUMBERS = 8  # of one observation
DELAY = PARAMETERS.index("delay_s")
MOST_STEADY_S = 0.3  # two poses with a larger interval give no prediction
MOST_MPS, MOST_RADPS = 5.0, 6.0  # of a robot without odometry
SLACK_M, SLACK_RAD = 0.2, 0.2
_FLOOR = PosePrior()


@dataclass(frozen=True, eq=False)
class Estimate:
    """Pose of the base, or the reason why there is none.

    Attributes:
        status: of the filter.
        T_map_base, covariance: see `LiveState`; None if unknown.
        inliers, outliers: landmarks that agree with the pose, and landmarks that do not.
        restarted: whether the filter was restarted at a new pose.
        nis, nis_dof: see `LiveState`.
    """

    status: PoseStatus
    T_map_base: Pose | None = None
    covariance: FloatArray | None = None
    inliers: tuple[LandmarkId, ...] = ()
    outliers: tuple[LandmarkId, ...] = ()
    restarted: bool = False
    nis: float = 0.0
    nis_dof: int = 0


class Estimator(Protocol):
    """Interface of the filters."""

    @property
    def delay_s(self) -> float:
        """Estimated delay of the images relative to odometry."""

    def add(self, row: MotionRow) -> None:
        """Add a row of odometry or gyro."""

    def predict_pose(self, time_s: float) -> Pose | None:
        """Predicted T_map_left at a time, before its images are used."""

    def carried(self, time_s: float, then_s: Sequence[float]) -> tuple[Pose, ...] | None:
        """T_left_left: motion of the rig from ``time_s`` to the exposure of each camera; None: unknown."""

    def observe(self, time_s: float, seen: Seen, then_s: Sequence[float] = ()) -> Estimate:
        """Estimate at ``time_s``; ``then_s`` has the exposure time of each camera, empty if all are ``time_s``."""


def make_estimator(kind: str, rig: AnyRig, landmarks: LandmarkMap) -> Estimator:
    """A filter.

    Args:
        kind: ``wheels``, ``pose``, or ``none`` (images only).

    Raises:
        InputError: wheels, and the rig has no T_base_left.
    """
    if kind == WHEELS:
        return WheelEstimator(rig, landmarks)
    return PoseEstimator(rig, landmarks) if kind == POSE else ImageEstimator(rig, landmarks)


class WheelEstimator:
    """Wheels and gyro on a level floor (`tracking/planar_stereo_filter.py`)."""

    def __init__(self, rig: AnyRig, landmarks: LandmarkMap) -> None:
        self._rig, self._landmarks = rig, landmarks
        self._filter = RigFilter(landmarks, rig)

    @property
    def delay_s(self) -> float:
        """See `Estimator`."""
        return float(self._filter.parameters[DELAY])

    def add(self, row: MotionRow) -> None:
        """See `Estimator`."""
        if row.kind == WHEELS:
            self._filter.wheels.add_odometry(row.time_s, *row.values)
        elif row.kind == GYRO:
            self._filter.wheels.add_gyro(row.time_s, *row.values)

    def predict_pose(self, time_s: float) -> Pose | None:
        """See `Estimator`."""
        return self._filter.predict_pose(time_s)

    def carried(self, time_s: float, then_s: Sequence[float]) -> tuple[Pose, ...] | None:
        """See `Estimator`."""
        return self._filter.carried(time_s, then_s)

    def observe(self, time_s: float, seen: Seen, then_s: Sequence[float] = ()) -> Estimate:
        """See `Estimator`."""
        answer = self._filter.observe(time_s, seen, then_s)
        if answer.state is None or answer.covariance is None:
            return _not_found(seen, self._rig, self._landmarks)
        status = _contradicted(answer.status, len(answer.outliers), answer.nis_dof)
        inliers = _mapped(seen, self._landmarks, answer.outliers)
        return Estimate(
            status, planar_pose(answer.state), floor_covariance(answer.covariance), inliers, answer.outliers,
            answer.restarted, answer.nis, answer.nis_dof,
        )  # fmt: skip


class PoseEstimator:
    """Poses of visual odometry, through space (`tracking/spatial_stereo_filter.py`)."""

    def __init__(self, rig: AnyRig, landmarks: LandmarkMap) -> None:
        self._rig, self._landmarks = rig, landmarks
        self._filter = PoseFilter(landmarks, rig)

    @property
    def delay_s(self) -> float:
        """See `Estimator`: not estimated."""
        return 0.0

    def add(self, row: MotionRow) -> None:
        """See `Estimator`."""
        pose = row.T_smooth_base or row.T_odometry_base
        if pose is not None:
            self._filter.add_odometry(row.time_s, pose)

    def predict_pose(self, time_s: float) -> Pose | None:
        """See `Estimator`."""
        return self._filter.predict_pose(time_s)

    def carried(self, time_s: float, then_s: Sequence[float]) -> tuple[Pose, ...] | None:
        """See `Estimator`."""
        return self._filter.carried(time_s, then_s)

    def observe(self, time_s: float, seen: Seen, then_s: Sequence[float] = ()) -> Estimate:
        """See `Estimator`."""
        answer = self._filter.observe(time_s, seen, then_s)
        if answer.T_map_left is None or answer.covariance is None:
            return _not_found(seen, self._rig, self._landmarks)
        poses, covariances = at_base([answer.T_map_left], answer.covariance[None], self._rig)
        status = _contradicted(answer.status, len(answer.outliers), answer.nis_dof)
        inliers = _mapped(seen, self._landmarks, answer.outliers)
        return Estimate(
            status, poses[0], covariances[0], inliers, answer.outliers, answer.restarted, answer.nis, answer.nis_dof
        )


class ImageEstimator:
    """Only the images of each step; the pose is predicted with constant velocity."""

    def __init__(self, rig: AnyRig, landmarks: LandmarkMap) -> None:
        self._rig, self._landmarks = rig, landmarks
        self._last: list[tuple[float, Pose]] = []

    @property
    def delay_s(self) -> float:
        """See `Estimator`: there is no odometry."""
        return 0.0

    def add(self, row: MotionRow) -> None:
        """See `Estimator`: not used."""

    def predict_pose(self, time_s: float) -> Pose | None:
        """See `Estimator`."""
        if not self._last or time_s - self._last[-1][0] > MOST_STEADY_S:
            return None
        time, pose = self._last[-1]
        if len(self._last) < 2 or time - self._last[0][0] > MOST_STEADY_S:
            return pose
        before, other = self._last[0]
        share = (time_s - time) / (time - before)
        turn = rotation_exp(share * rotation_log(pose.R @ other.R.T))
        return Pose("map", pose.from_frame, turn @ pose.R, pose.t + share * (pose.t - other.t))

    def carried(self, time_s: float, then_s: Sequence[float]) -> tuple[Pose, ...] | None:
        """See `Estimator`: constant velocity of the last two steps."""
        if len(self._last) < 2 or time_s - self._last[0][0] > MOST_STEADY_S:
            return None
        (before, a), (after, b) = self._last
        shares = (np.array(then_s) - time_s) / (after - before)
        turn, way = rotation_log(a.R.T @ b.R), a.R.T @ (b.t - a.t)
        return tuple(Pose("left", "left", rotation_exp(share * turn), share * way) for share in shares.tolist())

    def observe(self, time_s: float, seen: Seen, then_s: Sequence[float] = ()) -> Estimate:
        """See `Estimator`."""
        carried = self.carried(time_s, then_s) if then_s else ()
        found = locate_rig(seen, self._rig, self._landmarks, carried=carried or ())
        if found.T_map_camera is None or found.covariance is None:
            return Estimate(found.status, outliers=found.outliers)
        poses, covariances = at_base([found.T_map_camera], found.covariance[None], self._rig)
        if found.status == PoseStatus.OK and self._jumps(time_s, found.T_map_camera):
            return Estimate(PoseStatus.INCONSISTENT, poses[0], covariances[0], outliers=found.inliers)
        anew = not self._last or time_s - self._last[-1][0] > MOST_STEADY_S
        if found.status == PoseStatus.OK:
            left = Pose("map", "left", found.T_map_camera.R, found.T_map_camera.t)
            self._last = [*self._last[-1:], (time_s, left)]
        return Estimate(found.status, poses[0], covariances[0], found.inliers, found.outliers, anew)

    def _jumps(self, time_s: float, T_map_left: Pose) -> bool:
        """Whether the motion is too fast for a robot; after `MOST_STEADY_S`, any motion is accepted."""
        if not self._last or time_s - self._last[-1][0] > MOST_STEADY_S:
            return False
        before, last = self._last[-1]
        seconds = time_s - before
        far, turn = float(np.linalg.norm(T_map_left.t - last.t)), rotation_angle(T_map_left.R @ last.R.T)
        return far > MOST_MPS * seconds + SLACK_M or turn > MOST_RADPS * seconds + SLACK_RAD


def floor_covariance(C: FloatArray) -> FloatArray:
    """(6,6) covariance from (3,3) of x, y, heading; height and tilt as for a robot on wheels."""
    six = np.diag([0.0, 0.0, _FLOOR.height_sigma**2, _FLOOR.tilt_sigma**2, _FLOOR.tilt_sigma**2, 0.0])
    places = np.array([0, 1, 5])
    six[places[:, None], places[None]] = C
    return six


def largest_sigma_m(C: FloatArray) -> float:
    """Standard deviation along the least certain direction, meters, of a (6,6) covariance."""
    return math.sqrt(max(float(np.linalg.eigvalsh(C[:3, :3])[-1]), 0.0))


def _contradicted(status: PoseStatus, outliers: int, nis_dof: int) -> PoseStatus:
    return PoseStatus.INCONSISTENT if status == PoseStatus.OK and outliers > nis_dof / CORNER_NUMBERS else status


def _mapped(seen: Seen, landmarks: LandmarkMap, outliers: tuple[LandmarkId, ...]) -> tuple[LandmarkId, ...]:
    ids = {d.id for detections in seen for d in detections if d.id in landmarks}
    return tuple(sorted(ids - set(outliers)))


def _not_found(seen: Seen, rig: AnyRig, landmarks: LandmarkMap) -> Estimate:
    """The reason why the filter has not started."""
    found = locate_rig(seen, rig, landmarks)
    status = PoseStatus.LOST if found.status == PoseStatus.OK else found.status
    return Estimate(status, outliers=found.outliers)
