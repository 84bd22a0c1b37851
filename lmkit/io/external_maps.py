"""Maps of other systems: WPILib's AprilTag field layout (JSON) and TagSLAM's static bodies (YAML), in and out.

Formats that are only read are in `marker_maps`.

WPILib (FIRST robotics, PhotonVision): meters, quaternions W X Y Z; a tag's x axis points out of its face, y to the
left seen from the tag outwards, z up.  lmkit's axes are x right and y up seen by a viewer of the tag, z out of it.
TagSLAM: rotation vectors; a tag's axes are lmkit's.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.errors import InputError
from lmkit.geometry.pose import Pose
from lmkit.io.document_head import head_of
from lmkit.io.documents import dump_yaml, load_document, load_json, read_text
from lmkit.io.field_problems import plain_problem
from lmkit.io.landmark_map import FOREIGN_FAMILY, read_map
from lmkit.io.map_kinds import (
    APRILTAG_ROS,
    FIDUCIAL_SLAM,
    LIMELIGHT,
    LMKIT,
    MAP_PROGRAMS,
    MARKER_MAPPER,
    TAGSLAM,
    WPILIB,
    program_of_map,
)
from lmkit.io.map_plausibility import with_doubts
from lmkit.io.marker_maps import (
    APRILTAG,
    R_OURS_FIELD,
    MarkerDefaults,
    read_apriltag_ros,
    read_fiducial_slam,
    read_limelight,
    read_marker_mapper,
)
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.model.square_marker import SQUARE_FAMILIES

FIELD_TAG_M = 0.1651  # of every tag on a field, by the game's rules; the layout has no size
SMALLEST_TAG_M, LARGEST_TAG_M = 0.003, 10.0
LEAST_CORRELATION = 0.01  # smallest lost correlation with a warning


def read_any_map(path: Path, defaults: MarkerDefaults | None = None) -> LandmarkMap:
    """A map of lmkit or of another system, recognized by content.

    Args:
        defaults: family and size of markers for files without them.

    Raises:
        InputError: not readable, of an unknown kind, or with another family or size than ``defaults``.

    Warns:
        InputWarning: a family or size is assumed, since neither the file nor ``defaults`` has it.
    """
    text, defaults = read_text(path, "map file"), defaults or MarkerDefaults()
    head = head_of(text)
    program = program_of_map(text, head)
    if program in (LMKIT, LIMELIGHT):
        defaults.require_none(path)
    if head.format:
        return with_doubts(path, read_map(path))
    if program == TAGSLAM:
        return _from_tagslam(path, text, defaults)
    if program == LIMELIGHT:
        return _map(path, read_limelight(path, text))
    if program == APRILTAG_ROS:
        return _map(path, read_apriltag_ros(path, text, defaults))
    if program == MARKER_MAPPER:
        return _map(path, read_marker_mapper(path, text, defaults))
    if program == FIDUCIAL_SLAM:
        return _map(path, read_fiducial_slam(path, text, defaults))
    if program == WPILIB:
        return _from_wpilib(path, text, defaults)
    raise _unknown(path, text, head.keys)


def _unknown(path: Path, text: str, keys: frozenset[str]) -> InputError:
    """Error for a file that is not a map of a known kind."""
    first_line = text.lstrip().partition("\n")[0]
    if re.match(r"(?:code|id|tag_id|tag|marker)\s*[,;\t]", first_line, re.IGNORECASE):
        hint = f"lmkit map {path} -o map.yaml makes a map of a form: code,x_m,y_m,height_m,facing_deg"
        return InputError("not_a_map", f"{path}: a table, not a map", hint)
    if any("ros__parameters" in key or key.startswith("/**") for key in keys):
        return InputError("not_a_map", f"{path}: parameters of a ROS 2 node, which contain no poses", "give a map")
    what = f"its keys are {', '.join(sorted(keys)[:6])}" if keys else "it contains no keys"
    kinds = f"{', '.join(MAP_PROGRAMS[:-1])} or {MAP_PROGRAMS[-1]}"
    return InputError("not_a_map", f"{path}: not a map that is known: {what}", f"give a map of {kinds}")


def map_to_wpilib(landmarks: LandmarkMap, size_m: tuple[float, float]) -> str:
    """The text of a field layout.

    Args:
        size_m: length and width of the field.
    """
    tags = []
    for m in landmarks:
        T = m.T_map_landmark
        x, y, z, w = Pose("map", "tag", T.R @ R_OURS_FIELD, T.t).quaternion_xyzw.tolist()
        place = dict(zip("xyz", T.t.tolist(), strict=True))
        turn = {"quaternion": {"W": w, "X": x, "Y": y, "Z": z}}
        tags.append({"ID": m.code, "pose": {"translation": place, "rotation": turn}})
    return json.dumps({"tags": tags, "field": {"length": size_m[0], "width": size_m[1]}}, indent=1) + "\n"


def map_to_tagslam(landmarks: LandmarkMap) -> str:
    """The text of a TagSLAM file with one static body."""
    tags = []
    for m in landmarks:
        T = m.T_map_landmark
        pose: dict[str, Any] = {
            "position": dict(zip("xyz", T.t.tolist(), strict=True)),
            "rotation": dict(zip("xyz", T.rvec.tolist(), strict=True)),
        }
        if m.covariance is not None:
            sigma = np.sqrt(np.diag(_along_own_axes(m))).tolist()
            pose["position_noise"] = dict(zip("xyz", sigma[:3], strict=True))
            pose["rotation_noise"] = dict(zip("xyz", sigma[3:], strict=True))
        tags.append({"id": m.code, "size": m.size_m, "pose": pose})
    return dump_yaml({"bodies": [{"map": {"is_static": True, "type": "simple", "tags": tags}}]})


def has_correlations(landmarks: LandmarkMap) -> bool:
    """Whether covariances have correlations along a landmark's own axes; TagSLAM reads standard deviations only."""
    for m in landmarks:
        if m.covariance is not None:
            C = _along_own_axes(m)
            scale = np.sqrt(np.outer(np.diag(C), np.diag(C)))
            if (np.abs(C - np.diag(np.diag(C))) > LEAST_CORRELATION * scale).any():
                return True
    return False


def _along_own_axes(m: MappedLandmark) -> FloatArray:
    """(6,6) covariance along the landmark's axes: the convention of GTSAM, and so of TagSLAM."""
    assert m.covariance is not None
    turn = np.kron(np.eye(2), m.T_map_landmark.R)
    return np.asarray(turn.T @ m.covariance @ turn)


def _from_wpilib(path: Path, text: str, defaults: MarkerDefaults) -> LandmarkMap:
    mapped = []
    try:
        layout = load_json(path, text)
        # Fields of other seasons had other tags: a family in the layout has priority.
        stated = layout.get("family"), layout.get("size")
        family = defaults.family_of(path, None if stated[0] is None else str(stated[0]), APRILTAG)
        size_m = defaults.size_of(path, None if stated[1] is None else float(stated[1]), FIELD_TAG_M)
        if family not in (*SQUARE_FAMILIES, FOREIGN_FAMILY) or not 0 < size_m < LARGEST_TAG_M:
            raise ValueError(f"family {family!r} or size {size_m:g} m is unknown")
        # WPILib for 2027 keeps the tags with the field's drawing, as "field-tags".
        for tag in layout["field-tags"] if "field-tags" in layout else layout["tags"]:
            place, turn = tag["pose"]["translation"], tag["pose"]["rotation"]["quaternion"]
            pose = Pose.from_quaternion(
                "map", "tag", [float(place[k]) for k in "xyz"], [float(turn[k]) for k in ("X", "Y", "Z", "W")]
            )
            T = Pose("map", "landmark", pose.R @ R_OURS_FIELD.T, pose.t)
            mapped.append(MappedLandmark(LandmarkId(family, int(tag["ID"])), size_m, T))
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise InputError(
            "bad_layout", f"{path}: not a WPILib field layout ({plain_problem(error)})", "give tags with ID and pose"
        ) from None
    return _map(path, mapped)


def _from_tagslam(path: Path, text: str, defaults: MarkerDefaults) -> LandmarkMap:
    mapped = []
    family = defaults.family_of(path, None, APRILTAG)
    try:
        for body in load_document(path, text)["bodies"]:
            for values in body.values():
                T_map_body = _tagslam_pose("body", values["pose"]) if "pose" in values else None
                for tag in values.get("tags", []) if values.get("is_static") else []:
                    if "pose" not in tag:
                        continue
                    stated = tag.get("size", values.get("default_tag_size"))
                    size_m = defaults.size_of(path, None if stated is None else float(stated))
                    if size_m <= 0:
                        raise ValueError(f"tag {tag['id']} has no size")
                    T = _tagslam_pose("landmark", tag["pose"])
                    if T_map_body is not None:
                        T = Pose("map", "landmark", T_map_body.R @ T.R, T_map_body.R @ T.t + T_map_body.t)
                    C = _tagslam_covariance(tag["pose"], T)
                    mapped.append(MappedLandmark(LandmarkId(family, int(tag["id"])), size_m, T, C))
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        raise InputError(
            "bad_tagslam",
            f"{path}: not a TagSLAM file with tags ({plain_problem(error)})",
            "give tags with id, size and pose",
        ) from None
    return _map(path, mapped)


def _tagslam_pose(frame: str, values: dict[str, dict[str, float]]) -> Pose:
    place, turn = (np.array([float(values[part][k]) for k in "xyz"]) for part in ("position", "rotation"))
    if "w" in values["rotation"]:
        return Pose.from_quaternion("map", frame, place.tolist(), [*turn.tolist(), float(values["rotation"]["w"])])
    if np.linalg.norm(turn) > 2 * np.pi:
        raise ValueError(f"a rotation vector {turn.tolist()} is over 2 pi long: degrees?")
    return Pose.from_rvec("map", frame, turn, place)


def _tagslam_covariance(values: dict[str, dict[str, float]], T_map_tag: Pose) -> FloatArray | None:
    """(6,6) in the map frame from standard deviations (m, rad) along the tag's axes; None where there are none.

    Raises:
        ValueError: one of the two noises is missing, negative or not finite.
    """
    names = ("position_noise", "rotation_noise")
    if not any(name in values for name in names):
        return None
    sigma = np.array([float(values[name][k]) for name in names for k in "xyz"])
    if not (np.isfinite(sigma).all() and (sigma >= 0).all()):
        raise ValueError(f"noise of {sigma.tolist()} is negative or not finite")
    turn = np.kron(np.eye(2), T_map_tag.R)
    return np.asarray(turn @ np.diag(sigma**2) @ turn.T)


def _require_meters(path: Path, mapped: list[MappedLandmark]) -> None:
    """Refuse implausible sizes of tags.

    Raises:
        InputError: names the tag.
    """
    for marker in mapped:
        if not SMALLEST_TAG_M <= marker.size_m <= LARGEST_TAG_M:
            size = f"tag {marker.code} of {marker.size_m * 1000:.4g} mm"
            raise InputError(
                "bad_size",
                f"{path}: {size}, which no tag is",
                "check the unit of its size: meters, or millimeters in .fmap",
            )


def _map(path: Path, mapped: list[MappedLandmark]) -> LandmarkMap:
    if not mapped:
        raise InputError("no_tags", f"{path}: contains no tags with a pose", "give at least one")
    _require_meters(path, mapped)
    try:
        return with_doubts(path, LandmarkMap(mapped))
    except InputError as error:
        raise InputError(error.code, f"{path}: {error.message}", error.hint) from None
