"""Conversion of arguments of the public functions to the library's types."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lmkit.arrays import AnyArray, ByteArray
from lmkit.errors import InputError
from lmkit.model.codewords import parse_codes
from lmkit.model.families import MarkerFamily, family_named
from lmkit.model.landmark import LandmarkFamily
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.square_marker import SquareMarkerFamily
from lmkit.units import parse_length_mm

if TYPE_CHECKING:
    from lmkit.geometry.rig import AnyRig
    from lmkit.mapping.wall_constraints import LandmarkConstraint
    from lmkit.model.landmark_map import LandmarkMap
    from lmkit.model.recording import Recording
    from lmkit.model.tracked_trajectory import TrackedTrajectory
    from lmkit.model.trajectory import Trajectory
    from lmkit.planning.coverage import Demand

PathLike = str | os.PathLike[str]
ImageLike = PathLike | AnyArray
Families = str | MarkerFamily | Iterable[str | MarkerFamily]


NUMBER = (int, float, np.integer, np.floating)
LARGEST_SIGMA_M = 50.0
READ_RECORDING = "give lmkit.read_recording(detections=..., odometry=...), or the CSV of its detections"


class ImageWarning(UserWarning):
    """Warning: no landmark can be found in this image, because it is gray or has red and blue swapped."""


def as_path(path: PathLike, what: str = "path") -> Path:
    """Path from text or a path object.

    Args:
        what: name of the argument in errors, with what else it may be.

    Raises:
        InputError: neither.
    """
    if not isinstance(path, str | os.PathLike) or isinstance(path, bytes):
        raise InputError("not_a_path", f"{what}: {_name(path)} is given", "give a str or pathlib.Path of the file")
    return Path(path)


def require_type(value: object, kind: type | tuple[type, ...], what: str, hint: str) -> None:
    """Refuse an argument of another type.

    Args:
        what: name of the argument.
        hint: how to make one of the right type.

    Raises:
        InputError: names the argument and its type.
    """
    if not isinstance(value, kind):
        raise InputError("wrong_type", f"{what}: {_name(value)} is given", hint)


def as_image(image: ImageLike) -> ByteArray:
    """(H,W,3) BGR pixels from an array or an image file; a gray array gets three equal channels.

    Raises:
        InputError: another type or shape; names the conversion.
    """
    if isinstance(image, str | os.PathLike):
        from lmkit.io.images import read_image

        return read_image(Path(image))
    if isinstance(image, np.ndarray) and not image.size:
        hint = "check that the file was read: cv2.imread gives nothing for one that it cannot read"
        raise InputError("bad_image", f"the image has shape {image.shape}: it has no pixels", hint)
    if not isinstance(image, np.ndarray):
        raise InputError("bad_image", f"{_name(image)} is not an image", "give an array (H,W,3) in BGR, or a path")
    if image.dtype == np.uint16 and image.ndim == 2:
        from lmkit.io.images import gray_to_8_bit

        image = gray_to_8_bit(image)
    if image.dtype != np.uint8:
        hint = "scale it to 0..255 and convert: image.astype(numpy.uint8)"
        raise InputError("bad_image", f"the image has type {image.dtype}, 8 bit is needed", hint)
    if image.ndim == 2:
        return np.repeat(image[:, :, None], 3, axis=2)
    if image.ndim != 3 or image.shape[2] != 3:
        hint = "give (height, width, 3) in BGR; of four channels take image[:, :, :3]"
        raise InputError("bad_image", f"the image has shape {image.shape}", hint)
    return np.ascontiguousarray(image)


GRAY = "the image is gray: landmarks are recognized by red against blue; use a color camera, or AprilTags"


def as_families(families: Families) -> tuple[MarkerFamily, ...]:
    """Families from families, names, or text such as ``lm8,lm4``.

    Raises:
        InputError: one does not exist, or none is given.
    """
    if isinstance(families, LandmarkFamily | SquareMarkerFamily):
        return (families,)
    found = (f if not isinstance(f, str) else family_named(f.strip()) for f in _listed(families))
    return tuple(dict.fromkeys(found))


def _listed(families: Families) -> list[str | MarkerFamily]:
    """Names and families of a list, or of text such as ``lm8,lm4``."""
    names: object = families.split(",") if isinstance(families, str) else families
    listed: list[Any] = list(names) if isinstance(names, Iterable) else [names]
    if not listed or not all(isinstance(name, str | LandmarkFamily | SquareMarkerFamily) for name in listed):
        raise InputError(
            "unknown_family", f"families {families!r} names no families", 'give names, such as "lm8,lm4"'
        )
    return listed


def family_names(families: Families, detected: bool) -> tuple[str, ...]:
    """Names of families.

    Args:
        detected: lmkit must detect them in images, so only families of lmkit are allowed; else any marker family is.

    Raises:
        InputError: one cannot be detected.
    """
    if detected or isinstance(families, LandmarkFamily | SquareMarkerFamily):
        return tuple(family.name for family in as_families(families))
    return tuple(name.strip() if isinstance(name, str) else name.name for name in _listed(families))


def as_meters(length: float | str, name: str) -> float:
    """Length in meters from a number of meters, or from text with a unit such as ``180mm``.

    Raises:
        InputError: not a positive length, or so large that it must be in millimeters.
    """
    hint = 'give meters, such as 0.18, or text with a unit, such as "180mm"'
    if isinstance(length, str):
        meters = parse_length_mm(length, name) / 1000
    else:
        require_type(length, NUMBER, name, hint)
        meters = float(length)
    if not 0 < meters < 50:
        raise InputError("bad_length", f"{name}: {length!r} m is out of range", hint)
    return meters


def as_rate(hz: float | None) -> float | None:
    """Frames a second.

    Raises:
        InputError: not a positive number.
    """
    if hz is not None and not (isinstance(hz, NUMBER) and 0 < hz < math.inf):
        raise InputError("bad_rate", f"hz {hz!r} is not a valid frame rate", "give frames per second, such as 5")
    return hz


def as_sigmas(known_sigma: tuple[float, float] | None, known: object) -> tuple[float, float] | None:
    """Standard deviations of known landmarks: position (m) and rotation (rad).

    Raises:
        InputError: not two numbers of 0 or more, or no known landmarks are given.
    """
    if known_sigma is None:
        return None
    if known is None:
        hint = "give known=..., the map of those landmarks, or leave known_sigma out"
        raise InputError("not_together", "known_sigma is given without known", hint)
    hint = "give meters and radians, such as (0.005, 0.02)"
    if not isinstance(known_sigma, Sequence | np.ndarray) or len(known_sigma) != 2:
        raise InputError("bad_sigma", f"known_sigma {known_sigma!r} is not a pair of numbers", hint)
    for value, most in zip(known_sigma, (LARGEST_SIGMA_M, np.pi), strict=True):
        if not isinstance(value, NUMBER) or not 0 <= value <= most:
            raise InputError("bad_sigma", f"known_sigma: {value!r} is outside 0 to {most:.3g}", hint)
    return float(known_sigma[0]), float(known_sigma[1])


def as_point(point: Sequence[float], what: str) -> tuple[float, float]:
    """(x, y) in meters.

    Raises:
        InputError: not two finite numbers.
    """
    is_pair = isinstance(point, Sequence | np.ndarray) and np.shape(point) == (2,)
    if not is_pair or not all(isinstance(value, NUMBER) and math.isfinite(value) for value in point):
        hint = 'give (x, y) in meters, or text such as "2.5,1,90" or the name of a place'
        raise InputError("bad_place", f"{what}: {point!r} is not a place", hint)
    return float(point[0]), float(point[1])


def as_codes(codes: int | str | LandmarkId | Iterable[int | LandmarkId], family: MarkerFamily) -> list[int]:
    """Codes of one family, from codes, ids, or text such as ``0-15,42``.

    Raises:
        InputError: none, something else, an id of another family, or a code that the family does not have.
    """
    if isinstance(codes, str):
        return parse_codes(codes, family.code_count)
    listed = list(codes) if isinstance(codes, Iterable) and not isinstance(codes, LandmarkId) else [codes]
    hint = f'give codes from 0 to {family.code_count - 1}, such as range(12), or text such as "0-11"'
    if not listed:
        raise InputError("bad_codes", "no codes are given", hint)
    for code in listed:
        if isinstance(code, LandmarkId) and code.family != family.name:
            raise InputError("bad_codes", f"{code} is not of family {family.name}", f"give family={code.family!r}")
        if not isinstance(code, LandmarkId | int | np.integer):
            raise InputError("bad_codes", f"codes: {code!r} is not a code", hint)
    return [code.code if isinstance(code, LandmarkId) else int(code) for code in listed]


def as_rig(rig: AnyRig | PathLike) -> AnyRig:
    """A rig, or the rig of a file.

    Raises:
        InputError: implausible lengths, such as millimeters.
    """
    from lmkit.geometry.rig import Rig
    from lmkit.geometry.rig_plausibility import require_plausible
    from lmkit.geometry.stereo_rig import StereoRig
    from lmkit.io.any_rig import read_any_rig

    if isinstance(rig, Rig | StereoRig):
        require_plausible(rig, "the rig")
        return rig
    if isinstance(rig, str | os.PathLike):
        return read_any_rig(Path(rig))
    raise InputError("wrong_type", f"rig: {_name(rig)} is given", "give lmkit.read_rig(...), or the rig's file")


def as_map(landmarks: LandmarkMap | PathLike) -> LandmarkMap:
    """A map, or the map of a file."""
    from lmkit.io.external_maps import read_any_map
    from lmkit.model.landmark_map import LandmarkMap

    if isinstance(landmarks, LandmarkMap):
        return landmarks
    if isinstance(landmarks, str | os.PathLike):
        return read_any_map(Path(landmarks))
    hint = "give lmkit.read_map(...), or the map's file"
    raise InputError("wrong_type", f"landmarks: {_name(landmarks)} is given", hint)


def as_recording(recording: Recording | PathLike, rig: AnyRig | None = None) -> Recording:
    """A recording, or the detections of a CSV file, without odometry.

    Args:
        rig: the cameras of the detections; needed unless it is a stereo pair.

    Raises:
        InputError: neither, or a file that cannot be read.
    """
    from lmkit.model.recording import Recording
    from lmkit.pipelines.detect_recording import open_recording

    if isinstance(recording, str | os.PathLike):
        path = Path(recording)
        if path.suffix.lower() == ".csv":
            return open_recording(rig=rig, detections=path).read()
        raise InputError("not_a_recording", f"recording: {path} is not a CSV of detections", READ_RECORDING)
    require_type(recording, Recording, "recording", READ_RECORDING)
    return recording


def require_constraints(constraints: Sequence[LandmarkConstraint]) -> None:
    """Refuse constraints of another type.

    Raises:
        InputError: something else than a sequence of LandmarkConstraint.
    """
    from lmkit.mapping.wall_constraints import LandmarkConstraint

    hint = "give a list of lmkit.mapping.wall_constraints.LandmarkConstraint"
    require_type(constraints, (list, tuple), "constraints", hint)
    for constraint in constraints:
        require_type(constraint, LandmarkConstraint, "constraints", hint)


def as_trajectory(trajectory: Trajectory | TrackedTrajectory | PathLike, what: str) -> Trajectory:
    """A trajectory, the poses with status ``ok`` of a tracked one, or the trajectory of a file.

    Raises:
        InputError: none of them, or a tracked one without such a pose.
    """
    from lmkit.io.trajectory import read_trajectory
    from lmkit.model.tracked_trajectory import TrackedTrajectory
    from lmkit.model.trajectory import Trajectory

    if isinstance(trajectory, Trajectory):
        return trajectory
    if isinstance(trajectory, str | os.PathLike):
        return read_trajectory(Path(trajectory))
    hint = "give a Trajectory, the result of lmkit.track, or a trajectory's file"
    require_type(trajectory, TrackedTrajectory, what, hint)
    if not (sure := trajectory.sure):
        raise InputError("no_poses", f"{what}: no pose has status ok", "track a recording that sees the map")
    times, poses = zip(*sure, strict=True)
    return Trajectory(np.array(times), np.array([T.t for T in poses]), np.array([T.quaternion_xyzw for T in poses]))


def as_demand(demand: Demand | None, usual: Demand) -> Demand:
    """The demand, or the usual one for None.

    Raises:
        InputError: another type.
    """
    if demand is None:
        return usual
    require_type(demand, type(usual), "demand", "give lmkit.Demand(error_m=0.05, share=0.9)")
    return demand


def _name(value: object) -> str:
    return f"a value of type {type(value).__name__}"
