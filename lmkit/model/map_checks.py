"""Checks of a landmark map that was written by hand: implausible places and sizes."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.model.floor_plan import FloorPlan
from lmkit.model.landmark_id import LandmarkId, ids_text
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark

HIGHEST_M = 10.0
LARGEST_M = 2.0
LEVEL = 0.05  # sine of the tilt of a landmark that is mounted upright
BEFORE_CELLS = 3.0  # distance before its face at which a landmark looks into free space
APART = 0.9  # of the mean size; landmarks with less between their centers overlap


def check_map(landmarks: LandmarkMap, floor: FloorPlan | None = None) -> list[str]:
    """Warnings, one a kind, that name the landmarks; empty if nothing is unusual.

    Args:
        floor: walls and free space, for landmarks that look into a wall or are outside of the rooms.
    """
    kinds: list[tuple[str, Callable[[MappedLandmark], bool]]] = [
        ("center below the floor", lambda m: m.T_map_landmark.t[2] < 0),
        (f"center above {HIGHEST_M:g} m: is the height in meters?", lambda m: m.T_map_landmark.t[2] > HIGHEST_M),
        (f"larger than {LARGEST_M:g} m: is the size in meters?", lambda m: m.size_m > LARGEST_M),
        ("not upright: its upper edge is rotated on the wall, or it lies flat", lambda m: not _is_upright(m)),
    ]
    warnings = []
    for words, is_so in kinds:
        if found := [m.id for m in landmarks if is_so(m)]:
            warnings.append(f"{ids_text(found)}: {words}")
    if floor is not None and (found := landmarks_off(floor, landmarks)):
        words = "faces a wall or is outside of the rooms: check the position, and facing_deg by 180"
        warnings.append(f"{ids_text(found)}: {words}")
    for one, other in combinations(landmarks, 2):
        if _overlap(one, other):
            warnings.append(f"{ids_text([one.id, other.id])}: overlap on the wall; one of them is measured wrong")
    return warnings


def landmarks_off(floor: FloorPlan, landmarks: LandmarkMap) -> list[LandmarkId]:
    """Ids of landmarks that no place of the floor sees: they face a wall, or are outside of the rooms."""
    return [m.id for m in landmarks if not _looks_into(m, floor)]


def _is_upright(landmark: MappedLandmark) -> bool:
    return bool(landmark.T_map_landmark.R[2, 1] > 1 - LEVEL)


def _looks_into(landmark: MappedLandmark, floor: FloorPlan) -> bool:
    before: FloatArray = (
        landmark.T_map_landmark.t[:2] + BEFORE_CELLS * floor.cell_m * landmark.T_map_landmark.R[:2, 2]
    )
    return bool(floor.is_free(before))


def _overlap(one: MappedLandmark, other: MappedLandmark) -> bool:
    same_side = one.T_map_landmark.R[:, 2] @ other.T_map_landmark.R[:, 2] > 0.5
    apart = float(np.linalg.norm(one.T_map_landmark.t - other.T_map_landmark.t))
    return bool(same_side and apart < APART * (one.size_m + other.size_m) / 2)
