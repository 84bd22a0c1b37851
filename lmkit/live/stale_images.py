"""Old images that a camera repeats: corners stand still while odometry or the other cameras say the robot moves.

A feed that encodes an old image anew gives other bytes every time, so bytes tell nothing.  Corners do: from where a
landmark was, the motion since then predicts how far its corners move.  Odometry alone says so here, never the filter,
which the old image pulls.
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
from lmkit.live.motion import MotionRow
from lmkit.live.state import Event
from lmkit.localization.absolute_pose import locate_rig
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.observation import Detection
from lmkit.model.pose_status import PoseStatus

STILL_PX = 1.0  # corners that noise and encoding move are within
MOVED_PX = 5.0  # a motion that no noise hides
JUMP_PX = 20.0  # an image that shows another place than the motion leads to
SAME_PX = 0.5  # the same image again
NAMED_AFTER_S = 0.3
FOLLOWS = 0.5  # largest share of the expected motion by which the seen one may differ
STANDS_S = 1.0  # a robot that was put down may be believed after standing for so long
REMEMBERED = 3000  # images that moved
LONGEST_DELAY_S = 0.6  # of the images against odometry

Corners = dict[LandmarkId, FloatArray]


@dataclass
class _View:
    """One camera's corners (4,2), px, at a time, and odometry's pose of the base then."""

    corners: Corners
    odometry: Pose | None
    time_s: float
    together: Sequence[_View] = ()  # of all cameras at that time
    points: dict[LandmarkId, FloatArray] = field(default_factory=dict)  # (4,3) in the camera, once asked for


@dataclass
class _Camera:
    """Memory of one camera."""

    mounted: MountedCamera
    reference: _View | None = None  # since then its corners have stood still
    anchor: _View | None = None  # since the last start
    seen: deque[_View] = field(default_factory=lambda: deque(maxlen=REMEMBERED))
    since_s: float | None = None  # corners contradict the motion
    fresh_since_s: float | None = None  # and since then no more
    repeats: bool = False
    named: bool = False


class StaleImages:
    """Withholds detections of images that stand still while the robot moves.

    Args:
        by_odometry: rows of motion come; else the cameras of the rig are compared with each other.
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
        """Take a row of motion."""
        self._odometry.add(row)

    def withheld(
        self, time_s: float, seen: Sequence[Sequence[Detection]], delay_s: float = 0.0
    ) -> tuple[frozenset[int], tuple[Event, ...]]:
        """Cameras whose detections must not be used, and what is to be named.

        Args:
            delay_s: of the images against odometry, as far as it is known.
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
        """The filter was started here: nothing says yet that the images are of now."""
        self._starts += 1
        self._followed = not self._by_odometry
        self._stood_since = None
        for camera, view in zip(self._cameras, self._views, strict=True):
            camera.anchor = view if view.corners else None

    def doubt(self) -> str:
        """Why the pose of a step is not to be believed; empty where nothing speaks against it."""
        named = [camera.mounted.name for camera in self._cameras if camera.named]
        if len(named) < len(self._cameras):
            return ""
        return f"camera {', '.join(named)} repeats an old image, or the wheels slip"

    def waits(self, time_s: float) -> str:
        """Sentence on what must still be seen before the pose of a start is believed; empty if it was seen."""
        if self._followed:
            return ""
        stood = self._stood_since is not None and (self._starts < 2 or time_s - self._stood_since >= STANDS_S)
        return "" if stood else "located anew: waiting for images that move as odometry does"

    def _doubtful(self, k: int, view: _View) -> bool:
        """Whether a camera's corners contradict the motion; keeps the image since which they have stood still."""
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
        if camera.since_s is not None:  # what is read in the same old image only now and then
            reference.corners.update({id_: at for id_, at in view.corners.items() if id_ not in reference.corners})
        if camera.repeats or self._by_odometry:
            return camera.repeats or _length(expected) > MOVED_PX
        return self._contradicts(k, reference, view, common)

    def _is_back(self, camera: _Camera, view: _View) -> bool:
        """Whether a camera that repeated an image has contradicted nothing for a while."""
        if not view.corners:
            return False
        if camera.fresh_since_s is None:
            camera.fresh_since_s = view.time_s
        return view.time_s - camera.fresh_since_s >= NAMED_AFTER_S

    def _renew(self, camera: _Camera, view: _View, is_jump: bool) -> bool:
        """Keep an image that moved; whether it is one that was seen before at another place."""
        camera.repeats = is_jump and self._was_seen(camera, view)
        camera.reference = view
        if not camera.repeats:
            camera.seen.append(_View(view.corners, view.odometry, view.time_s))
        return camera.repeats

    def _was_seen(self, camera: _Camera, view: _View) -> bool:
        """Whether an earlier image, since which the robot has moved, had the very same corners."""
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
        """Whether the other cameras say that the corners of this one should have moved."""
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
        """Pose of the base by all cameras but one; None where they do not give it."""
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
        """(N,2), px: how far corners moved, and how far odometry says that they did."""
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
        expected = np.full_like(at, 2 * JUMP_PX)  # behind the camera: it cannot be seen any more
        if ahead.any():
            expected[ahead] = camera.mounted.model.project(later[ahead]) - at[ahead]
        return moved, expected

    def _points(self, camera: _Camera, view: _View, id_: LandmarkId) -> FloatArray:
        """(4,3) corners in the camera, as far as their size in the image says."""
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
        """Since the last start: do images move as odometry does, or does the robot stand?"""
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
                # At first only an image that stands still is feared: the odometry's delay is not known yet.
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
