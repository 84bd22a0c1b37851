"""Rigs as a Kalibr camchain: cam0 is the left camera, cam1 the right one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from lmkit.arrays import FloatArray
from lmkit.errors import InputError
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.lens_conversion import with_four_coefficients
from lmkit.geometry.pose import Pose
from lmkit.geometry.rotations import orthonormal
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.io.documents import dump_yaml, first_problem, load_document, read_text

MOST_ERROR_PX = 1.0
LEAST_DETERMINANT = 0.9  # of almost-rotations in files of few digits
_MODELS = {"radtan": "pinhole", "equidistant": "fisheye"}
Row4 = Annotated[list[float], Field(min_length=4, max_length=4)]


Matrix4 = Annotated[list[Row4], Field(min_length=4, max_length=4)]


class _Camera(BaseModel):
    model_config = ConfigDict(extra="ignore", allow_inf_nan=False)
    camera_model: str
    distortion_model: Literal["radtan", "equidistant", "none"]
    intrinsics: Row4
    distortion_coeffs: list[float] = Field(max_length=4)
    resolution: tuple[Annotated[int, Field(gt=0)], Annotated[int, Field(gt=0)]]
    T_cn_cnm1: Matrix4 | None = None
    T_cam_imu: Matrix4 | None = None
    T_imu_cam: Matrix4 | None = None

    @field_validator("camera_model")
    @classmethod
    def _is_pinhole(cls, name: str) -> str:
        if name != "pinhole":
            raise ValueError(f"{name!r} is not read, only pinhole; calibrate again with pinhole-equi")
        return name

    def T_camera_imu(self) -> FloatArray | None:
        """(4,4) of Kalibr's T_cam_imu, or of the inverse that OpenVINS writes."""
        if self.T_cam_imu is not None:
            return np.array(self.T_cam_imu)
        return None if self.T_imu_cam is None else np.linalg.inv(np.array(self.T_imu_cam))


class _Camchain(BaseModel):
    model_config = ConfigDict(extra="ignore", allow_inf_nan=False)
    cam0: _Camera
    cam1: _Camera


def rig_to_camchain(rig: StereoRig) -> tuple[str, str, float]:
    """The text of the file, its distortion model, and by how many pixels at most its lenses differ from the rig's.

    Kalibr's lenses have four coefficients: radtan k1 k2 p1 p2, equidistant k1 k2 k3 k4.  Longer distortions are
    replaced by the nearer of the two, the same for both cameras.

    Raises:
        InputError: neither is near.
    """
    eyes = (rig.left, rig.right)
    made = {name: [with_four_coefficients(eye, model) for eye in eyes] for name, model in _MODELS.items()}
    worst = {name: max(error_px for _, error_px in cameras) for name, cameras in made.items()}
    kind = min(worst, key=lambda name: worst[name])
    if worst[kind] > MOST_ERROR_PX:
        raise InputError(
            "no_kalibr_lens",
            f"Kalibr's lenses of four coefficients miss this rig's by {worst[kind]:.2f} px or more",
            "calibrate with --model fisheye, or write opencv or ros instead",
        )
    cameras: dict[str, Any] = {}
    for number, (camera, _) in enumerate(made[kind]):
        K = camera.K
        cameras[f"cam{number}"] = {
            "camera_model": "pinhole",
            "distortion_model": kind,
            "intrinsics": [float(v) for v in (K[0, 0], K[1, 1], K[0, 2], K[1, 2])],
            "distortion_coeffs": camera.distortion.tolist(),
            "resolution": list(camera.image_size),
            "cam_overlaps": [1 - number],
            "rostopic": f"/{('left', 'right')[number]}/image_raw",
        }
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rig.T_right_left.R, rig.T_right_left.t
    cameras["cam1"] = {"T_cn_cnm1": T.tolist()} | cameras["cam1"]
    return dump_yaml(cameras), kind, worst[kind]


def read_camchain(path: Path) -> StereoRig:
    """A rig from the first two cameras of a camchain.

    Raises:
        InputError: not readable or not valid, or cam1 does not say how it stands to cam0.
    """
    hint = "give a camchain of a stereo pair as Kalibr writes it"
    try:
        data = _Camchain.model_validate(load_document(path, _text(path), finite=False))
    except ValidationError as error:
        where, problem = first_problem(error)
        raise InputError("bad_camchain", f"{path}: {where}: {problem}", hint) from None
    try:
        T = _between(data)
        if T is None:
            raise InputError("bad_camchain", f"{path}: cam1.T_cn_cnm1: missing (and no T_cam_imu of both)", hint)
        if np.linalg.det(T[:3, :3]) < LEAST_DETERMINANT:
            raise ValueError("cam1: its rotation to cam0 is not a rotation")
        return StereoRig(
            _camera(data.cam0), _camera(data.cam1), Pose("right", "left", orthonormal(T[:3, :3]), T[:3, 3])
        )
    except ValueError as error:
        raise InputError("bad_camchain", f"{path}: {error}", hint) from None


def _between(data: _Camchain) -> FloatArray | None:
    """(4,4) from cam0 to cam1: as it stands, or through the IMU."""
    if data.cam1.T_cn_cnm1 is not None:
        return np.array(data.cam1.T_cn_cnm1)
    left, right = data.cam0.T_camera_imu(), data.cam1.T_camera_imu()
    return None if left is None or right is None else right @ np.linalg.inv(left)


def _text(path: Path) -> str:
    """Text of the file without OpenCV's first line, which OpenVINS writes."""
    return read_text(path, "camchain").removeprefix("%YAML:1.0")


def _camera(data: _Camera) -> CameraModel:
    fx, fy, cx, cy = data.intrinsics
    model = _MODELS.get(data.distortion_model, "pinhole")
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    return CameraModel(data.resolution, K, np.array(data.distortion_coeffs), model)
