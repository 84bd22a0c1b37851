"""All observations of a recording, collected once for the many searches and adjustments of its initialization."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from lmkit.arrays import BoolArray, FloatArray, IntArray
from lmkit.geometry.rig import AnyRig
from lmkit.kernels.reprojection import Corners
from lmkit.localization.reprojection import sides_px
from lmkit.mapping.observation_arrays import ObservationArrays
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.recording import RigFrame


class RecordedObservations:
    """Observations of all landmarks in all frames (N), by frame and then by camera.

    Attributes:
        ids: the L landmarks; observations name them by their number here.
        arrays: the S observations.
        detections: (S) of these observations.
        side_px: (S,) sides in the image.
        is_single: (S,) whether the image shows the landmark once; which one of two is the mapped one is unknown.
        shown: (N,L) whether a camera shows the landmark.
    """

    def __init__(self, frames: Sequence[RigFrame], rig: AnyRig) -> None:
        in_frames = [{o.id for camera in frame.seen for o in camera} for frame in frames]
        self.ids: tuple[LandmarkId, ...] = tuple(sorted(set().union(*in_frames)))
        self._of, self._number = (frames, rig), {id_: k for k, id_ in enumerate(self.ids)}
        self.arrays, self.detections = ObservationArrays.collect_with_detections(frames, rig, self.ids)
        self.side_px: FloatArray = sides_px(np.array([o.corners for o in self.detections]).reshape(-1, 4, 2))
        self.shown: BoolArray = np.zeros((len(frames), len(self.ids)), dtype=bool)
        for shown, ids in zip(self.shown, in_frames, strict=True):
            shown[[self._number[id_] for id_ in ids]] = True
        # Observations of one landmark in one frame follow each other in this order.
        pairs = self.arrays.at * len(self.ids) + self.arrays.of
        self._order = np.argsort(pairs, kind="stable")
        self._pairs = pairs[self._order]
        _, image, count = np.unique(
            pairs * (1 + int(self.arrays.mount.max(initial=0))) + self.arrays.mount,
            return_inverse=True,
            return_counts=True,
        )
        self.is_single: BoolArray = count[image.ravel()] == 1

    def are_of(self, frames: Sequence[RigFrame], rig: AnyRig) -> bool:
        """Whether the observations are from this recording."""
        return self._of[0] is frames and self._of[1] is rig

    def only(self, frames: Sequence[int], ids: Sequence[LandmarkId]) -> ObservationArrays:
        """Observations in these frames of these landmarks, which the recording has."""
        return self.arrays.only(frames, [self._number[id_] for id_ in ids])

    def numbers(self, ids: Collection[LandmarkId]) -> list[int]:
        """Numbers of those landmarks that the recording has."""
        return [self._number[id_] for id_ in ids if id_ in self._number]

    def ids_in(self, frames: Sequence[int]) -> set[LandmarkId]:
        """Landmarks that some of these frames show."""
        return {self.ids[k] for k in np.flatnonzero(self.shown[list(frames)].any(axis=0))}

    def rows_in(self, frames: Sequence[int], ids: Collection[LandmarkId]) -> IntArray:
        """Single observations in these frames of these landmarks."""
        in_frame, of = np.zeros(self.shown.shape[0], dtype=bool), np.zeros(len(self.ids), dtype=bool)
        in_frame[list(frames)], of[self.numbers(ids)] = True, True
        return np.flatnonzero(in_frame[self.arrays.at] & of[self.arrays.of] & self.is_single)

    def rows_of(self, frame: int, id_: LandmarkId) -> IntArray:
        """Single observations in one frame of one landmark, the first camera's first."""
        first, end = np.searchsorted(self._pairs, frame * len(self.ids) + self._number[id_] + np.array([0, 1]))
        rows = self._order[first:end]
        return rows[self.is_single[rows]]

    def corners(self, rows: IntArray, corners_map: Mapping[LandmarkId, FloatArray]) -> Corners:
        """Some observations, for kernels.

        Args:
            corners_map: (4,3) corners of the landmarks in the map.
        """
        table = np.zeros((len(self.ids), 4, 3))
        for id_, corners in corners_map.items():
            if id_ in self._number:
                table[self._number[id_]] = corners
        a = self.arrays
        mount = a.mount[rows]
        points = table[a.of[rows]]
        return Corners(points, a.rays[rows], a.by_ray[rows], a.whitener[rows], a.mounted_R[mount], a.mounted_t[mount])

    def largest_views(self) -> dict[LandmarkId, list[tuple[float, int]]]:
        """Views of every landmark: (side in px, frame), the largest first."""
        at, of = np.divmod(self._pairs, max(len(self.ids), 1))
        starts = np.flatnonzero(np.diff(self._pairs, prepend=-1))
        at, of = at[starts], of[starts]
        side = np.maximum.reduceat(self.side_px[self._order], starts) if len(starts) else np.zeros(0)
        order = np.lexsort((-at, -side, of))
        views: dict[LandmarkId, list[tuple[float, int]]] = {}
        for k, px, frame in zip(of[order].tolist(), side[order].tolist(), at[order].tolist(), strict=True):
            views.setdefault(self.ids[k], []).append((px, frame))
        return views
