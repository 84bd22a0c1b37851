"""All observations of a recording as arrays: landmark, frame and camera of each, and its corners as rays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lmkit.arrays import FloatArray, IntArray
from lmkit.geometry.pose_array import PoseArray
from lmkit.geometry.rig import AnyRig, mounted_cameras
from lmkit.kernels.landmark_bundle import Bundle
from lmkit.localization.correspondences import CORNER_FLOOR_PX
from lmkit.localization.reprojection import through_lens
from lmkit.mapping.camera_relations import CameraRelations
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.observation import Detection
from lmkit.model.recording import RigFrame


@dataclass(frozen=True, eq=False)
class ObservationArrays:
    """Correspondences of landmarks by all cameras.

    Attributes:
        at, of: (S,) frame and landmark of each observation.
        rays, by_ray, whitener: (S,4,2), (S,4,2,2), (S,8,8) as of `CameraCorrespondences`.
        variance: (S,) stated variance of a corner's coordinate, px^2, without the floor; 0 if none is stated.
        mount: (S,) which of the mounted cameras saw it.
        mounted_R, mounted_t: (K,3,3), (K,3) from the rig's left camera into mounted cameras: those of the rig, and
            if they do not expose together, one for each frame.
        mounted_camera: (K,) index of the rig's camera for each mounted camera.
    """

    at: IntArray
    of: IntArray
    rays: FloatArray
    by_ray: FloatArray
    whitener: FloatArray
    variance: FloatArray
    mount: IntArray
    mounted_R: FloatArray
    mounted_t: FloatArray
    mounted_camera: IntArray

    @classmethod
    def collect(cls, frames: Sequence[RigFrame], rig: AnyRig, ids: Sequence[LandmarkId]) -> ObservationArrays:
        """Observations of these landmarks as arrays; others are omitted."""
        return cls.collect_with_detections(frames, rig, ids)[0]

    @classmethod
    def collect_with_detections(
        cls, frames: Sequence[RigFrame], rig: AnyRig, ids: Sequence[LandmarkId]
    ) -> tuple[ObservationArrays, list[Detection]]:
        """Observations as arrays, and the detections in the same order: by frame, then by camera."""
        index = {id_: k for k, id_ in enumerate(ids)}
        cameras = mounted_cameras(rig)
        mounted = [(camera.T_camera_left, which) for which, camera in enumerate(cameras)]
        rows: list[tuple[int, int, int]] = []
        detections: list[Detection] = []
        parts: list[tuple[FloatArray, ...]] = []
        for which, camera in enumerate(cameras):
            mount = which
            listed: list[Detection] = []
            own: list[tuple[int, int, int]] = []
            for at, frame in enumerate(frames):
                if frame.carried:
                    mount = len(mounted)
                    mounted.append((camera.T_camera_left @ frame.carried[which].inverse(), which))
                for o in frame.seen[which]:
                    of = index.get(o.id)
                    if of is not None:
                        listed.append(o)
                        own.append((at, of, mount))
            seen = through_lens(listed, camera.model, CORNER_FLOOR_PX)
            rows += [own[k] for k in seen.kept]
            detections += [listed[k] for k in seen.kept]
            parts.append((seen.rays, seen.by_ray, seen.whitener, seen.variances))
        table = np.array(rows, dtype=np.int64).reshape(-1, 3)
        # Frame by frame: sums over them then stay in the processor's cache.
        order = np.argsort(table[:, 0], kind="stable")
        rays, by_ray, whitener, variance = (np.concatenate(column)[order] for column in zip(*parts, strict=True))
        at_frame, of_landmark, by_mount = np.ascontiguousarray(table[order].T)
        R, t = np.array([T.R for T, _ in mounted]), np.array([T.t for T, _ in mounted])
        cameras_of = np.array([which for _, which in mounted])
        arrays = cls(at_frame, of_landmark, rays, by_ray, whitener, variance, by_mount, R, t, cameras_of)
        return arrays, [detections[k] for k in order.tolist()]

    def only(self, frames: Sequence[int], landmarks: Sequence[int]) -> ObservationArrays:
        """Observations in some frames of some landmarks, both renumbered in the given order."""
        at, of = (_renumbered(old, new) for old, new in ((self.at, frames), (self.of, landmarks)))
        kept = np.flatnonzero((at >= 0) & (of >= 0))
        return replace(
            self,
            at=at[kept],
            of=of[kept],
            rays=self.rays[kept],
            by_ray=self.by_ray[kept],
            whitener=self.whitener[kept],
            variance=self.variance[kept],
            mount=self.mount[kept],
        )

    def __len__(self) -> int:
        return len(self.at)

    @property
    def camera(self) -> IntArray:
        """(S,) index of the rig's camera of each observation."""
        return self.mounted_camera[self.mount]

    def bundle(
        self, poses: PoseArray, landmarks: PoseArray, arms: FloatArray, relations: CameraRelations | None = None
    ) -> Bundle:
        """The observations from (N) rig poses of (L) landmarks, with corners ``arms`` (L,4,3) in their own frames.

        Args:
            relations: current relative poses of the cameras; None: those of the rig file.
        """
        R, t = self.mounted_R, self.mounted_t
        if relations is not None:
            R, t = relations.of_mounted(self.mounted_camera, R, t)
        return Bundle(
            self.at,
            self.of,
            self.mount,
            self.rays,
            self.by_ray,
            self.whitener,
            R,
            t,
            poses.R,
            poses.t,
            landmarks.R,
            landmarks.t,
            arms,
        )


@dataclass(frozen=True, eq=False)
class StoredObservations:
    """Observations whose large arrays are in a file, and in memory only while a bundle is built from them.

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


def _renumbered(numbers: IntArray, kept: Sequence[int]) -> IntArray:
    """Index of each number in ``kept``; -1 if it is not there."""
    table = np.full(max([-1, *kept, *numbers.max(initial=-1, keepdims=True).tolist()]) + 1, -1)
    table[list(kept)] = np.arange(len(kept))
    return np.asarray(table[numbers])
