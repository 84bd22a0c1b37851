"""Pose of a stereo camera in space: an iterated extended Kalman filter on corners and odometry.

The state is the left camera's pose.  Poses of odometry (visual-inertial, another SLAM) predict it from frame
to frame, and all corners of all mapped landmarks in all cameras update it, as in
`planar_stereo_filter.py`.  Memory is constant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lmkit.arrays import BoolArray, FloatArray, widest_sigma
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import AnyRig
from lmkit.geometry.rotations import orthonormal, skew
from lmkit.localization.absolute_pose import LocateOptions, locate_rig
from lmkit.localization.correspondences import CORNER_FLOOR_PX, Correspondences
from lmkit.mapping.carried_cameras import carried_by
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.observation import Detection
from lmkit.model.pose_status import PoseStatus
from lmkit.odometry.online_pose_odometry import PoseRows
from lmkit.odometry.pose_odometry import PoseNoise
from lmkit.tracking.exposure_queue import ExposureQueue
from lmkit.tracking.exposure_updates import ExposureUpdates
from lmkit.tracking.lasting_errors import LastingErrors
from lmkit.tracking.planar_stereo_filter import DOUBTS, UPDATE
from lmkit.tracking.range_bearing_filter import NOWHERE_M


@dataclass(frozen=True, eq=False)
class SpacePose:
    """Pose of the cameras at one time.

    Attributes:
        status: ``ok``, or ``lost`` (no fix yet, or uncertain by a meter).
        T_map_left: None before the first fix.
        covariance: (6,6) x y z (m), rotation about x y z of the map (rad).
        outliers: landmarks that were rejected.
        restarted: True if the filter was restarted at this time.
        nis, nis_dof: see `range_bearing_filter.TrackedPose`.
    """

    time_s: float
    status: PoseStatus
    T_map_left: Pose | None
    covariance: FloatArray | None
    outliers: tuple[LandmarkId, ...] = ()
    restarted: bool = False
    nis: float = 0.0
    nis_dof: int = 0


@dataclass(frozen=True, eq=False)
class _Step:
    """Motion between two times: base pose before, rotation and translation (of the camera, in the map)."""

    base: FloatArray
    turned: FloatArray
    way: FloatArray
    sigmas: FloatArray
    taken: tuple[FloatArray, FloatArray] | None


class PoseFilter:
    """Feed poses of odometry, and detections of all cameras, in the order of time; every frame gives a pose.

    Args:
        rig: odometry's poses are those of its base if it has T_base_left; otherwise they are the
            left camera's.
        corner_floor_px: see `LocateOptions`.
    """

    def __init__(
        self,
        landmarks: LandmarkMap,
        rig: AnyRig,
        noise: PoseNoise | None = None,
        corner_floor_px: float = CORNER_FLOOR_PX,
    ) -> None:
        self._map, self._rig, self._floor_px = landmarks, rig, corner_floor_px
        self._T = rig.T_base_left or Pose.identity("base", "left")
        self._rows = PoseRows(noise)
        self._time: float | None = None
        self._R: FloatArray = np.eye(3)
        self._p: FloatArray = np.zeros(3)
        self._P: FloatArray = np.zeros((6, 6))
        self._lasting = LastingErrors(6)
        self._exposures = ExposureQueue()
        self._doubts = 0
        self._taken: tuple[FloatArray, FloatArray] | None = None  # odometry's predicted pose of the last frame

    def add_odometry(self, time_s: float, T_odometry_base: Pose) -> None:
        """Add a pose of odometry, in its own frame that drifts."""
        self._rows.add(time_s, T_odometry_base)

    def carried(self, time_s: float, then_s: Sequence[float]) -> tuple[Pose, ...]:
        """T_left_left: motion of the rig from ``time_s`` to each of other times, from the odometry so far."""
        R, p = self._rows.at(time_s)
        places = [self._rows.at(then) for then in then_s]
        turns = np.array([R.T @ later for later, _ in places]).reshape(-1, 3, 3)
        return carried_by(turns, np.array([(later - p) @ R for _, later in places]).reshape(-1, 3), self._rig)

    def observe(
        self, time_s: float, detections: Sequence[Sequence[Detection]], then_s: Sequence[float] = ()
    ) -> SpacePose:
        """Pose of the left camera at ``time_s``; every list of detections may be empty.

        Args:
            then_s: when each camera exposed; empty: all at ``time_s``.  Later exposures are used with the next frame.
        """
        if self._time is None:
            return self._start(time_s, detections, then_s)
        done = ExposureUpdates(self._exposures.due(time_s, detections, then_s), self._seen, self._update)
        self._predict(time_s)
        if done.fits:
            self._doubts = 0 if any(done.fits) else self._doubts + 1
            if self._doubts >= DOUBTS:
                again = self._start(time_s, detections, then_s)
                if again.T_map_left is not None:
                    return again
        return self._pose(time_s, tuple(sorted(done.outliers)), False, done.nis, done.nis_dof)

    def _seen(self, at: float, detections: Sequence[Sequence[Detection]]) -> Correspondences:
        """Correspondences of cameras that exposed together, after a step to that time."""
        assert self._time is not None
        self._predict(at)
        # An exposure before the last frame arrives too late.
        carried = self.carried(self._time, [at] * len(detections)) if at < self._time else ()
        return Correspondences.of_rig(detections, self._rig, self._map, self._floor_px, carried)

    def _update(self, seen: Correspondences) -> tuple[BoolArray, float]:
        """(S,) the inliers of the update with the corners, and their innovation."""
        done = seen.update_space(self._P, self._R, self._p, UPDATE)
        if done.used.any():
            self._lasting.update(seen, done)
            self._R, self._p, self._P = orthonormal(done.R), done.p, done.covariance
        return done.used, done.cost

    def _start(self, time_s: float, detections: Sequence[Sequence[Detection]], then_s: Sequence[float]) -> SpacePose:
        carried = self.carried(time_s, then_s) if then_s else ()
        options = LocateOptions(corner_floor_px=self._floor_px)
        found = locate_rig(detections, self._rig, self._map, options, carried)
        if found.status != PoseStatus.OK or found.T_map_camera is None or found.covariance is None:
            return SpacePose(time_s, PoseStatus.LOST, None, None)
        self._R, self._p, self._P = found.T_map_camera.R, found.T_map_camera.t, found.covariance
        seen = Correspondences.of_rig(detections, self._rig, self._map, self._floor_px, carried)
        fit = np.array([landmark.id not in found.outliers for landmark in seen.landmarks])
        self._lasting.start(seen, self._R, self._p, fit, self._P)
        self._time, self._doubts = time_s, 0
        self._exposures.clear()
        return self._pose(time_s, found.outliers, True)

    def predict_pose(self, time_s: float) -> Pose | None:
        """Predicted T_map_left at ``time_s`` from the odometry so far; None before the first fix; changes nothing."""
        if self._time is None:
            return None
        if time_s <= self._time:
            return Pose("map", "left", self._R, self._p)
        step = self._step(self._time, time_s)
        return Pose("map", "left", orthonormal(step.base @ step.turned @ self._T.R), self._p + step.way)

    def _predict(self, time_s: float) -> None:
        """Predict to a time with odometry; a time in the past changes nothing."""
        assert self._time is not None
        if time_s <= self._time:
            return
        self._rows.forget(self._time)
        step = self._step(self._time, time_s)
        self._time = time_s
        self._taken = step.taken
        arm, later = self._T.t, step.base @ step.turned
        F, G = np.eye(6), np.zeros((6, 6))
        F[:3, 3:] = -skew(step.way)
        G[:3, :3], G[:3, 3:], G[3:, 3:] = step.base, -later @ skew(arm), later
        self._P = F @ self._P @ F.T + (G * step.sigmas**2) @ G.T
        self._lasting.predict(F)
        self._R, self._p = orthonormal(later @ self._T.R), self._p + step.way

    def _step(self, before_s: float, time_s: float) -> _Step:
        """Motion between two times from odometry."""
        later = self._rows.at(time_s)
        # From the pose predicted then, so that prediction errors are corrected.
        before = self._rows.at(before_s) if self._taken is None else self._taken
        taken = None if self._rows.unknown else later
        turned, moved = before[0].T @ later[0], (later[1] - before[1]) @ before[0]
        # Of the camera: T_left_base T_base_base' T_base_left.
        base, arm = self._R @ self._T.R.T, self._T.t
        way = base @ (moved + turned @ arm - arm)
        return _Step(base, turned, way, self._rows.sigmas(before_s, time_s), taken)

    def _pose(
        self, time_s: float, outliers: tuple[LandmarkId, ...], restarted: bool, nis: float = 0.0, nis_dof: int = 0
    ) -> SpacePose:
        P = self._P + self._lasting.excess
        lost = self._doubts >= DOUBTS or widest_sigma(P[:3, :3], NOWHERE_M) > NOWHERE_M
        pose = Pose("map", "left", self._R, self._p)
        status = PoseStatus.LOST if lost else PoseStatus.OK
        return SpacePose(time_s, status, pose, P, outliers, restarted, nis, nis_dof)
