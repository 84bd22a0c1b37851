"""Pose of a robot with a stereo camera on a level floor: an iterated extended Kalman filter on the corners.

The state is that of `online_wheel_odometry.py`.  Each frame updates it by all corners of all mapped landmarks in both
cameras (the update as Gauss-Newton: Bell and Cathey 1993), so that a single far landmark still helps, although images
alone cannot distinguish its two poses.  The robot is on wheels: its height is known, and it is level.  Landmarks that
do not fit are left out; if none fits for some frames, the filter is restarted.  The error of a landmark's place is
the same in every frame; the covariance includes this correlation (`lasting_errors.py`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from lmkit.arrays import BoolArray, FloatArray
from lmkit.errors import InputError
from lmkit.geometry.planar import planar_pose
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import AnyRig
from lmkit.geometry.rotations import skew
from lmkit.kernels.pose_update import Update
from lmkit.localization.absolute_pose import LocateOptions, locate_rig
from lmkit.localization.correspondences import CORNER_FLOOR_PX, Correspondences
from lmkit.localization.pose_prior import PosePrior
from lmkit.mapping.carried_cameras import carried_from
from lmkit.model.estimate import PoseEstimate
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.observation import Detection
from lmkit.model.pose_status import PoseStatus
from lmkit.odometry.online_wheel_odometry import AHEAD_S, LONGEST_DELAY_S, STATES, Wheels
from lmkit.odometry.wheel_odometry import NOMINAL, PARAMETERS, PRIOR_SIGMA, MotionNoise
from lmkit.tracking.exposure_queue import ExposureQueue
from lmkit.tracking.exposure_updates import ExposureUpdates
from lmkit.tracking.lasting_errors import LastingErrors
from lmkit.tracking.range_bearing_filter import NOWHERE_M, TrackedPose

OUTLIER_SIGMA = 4.5
# Squared length of the last step, in standard deviations; outlier threshold; iterations.
UPDATE = Update(converged=1e-3, limit=8 * OUTLIER_SIGMA**2, iterations=4)
PLANAR = np.array([0, 1, 5])  # x, y and heading, of the six numbers of a pose
DELAY = 3 + PARAMETERS.index("delay_s")
DOUBTS = 4  # frames without a fitting landmark, before the robot may have been carried away


class RigFilter:
    """Feed ``wheels`` rows, and detections of all cameras, in the order of time; every frame gives a pose.

    Args:
        rig: with its T_base_left.
        corner_floor_px: see `LocateOptions`.

    Raises:
        InputError: the rig has no T_base_left.
    """

    def __init__(
        self,
        landmarks: LandmarkMap,
        rig: AnyRig,
        motion_noise: MotionNoise | None = None,
        corner_floor_px: float = CORNER_FLOOR_PX,
    ) -> None:
        if rig.T_base_left is None:
            raise InputError("no_base", "the rig has no T_base_left", "add the pose of the left camera on the robot")
        self._map, self._rig, self._T = landmarks, rig, rig.T_base_left
        self._base = self._T.R.copy(), self._T.t.copy()  # kernels find what is not read-only faster
        self._floor_px = corner_floor_px
        self.wheels = Wheels(motion_noise)
        self._time: float | None = None
        self._x: FloatArray = np.zeros(STATES)
        self._P: FloatArray = np.zeros((STATES, STATES))
        self._lasting = LastingErrors(STATES)
        self._exposures = ExposureQueue()
        self._doubts = 0
        self._prior = PosePrior(
            height_m=float(self._T.t[2]),
            down=(float(-self._T.R[2, 0]), float(-self._T.R[2, 1]), float(-self._T.R[2, 2])),
        )

        sigmas = (self._prior.height_sigma, self._prior.tilt_sigma, self._prior.tilt_sigma)
        self._level = np.array(sigmas) ** -2.0

    @property
    def parameters(self) -> FloatArray:
        """(6,) estimated errors of the odometry, as `motion.PARAMETERS`."""
        return self._x[3:].copy() if self._time is not None else np.array(NOMINAL)

    def predict_pose(self, time_s: float) -> Pose | None:
        """Predicted T_map_left at ``time_s`` from the odometry so far; None before the first fix; changes nothing."""
        if self._time is None:
            return None
        x = self._x
        if time_s > self._time:
            x, _, _ = self.wheels.step(self._x, self._time, time_s)
        return planar_pose(x[:3]) @ self._T

    def carried(self, time_s: float, then_s: Sequence[float]) -> tuple[Pose, ...]:
        """T_left_left: motion of the rig from ``time_s`` to each of other times, from the odometry so far."""
        return carried_from(time_s, then_s, self._rig, self.wheels.model(time_s), self.parameters)

    def observe(
        self, time_s: float, detections: Sequence[Sequence[Detection]], then_s: Sequence[float] = ()
    ) -> TrackedPose:
        """Pose at ``time_s``; every list of detections may be empty.

        Args:
            then_s: when each camera exposed; empty: all at ``time_s``.  Later exposures are used with the next frame.
        """
        if self._time is None:
            return self._start(time_s, detections, then_s)
        done = ExposureUpdates(self._exposures.due(time_s, detections, then_s), self._seen, self._update)
        self._step(time_s)
        if done.fits:
            self._doubts = 0 if any(done.fits) else self._doubts + 1
            if self._doubts >= DOUBTS:
                again = self._start(time_s, detections, then_s)
                if again.state is not None:
                    return again
        return self._pose(time_s, tuple(sorted(done.outliers)), False, done.nis, done.nis_dof)

    def _step(self, time_s: float) -> None:
        """Predict to a time with odometry; a time in the past changes nothing."""
        assert self._time is not None
        if time_s > self._time:
            self.wheels.forget(self._time)
            self._x, F, Q = self.wheels.step(self._x, self._time, time_s)
            self._P = F @ self._P @ F.T + Q
            self._lasting.predict(F)
            self._time = time_s

    def _seen(self, at: float, detections: Sequence[Sequence[Detection]]) -> Correspondences:
        """Correspondences of cameras that exposed together, after a step to that time."""
        assert self._time is not None
        self._step(at)
        # An exposure before the last frame arrives too late.
        carried = self.carried(self._time, [at] * len(detections)) if at < self._time else ()
        return Correspondences.of_rig(detections, self._rig, self._map, self._floor_px, carried)

    def _start(
        self, time_s: float, detections: Sequence[Sequence[Detection]], then_s: Sequence[float]
    ) -> TrackedPose:
        carried = self.carried(time_s, then_s) if then_s else ()
        options = LocateOptions(prior=self._prior, corner_floor_px=self._floor_px)
        found = locate_rig(detections, self._rig, self._map, options, carried)
        C = found.covariance_at(self._T.inverse())
        if found.status != PoseStatus.OK or found.T_map_camera is None or C is None:
            return TrackedPose(time_s, PoseStatus.LOST, None, None)
        base = found.T_map_camera.R @ self._T.R.T
        place = found.T_map_camera.t - base @ self._T.t
        # Odometry errors are kept when the robot was carried away.
        own = (np.array(NOMINAL), np.diag(PRIOR_SIGMA**2)) if self._time is None else (self._x[3:], self._P[3:, 3:])
        self._x = np.concatenate([[place[0], place[1], np.arctan2(base[1, 0], base[0, 0])], own[0]])
        self._P = np.zeros((STATES, STATES))
        self._P[3:, 3:] = own[1]
        self._P[:3, :3] = C[PLANAR[:, None], PLANAR]
        seen = Correspondences.of_rig(detections, self._rig, self._map, self._floor_px, carried)
        fit = np.array([landmark.id not in found.outliers for landmark in seen.landmarks])
        self._lasting.start(seen, found.T_map_camera.R, found.T_map_camera.t, fit, self._state_by_pull(found))
        self._time, self._doubts = time_s, 0
        self._exposures.clear()
        return self._pose(time_s, found.outliers, True)

    def _update(self, seen: Correspondences) -> tuple[BoolArray, float]:
        """Gauss-Newton on corners and the prediction; (S,) the inliers, and their innovation.

        Height, roll and pitch at that time are fitted in addition, with a prior of a level robot.
        """
        done = seen.update_planar(self._P, self._level, self._base, self._x, UPDATE)
        if done.used.any():
            self._lasting.update(seen, done)
            self._x, self._P = done.state, done.covariance
            # Odometry is not kept longer than that, and none has arrived yet.
            self._x[DELAY] = min(max(self._x[DELAY], -AHEAD_S), LONGEST_DELAY_S)
        return done.used, done.cost

    def _state_by_pull(self, found: PoseEstimate) -> FloatArray:
        """(9,6) from gradients on a located pose to errors of the state."""
        assert found.T_map_camera is not None
        assert found.covariance is not None
        at_base = np.eye(6)
        at_base[:3, 3:] = skew(found.T_map_camera.R @ self._T.R.T @ self._T.t)
        moves = np.zeros((STATES, 6))
        moves[:3] = (at_base @ found.covariance)[PLANAR]
        return moves

    def _pose(
        self, time_s: float, outliers: tuple[LandmarkId, ...], restarted: bool, nis: float = 0.0, nis_dof: int = 0
    ) -> TrackedPose:
        P = (self._P + self._lasting.excess)[:3, :3]
        xx, xy, yy = P[0, 0].item(), P[0, 1].item(), P[1, 1].item()
        # The larger eigenvalue of the place's covariance.
        largest = (xx + yy) / 2 + math.hypot((xx - yy) / 2, xy)
        lost = largest > NOWHERE_M**2 or self._doubts >= DOUBTS
        status = PoseStatus.LOST if lost else PoseStatus.OK
        return TrackedPose(time_s, status, self._x[:3].copy(), P, outliers, restarted, nis, nis_dof)
