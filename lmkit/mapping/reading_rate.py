"""Reading rate of a landmark while it is in view: a print that only resembles a landmark is read in few frames.

Such a print has a fixed place, so parallax does not distinguish it from a landmark.  But landmarks that are
large and not slanted are read in nearly all frames.  So the frames just before and after each reading are
tested.  A temporary occlusion does not matter, since it hides the landmark in many consecutive frames.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from lmkit.arrays import BoolArray, FloatArray, IntArray
from lmkit.geometry.pose_array import PoseArray
from lmkit.geometry.rig import AnyRig, mounted_cameras
from lmkit.mapping.bundle_adjustment import BundleProblem
from lmkit.model.detector_model import half_read_px, recognized
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import MappedLandmark

NEIGHBORS = np.array([-4, -3, -2, -1, 1, 2, 3, 4])  # frames before and after a frame with a reading
SURELY = 0.9  # least probability of reading for a landmark that should be read
NEAREST_M = 0.05
WIDEST = 0.75  # of the image's size over the focal length: outside, lens models fold back into the image


@dataclass(frozen=True, eq=False)
class LocatedFrames:
    """Frames of a recording with their poses, and the frames with readings of each landmark.

    Attributes:
        times_s: (N,).
        poses: (N) T_map_left.
        rig: rig of the recording.
        looked: (N,C) cameras that read any landmark.
        read: frames in which an observation fits each landmark.
    """

    times_s: FloatArray
    poses: PoseArray
    rig: AnyRig
    looked: BoolArray
    read: dict[LandmarkId, IntArray]

    @classmethod
    def of(cls, problem: BundleProblem, rig: AnyRig) -> LocatedFrames:
        """Frames of a solved recording."""
        seen = problem.seen
        looked = np.zeros((len(problem.times), len(mounted_cameras(rig))), dtype=bool)
        looked[seen.at, seen.camera] = True
        read = {id_: np.unique(seen.at[problem.used & (seen.of == k)]) for k, id_ in enumerate(problem.landmark_ids)}
        return cls(problem.times, PoseArray("map", "left", problem.R, problem.p), rig, looked, read)

    def times_of(self, id_: LandmarkId) -> FloatArray:
        """Times of the frames in which an observation fits a landmark."""
        return np.asarray(self.times_s[self.read.get(id_, np.zeros(0, dtype=np.int64))])

    def beside(self, id_: LandmarkId) -> tuple[IntArray, BoolArray]:
        """(K,) frames next to a reading of a landmark, and which of them read it."""
        own = self.read.get(id_, np.zeros(0, dtype=np.int64))
        beside = (own[:, None] + NEIGHBORS).ravel()
        frames = np.unique(beside[(beside >= 0) & (beside < len(self.times_s))])
        return frames, np.isin(frames, own)

    def readable(self, landmark: MappedLandmark, frames: IntArray) -> BoolArray:
        """(K,) frames in which a camera sees a landmark well enough that it should be read."""
        answer = np.zeros(len(frames), dtype=bool)
        in_rig = (landmark.corners_map - self.poses.t[frames, None]) @ self.poses.R[frames]
        normal = landmark.T_map_landmark.R[:, 2] @ self.poses.R[frames]
        for which, camera in enumerate(mounted_cameras(self.rig)):
            T, model = camera.T_camera_left, camera.model
            points = in_rig @ T.R.T + T.t
            center = points.mean(axis=1)
            facing = -((normal @ T.R.T) * center).sum(axis=1) / np.maximum(np.linalg.norm(center, axis=1), NEAREST_M)
            limit = WIDEST * np.array(model.image_size) / model.K[[0, 1], [0, 1]]
            slopes = np.abs(points[..., :2]) / np.maximum(points[..., 2:], NEAREST_M)
            shown = (points[..., 2] > NEAREST_M).all(axis=1) & (slopes < limit).all(axis=(1, 2))
            rows = np.flatnonzero(shown & self.looked[frames, which] & (facing > 0))
            corners = model.project(points[rows].reshape(-1, 3)).reshape(-1, 4, 2)
            sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean(axis=1)
            chance = recognized(sides, np.arccos(facing[rows]), half_read_px(landmark.id.family))
            inside = model.contains(corners.reshape(-1, 2)).reshape(-1, 4).all(axis=1)
            answer[rows] |= inside & (chance >= SURELY)
        return answer


def neighbors_read(landmark: MappedLandmark, recordings: Iterable[LocatedFrames]) -> tuple[int, int]:
    """Number of frames next to readings of a landmark that should read it, and number that do; each counts once."""
    expected = read = 0
    for recording in recordings:
        frames, is_read = recording.beside(landmark.id)
        expected += int((recording.readable(landmark, frames) | is_read).sum())
        read += int(is_read.sum())
    return expected, read


def most_neighbors(id_: LandmarkId, recordings: Iterable[LocatedFrames]) -> tuple[int, int]:
    """Results of `neighbors_read` if each of those frames should read the landmark; nothing is projected."""
    reads = [recording.beside(id_)[1] for recording in recordings]
    return sum(map(len, reads)), sum(int(is_read.sum()) for is_read in reads)
