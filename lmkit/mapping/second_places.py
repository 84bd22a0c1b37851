"""Place of a landmark according to its contradicting observations: its code is mounted twice, or it was moved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import AnyRig
from lmkit.localization.absolute_pose import possible_poses
from lmkit.mapping.bundle_results import Bundle
from lmkit.mapping.survey_results import ContradictedLandmark
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.model.recording import RigFrame

LEAST_FRAMES, AGREE_M = 3, 0.3  # frames whose places are so near to their median, half of them, name a place


def with_second_places(
    contradicted: Sequence[ContradictedLandmark],
    bundle: Bundle,
    outlier_sigma: float,
    frames: Sequence[RigFrame],
    rig: AnyRig,
    sizes_m: Mapping[LandmarkId, float],
) -> tuple[ContradictedLandmark, ...]:
    """The landmarks, each with the place on which its contradicting observations agree, if they do.

    Args:
        outlier_sigma: residual above which an observation contradicts.
        frames: of the recording; poses are those of the bundle.
    """
    by_time = {frame.time_s: frame for frame in frames}
    found = []
    for one in contradicted:
        off = (bundle.of == bundle.ids.index(one.id)) & (bundle.residuals > outlier_sigma)
        rows = np.unique(bundle.frames[off]).tolist()
        places = [
            place
            for row in rows
            if (place := _place(one.id, by_time[float(bundle.times_s[row])], bundle.poses.pose(row), rig, sizes_m))
            is not None
        ]
        found.append(replace(one, place=_agreed(places)))
    return tuple(found)


def _place(
    id_: LandmarkId, frame: RigFrame, T_map_left: Pose, rig: AnyRig, sizes_m: Mapping[LandmarkId, float]
) -> FloatArray | None:
    """(3,) center of the landmark in the map, from one frame alone."""
    seen = tuple(tuple(o for o in camera if o.id == id_) for camera in frame.seen)
    alone = LandmarkMap([MappedLandmark(id_, sizes_m[id_], Pose.identity("map", "landmark"))])
    poses = possible_poses(seen, rig, alone)
    return None if not poses else T_map_left.apply(poses[0].inverse().t[None])[0]


def _agreed(places: Sequence[FloatArray]) -> tuple[float, float, float] | None:
    if len(places) < LEAST_FRAMES:
        return None
    middle = np.median(places, axis=0)
    if np.median(np.linalg.norm(places - middle, axis=1)) > AGREE_M:
        return None
    x, y, z = middle.tolist()
    return x, y, z
