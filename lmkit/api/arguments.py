"""Arguments of the public functions, turned into what the library takes."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lmkit.arrays import AnyArray, ByteArray
from lmkit.errors import InputError
from lmkit.model.families import MarkerFamily, family_named
from lmkit.model.landmark import LandmarkFamily
from lmkit.model.square_marker import SquareMarkerFamily
from lmkit.units import parse_length_mm

if TYPE_CHECKING:
    from lmkit.geometry.rig import AnyRig
    from lmkit.model.landmark_map import LandmarkMap

PathLike = str | os.PathLike[str]
ImageLike = PathLike | AnyArray
Families = str | MarkerFamily | Iterable[str | MarkerFamily]


class ImageWarning(UserWarning):
    """An image in which landmarks cannot be found as it stands: gray, or with red and blue swapped."""


def as_path(path: PathLike) -> Path:
    """A path of text or of a path object.

    Raises:
        InputError: neither.
    """
    if not isinstance(path, str | os.PathLike):
        raise InputError("not_a_path", f"{_name(path)} is not a path", "give a str or pathlib.Path")
    return Path(path)


def as_image(image: ImageLike, needs_color: bool = True) -> ByteArray:
    """(H,W,3) BGR pixels of an array, or of the image file of that name; a gray array gets three channels.

    Args:
        needs_color: warn of a gray array.

    Raises:
        InputError: another type or shape; says what to convert.
    """
    if isinstance(image, str | os.PathLike):
        from lmkit.io.images import read_image

        return read_image(Path(image))
    if not isinstance(image, np.ndarray):
        raise InputError("bad_image", f"{_name(image)} is not an image", "give an array (H,W,3) in BGR, or a path")
    if image.dtype == np.uint16 and image.ndim == 2:
        from lmkit.io.images import gray_to_8_bit

        image = gray_to_8_bit(image)
    if image.dtype != np.uint8:
        hint = "scale it to 0..255 and convert: image.astype(numpy.uint8)"
        raise InputError("bad_image", f"the image has type {image.dtype}, 8 bit is needed", hint)
    if image.ndim == 2:
        if needs_color:
            warnings.warn(ImageWarning(GRAY), stacklevel=4)
        return np.repeat(image[:, :, None], 3, axis=2)
    if image.ndim != 3 or image.shape[2] != 3:
        hint = "give (height, width, 3) in BGR; of four channels take image[:, :, :3]"
        raise InputError("bad_image", f"the image has shape {image.shape}", hint)
    return np.ascontiguousarray(image)


GRAY = "the image is gray: landmarks are recognized by red against blue; use a color camera, or AprilTags"


def as_families(families: Families) -> tuple[MarkerFamily, ...]:
    """Families of names, of a list such as ``lm8,lm4``, or as they are.

    Raises:
        InputError: one does not exist.
    """
    if isinstance(families, LandmarkFamily | SquareMarkerFamily):
        return (families,)
    names = families.split(",") if isinstance(families, str) else list(families)
    found = (f if isinstance(f, LandmarkFamily | SquareMarkerFamily) else family_named(str(f).strip()) for f in names)
    return tuple(dict.fromkeys(found))


def family_names(families: Families, detected: bool) -> tuple[str, ...]:
    """Names of families.

    Args:
        detected: lmkit is to find them in images, so that they must be its own; else they are of any markers.

    Raises:
        InputError: one cannot be detected.
    """
    if detected or isinstance(families, LandmarkFamily | SquareMarkerFamily):
        return tuple(family.name for family in as_families(families))
    names = families.split(",") if isinstance(families, str) else list(families)
    return tuple(
        name.name if isinstance(name, LandmarkFamily | SquareMarkerFamily) else name.strip() for name in names
    )


def as_meters(length: float | str, name: str) -> float:
    """Meters of a number of meters, or of text with a unit such as ``180mm``.

    Raises:
        InputError: not a positive length, or so large that millimeters must be meant.
    """
    meters = parse_length_mm(length, name) / 1000 if isinstance(length, str) else float(length)
    if not 0 < meters < 50:
        hint = 'give meters, such as 0.18, or text with a unit, such as "180mm"'
        raise InputError("bad_length", f"{name}: {length!r} m is out of range", hint)
    return meters


def as_rig(rig: AnyRig | PathLike) -> AnyRig:
    """A rig, or the rig of a file.

    Raises:
        InputError: lengths that no rig has, such as millimeters.
    """
    from lmkit.geometry.rig import Rig
    from lmkit.geometry.rig_plausibility import require_plausible
    from lmkit.geometry.stereo_rig import StereoRig
    from lmkit.io.any_rig import read_any_rig

    if isinstance(rig, Rig | StereoRig):
        require_plausible(rig, "the rig")
        return rig
    return read_any_rig(as_path(rig))


def as_map(landmarks: LandmarkMap | PathLike) -> LandmarkMap:
    """A map, or the map of a file."""
    from lmkit.io.external_maps import read_any_map
    from lmkit.model.landmark_map import LandmarkMap

    if isinstance(landmarks, LandmarkMap):
        return landmarks
    return read_any_map(as_path(landmarks))


def _name(value: object) -> str:
    return f"a value of type {type(value).__name__}"
