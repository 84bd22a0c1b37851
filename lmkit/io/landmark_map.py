"""Map files: where every landmark is mounted, as YAML (docs/formats.md)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from lmkit.arrays import is_covariance
from lmkit.errors import InputError
from lmkit.geometry.pose import Pose
from lmkit.io.documents import dump_yaml
from lmkit.io.layouts import Layout, count, items, keys_of, number, read_layout, word
from lmkit.io.rig import Matrix6, Row
from lmkit.model.families import family_named
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.model.scan import POLE

FORMAT = "lmkit-map/1"
MOST_SIZE_M = 100.0
FOREIGN_FAMILY = "aruco"  # of any dictionary: not read in images, but its recorded detections are used
UPRIGHT = (0.5, 0.5, 0.5, 0.5)  # of poles, which face nowhere: y of the landmark up, its z along x of the map


@dataclass(frozen=True, kw_only=True)
class _Landmark(Layout):
    code: Annotated[int, count]
    family: str
    size_m: Annotated[float, number(above=0, most=MOST_SIZE_M)]
    position: Row
    quaternion: Annotated[list[float], items(number(), 4, 4)] | None = None
    covariance: Matrix6 | None = None
    name: str | None = None
    valid_from: float | None = None
    valid_to: float | None = None


@dataclass(frozen=True, kw_only=True)
class _MapFile(Layout):
    frame: Annotated[str, word("map")]
    landmarks: Annotated[list[_Landmark], items(keys_of(_Landmark), 1)]


def read_map(path: Path) -> LandmarkMap:
    """A map from its file.

    Raises:
        InputError: not readable or not valid; names the key.
    """
    data = read_layout(path, _MapFile, FORMAT, "map file")
    landmarks = []
    for index, item in enumerate(data.landmarks):
        where = f"{path}: landmarks[{index}]"
        id_ = _id_of(item, where)
        quaternion = UPRIGHT if item.quaternion is None and item.family == POLE else item.quaternion
        if quaternion is None:
            raise InputError("missing_key", f"{where}.quaternion: missing", "write a unit quaternion x y z w")
        try:
            pose = Pose.from_quaternion("map", "landmark", item.position, quaternion)
        except ValueError as error:
            raise InputError("bad_value", f"{where}.quaternion: {error}", "write a unit quaternion x y z w") from None
        covariance = None if item.covariance is None else np.array(item.covariance)
        if covariance is not None and not is_covariance(covariance):
            raise InputError(
                "bad_value",
                f"{where}.covariance: not symmetric, or negative in some direction",
                "write the 6x6 covariance of x y z (m) and rotation (rad), or leave it out",
            )
        valid = item.valid_from, item.valid_to
        if item.valid_from is not None and item.valid_to is not None and item.valid_to < item.valid_from:
            raise InputError(
                "bad_value", f"{where}.valid_to: earlier than valid_from", "write both in seconds of the same clock"
            )
        landmarks.append(MappedLandmark(id_, item.size_m, pose, covariance, item.name, *valid))
    try:
        return LandmarkMap(landmarks)
    except InputError as error:
        raise InputError(error.code, f"{path}: {error.message}", error.hint) from None


def _id_of(item: _Landmark, where: str) -> LandmarkId:
    _require_family(item.family)
    try:
        return LandmarkId(item.family, item.code)
    except ValueError as error:
        raise InputError("code_range", f"{where}.code: {error}", f"write a code of family {item.family}") from None


def _require_family(name: str) -> None:
    if name not in (FOREIGN_FAMILY, POLE):
        family_named(name)


def require_readable(landmarks: LandmarkMap) -> None:
    """Refuse a map whose file would not be read, or would be read as another map.

    Raises:
        InputError: a family does not exist.
    """
    for landmark in (*landmarks, *landmarks.past):
        _require_family(landmark.family)


def map_to_yaml(landmarks: LandmarkMap) -> str:
    """The text of a map file."""
    entries: list[dict[str, Any]] = []
    for landmark in (*landmarks, *landmarks.past):
        entry: dict[str, Any] = {
            "code": landmark.code,
            "family": landmark.family,
            "size_m": landmark.size_m,
            "position": landmark.T_map_landmark.t.tolist(),
            "quaternion": landmark.T_map_landmark.quaternion_xyzw.tolist(),
        }
        if landmark.covariance is not None:
            entry["covariance"] = landmark.covariance.tolist()
        if landmark.name is not None:
            entry["name"] = landmark.name
        for key, time_s in (("valid_from", landmark.valid_from_s), ("valid_to", landmark.valid_to_s)):
            if time_s is not None:
                entry[key] = time_s
        entries.append(entry)
    return dump_yaml({"format": FORMAT, "frame": "map", "landmarks": entries})
