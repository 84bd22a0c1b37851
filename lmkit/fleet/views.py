"""Views: reading quality of each landmark in images that show it completely, by the robot's pose.

Views of one kind, of similar size in the image and from a similar direction, can be compared over days: an object
that hides a landmark from one side today also hides it tomorrow.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from lmkit.fleet.jobs import READERS, Outcome
from lmkit.fleet.recordings import FleetRecording
from lmkit.fleet.store import Store
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import AnyRig, mounted_cameras
from lmkit.localization.expected_landmarks import Expected, ExpectedLandmarks
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.observation import Detection
from lmkit.model.pose_status import PoseStatus
from lmkit.model.recording import RigFrame
from lmkit.model.tracked_trajectory import TrackedTrajectory

EVERY_S = 0.4  # images in between are nearly equal
LEAST_SIDE_PX, BORDER_PX = 12.0, 8.0  # of a landmark that is expected to be read
SURE_M = 0.1  # largest standard deviation of a pose that predicts visible landmarks
STEPS_PER_OCTAVE = 3  # classes of size in the image
AZIMUTH_RAD = np.deg2rad(20.0)  # classes of direction, about the vertical through the landmark
COLUMNS = ("id", "size", "direction", "expected", "read", "evidence", "weighed")

Kind = tuple[str, int, int]  # landmark, class of size, class of direction


@dataclass
class Count:
    """Views of one kind in one recording.

    Attributes:
        expected, read: images that should show the landmark, and those in which it was read.
        evidence: sum of log(margin / side^2) of readings that have a margin; the margin grows with the pixels.
        weighed: number of these readings.
    """

    expected: int = 0
    read: int = 0
    evidence: float = 0.0
    weighed: int = 0


@dataclass
class Views:
    """Counts by kind of view, summed over the parts of a recording."""

    counts: dict[Kind, Count] = field(default_factory=dict)

    def add(
        self, frames: Sequence[RigFrame], rig: AnyRig, landmarks: LandmarkMap, tracked: TrackedTrajectory
    ) -> None:
        """Count the views of a tracked part."""
        expected, cameras = ExpectedLandmarks(rig, landmarks), mounted_cameras(rig)
        for frame, T_map_left in _sure_poses(frames, rig, tracked):
            for k, camera in enumerate(cameras):
                shown, _ = expected.in_camera(k, T_map_left)
                inside = {i: c for i, c in shown.items() if camera.model.contains(c, BORDER_PX).all()}
                place = T_map_left.apply(camera.T_camera_left.inverse().t[None])[0]
                self._count(inside, {d.id: d for d in frame.seen[k]}, landmarks, place)

    def _count(
        self, inside: Expected, seen: Mapping[LandmarkId, Detection], landmarks: LandmarkMap, place: Any
    ) -> None:
        for id_, corners in inside.items():
            side = float(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).mean())
            landmark = landmarks.find(id_)
            if side < LEAST_SIDE_PX or landmark is None:
                continue
            T = landmark.T_map_landmark
            along = T.R.T @ (place - T.t)
            direction = round(float(np.arctan2(along[0], along[2])) / AZIMUTH_RAD)
            size = round(STEPS_PER_OCTAVE * np.log2(side / LEAST_SIDE_PX))
            count = self.counts.setdefault((str(id_), size, direction), Count())
            count.expected += 1
            if id_ in seen:
                count.read += 1
                if seen[id_].margin > 0:
                    count.evidence += float(np.log(seen[id_].margin / side**2))
                    count.weighed += 1

    def columns(self) -> dict[str, Any]:
        """Columns of a table, a row for each kind of view."""
        rows = [(*kind, *vars(count).values()) for kind, count in sorted(self.counts.items())]
        return dict(zip(COLUMNS, zip(*rows, strict=True), strict=True)) if rows else dict.fromkeys(COLUMNS, ())


def _sure_poses(
    frames: Sequence[RigFrame], rig: AnyRig, tracked: TrackedTrajectory
) -> Iterator[tuple[RigFrame, Pose]]:
    """Frames with a precise pose, not too close in time, with T_map_left."""
    by_time = {frame.time_s: frame for frame in frames}
    last_s = -np.inf
    for time_s, pose, C, status in zip(
        tracked.times_s.tolist(), tracked.poses, tracked.covariances, tracked.statuses, strict=True
    ):
        sure = status == PoseStatus.OK and np.trace(C[:3, :3]) < SURE_M**2
        if not sure or time_s not in by_time or time_s < last_s + EVERY_S:
            continue
        last_s = time_s
        on_base = tracked.of_base and rig.T_base_left is not None
        yield by_time[time_s], pose @ rig.T_base_left if on_base else pose  # type: ignore[operator]


def write_views(store: Store, key: str, views: Views) -> None:
    """Write the views of a tracked recording."""
    store.write_table(_name(key), views.columns())


def read_views(store: Store, tracked: Sequence[tuple[FleetRecording, str, Outcome]]) -> dict[str, dict[Kind, Count]]:
    """Counts of every tracked recording by its source, read in parallel."""
    done = [(recording.source, key) for recording, key, outcome in tracked if outcome.ok]
    with ThreadPoolExecutor(READERS) as pool:
        return dict(zip((s for s, _ in done), pool.map(partial(_read, store), (k for _, k in done)), strict=True))


def _read(store: Store, key: str) -> dict[Kind, Count]:
    columns, _ = store.read_table(_name(key))
    lists = [columns[name].tolist() if isinstance(columns[name], np.ndarray) else columns[name] for name in COLUMNS]
    return {(row[0], row[1], row[2]): Count(*row[3:]) for row in zip(*lists, strict=True)}


def _name(key: str) -> str:
    return f"track/{key}.views.parquet"
