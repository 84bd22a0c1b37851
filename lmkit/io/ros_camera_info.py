"""Rigs as a pair of ROS camera_info files, left.yaml and right.yaml (sensor_msgs/CameraInfo, camera_calibration)."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from lmkit.arrays import FloatArray
from lmkit.errors import InputError
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.lens_models import LENS_MODELS
from lmkit.geometry.pose import Pose
from lmkit.geometry.rectification import rectification
from lmkit.geometry.rig import Rig
from lmkit.geometry.rotations import orthonormal
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.io.documents import dump_yaml, load_document, read_text
from lmkit.io.field_problems import first_problem
from lmkit.io.tables import LARGEST

FILES = ("left.yaml", "right.yaml")
_FROM_ROS = {lens.ros_name: name for name, lens in LENS_MODELS.items()} | {"fisheye": "fisheye"}
_UNDISTORTED = ("", "none", "None")  # of simulators and rectified images
# image_geometry of ROS gives the coefficients of both to OpenCV, which goes by their number.
_BY_COUNT = {"plumb_bob": (8, "rational"), "rational_polynomial": (5, "pinhole")}
_MESSAGE_KEYS = {
    "width": "image_width", "height": "image_height",
    "K": "camera_matrix", "D": "distortion_coefficients", "R": "rectification_matrix", "P": "projection_matrix",
    "k": "camera_matrix", "d": "distortion_coefficients", "r": "rectification_matrix", "p": "projection_matrix",
}  # fmt: skip
NOT_A_ROTATION = 0.02
_ROWS = {"camera_matrix": 3, "distortion_coefficients": 1, "rectification_matrix": 3, "projection_matrix": 3}


class _Matrix(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, defer_build=True)
    rows: int
    cols: int
    data: list[float]


class _Part(BaseModel):
    model_config = ConfigDict(extra="ignore", defer_build=True)
    x_offset: int = 0
    y_offset: int = 0
    width: int = 0
    height: int = 0

    def is_part_of(self, width: int, height: int) -> bool:
        """Whether it is less than the whole image; all zeros mean the whole image."""
        return (self.x_offset, self.y_offset) != (0, 0) or (self.width, self.height) not in ((0, 0), (width, height))


class _CameraInfo(BaseModel):
    # Drivers add their own keys; unknown keys are ignored.
    model_config = ConfigDict(extra="ignore", allow_inf_nan=False, defer_build=True)
    image_width: Annotated[int, Field(gt=0)]
    image_height: Annotated[int, Field(gt=0)]
    camera_name: str = ""
    camera_matrix: _Matrix
    distortion_model: str
    distortion_coefficients: _Matrix
    rectification_matrix: _Matrix | None = None  # of one camera alone, neither is needed
    projection_matrix: _Matrix | None = None
    binning_x: int = 0
    binning_y: int = 0
    roi: _Part = _Part()


def rig_to_camera_infos(rig: StereoRig) -> tuple[str, str]:
    """The texts of the left and of the right file.

    The relative pose of the cameras is in their rectification; T_base_left and uncertainties are lost.
    """
    maps = rectification(rig)
    left, right = rig.left, rig.right
    return _text("left", left, maps.R_left, maps.P_left), _text("right", right, maps.R_right, maps.P_right)


def _text(name: str, camera: CameraModel, R: FloatArray, P: FloatArray) -> str:
    width, height = camera.image_size
    count = max(camera.lens.fitted, len(camera.distortion))
    distortion = np.pad(camera.distortion, (0, count - len(camera.distortion)))
    return dump_yaml(
        {
            "image_width": width,
            "image_height": height,
            "camera_name": name,
            "camera_matrix": _matrix(np.array(camera.K)),
            "distortion_model": camera.lens.ros_name,
            "distortion_coefficients": _matrix(distortion[None]),
            "rectification_matrix": _matrix(R),
            "projection_matrix": _matrix(P),
        }
    )


def read_camera_infos(left: Path, right: Path) -> StereoRig:
    """A rig from its two files.

    Raises:
        InputError: not readable or not valid, or the two are not a stereo pair.
    """
    infos = [_read(path) for path in (left, right)]
    cameras = [_camera(path, info) for path, info in zip((left, right), infos, strict=True)]
    for path, info in zip((left, right), infos, strict=True):
        R = _array(info.rectification_matrix, (3, 3), "rectification_matrix", path)
        if not np.abs(R @ R.T - np.eye(3)).max() < NOT_A_ROTATION or np.linalg.det(R) < 0:
            raise InputError(
                "no_stereo",
                f"{path}: rectification_matrix is not a rotation: the driver was not given a stereo calibration",
                "give the pair as stereo calibration wrote it",
            )
    R1, R2 = (
        orthonormal(_array(i.rectification_matrix, (3, 3), "rectification_matrix", p))
        for i, p in zip(infos, (left, right), strict=True)
    )
    P1, P2 = (
        _array(i.projection_matrix, (3, 4), "projection_matrix", p) for i, p in zip(infos, (left, right), strict=True)
    )
    # Rectified, the right camera differs by a shift: P[:, 3] = K t.
    shift = _shift(right, P2) - _shift(left, P1)
    if not shift.any():
        hint = "give the pair as stereo calibration wrote it, left file first"
        raise InputError(
            "no_stereo", f"{right}: projection_matrix has no baseline: these are two single cameras", hint
        )
    return StereoRig(cameras[0], cameras[1], Pose("right", "left", R2.T @ R1, R2.T @ shift))


def read_camera_info(path: Path) -> Rig:
    """A rig of one camera from its camera_info file.

    Raises:
        InputError: not readable or not valid.
    """
    info = _read(path)
    return Rig.of_one(_camera(path, info), name=info.camera_name or "camera")


def rig_to_camera_info(rig: Rig) -> str:
    """The text of a camera_info file of a rig of one camera."""
    camera = rig.left
    P = np.column_stack([np.array(camera.K), np.zeros(3)])
    return _text(rig.cameras[0].name, camera, np.eye(3), P)


def _shift(path: Path, P: FloatArray) -> FloatArray:
    if np.linalg.cond(P[:, :3]) > 1e12:
        raise InputError(
            "no_stereo", f"{path}: projection_matrix is singular", "give the files that stereo calibration wrote"
        )
    with np.errstate(over="ignore", invalid="ignore"):
        shift = np.linalg.solve(P[:, :3], P[:, 3])
    if not np.abs(shift).max() < LARGEST:
        raise InputError(
            "no_stereo", f"{path}: projection_matrix has no baseline in meters", "give what stereo calibration wrote"
        )
    return np.asarray(shift)


def _read(path: Path) -> _CameraInfo:
    hint = "give camera_info YAML as ROS camera_calibration writes it"
    data = load_document(path, read_text(path, "camera_info file"), finite=False, several=True)
    try:
        info = _CameraInfo.model_validate(_as_calibrated(data))
    except ValidationError as error:
        where, problem = first_problem(error)
        raise InputError("bad_camera_info", f"{path}: {where}: {problem}", hint) from None
    if max(info.binning_x, info.binning_y) > 1 or info.roi.is_part_of(info.image_width, info.image_height):
        raise InputError(
            "bad_camera_info",
            f"{path}: its images are binned, or a part of the sensor (binning_x, roi), and K is that of the whole",
            "record whole images, or scale and shift K and the size to those of the images",
        )
    return info


def _as_calibrated(data: Any) -> Any:
    """Keys of a CameraInfo message (``ros2 topic echo``, D K R P in either case) and of old drivers, renamed."""
    if not isinstance(data, dict):
        return data
    named = {_MESSAGE_KEYS.get(key, key): value for key, value in data.items()}
    if "distortion_model" not in named and "camera_model" in named:
        named["distortion_model"] = named["camera_model"]
    for key, rows in _ROWS.items():
        values = named.get(key)
        if isinstance(values, list):
            named[key] = {"rows": rows, "cols": len(values) // rows, "data": values}
    return named


def _camera(path: Path, info: _CameraInfo) -> CameraModel:
    distortion = np.array(info.distortion_coefficients.data)
    count, other = _BY_COUNT.get(info.distortion_model, (-1, ""))
    model = other if len(distortion) == count else _FROM_ROS.get(info.distortion_model)
    if info.distortion_model in _UNDISTORTED and not distortion.any():
        model, distortion = "pinhole", distortion[:0]
    if model is None:
        known = ", ".join(_FROM_ROS)
        raise InputError("bad_camera_info", f"{path}: distortion_model {info.distortion_model!r}", f"known: {known}")
    try:
        K = _array(info.camera_matrix, (3, 3), "camera_matrix", path)
        if not K.any():
            raise ValueError("its camera matrix is zero: the camera is not calibrated")
        return CameraModel((info.image_width, info.image_height), K, distortion, model)
    except ValueError as error:
        raise InputError("bad_camera_info", f"{path}: {error}", "see docs/formats.md") from None


def _array(matrix: _Matrix | None, shape: tuple[int, int], name: str, path: Path) -> FloatArray:
    if matrix is None:
        hint = "give the pair as stereo calibration wrote it"
        raise InputError("bad_camera_info", f"{path}: {name}: missing", hint)
    if (matrix.rows, matrix.cols) != shape or len(matrix.data) != shape[0] * shape[1]:
        raise InputError("bad_camera_info", f"{path}: {name} is not {shape[0]} x {shape[1]}", "see docs/formats.md")
    return np.array(matrix.data).reshape(shape)


def _matrix(values: FloatArray) -> dict[str, Any]:
    return {"rows": values.shape[0], "cols": values.shape[1], "data": values.ravel().tolist()}
