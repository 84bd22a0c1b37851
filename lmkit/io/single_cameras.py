"""Files of single cameras from FRC tools, EuRoC and VINS.

PhotonVision, calibdb and WPIcal (JSON); sensor.yaml of EuRoC; camera files of camodocal, which VINS reads (YAML).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.errors import InputError
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.rig import Rig
from lmkit.io.documents import load_document
from lmkit.io.field_problems import plain_problem

PHOTONVISION = frozenset({"cameraIntrinsics", "resolution"})
CALIBDB = frozenset({"camera_matrix", "img_size"})
EUROC = frozenset({"intrinsics", "resolution", "distortion_model"})
CAMODOCAL = frozenset({"model_type", "image_width"})
_EUROC_MODELS = {"radial-tangential": "pinhole", "radtan": "pinhole", "equidistant": "fisheye"}
_MODEL_OF_COUNT = {0: "pinhole", 4: "pinhole", 5: "pinhole", 8: "rational", 12: "rational", 14: "rational"}


def is_single_camera(keys: frozenset[str]) -> bool:
    """Whether a document with these keys is such a file."""
    return any(kind <= keys for kind in (PHOTONVISION, CALIBDB, EUROC, CAMODOCAL))


def read_single_camera(path: Path, text: str) -> Rig:
    """A rig of one camera.

    Raises:
        InputError: a value is missing or of the wrong kind, or a lens model that is not supported.
    """
    from lmkit.io.opencv_rig import OpenCvLoader

    content = load_document(path, text, OpenCvLoader)
    try:
        if content.keys() >= PHOTONVISION:
            camera = _photonvision(content)
        elif content.keys() >= CALIBDB:
            camera = _calibdb(content)
        elif content.keys() >= CAMODOCAL:
            camera = _camodocal(content)
        else:
            camera = _euroc(content)
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        raise InputError(
            "bad_camera",
            f"{path}: not a camera calibration ({plain_problem(error)})",
            "give the file as the tool wrote it",
        ) from None
    return Rig.of_one(camera)


def _photonvision(content: Mapping[str, Any]) -> CameraModel:
    model = content.get("lensmodel", "LENSMODEL_OPENCV")
    if model != "LENSMODEL_OPENCV":
        raise ValueError(f"lensmodel {str(model)[:40]!r} is not supported")
    size = content["resolution"]
    distortion = content.get("distCoeffs", content.get("cameraExtrinsics"))  # its name until 2024
    if distortion is None:
        raise KeyError("distCoeffs")
    return _camera((size["width"], size["height"]), content["cameraIntrinsics"]["data"], distortion["data"])


def _calibdb(content: Mapping[str, Any]) -> CameraModel:
    if str(content.get("distortion_model", "rectilinear")) not in ("rectilinear", "plumb_bob", "rational_polynomial"):
        raise ValueError(f"distortion_model {content['distortion_model']!r} is not supported")
    return _camera(content["img_size"], content["camera_matrix"], content["distortion_coefficients"])


def _euroc(content: Mapping[str, Any]) -> CameraModel:
    fx, fy, cx, cy = (float(v) for v in content["intrinsics"])
    if content.get("camera_model", "pinhole") != "pinhole" or content["distortion_model"] not in _EUROC_MODELS:
        raise ValueError(f"{content.get('camera_model')} with {content['distortion_model']} is not supported")
    distortion = content.get("distortion_coefficients", content.get("distortion_coeffs"))
    K = [fx, 0, cx, 0, fy, cy, 0, 0, 1]
    return _camera(content["resolution"], K, distortion, _EUROC_MODELS[content["distortion_model"]])


def _camodocal(content: Mapping[str, Any]) -> CameraModel:
    """PINHOLE has OpenCV's k1 k2 p1 p2; KANNALA_BRANDT calls the coefficients of the fisheye model k2 to k5."""
    size, model = (content["image_width"], content["image_height"]), content["model_type"]
    values = content["projection_parameters"] if model in ("PINHOLE", "KANNALA_BRANDT") else {}
    if model == "PINHOLE":
        names, lens = ("fx", "fy", "cx", "cy"), "pinhole"
        distortion = [content["distortion_parameters"][key] for key in ("k1", "k2", "p1", "p2")]
    elif model == "KANNALA_BRANDT":
        names, lens = ("mu", "mv", "u0", "v0"), "fisheye"
        distortion = [values[key] for key in ("k2", "k3", "k4", "k5")]
    else:
        raise ValueError(f"model_type {str(model)[:40]!r} is not supported, only PINHOLE and KANNALA_BRANDT")
    fx, fy, cx, cy = (float(values[key]) for key in names)
    return _camera(size, [fx, 0, cx, 0, fy, cy, 0, 0, 1], distortion, lens)


def _camera(size: Any, K: Any, distortion: Any, model: str | None = None) -> CameraModel:
    width, height = (float(side) for side in size)
    if width != int(width) or height != int(height):
        raise ValueError(f"its size is {width:g} x {height:g} pixels")
    numbers: FloatArray = np.array(distortion, dtype=np.float64).ravel()
    chosen = model or _MODEL_OF_COUNT.get(len(numbers))
    if chosen is None:
        raise ValueError(f"{len(numbers)} distortion coefficients")
    return CameraModel((int(width), int(height)), np.array(K, dtype=np.float64).reshape(3, 3), numbers, chosen)
