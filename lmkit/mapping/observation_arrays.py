"""All observations of a recording as arrays: landmark, frame and camera of each, and its corners as rays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lmkit.arrays import FloatArray, IntArray
from lmkit.geometry.pose_array import PoseArray
from lmkit.geometry.rig import AnyRig, mounted_cameras
from lmkit.kernels.landmark_bundle import Bundle
from lmkit.localization.correspondences import CORNER_FLOOR_PX
from lmkit.localization.reprojection import through_lens
from lmkit.mapping.camera_relations import CameraRelations
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.recording import RigFrame


@dataclass(frozen=True, eq=False)
class ObservationArrays:
    """Correspondences of landmarks by all cameras.

    Attributes:
        at, of: (S,) frames and landmarks.
        rays, by_ray, whitener: (S,4,2), (S,4,2,2), (S,8,8) as of `CameraCorrespondences`.
        camera_R, camera_t: (S,3,3), (S,3) from the rig's left camera into the camera.
        camera: (S,) which camera of the rig it is.
    """

    at: IntArray
    of: IntArray
    rays: FloatArray
    by_ray: FloatArray
    whitener: FloatArray
    camera_R: FloatArray
    camera_t: FloatArray
    camera: IntArray

    @classmethod
    def collect(cls, frames: Sequence[RigFrame], rig: AnyRig, ids: Sequence[LandmarkId]) -> ObservationArrays:
        """Observations of these landmarks as arrays; others are left out."""
        index = {id_: k for k, id_ in enumerate(ids)}
        rows: list[tuple[int, int]] = []
        parts: list[tuple[Any, ...]] = []
        for which, camera in enumerate(mounted_cameras(rig)):
            R, t = camera.T_camera_left.R, camera.T_camera_left.t
            observations = [frame.seen[which] for frame in frames]
            listed = [(o, (k, index[o.id])) for k, some in enumerate(observations) for o in some if o.id in index]
            seen = through_lens([o for o, _ in listed], camera.model, CORNER_FLOOR_PX)
            rows += [listed[k][1] for k in seen.kept]
            turned, moved = np.repeat(R[None], len(seen.kept), axis=0), np.tile(t, (len(seen.kept), 1))
            for row, k in enumerate(seen.kept):
                if carried := frames[listed[k][1][0]].carried:
                    T = camera.T_camera_left @ carried[which].inverse()
                    turned[row], moved[row] = T.R, T.t
            parts.append((seen.rays, seen.by_ray, seen.whitener, turned, moved, np.full(len(seen.kept), which)))
        table = np.array(rows, dtype=np.int64).reshape(-1, 2)
        # Frame by frame: sums over them then stay in the processor's cache.
        order = np.argsort(table[:, 0], kind="stable")
        columns = (np.concatenate(column)[order] for column in zip(*parts, strict=True))
        return cls(table[order, 0], table[order, 1], *columns)

    def only(self, frames: Sequence[int], landmarks: Sequence[int]) -> ObservationArrays:
        """Observations in some frames of some landmarks, both numbered anew in the order given."""
        at, of = (_renumbered(old, new) for old, new in ((self.at, frames), (self.of, landmarks)))
        kept = np.flatnonzero((at >= 0) & (of >= 0))
        rest: tuple[Any, ...] = (self.rays, self.by_ray, self.whitener, self.camera_R, self.camera_t, self.camera)
        return ObservationArrays(at[kept], of[kept], *(column[kept] for column in rest))

    def __len__(self) -> int:
        return len(self.at)

    def bundle(
        self, poses: PoseArray, landmarks: PoseArray, arms: FloatArray, relations: CameraRelations | None = None
    ) -> Bundle:
        """The observations from (N) rig poses of (L) landmarks, with corners ``arms`` (L,4,3) in their own frames.

        Args:
            relations: the cameras as they are now; None: as in the rig file.
        """
        camera_R, camera_t = self.camera_R, self.camera_t
        if relations is not None:
            camera_R, camera_t = relations.of_observations(self.camera, camera_R, camera_t)
        return Bundle(
            self.at,
            self.of,
            self.rays,
            self.by_ray,
            self.whitener,
            camera_R,
            camera_t,
            poses.R,
            poses.t,
            landmarks.R,
            landmarks.t,
            arms,
        )


@dataclass(frozen=True, eq=False)
class StoredObservations:
    """Observations whose large arrays are in a file, and in memory only while a bundle is made of them.

    Attributes:
        at, of, camera: as of `ObservationArrays`.
        path: the file.
    """

    at: IntArray
    of: IntArray
    camera: IntArray
    path: Path

    @classmethod
    def write(cls, seen: ObservationArrays, path: Path) -> StoredObservations:
        """Write all arrays into a file."""
        np.savez(path, **{name: getattr(seen, name) for name in ObservationArrays.__dataclass_fields__})
        return cls(seen.at, seen.of, seen.camera, path)

    def __len__(self) -> int:
        return len(self.at)

    def bundle(
        self, poses: PoseArray, landmarks: PoseArray, arms: FloatArray, relations: CameraRelations | None = None
    ) -> Bundle:
        """A bundle as of `ObservationArrays`."""
        with np.load(self.path) as arrays:
            seen = ObservationArrays(*(arrays[name] for name in ObservationArrays.__dataclass_fields__))
        return seen.bundle(poses, landmarks, arms, relations)


class RecordedObservations:
    """All observations of a recording, made arrays once; bundle adjustments of parts of it take theirs from here."""

    def __init__(self, frames: Sequence[RigFrame], rig: AnyRig) -> None:
        ids = sorted({o.id for frame in frames for o in frame.detections})
        self._number = {id_: k for k, id_ in enumerate(ids)}
        self._all = ObservationArrays.collect(frames, rig, ids)

    def only(self, frames: Sequence[int], ids: Sequence[LandmarkId]) -> ObservationArrays:
        """Observations in these frames of these landmarks, which the recording has."""
        return self._all.only(frames, [self._number[id_] for id_ in ids])


def _renumbered(numbers: IntArray, kept: Sequence[int]) -> IntArray:
    """Each number's place in ``kept``; -1 for those that are not there."""
    table = np.full(max([-1, *kept, *numbers.max(initial=-1, keepdims=True).tolist()]) + 1, -1)
    table[list(kept)] = np.arange(len(kept))
    return np.asarray(table[numbers])
