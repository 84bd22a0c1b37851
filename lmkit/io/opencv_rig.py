"""Rigs as OpenCV's own YAML: M1 D1 M2 D2 R T R1 R2 P1 P2 Q of a stereo pair, K and D of one camera."""

from __future__ import annotations

from collections.abc import Hashable
from pathlib import Path
from typing import Annotated, Any
from xml.etree import ElementTree

import cv2
import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from lmkit.arrays import FloatArray
from lmkit.errors import InputError, InputWarning, warn_caller
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.pose import Pose
from lmkit.geometry.rectification import rectification
from lmkit.geometry.rig import AnyRig, Rig
from lmkit.geometry.rotations import orthonormal
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.io.calibration_names import fields_by_name
from lmkit.io.documents import PlainLoader, load_document, read_text
from lmkit.io.field_problems import first_problem

_FIELDS = ("M1", "M2", "D1", "D2", "R", "T", "image_width", "image_height")  # of a stereo pair
_MONO_FIELDS = ("K", "D", "image_width", "image_height")
ALMOST = 1e-3
_NO_OMNI = "calibrate again as fisheye: lmkit calibrate --model fisheye"
_UNDECIDED = (
    "four distortion coefficients are read as k1 k2 p1 p2 of a pinhole camera; where cv2.fisheye gave them, write "
    "model: fisheye beside them"
)
_MODEL_OF_COUNT = {0: "pinhole", 4: "pinhole", 5: "pinhole", 8: "rational", 12: "rational", 14: "rational"}


def rig_to_opencv_yaml(rig: StereoRig) -> str:
    """The text of the file; lengths in meters.  ``model`` distinguishes fisheye with four coefficients."""
    maps = rectification(rig)
    storage = cv2.FileStorage(".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.write("model", rig.left.model)
    storage.write("image_width", rig.left.image_size[0])
    storage.write("image_height", rig.left.image_size[1])
    for number, camera in ((1, rig.left), (2, rig.right)):
        storage.write(f"M{number}", np.array(camera.K))
        storage.write(f"D{number}", np.array(camera.distortion).reshape(1, -1))
    matrices = {
        "R": np.array(rig.T_right_left.R),
        "T": np.array(rig.T_right_left.t).reshape(3, 1),
        "R1": maps.R_left,
        "R2": maps.R_right,
        "P1": maps.P_left,
        "P2": maps.P_right,
        "Q": maps.Q,
    }
    for name, matrix in matrices.items():
        storage.write(name, matrix)
    return str(storage.releaseAndGetString())


def camera_to_opencv_yaml(camera: CameraModel) -> str:
    """The text of the file of one camera, as OpenCV's calibration sample names its values."""
    storage = cv2.FileStorage(".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.write("model", camera.model)
    storage.write("image_width", camera.image_size[0])
    storage.write("image_height", camera.image_size[1])
    storage.write("camera_matrix", np.array(camera.K))
    storage.write("distortion_coefficients", np.array(camera.distortion).reshape(1, -1))
    return str(storage.releaseAndGetString())


def read_opencv_rig(path: Path) -> AnyRig:
    """A stereo rig, or a rig of one camera, from OpenCV's YAML or XML.

    Raises:
        InputError: not readable, a matrix or the image size is missing, or a matrix is of the wrong shape.
    """
    hint = "give the M1 D1 M2 D2 R T, image_width and image_height of a stereo pair, as cv2.FileStorage writes them"
    # Read as plain YAML: OpenCV's own reader does not check the stated size of a matrix.
    text = read_text(path, "OpenCV rig file")
    if text.lstrip().startswith("<"):
        content = _from_xml(path, text)
    else:
        content = load_document(path, text, OpenCvLoader, finite=False)
    content = content if isinstance(content, dict) else {}
    if "xi" in content:
        raise InputError("bad_opencv", f"{path}: an omnidirectional camera (xi), which is not supported", _NO_OMNI)
    if str(content.get("fisheye_model", "0")) not in ("0", ""):  # key of OpenCV's calibration sample
        content = {"model": "fisheye"} | content
    named = _named(path, {str(key): _as_matrix(value) for key, value in content.items()})
    if named.keys().isdisjoint({"K", "D", "M1", "M2", "D1", "D2", "R", "T"}):
        keys = ", ".join(sorted(map(str, content))[:6]) or "none"
        raise InputError("not_a_rig", f"{path}: no camera matrix (M1, K, camera_matrix) among its keys: {keys}", hint)
    is_alone = "K" in named and named.keys().isdisjoint({"M1", "M2"})
    missing = [key for key in (_MONO_FIELDS if is_alone else _FIELDS) if key not in named]
    if missing:
        several = "; stereo_calib writes R and T to another file: put all in one" if {"R", "T"} <= {*missing} else ""
        raise InputError("bad_opencv", f"{path}: {', '.join(missing)}: missing{several}", hint)
    if "model" not in named and any(_is_undecided(named[key]) for key in named.keys() & {"D", "D1", "D2"}):
        warn_caller(InputWarning(f"{path}: {_UNDECIDED}"))
    try:
        if is_alone:
            return Rig.of_one(_OpenCvCamera.model_validate(named).camera())
        data = _OpenCvRig.model_validate(named)
        cameras = [data.intrinsics(M, D) for M, D in ((data.M1, data.D1), (data.M2, data.D2))]
        R = data.R.array()
        # Matrices with few digits are only approximately rotations.
        R = orthonormal(R) if R.shape == (3, 3) and np.abs(R @ R.T - np.eye(3)).max() < ALMOST else R
        return StereoRig(cameras[0], cameras[1], Pose("right", "left", R, data.T.array().ravel()))
    except ValidationError as error:
        where, problem = first_problem(error)
        raise InputError("bad_opencv", f"{path}: {where}: {problem}", hint) from None
    except ValueError as error:
        raise InputError("bad_opencv", f"{path}: {error}", hint) from None


def _named(path: Path, content: dict[str, Any]) -> dict[str, Any]:
    """Values by the field that their names stand for.

    Raises:
        InputError: two names stand for the same field, with different values.
    """
    named: dict[str, Any] = {}
    origin: dict[str, str] = {}
    for name, field in fields_by_name(content).items():
        if named.setdefault(field, content[name]) != content[name]:
            raise InputError(
                "bad_opencv", f"{path}: {origin[field]} and {name} are both {field}, but differ", "keep one of them"
            )
        origin.setdefault(field, name)
    size = named.pop("image_size", None)
    if isinstance(size, dict) and isinstance(size.get("data"), list) and len(size["data"]) == 2:
        named = {"image_width": size["data"][0], "image_height": size["data"][1]} | named
    return named


def _is_undecided(D: Any) -> bool:
    """Whether a distortion may be of a pinhole or of a fisheye camera: four numbers, not all zero."""
    data = D.get("data") if isinstance(D, dict) else None
    return isinstance(data, list) and len(data) == 4 and any(data)


def _as_matrix(value: Any) -> Any:
    """Lists of numbers, as scripts write them with ``tolist``, as a matrix of cv2.FileStorage.

    OpenCV 5 writes arrays of one dimension with ``sizes``, without rows and cols.
    """
    if isinstance(value, dict) and isinstance(value.get("sizes"), list) and isinstance(value.get("data"), list):
        sizes = value["sizes"]
        return {"rows": 1, "cols": sizes[0], "data": value["data"]} if len(sizes) == 1 else value
    if not isinstance(value, list):
        return value
    rows = value if value and all(isinstance(row, list) for row in value) else [value]
    if len({len(row) for row in rows}) != 1:
        return value
    return {"rows": len(rows), "cols": len(rows[0]), "data": [number for row in rows for number in row]}


class OpenCvLoader(PlainLoader):
    """Plain YAML, and OpenCV's tag for matrices."""


def _read_matrix(loader: yaml.SafeLoader, node: yaml.MappingNode) -> dict[Hashable, Any]:
    return loader.construct_mapping(node, deep=True)


OpenCvLoader.add_constructor("tag:yaml.org,2002:opencv-matrix", _read_matrix)
OpenCvLoader.add_constructor("tag:yaml.org,2002:opencv-nd-matrix", _read_matrix)


def _from_xml(path: Path, text: str) -> dict[str, Any]:
    """Values of cv2.FileStorage's XML: matrices, and text of anything else that has no children."""
    if "<!" in text.replace("<!--", ""):
        raise InputError("bad_opencv", f"{path}: contains declarations (<!), which are not supported", "remove them")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as error:
        raise InputError("bad_opencv", f"{path}: not XML ({error})", "give a file of cv2.FileStorage") from None
    content: dict[str, Any] = {}
    for child in root:
        data = (child.findtext("data") or child.text or "").split()
        if child.find("data") is not None:
            content[child.tag] = {"rows": child.findtext("rows"), "cols": child.findtext("cols"), "data": data}
        elif not len(child):
            content[child.tag] = data if len(data) > 1 else "".join(data)
    return content


class _Matrix(BaseModel):
    model_config = ConfigDict(extra="ignore", allow_inf_nan=False, defer_build=True)
    rows: Annotated[int, Field(gt=0)]
    cols: Annotated[int, Field(gt=0)]
    data: list[float]

    def array(self) -> FloatArray:
        if len(self.data) != self.rows * self.cols:
            raise ValueError(f"a matrix of {self.rows} x {self.cols} holds {len(self.data)} numbers")
        return np.array(self.data).reshape(self.rows, self.cols)


class _Sized(BaseModel):
    # Files may have additional keys.
    model_config = ConfigDict(extra="ignore", defer_build=True)
    model: str = ""
    image_width: Annotated[int, Field(gt=0)]
    image_height: Annotated[int, Field(gt=0)]

    def intrinsics(self, K: _Matrix, D: _Matrix) -> CameraModel:
        model = self.model or _MODEL_OF_COUNT.get(len(D.data))
        if model is None:
            raise ValueError(f"{len(D.data)} distortion coefficients, expected 0, 4, 5, 8, 12 or 14")
        return CameraModel((self.image_width, self.image_height), K.array(), D.array().ravel(), model)


class _OpenCvCamera(_Sized):
    K: _Matrix
    D: _Matrix

    def camera(self) -> CameraModel:
        return self.intrinsics(self.K, self.D)


class _OpenCvRig(_Sized):
    M1: _Matrix
    D1: _Matrix
    M2: _Matrix
    D2: _Matrix
    R: _Matrix
    T: _Matrix
