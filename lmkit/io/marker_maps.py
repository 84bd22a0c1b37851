"""Maps of square markers that other programs write: fiducial_slam, apriltag_ros, Limelight and marker_mapper.

fiducial_slam (map.txt): lines of id, x y z (m), roll pitch yaw (deg), variance, count, neighbors.
apriltag_ros (tags.yaml): bundles of tags, meters, with a quaternion; the bundle's frame becomes the map's.
Limelight (.fmap, JSON): 4x4 transforms, meters, from the center of the field; sizes in mm; axes as in WPILib.
marker_mapper (YAML of OpenCV): corners of every marker, meters, top left first, then clockwise.
Axes of a marker are lmkit's (x right, y up, z out of it), except Limelight's.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.errors import InputError, InputWarning, warn_caller
from lmkit.geometry.pose import Pose
from lmkit.geometry.rotations import orthonormal
from lmkit.io.documents import load_document, load_json
from lmkit.io.field_problems import plain_problem
from lmkit.io.map_kinds import FIDUCIAL
from lmkit.io.tables import to_number
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import MappedLandmark

# Columns: the field tag's x (out), y (left seen from the tag, lmkit's x), z (up, lmkit's y), in lmkit's axes.
R_OURS_FIELD = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
APRILTAG = "tag36h11"
FOREIGN_ARUCO = "aruco"  # of an unknown dictionary
MOST_MARKERS = 20_000  # of a map.txt; no family has as many
NOT_A_ROTATION = 0.02
_LIMELIGHT = re.compile(r"(?:apriltag\d?_)?(\d+h\d+)(?:_classic)?$")
_UNSPACED = re.compile(r"\b(id|corners):(?=[\[\d-])")  # OpenCV writes {id:0, which is another key in YAML


@dataclass(frozen=True)
class MarkerDefaults:
    """Family and size of markers, for files that do not give them.

    Attributes:
        family: name, or None where it was not given.
        size_m: outer edge of the black border, or None.
        can_be_given: whether the command has options for both; else the file must be converted first.
    """

    family: str | None = None
    size_m: float | None = None
    can_be_given: bool = True

    def require(self, path: Path, what: str) -> tuple[str, float]:
        """Family and size.

        Raises:
            InputError: one of them was not given.
        """
        if self.family is None or self.size_m is None:
            raise InputError(
                "no_family_or_size",
                f"{path}: {what} states neither the family nor the size of its markers",
                "give both, such as --family aruco5x5_1000 --size 140mm"
                if self.can_be_given
                else f"convert it first: {_conversion(path, '--family aruco5x5_1000 --size 140mm')}",
            )
        return self.family, self.size_m

    def require_none(self, path: Path) -> None:
        """Refuse values for a file that has its own.

        Raises:
            InputError: family or size was given.
        """
        if self.family is not None or self.size_m is not None:
            hint = "leave --family and --size out"
            raise InputError("not_together", f"{path} states the family and the size of each landmark", hint)

    def family_of(self, path: Path, stated: str | None, assumed: str) -> str:
        """Family of a file's markers: as the file states, as given, or assumed with a warning.

        Raises:
            InputError: the file states another one than was given.
        """
        if stated is not None and self.family is not None and stated != self.family:
            raise InputError(
                "not_together", f"{path}: its markers are {stated}, not {self.family}", "leave --family out"
            )
        if stated is None and self.family is None:
            other = self._other(path, "--family")
            _warn(f"{path} does not state the family of its markers: {assumed} is assumed; {other}")
        return stated or self.family or assumed

    def size_of(self, path: Path, stated: float | None, assumed: float | None = None) -> float:
        """Size of a file's markers in meters, likewise; 0 where nothing is assumed.

        Raises:
            InputError: the file states another one than was given.
        """
        if stated is not None and self.size_m is not None and not math.isclose(stated, self.size_m, rel_tol=1e-3):
            raise InputError(
                "not_together",
                f"{path}: its markers are {stated * 1000:g} mm, not {self.size_m * 1000:g} mm",
                "leave --size out, or correct the file",
            )
        if stated is None and self.size_m is None and assumed is not None:
            other = self._other(path, "--size")
            _warn(f"{path} does not state the size of its markers: {assumed * 1000:g} mm is assumed; {other}")
        return stated or self.size_m or assumed or 0.0

    def _other(self, path: Path, option: str) -> str:
        """Advice for markers that differ from the assumed value."""
        if self.can_be_given:
            return f"give {option} if it is another"
        return f"if it is another, convert the map first: {_conversion(path, f'{option} ...')}"


def _conversion(path: Path, options: str) -> str:
    return f"lmkit convert {path} --to map {options} -o map.yaml"


def _warn(sentence: str) -> None:
    warn_caller(InputWarning(sentence))


def read_fiducial_slam(path: Path, text: str, defaults: MarkerDefaults) -> list[MappedLandmark]:
    """The markers of a map.txt; variances are not read.

    Raises:
        InputError: a line is no marker, or family and size were not given.
    """
    family, size_m = defaults.require(path, "a map of fiducial_slam")
    if text.count("\n") > MOST_MARKERS:
        raise InputError("too_large", f"{path}: more than {MOST_MARKERS} markers", "give one map")
    markers = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split()
        if not words:
            continue
        try:
            x, y, z, *angles = (to_number(word) for word in words[1:7] if FIDUCIAL.match(line))
            id_ = LandmarkId(family, int(words[0]))
        except ValueError as error:
            what = f"line {number} is not a marker ({plain_problem(error)})"
            raise InputError("bad_map", f"{path}: {what}", "give map.txt of fiducial_slam") from None
        roll, pitch, yaw = (math.radians(angle) for angle in angles)
        T = Pose("map", "landmark", _from_roll_pitch_yaw(roll, pitch, yaw), np.array([x, y, z]))
        markers.append(MappedLandmark(id_, size_m, T))
    return markers


def read_apriltag_ros(path: Path, text: str, defaults: MarkerDefaults) -> list[MappedLandmark]:
    """The tags of the one bundle of a tags.yaml.

    Raises:
        InputError: no bundle, or several without relative poses.
    """
    with _named(path, "bad_map", "a tags.yaml of apriltag_ros", "give id, size, x y z, qw qx qy qz of every tag"):
        data = load_document(path, text)
        bundles = data.get("tag_bundles") or []
        if len(bundles) != 1:
            held = f"{len(bundles)} bundles, and not their poses in one frame" if bundles else "no tag with a pose"
            hint = "keep one of tag_bundles" if bundles else "find the tags' poses first: lmkit survey"
            raise InputError("bad_map", f"{path}: tags.yaml of apriltag_ros holds {held}", hint)
        markers = []
        family = defaults.family_of(path, None, APRILTAG)
        for tag in bundles[0]["layout"]:
            place = [float(tag.get(key, 0.0)) for key in "xyz"]
            turn = [float(tag.get(key, key == "qw")) for key in ("qx", "qy", "qz", "qw")]
            id_ = LandmarkId(family, int(tag["id"]))
            T = Pose.from_quaternion("map", "landmark", place, turn)
            markers.append(MappedLandmark(id_, defaults.size_of(path, _size(tag["size"])), T))
        return markers


def read_limelight(path: Path, text: str) -> list[MappedLandmark]:
    """The tags of a .fmap.

    Raises:
        InputError: a tag lacks its transform, or is of another family.
    """
    with _named(path, "bad_map", "a field map of Limelight", "give id, family, size (mm) and transform of every tag"):
        markers = []
        for tag in load_json(path, text)["fiducials"]:
            found = _LIMELIGHT.fullmatch(str(tag["family"]))
            if found is None:
                raise ValueError(f"family {tag['family']!r} is unknown")
            T = np.array(tag["transform"], dtype=np.float64).reshape(4, 4)
            if np.abs(T[3] - [0, 0, 0, 1]).max() > NOT_A_ROTATION:
                raise ValueError(f"the last row of tag {tag['id']}'s transform is not 0 0 0 1: is it by columns?")
            pose = Pose("map", "landmark", _rotation(T[:3, :3]) @ R_OURS_FIELD.T, T[:3, 3])
            id_ = LandmarkId(f"tag{found[1]}", int(tag["id"]))
            markers.append(MappedLandmark(id_, _size(tag["size"]) / 1000, pose))
        return markers


def read_marker_mapper(path: Path, text: str, defaults: MarkerDefaults) -> list[MappedLandmark]:
    """The markers of a map of ArUco's marker_mapper.

    Raises:
        InputError: corners in pixels, or of no square.
    """
    with _named(path, "bad_map", "a map of marker_mapper", "give id and four corners of every marker, in meters"):
        data = load_document(path, _UNSPACED.sub(r"\1: ", text))
        if int(data.get("aruco_bc_mInfoType", 1)) != 1:
            raise ValueError("its corners are in pixels (aruco_bc_mInfoType), not in meters")
        stated = str(data.get("aruco_bc_dict", "")).lower() or None
        family = defaults.family_of(path, stated, FOREIGN_ARUCO)
        markers = []
        for marker in data["aruco_bc_markers"]:
            corners = np.array(marker["corners"], dtype=np.float64).reshape(4, 3)
            right = corners[1] + corners[2] - corners[0] - corners[3]
            up = corners[0] + corners[1] - corners[2] - corners[3]
            size_m = _size(float(np.linalg.norm(right) + np.linalg.norm(up)) / 4)
            axes = np.column_stack([right, up, np.cross(right, up) / (2 * size_m)]) / (2 * size_m)
            T = Pose("map", "landmark", _rotation(axes), corners.mean(axis=0))
            markers.append(MappedLandmark(LandmarkId(family, int(marker["id"])), size_m, T))
        return markers


class _named:  # noqa: N801  (used as a function)
    """Converts errors of reading to one that names the assumed kind of file."""

    def __init__(self, path: Path, code: str, what: str, hint: str) -> None:
        self.parts = path, code, what, hint

    def __enter__(self) -> None: ...

    def __exit__(self, kind: Any, error: BaseException | None, at: Any) -> None:
        if isinstance(error, ValueError | KeyError | TypeError | AttributeError | IndexError | OverflowError):
            path, code, what, hint = self.parts
            raise InputError(code, f"{path}: not {what} ({plain_problem(error)})", hint) from None


def _from_roll_pitch_yaw(roll: float, pitch: float, yaw: float) -> FloatArray:
    """(3,3) rotation about x, then y, then z of the fixed axes; radians."""
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(angle), math.sin(angle)) for angle in (roll, pitch, yaw))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def _rotation(R: FloatArray) -> FloatArray:
    if not np.abs(R @ R.T - np.eye(3)).max() < NOT_A_ROTATION or np.linalg.det(R) < 0:
        raise ValueError("its rotation matrix is not a rotation")
    return orthonormal(R)


def _size(value: Any) -> float:
    size = float(value)
    if not 0 < size < 1e5:
        raise ValueError(f"size {size:g} is out of range")
    return size
