"""Pose of a robot on wheels: extended Kalman filters in the plane (Thrun et al. 2005, chapter 7).

The state is that of `online_wheel_odometry.py`; memory is constant.

A reading is right or wrong, and after some time without landmarks this cannot be decided at once.  So both are
followed (a mixture of few filters, Alspach and Sorenson 1972), each with its probability, until later readings
decide.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.geometry.planar import wrap_heading
from lmkit.localization.range_bearing import Readings, locate_planar
from lmkit.localization.range_bearing_noise import DRIVE_NOISE, ReadingNoise
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.observation import RangeBearing
from lmkit.model.pose_status import PoseStatus
from lmkit.odometry.online_wheel_odometry import STATES, Wheels
from lmkit.odometry.wheel_odometry import NOMINAL, PRIOR_SIGMA, MotionNoise

MOST_TRACKS = 6
HOPELESS = 10.0  # log likelihood ratio to the best
WRONG_SHARE = 0.04  # of readings: another code, a reflection
WRONG_DENSITY = 0.1  # of a wrong reading's range and bearing: anywhere within 10 m and 1 rad
DOUBTS = 4  # consecutive wrong readings of the best track, before the robot may have been carried away
CARRIED_OFF = -7.0  # log probability of that
SURE = 0.9  # probability of all tracks near the best one
SAME_M, SAME_RAD = 0.1, 0.05
NEAR_M = 0.5
NOWHERE_M = 1.0  # a position with a larger standard deviation is not reported


@dataclass(frozen=True, eq=False)
class TrackedPose:
    """Pose of the robot at one time.

    Attributes:
        status: ``ok``; ``ambiguous`` (another place is possible); ``lost`` (no fix yet, or uncertain by a meter).
        state: (3,) x, y (m), heading (rad); None before the first fix.
        covariance: (3,3).
        outliers: landmarks whose readings were rejected.
        restarted: True if the filter was restarted at this time.
        nis, nis_dof: squared innovations of the inliers, in standard deviations, and their degrees of freedom; on
            average the two are equal.
    """

    time_s: float
    status: PoseStatus
    state: FloatArray | None
    covariance: FloatArray | None
    outliers: tuple[LandmarkId, ...] = ()
    restarted: bool = False
    nis: float = 0.0
    nis_dof: int = 0


@dataclass(eq=False)
class _Track:
    """One filter of the mixture: state, covariance, and the logarithm of its weight."""

    x: FloatArray
    P: FloatArray
    log_weight: float
    doubts: int = 0  # wrong readings in a row
    outliers: tuple[LandmarkId, ...] = ()
    nis: float = 0.0
    nis_dof: int = 0


class PlanarFilter:
    """Feed ``wheels`` rows, and readings, in the order of time; every frame gives a pose."""

    def __init__(
        self, landmarks: LandmarkMap, noise: ReadingNoise | None = None, motion_noise: MotionNoise | None = None
    ) -> None:
        self._map, self._noise = landmarks, noise or DRIVE_NOISE
        self.wheels = Wheels(motion_noise)
        self._time: float | None = None
        self._tracks: list[_Track] = []
        self._seen: dict[LandmarkId, deque[float]] = {}

    @property
    def parameters(self) -> FloatArray:
        """(6,) estimated errors of the odometry, as `motion.PARAMETERS`."""
        return self._tracks[0].x[3:].copy() if self._tracks else np.array(NOMINAL)

    def predicted(self, time_s: float) -> tuple[FloatArray, FloatArray] | None:
        """Most probable state (3,) before the readings of ``time_s``, and its (3,3) covariance; None if unknown."""
        if not self._tracks:
            return None
        self._predict(time_s)
        best = max(self._tracks, key=lambda track: track.log_weight)
        return best.x[:3].copy(), best.P[:3, :3].copy()

    def observe(self, time_s: float, readings: Sequence[RangeBearing]) -> TrackedPose:
        """Pose at ``time_s``; the list of readings may be empty."""
        if not self._tracks:
            self._tracks = self._located(readings, 0.0)
            self._time = time_s
            return self._pose(time_s, bool(self._tracks))
        self._predict(time_s)
        seen = Readings.of(readings, self._map, self._noise)
        for row, spread in enumerate(self._spread(time_s, seen.ids)):
            self._update(seen.only(np.arange(len(seen.ids)) == row), spread)
        carried_off = False
        if self._tracks[0].doubts >= DOUBTS:
            fresh = self._located(readings, self._tracks[0].log_weight + CARRIED_OFF)
            known = [track for track in fresh if not any(_same(track, other) for other in self._tracks)]
            self._tracks = (self._tracks[: MOST_TRACKS - len(known)] + known)[:MOST_TRACKS]
            if self._tracks[0].doubts >= 2 * DOUBTS and known:
                self._tracks, carried_off = known, True
        return self._pose(time_s, carried_off)

    def _located(self, readings: Sequence[RangeBearing], log_weight: float) -> list[_Track]:
        """Tracks that start from this frame alone: the pose from the readings, and its alternatives."""
        found = locate_planar(readings, self._map, self._noise)
        if found.pose is None or found.pose.heading_rad is None or found.covariance is None:
            return []
        places = [(found.pose, 0.0), *found.alternatives]
        P = np.diag(np.concatenate([np.zeros(3), PRIOR_SIGMA**2]))
        P[:3, :3] = 2 * found.covariance
        tracks = []
        for pose, ratio in places[:MOST_TRACKS]:
            if pose.heading_rad is not None:
                x = np.concatenate([[pose.x_m, pose.y_m, pose.heading_rad], NOMINAL])
                tracks.append(_Track(x, P.copy(), log_weight - ratio))
        return tracks

    def _predict(self, time_s: float) -> None:
        assert self._time is not None
        if time_s <= self._time:
            return
        self.wheels.forget(self._time)
        for track in self._tracks:
            track.x, track.P = self.wheels.predict(track.x, track.P, self._time, time_s)
        self._time = time_s

    def _spread(self, time_s: float, ids: Sequence[LandmarkId]) -> FloatArray:
        """(R,) factors of the readings' standard deviations: readings of a landmark close in time are correlated."""
        spread = []
        for id_ in ids:
            times = self._seen.setdefault(id_, deque())
            while times and times[0] < time_s - self._noise.related_s:
                times.popleft()
            times.append(time_s)
            spread.append(math.sqrt(len(times)))
        return np.array(spread)

    def _update(self, reading: Readings, spread: float) -> None:
        """Split every track in two: with the reading, and without it."""
        grown: list[_Track] = []
        for track in self._tracks:
            grown.append(
                _Track(
                    track.x,
                    track.P,
                    track.log_weight + math.log(WRONG_SHARE * WRONG_DENSITY),
                    track.doubts + 1,
                    (*track.outliers, reading.ids[0]),
                    track.nis,
                    track.nis_dof,
                )
            )
            grown.append(_with_reading(track, reading, spread))
        grown.sort(key=lambda track: -track.log_weight)
        kept: list[_Track] = []
        for track in grown:
            if len(kept) == MOST_TRACKS or track.log_weight < grown[0].log_weight - HOPELESS:
                break
            if not any(_same(track, other) for other in kept):
                kept.append(track)
        for track in kept:
            track.x, track.P = track.x.copy(), track.P.copy()
        self._tracks = kept

    def _pose(self, time_s: float, restarted: bool) -> TrackedPose:
        if not self._tracks:
            return TrackedPose(time_s, PoseStatus.LOST, None, None)
        best = self._tracks[0]
        weights = np.exp([track.log_weight - best.log_weight for track in self._tracks])
        near = [np.hypot(*(track.x[:2] - best.x[:2])) < NEAR_M for track in self._tracks]
        status = PoseStatus.OK
        if np.sqrt(np.linalg.eigvalsh(best.P[:2, :2])[-1]) > NOWHERE_M or best.doubts >= DOUBTS:
            status = PoseStatus.LOST
        elif weights[near].sum() < SURE * weights.sum():
            status = PoseStatus.AMBIGUOUS
        for track in self._tracks:
            track.log_weight -= best.log_weight
        answer = TrackedPose(
            time_s,
            status,
            best.x[:3].copy(),
            best.P[:3, :3].copy(),
            best.outliers,
            restarted,
            best.nis,
            best.nis_dof,
        )
        for track in self._tracks:
            track.outliers, track.nis, track.nis_dof = (), 0.0, 0
        return answer


def _with_reading(track: _Track, reading: Readings, spread: float) -> _Track:
    """The track after a right reading, weighted with the likelihood of its innovation."""
    given = np.array([np.isfinite(reading.ranges[0]), np.isfinite(reading.bearings[0])])
    H = np.zeros((2, STATES))
    H[:, :3] = reading.jacobian(track.x[:3])[0] / spread
    r = reading.standardized(track.x[None, :3])[0, 0] / spread
    PH = track.P @ H.T
    S = H @ PH + np.eye(2)
    inverse = np.linalg.inv(S)
    K = PH @ inverse
    # Density in units of range and bearing, comparable with that of a wrong reading.
    units = spread**2 * float(np.prod(np.array([reading.range_sigma[0], reading.bearing_sigma[0]])[given]))
    squared = float(r @ inverse @ r)
    log = (
        -0.5 * squared - 0.5 * math.log(np.linalg.det(S)) - math.log(2 * math.pi * units) + math.log(1 - WRONG_SHARE)
    )
    # Readings that share errors weigh less, but each is as accurate as its own noise says.
    own = spread * r
    nis = float(own @ np.linalg.solve(spread**2 * (S - np.eye(2)) + np.eye(2), own))
    left = np.eye(STATES) - K @ H
    return _Track(
        track.x + K @ r,
        left @ track.P @ left.T + K @ K.T,
        track.log_weight + log,
        0,
        track.outliers,
        track.nis + nis,
        track.nis_dof + int(given.sum()),
    )


def _same(a: _Track, b: _Track) -> bool:
    off = a.x[:3] - b.x[:3]
    return bool(np.hypot(off[0], off[1]) < SAME_M and abs(wrap_heading(off[2])) < SAME_RAD)
