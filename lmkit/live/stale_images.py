"""Old images that a camera repeats: corners do not move although odometry or other cameras measure motion.

A feed that encodes an old image again gives other bytes every time, so bytes cannot be compared.  Instead, the
motion since an earlier image predicts how far corners move.  This motion is from odometry only, not from the filter,
which old images falsify.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import AnyRig, MountedCamera, mounted_cameras
from lmkit.live.dead_reckoning import DeadReckoning
from lmkit.live.events import Event
from lmkit.live.motion import MotionRow
from lmkit.localization.absolute_pose import locate_rig
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.observation import Detection
from lmkit.model.pose_status import PoseStatus

STILL_PX = 1.0  # largest motion of corners by noise and encoding
MOVED_PX = 5.0  # least motion that is certain despite noise
JUMP_PX = 20.0  # difference from the predicted motion, for an image of another place
SAME_PX = 0.5  # largest difference of corners in a repeated image
NAMED_AFTER_S = 0.3
FOLLOWS = 0.5  # largest difference of observed and expected motion, as a share of the expected one
STANDS_S = 1.0  # after a restart, a pose is accepted after standing for this time
REMEMBERED = 3000  # stored images with motion
LONGEST_DELAY_S = 0.6  # of the images relative to odometry

Corners = dict[LandmarkId, FloatArray]


@dataclass
class _View:
    """One camera's corners (4,2), px, at a time, and odometry's pose of the base at this time."""

    corners: Corners
    odometry: Pose | None
    time_s: float
    together: Sequence[_View] = ()  # views of all cameras at this time
    points: dict[LandmarkId, FloatArray] = field(default_factory=dict)  # (4,3) in the camera, computed when needed


@dataclass
class _Camera:
    """Memory of one camera."""

    mounted: MountedCamera
    reference: _View | None = None  # view since which its corners have not moved
    anchor: _View | None = None  # view since the last start
    seen: deque[_View] = field(default_factory=lambda: deque(maxlen=REMEMBERED))
    since_s: float | None = None  # start of corners that contradict the motion
    fresh_since_s: float | None = None  # start of corners that agree with it again
    repeats: bool = False
    named: bool = False


class StaleImages:
    """Withholds detections of images without motion while the robot moves.

    Args:
        by_odometry: compare with rows of motion; else compare the cameras of the rig with each other.
    """

    def __init__(self, rig: AnyRig, landmarks: LandmarkMap, by_odometry: bool) -> None:
        self._rig, self._map, self._by_odometry = rig, landmarks, by_odometry
        self._cameras = [_Camera(mounted) for mounted in mounted_cameras(rig)]
        self._base = rig.T_base_left or Pose.identity("base", "left")
        self._odometry = DeadReckoning()
        self._followed = not by_odometry
        self._starts = 0
        self._views: list[_View] = []
        self._stood_since: float | None = None

    def add(self, row: MotionRow) -> None:
        """Add a row of motion."""
        self._odometry.add(row)

    def withheld(
        self, time_s: float, seen: Sequence[Sequence[Detection]], delay_s: float = 0.0
    ) -> tuple[frozenset[int], tuple[Event, ...]]:
        """Cameras whose detections must not be used, and events.

        Args:
            delay_s: estimated delay of the images relative to odometry.
        """
        at = self._odometry.at(time_s - min(max(delay_s, 0.0), LONGEST_DELAY_S))
        views = [_View({d.id: d.corners for d in found if d.id in self._map}, at, time_s) for found in seen]
        if not self._by_odometry:
            for view in views:
                view.together = views
        self._views = views
        stale, events = set(), []
        for k, (camera, view) in enumerate(zip(self._cameras, views, strict=True)):
            if self._doubtful(k, view):
                stale.add(k)
                camera.fresh_since_s = None
                camera.since_s = camera.since_s if camera.since_s is not None else time_s
                if not camera.named and (camera.repeats or time_s - camera.since_s >= NAMED_AFTER_S):
                    camera.named = True
                    events.append(Event("camera_stale", self._sentence(camera), time_s))
            elif camera.named and not self._is_back(camera, view):
                stale.add(k)
            elif view.corners:
                if camera.named:
                    name = camera.mounted.name
                    events.append(Event("camera_back", f"camera {name} gives new images again", time_s))
                    if all(other.named for other in self._cameras):
                        self.start()
                camera.since_s, camera.named = None, False
        self._follow(views, stale)
        return frozenset(stale), tuple(events)

    def start(self) -> None:
        """Note a start of the filter: it is not yet known whether the images are current."""
        self._starts += 1
        self._followed = not self._by_odometry
        self._stood_since = None
        for camera, view in zip(self._cameras, self._views, strict=True):
            camera.anchor = view if view.corners else None

    def doubt(self) -> str:
        """Reason why the pose of a step is not reliable; empty if there is none."""
        named = [camera.mounted.name for camera in self._cameras if camera.named]
        if len(named) < len(self._cameras):
            return ""
        return f"camera {', '.join(named)} repeats an old image, or the wheels slip"

    def waits(self, time_s: float) -> str:
        """Missing condition before the pose of a start is accepted; empty if it is met."""
        if self._followed:
            return ""
        stood = self._stood_since is not None and (self._starts < 2 or time_s - self._stood_since >= STANDS_S)
        return "" if stood else "located anew: waiting for images that move as odometry does"

    def _doubtful(self, k: int, view: _View) -> bool:
        """Whether a camera's corners contradict the motion; keeps the image since which they have not moved."""
        camera = self._cameras[k]
        if not view.corners:
            return False
        reference = camera.reference
        common = [] if reference is None else [id_ for id_ in view.corners if id_ in reference.corners]
        if reference is None or not common:
            return self._renew(camera, view, is_jump=True)
        moved, expected = self._shifts(camera, reference, view, common)
        if _length(moved) > (STILL_PX if camera.since_s is None else MOVED_PX):
            return self._renew(camera, view, is_jump=_length(moved - expected) > JUMP_PX)
        if camera.since_s is not None:  # landmarks that are read only sometimes in the same old image
            reference.corners.update({id_: at for id_, at in view.corners.items() if id_ not in reference.corners})
        if camera.repeats or self._by_odometry:
            return camera.repeats or _length(expected) > MOVED_PX
        return self._contradicts(k, reference, view, common)

    def _is_back(self, camera: _Camera, view: _View) -> bool:
        """Whether a camera that repeated an image has agreed with the motion for a while."""
        if not view.corners:
            return False
        if camera.fresh_since_s is None:
            camera.fresh_since_s = view.time_s
        return view.time_s - camera.fresh_since_s >= NAMED_AFTER_S

    def _renew(self, camera: _Camera, view: _View, is_jump: bool) -> bool:
        """Store an image with motion; returns whether the same image was seen before at another place."""
        camera.repeats = is_jump and self._was_seen(camera, view)
        camera.reference = view
        if not camera.repeats:
            camera.seen.append(_View(view.corners, view.odometry, view.time_s))
        return camera.repeats

    def _was_seen(self, camera: _Camera, view: _View) -> bool:
        """Whether an earlier image had the same corners although the robot has moved since."""
        ids = list(view.corners)
        first, x = ids[0], float(view.corners[ids[0]][0, 0])
        has_left = False
        for other in reversed(camera.seen):
            corners = other.corners.get(first)
            if corners is None:
                continue
            if abs(corners[0, 0] - x) > SAME_PX or other.corners.keys() != view.corners.keys():
                has_left = has_left or abs(corners[0, 0] - x) > MOVED_PX
                continue
            moved, expected = self._shifts(camera, other, view, ids)
            if np.abs(moved).max() <= SAME_PX and (_length(expected) > MOVED_PX if self._by_odometry else has_left):
                return True
        return False

    def _contradicts(self, k: int, reference: _View, view: _View, common: Sequence[LandmarkId]) -> bool:
        """Whether corners of this camera should have moved according to the other cameras."""
        others = [pair for j, pair in enumerate(zip(reference.together, view.together, strict=True)) if j != k]
        shifts = [_moved(a, b, ids) for a, b in others if (ids := [id_ for id_ in b.corners if id_ in a.corners])]
        if all(_length(shift) < MOVED_PX for shift in shifts):
            return self._cameras[k].since_s is not None
        before, now = self._by_others(k, reference.together), self._by_others(k, view.together)
        if before is None or now is None:
            return self._cameras[k].since_s is not None
        _, expected = self._shifts(
            self._cameras[k], _View(reference.corners, before, 0.0), _View(view.corners, now, 0.0), common
        )
        return _length(expected) > MOVED_PX

    def _by_others(self, k: int, views: Sequence[_View]) -> Pose | None:
        """Pose of the base from all cameras except one; None if they do not determine it."""
        seen = [
            [] if j == k else [Detection(id_, corners, 1.0, 1.0) for id_, corners in view.corners.items()]
            for j, view in enumerate(views)
        ]
        if not any(seen):
            return None
        found = locate_rig(seen, self._rig, self._map)
        if found.status != PoseStatus.OK or found.T_map_camera is None:
            return None
        T = found.T_map_camera.R @ self._base.R.T
        return Pose("odometry", "base", T, found.T_map_camera.t - T @ self._base.t)

    def _shifts(
        self, camera: _Camera, before: _View, now: _View, ids: Sequence[LandmarkId]
    ) -> tuple[FloatArray, FloatArray]:
        """(N,2), px: observed motion of corners, and their motion predicted from odometry."""
        moved = _moved(before, now, ids)
        if before.odometry is None or now.odometry is None:
            return moved, np.zeros_like(moved)
        points = np.concatenate([self._points(camera, before, id_) for id_ in ids])
        T = camera.mounted.T_camera_left
        R, t = T.R @ self._base.R.T, T.t - T.R @ self._base.R.T @ self._base.t  # from the base into the camera
        step = now.odometry.inverse() @ before.odometry
        later = (((points - t) @ R) @ step.R.T + step.t) @ R.T + t
        at = np.concatenate([before.corners[id_] for id_ in ids])
        ahead = later[:, 2] > 0.05
        expected = np.full_like(at, 2 * JUMP_PX)  # behind the camera, so no longer visible
        if ahead.any():
            expected[ahead] = camera.mounted.model.project(later[ahead]) - at[ahead]
        return moved, expected

    def _points(self, camera: _Camera, view: _View, id_: LandmarkId) -> FloatArray:
        """(4,3) corners in the camera, with the depth from their size in the image."""
        if id_ not in view.points:
            rays = camera.mounted.model.unproject(view.corners[id_])
            side = float(np.linalg.norm(rays - np.roll(rays, 1, axis=0), axis=1).max())
            depth = self._size_m(id_) / max(side, 1e-6)
            view.points[id_] = depth * np.column_stack([rays, np.ones(4)])
        return view.points[id_]

    def _size_m(self, id_: LandmarkId) -> float:
        landmark = self._map.find(id_)
        assert landmark is not None
        return landmark.size_m

    def _follow(self, views: Sequence[_View], stale: set[int]) -> None:
        """Check since the last start: images move with odometry, or the robot is stationary."""
        if self._followed:
            return
        for k, (camera, view) in enumerate(zip(self._cameras, views, strict=True)):
            if not view.corners or k in stale:
                continue
            ids = [] if camera.anchor is None else [id_ for id_ in view.corners if id_ in camera.anchor.corners]
            if camera.anchor is None or not ids:
                camera.anchor, self._stood_since = view, None
                continue
            moved, expected = self._shifts(camera, camera.anchor, view, ids)
            if _length(expected) > MOVED_PX:
                # At the first start only images without motion are refused: the odometry's delay is not known yet.
                first = self._starts < 2 and _length(moved) > MOVED_PX
                self._followed = first or _length(moved - expected) < FOLLOWS * _length(expected)
                self._stood_since = None
                if self._followed:
                    return
            elif self._stood_since is None:
                self._stood_since = view.time_s

    def _sentence(self, camera: _Camera) -> str:
        name = camera.mounted.name
        if camera.repeats:
            return f"camera {name} repeats an old image; not used"
        says = "odometry says" if self._by_odometry else "the other cameras say"
        return f"camera {name} repeats an old image, or the wheels slip: {says} that the robot moves; not used"


def _moved(before: _View, now: _View, ids: Sequence[LandmarkId]) -> FloatArray:
    return np.concatenate([now.corners[id_] - before.corners[id_] for id_ in ids])


def _length(shifts: FloatArray) -> float:
    """Median length of (N,2) shifts."""
    return float(np.median(np.linalg.norm(shifts, axis=1)))
