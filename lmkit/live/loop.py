"""One step of a live run: search, filter, decide.  Threads and outputs are in other modules."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from lmkit.detection.windows import is_colorless
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import AnyRig, mounted_cameras
from lmkit.geometry.rotations import quaternion_to_matrix
from lmkit.live.blind_cameras import BlindCameras
from lmkit.live.budget import LatencyBudget
from lmkit.live.estimators import Estimate, make_estimator
from lmkit.live.events import Event
from lmkit.live.exposures import Exposures
from lmkit.live.frame_group import FrameGroup
from lmkit.live.mirrored_images import MirroredImages
from lmkit.live.motion import GYRO, MotionRow
from lmkit.live.publication import Decision, Publication, PublicationRule
from lmkit.live.reader import Rate
from lmkit.live.search import Search
from lmkit.live.stale_images import StaleImages
from lmkit.live.state import CameraView, LiveState
from lmkit.localization.expected_landmarks import ExpectedLandmarks
from lmkit.model.families import family_named
from lmkit.model.landmark import LandmarkFamily
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.pose_status import PoseStatus

WHOLE_EVERY_S = 1.0  # interval between whole images, one camera in turn
POSES_KEPT = 400  # poses of odometry, for its frame in the map
SILENT_S = 1.0  # time without odometry before an event


@dataclass(frozen=True)
class LoopSettings:
    """Settings of the loop.

    Attributes:
        motion: ``wheels``, ``pose`` or ``none``: odometry that predicts the pose between images.
        profile: of the detector.
        budget_s: latency budget; 0: none.
        rule: conditions for the publication of a pose.
    """

    motion: str = "none"
    profile: str = "balanced"
    budget_s: float = 0.05
    rule: PublicationRule = field(default_factory=PublicationRule)


class LiveLoop:
    """The loop's state; `step` processes the images of one time.

    Args:
        now: function that returns the loop's time, for latencies.

    Raises:
        InputError: wheels, and the rig has no T_base_left.
    """

    def __init__(
        self,
        rig: AnyRig,
        landmarks: LandmarkMap,
        settings: LoopSettings | None = None,
        now: Callable[[], float] = time.time,
    ) -> None:
        self.rig, self.landmarks, self.settings = rig, landmarks, settings or LoopSettings()
        self._now = now
        self._expected = ExpectedLandmarks(rig, landmarks)
        self._search = Search(rig, landmarks, self._expected)
        self._estimator = make_estimator(self.settings.motion, rig, landmarks)
        self._exposures = Exposures(rig)
        self._stale = StaleImages(rig, landmarks, self.settings.motion != "none")
        self._mirror = MirroredImages(rig, landmarks)
        rule = self.settings.rule
        self._publication = Publication(replace(rule, confirm=min(rule.confirm, max(len(landmarks), 1))))
        self._budget = LatencyBudget(self.settings.budget_s or 1e9, self.settings.profile)
        self._names = [camera.name for camera in mounted_cameras(rig)]
        self._blind = BlindCameras(self._names)
        self._needs_color = any(isinstance(family_named(n), LandmarkFamily) for n in landmarks.families)
        self._gray: set[int] = set()
        self._rate, self._number, self._groups = Rate(), 0, 0
        self._status = PoseStatus.LOST
        self._whole_at, self._turn = float("-inf"), 0
        self._odometry: deque[tuple[float, Pose]] = deque(maxlen=POSES_KEPT)
        self._motion_at: dict[str, float] = {}  # last row of odometry and of the gyro
        self._silent: set[str] = set()
        self._waiting: tuple[MotionRow, ...] = ()  # rows of steps skipped by the budget

    @property
    def latency_p95_s(self) -> float:
        """The 95 % latency of the last steps."""
        return self._budget.p95_s()

    def step(self, group: FrameGroup, is_live: bool = False) -> LiveState | None:
        """The state after the images of one time; None if the latency budget skips them.

        Args:
            is_live: whether images age during the search.
        """
        events = [*group.events]
        for row in group.motion:
            self._take(row)
        self._groups += 1
        if is_live and self._groups % self._budget.every:
            self._waiting = (*self._waiting, *group.motion)
            return None
        profile = group.profile or self._budget.profile
        then_s = self._exposures.times(group.time_s, group.stamps_s)
        carried, apart = self._exposures.carried(group.time_s, then_s, self._estimator)
        views = self._views(group, profile, carried)
        events += self._color_events(group, views)
        events += self._odometry_events(group.time_s)
        seen = [view.detections for view in views]
        stale, named = self._stale.withheld(group.time_s, seen, self._estimator.delay_s)
        events += named
        left_out = stale | apart
        believed = [() if k in left_out else s for k, s in enumerate(seen)]
        estimate = self._estimator.observe(group.time_s, believed, then_s)
        if estimate.restarted:
            self._stale.start()
        views, missing = self._with_expected(views, estimate, left_out, carried)
        events += self._blind.add(group.time_s, views, self._plainly_in_view(views, estimate, carried))
        waits = self._stale.waits(group.time_s)
        decision = self._publication.decide(group.time_s, estimate, missing, self._stale.doubt(), waits)
        events += self._mirror.add(group.time_s, seen, decision.status)
        if self._mirror.sentence:
            decision = Decision(PoseStatus.INCONSISTENT, self._mirror.sentence)
        ok = decision.status == PoseStatus.OK
        if decision.status != self._status:
            text = f"{self._status} -> {decision.status}" + (f": {decision.reason}" if decision.reason else "")
            events.append(Event(f"status_{decision.status}", text, group.time_s))
        self._status = decision.status
        latency = self._now() - group.time_s if is_live else None
        if latency is not None and (changed := self._budget.add(latency)):
            events.append(Event("latency_budget", changed, group.time_s))
        if ok:
            self._rate.add(self._now() if is_live else group.time_s)
        state = LiveState(
            number=self._number,
            time_s=group.time_s,
            status=decision.status,
            T_map_base=estimate.T_map_base if ok else None,
            covariance=estimate.covariance if ok else None,
            views=views,
            ids=estimate.inliers,
            outliers=estimate.outliers,
            restarted=estimate.restarted,
            resets=self._publication.resets,
            nis=estimate.nis,
            nis_dof=estimate.nis_dof,
            latency_s=latency,
            rate_hz=self._rate.value(self._now() if is_live else group.time_s),
            profile=profile,
            reason=decision.reason,
            T_map_odometry=self._odometry_frame(group.time_s, estimate) if ok else None,
            events=tuple(events),
            truth=group.truth,
            group=replace(group, motion=(*self._waiting, *group.motion)),
        )
        self._waiting = ()
        self._number += 1
        return state

    def _take(self, row: MotionRow) -> None:
        self._estimator.add(row)
        self._stale.add(row)
        self._motion_at["gyro" if row.kind == GYRO else "odometry"] = row.time_s
        if row.T_odometry_base is not None:
            self._odometry.append((row.time_s, row.T_odometry_base))

    def _views(self, group: FrameGroup, profile: str, carried: Sequence[Pose]) -> tuple[CameraView, ...]:
        if group.seen is not None:
            return tuple(
                CameraView(name, image, stamp, tuple(seen), search="whole")
                for name, image, stamp, seen in zip(
                    self._names, group.images, group.stamps_s, group.seen, strict=True
                )
            )
        sure = self._status == PoseStatus.OK
        predicted = self._estimator.predict_pose(group.time_s) if sure else None
        whole: frozenset[int] = frozenset()
        if predicted is None:
            self._whole_at = group.time_s
        elif group.time_s - self._whole_at >= WHOLE_EVERY_S / len(self._names):
            whole, self._whole_at = frozenset([self._turn % len(self._names)]), group.time_s
            self._turn += 1
        poses = None if predicted is None else self._by_camera(predicted, carried)
        views = self._search.views(group.images, group.stamps_s, poses, whole, profile)
        # If no landmark is expected, odometry alone is used for a while, if there is odometry.
        expects_landmarks = self.settings.motion == "none" or any(view.expected for view in views)
        if predicted is None or not expects_landmarks or any(view.detections for view in views):
            return views
        return self._search.again(views, profile)

    def _by_camera(self, T_map_left: Pose, carried: Sequence[Pose]) -> list[Pose]:
        """T_map_left at the exposure of every camera."""
        return [T_map_left @ moved for moved in carried] or [T_map_left] * len(self._names)

    def _with_expected(
        self, views: tuple[CameraView, ...], estimate: Estimate, left_out: frozenset[int], carried: Sequence[Pose]
    ) -> tuple[tuple[CameraView, ...], tuple[LandmarkId, ...]]:
        """The views with the predicted landmarks; and landmarks that should be clearly visible but are not read.

        Predictions are kept if landmarks confirmed the pose.
        """
        if estimate.T_map_base is None or (estimate.inliers and all(view.expected for view in views)):
            return views, ()
        poses = self._by_camera(self._left_camera(estimate.T_map_base), carried)
        drawn, missing = [], []
        for k, view in enumerate(views):
            expected, plain = self._expected.in_camera(k, poses[k])
            drawn.append(replace(view, expected=expected))
            if view.search != "none" and k not in left_out:
                read = {d.id for d in view.detections}
                missing += [id_ for id_ in plain if id_ not in read]
        return tuple(drawn), tuple(dict.fromkeys(missing))

    def _left_camera(self, T_map_base: Pose) -> Pose:
        T_base_left = self.rig.T_base_left
        T = T_map_base if T_base_left is None else T_map_base @ T_base_left
        return Pose("map", "left", T.R, T.t)

    def _plainly_in_view(
        self, views: tuple[CameraView, ...], estimate: Estimate, carried: Sequence[Pose]
    ) -> list[tuple[LandmarkId, ...]]:
        """Landmarks that should be clearly visible in cameras without detections, while others confirm the pose."""
        if estimate.T_map_base is None or len(estimate.inliers) <= len(estimate.outliers):
            return [()] * len(views)
        poses = self._by_camera(self._left_camera(estimate.T_map_base), carried)
        return [() if view.detections else self._expected.in_camera(k, poses[k])[1] for k, view in enumerate(views)]

    def _color_events(self, group: FrameGroup, views: tuple[CameraView, ...]) -> list[Event]:
        """Reports gray cameras, once, if landmarks are recognized by their color."""
        events = []
        for k, view in enumerate(views):
            if view.image is None or not self._needs_color or k in self._gray or self._number > 0:
                continue
            if is_colorless(view.image) and view.image.any():
                self._gray.add(k)
                text = (
                    f"camera {view.name} is gray: landmarks are recognized by color; use a color camera or AprilTags"
                )
                events.append(Event("camera_gray", text, group.time_s))
        return events

    def _odometry_events(self, time_s: float) -> list[Event]:
        """Reports odometry, and a gyro with earlier data, when their data stop and when they resume."""
        if self.settings.motion == "none":
            return []
        self._motion_at.setdefault("odometry", time_s)
        events = []
        for name, last_s in self._motion_at.items():
            silent = time_s - last_s > SILENT_S
            if silent and name not in self._silent:
                self._silent.add(name)
                events.append(Event(f"{name}_lost", f"no {name} for {time_s - last_s:.1f} s", time_s))
            elif not silent and name in self._silent:
                self._silent.discard(name)
                events.append(Event(f"{name}_back", f"{name} is back", time_s))
        return events

    def _odometry_frame(self, time_s: float, estimate: Estimate) -> Pose | None:
        """T_map_odometry from the odometry's pose at this time."""
        if not self._odometry or estimate.T_map_base is None:
            return None
        k = int(np.searchsorted([t for t, _ in self._odometry], time_s))
        if k == 0 or k == len(self._odometry):
            T = self._odometry[min(k, len(self._odometry) - 1)][1]
        else:
            (before, a), (after, b) = self._odometry[k - 1], self._odometry[k]
            share = (time_s - before) / max(after - before, 1e-9)
            q = (1 - share) * a.quaternion_xyzw + share * np.sign(a.quaternion_xyzw @ b.quaternion_xyzw or 1.0) * (
                b.quaternion_xyzw
            )
            R = quaternion_to_matrix(q / np.linalg.norm(q))
            T = Pose(a.to_frame, a.from_frame, R, (1 - share) * a.t + share * b.t)
        T_map_base = Pose("map", T.from_frame, estimate.T_map_base.R, estimate.T_map_base.t)
        return T_map_base @ T.inverse()
