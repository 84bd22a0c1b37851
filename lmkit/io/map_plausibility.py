"""Plausibility of a map that was read: units of its positions, and overlapping landmarks."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lmkit.errors import InputError, InputWarning, warn_caller
from lmkit.geometry.rotations import quaternion_to_matrix
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.model.landmark_overlap import overlaps
from lmkit.model.scan import POLE

HIGHEST_M, WIDEST_M = 20.0, 1000.0  # of maps in a building or on a field
# Distance in sides of a landmark of 15 px with a focal length of 15,000 px: farther landmarks are never in one image.
FARTHEST_SIZES = 1000.0
UPRIGHT, SAME_WALL = 0.99, 0.7  # cosines: of a landmark's y axis with the vertical, and of two normals
HARDLY_HIGH_M = 100.0  # floors are near z = 0


def with_doubts(path: Path, landmarks: LandmarkMap) -> LandmarkMap:
    """The map, with a warning about implausible positions, and about overlapping landmarks.

    Raises:
        InputError: ``implausible_map``, landmarks far above the floor, with no two in sight of each other.

    Warns:
        InputWarning: great heights or distances, or landmarks that overlap.
    """
    mapped = list(landmarks)
    if not mapped:
        warn_caller(InputWarning(f"{path}: contains only earlier places (valid_to), which are not used"))
        return landmarks
    places = np.array([marker.T_map_landmark.t for marker in mapped])
    height, width = float(np.abs(places[:, 2]).max()), float(np.ptp(places, axis=0).max())
    if height > HIGHEST_M or width > WIDEST_M:
        require_in_sight(path, mapped)
        sentence = (
            f"{path}: landmarks up to {height:.4g} m high and {width:.4g} m apart: are its lengths inches or "
            "millimeters? Give meters"
        )
        warn_caller(InputWarning(sentence))
    if _reads_upright_with_w_first(mapped):
        sentence = (
            f"{path}: every landmark is upright if its quaternion is read with w first, and not if read as x y z w: "
            "write x y z w"
        )
        warn_caller(InputWarning(sentence))
    for a, b, apart in overlaps(mapped):
        sentence = (
            f"{path}: {a.id} and {b.id} overlap, {1000 * apart:.0f} mm from center to center: correct the place or "
            "the code of one of them"
        )
        warn_caller(InputWarning(sentence))
    return landmarks


def _reads_upright_with_w_first(mapped: Sequence[MappedLandmark]) -> bool:
    """Whether landmarks of several walls are all upright with quaternions w x y z, and not with those read."""
    faced = [m for m in mapped if m.id.family != POLE]
    quaternions = np.array([m.T_map_landmark.quaternion_xyzw for m in faced]).reshape(-1, 4)
    as_read, w_first = (quaternion_to_matrix(q) for q in (quaternions, quaternions[:, [1, 2, 3, 0]]))
    normals = w_first[:, :, 2]
    are_several = len(faced) > 1 and float((normals @ normals.T).min()) < SAME_WALL
    return are_several and bool((w_first[:, 2, 1] > UPRIGHT).all()) and not (as_read[:, 2, 1] > UPRIGHT).all()


def require_in_sight(path: Path, mapped: Sequence[MappedLandmark]) -> None:
    """Refuse landmarks that are all farther from the next one than can be seen, some far above the floor.

    Raises:
        InputError: ``implausible_map``: lengths are probably millimeters.
    """
    places = np.array([marker.T_map_landmark.t for marker in mapped]).reshape(-1, 3)
    sizes_m = np.array([marker.size_m for marker in mapped])
    height_m = float(np.abs(places[:, 2]).max(initial=0.0))
    if len(places) < 2 or height_m < HARDLY_HIGH_M:
        return
    # Importing scipy takes longer than this computation.
    nearest = np.array([np.partition(np.linalg.norm(places - place, axis=1), 1)[1] for place in places])
    if (nearest > FARTHEST_SIZES * sizes_m).all():
        raise InputError(
            "implausible_map",
            f"{path}: landmarks are up to {height_m:.4g} m high and at least {nearest.min():.4g} m from each other, "
            f"with sides of {1000 * sizes_m.max():.4g} mm at most: are its lengths millimeters?",
            "write positions in meters: divide those in millimeters by 1000",
        )
