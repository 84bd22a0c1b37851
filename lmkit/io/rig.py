"""Rig files: a calibrated stereo camera as YAML (docs/formats.md)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from lmkit.errors import InputError
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.pose import Pose
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.io.documents import Document, dump_yaml, read_document

Row = Annotated[list[float], Field(min_length=3, max_length=3)]
Matrix3 = Annotated[list[Row], Field(min_length=3, max_length=3)]
Row6 = Annotated[list[float], Field(min_length=6, max_length=6)]
Matrix6 = Annotated[list[Row6], Field(min_length=6, max_length=6)]


class _Camera(Document):
    image_size: tuple[int, int]
    model: Literal["pinhole", "rational", "fisheye"]
    K: Matrix3
    distortion: list[float]


class _Transform(Document):
    R: Matrix3
    t: Row


class _Uncertainty(Document):
    T_right_left: Matrix6
    left_sigma: list[float] | None = None
    right_sigma: list[float] | None = None


class _RigFile(Document):
    format: str = "lmkit-rig/1"
    left: _Camera
    right: _Camera
    T_right_left: _Transform
    T_base_left: _Transform | None = None
    uncertainty: _Uncertainty | None = None


def read_rig(path: Path) -> StereoRig:
    """A rig from its file.

    Raises:
        InputError: not readable or not valid; names the key.
    """
    data = read_document(path, _RigFile, "rig file")
    covariance = sigma = None
    if data.uncertainty is not None:
        covariance = np.array(data.uncertainty.T_right_left)
        if data.uncertainty.left_sigma is not None and data.uncertainty.right_sigma is not None:
            sigma = (np.array(data.uncertainty.left_sigma), np.array(data.uncertainty.right_sigma))
    base = data.T_base_left
    return StereoRig(
        left=_camera(path, "left", data.left),
        right=_camera(path, "right", data.right),
        T_right_left=_pose(path, "T_right_left", "right", "left", data.T_right_left),
        T_base_left=None if base is None else _pose(path, "T_base_left", "base", "left", base),
        covariance=covariance,
        intrinsics_sigma=sigma,
    )


def rig_to_yaml(rig: StereoRig) -> str:
    """The text of a rig file."""
    data: dict[str, Any] = {
        "format": "lmkit-rig/1",
        "left": _camera_dict(rig.left),
        "right": _camera_dict(rig.right),
        "T_right_left": {"R": rig.T_right_left.R.tolist(), "t": rig.T_right_left.t.tolist()},
    }
    if rig.T_base_left is not None:
        data["T_base_left"] = {"R": rig.T_base_left.R.tolist(), "t": rig.T_base_left.t.tolist()}
    if rig.covariance is not None:
        data["uncertainty"] = {"T_right_left": rig.covariance.tolist()}
        if rig.intrinsics_sigma is not None:
            for key, sigma in zip(("left_sigma", "right_sigma"), rig.intrinsics_sigma, strict=True):
                data["uncertainty"][key] = sigma.tolist()
    return dump_yaml(data)


def _camera(path: Path, key: str, data: _Camera) -> CameraModel:
    try:
        return CameraModel(data.image_size, np.array(data.K), np.array(data.distortion), data.model)
    except ValueError as error:
        raise InputError("bad_value", f"{path}: {key}: {error}", "see docs/formats.md") from None


def _camera_dict(camera: CameraModel) -> dict[str, Any]:
    return {
        "image_size": list(camera.image_size),
        "model": camera.model,
        "K": camera.K.tolist(),
        "distortion": camera.distortion.tolist(),
    }


def _pose(path: Path, key: str, to_frame: str, from_frame: str, data: _Transform) -> Pose:
    try:
        return Pose(to_frame, from_frame, np.array(data.R), np.array(data.t))
    except ValueError as error:
        raise InputError("bad_value", f"{path}: {key}.R: {error}", "write a rotation matrix") from None
