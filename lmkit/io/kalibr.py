"""Rigs as a Kalibr camchain: cam0 is the first (left) camera, cam1 the second (right) one, and so on."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator

from lmkit.arrays import FloatArray
from lmkit.errors import InputError
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.lens_conversion import with_four_coefficients
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import AnyRig, MountedCamera, Rig, mounted_cameras, with_time_offsets
from lmkit.geometry.rotations import orthonormal
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.io.documents import dump_yaml, load_document, read_text
from lmkit.io.field_problems import first_problem

MOST_ERROR_PX = 1.0
LEAST_DETERMINANT = 0.9  # of almost-rotations in files of few digits
_MODELS = {"radtan": "pinhole", "equidistant": "fisheye"}  # as written; TagSLAM has plumb_bob, radtan with k3
Row4 = Annotated[list[float], Field(min_length=4, max_length=4)]


Matrix4 = Annotated[list[Row4], Field(min_length=4, max_length=4)]


class _Camera(BaseModel):
    model_config = ConfigDict(extra="ignore", allow_inf_nan=False)
    camera_model: str
    distortion_model: Literal["radtan", "equidistant", "none", "plumb_bob"]
    intrinsics: Row4
    distortion_coeffs: list[float] = Field(max_length=5)
    resolution: tuple[Annotated[int, Field(gt=0)], Annotated[int, Field(gt=0)]]
    T_cn_cnm1: Matrix4 | None = None
    T_cam_imu: Matrix4 | None = None
    T_imu_cam: Matrix4 | None = None
    timeshift_cam_imu: float | None = None

    @field_validator("T_cn_cnm1", "T_cam_imu", "T_imu_cam", mode="before")
    @classmethod
    def _as_rows(cls, value: Any) -> Any:
        """Rows of a matrix that is written as 16 numbers (MSCKF-VIO) or as cv2.FileStorage does (VINS)."""
        value = value.get("data") if isinstance(value, dict) else value
        is_flat = isinstance(value, list) and len(value) == 16
        return [value[k : k + 4] for k in range(0, 16, 4)] if is_flat else value

    @field_validator("camera_model")
    @classmethod
    def _is_pinhole(cls, name: str) -> str:
        if name != "pinhole":
            raise ValueError(f"{name!r} is not supported, only pinhole")
        return name

    def T_camera_imu(self) -> FloatArray | None:
        """(4,4) of Kalibr's T_cam_imu, or of the inverse that OpenVINS writes."""
        if self.T_cam_imu is not None:
            return np.array(self.T_cam_imu)
        return None if self.T_imu_cam is None else np.linalg.inv(np.array(self.T_imu_cam))


def rig_to_camchain(rig: AnyRig) -> tuple[str, str, float]:
    """The text of the file, its distortion model, and the largest difference from the rig's lenses, px.

    Kalibr's lenses have four coefficients: radtan k1 k2 p1 p2, equidistant k1 k2 k3 k4.  Longer distortions are
    replaced by the nearer of the two, the same for all cameras.

    Raises:
        InputError: neither is near.
    """
    mounted = mounted_cameras(rig)
    made = {name: [with_four_coefficients(c.model, model) for c in mounted] for name, model in _MODELS.items()}
    worst = {name: max(error_px for _, error_px in cameras) for name, cameras in made.items()}
    kind = min(worst, key=lambda name: worst[name])
    if worst[kind] > MOST_ERROR_PX:
        raise InputError(
            "no_kalibr_lens",
            f"Kalibr's lens models (four coefficients) differ from this rig's by {worst[kind]:.2f} px or more",
            "calibrate with --model radtan (wide lenses: fisheye), or write opencv or ros instead",
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
            "cam_overlaps": [other for other in range(len(mounted)) if other != number],
            "rostopic": f"/{mounted[number].name}/image_raw",
        }
        if any(camera.time_offset_s for camera in mounted):
            cameras[f"cam{number}"]["timeshift_cam_imu"] = mounted[number].time_offset_s
        if number > 0:
            T = mounted[number].T_camera_left.matrix @ mounted[number - 1].T_camera_left.inverse().matrix
            cameras[f"cam{number}"] = {"T_cn_cnm1": T.tolist()} | cameras[f"cam{number}"]
    return dump_yaml(cameras), kind, worst[kind]


def read_camchain(path: Path) -> AnyRig:
    """A rig from a camchain: a `StereoRig` of two cameras, else a `Rig` of cameras cam0, cam1, ...

    Raises:
        InputError: not readable or not valid, or a camera has no pose relative to the previous one.
    """
    hint = "give a camchain as Kalibr writes it"
    content = load_document(path, read_text(path, "camchain"), finite=False)
    content = content if isinstance(content, dict) else {}
    names = [f"cam{k}" for k in range(max(1, sum(str(key).startswith("cam") for key in content)))]
    chain = []
    for name in names:
        if name not in content:
            raise InputError("bad_camchain", f"{path}: {name}: missing", hint)
        try:
            chain.append(_Camera.model_validate(content[name]))
        except ValidationError as error:
            where, problem = first_problem(error)
            # A model that is not supported is as Kalibr writes it.
            is_model = where in ("camera_model", "distortion_model")
            remedy = "calibrate again with pinhole-equi or pinhole-radtan" if is_model else hint
            raise InputError("bad_camchain", f"{path}: {name}.{where}: {problem}", remedy) from None
    try:
        T, poses = np.eye(4), [np.eye(4)]
        for k in range(1, len(chain)):
            between = _between(chain[k - 1], chain[k])
            if between is None:
                is_tagslam = "rig_body" in content[names[k]]
                raise InputError(
                    "bad_camchain",
                    f"{path}: {names[k]}.T_cn_cnm1: missing (and no T_cam_imu of both)",
                    "TagSLAM's camera_poses.yaml is not read: add T_cn_cnm1 or T_cam_imu" if is_tagslam else hint,
                )
            if np.linalg.det(between[:3, :3]) < LEAST_DETERMINANT:
                raise ValueError(f"{names[k]}: the rotation to {names[k - 1]} is not a rotation")
            T = between @ T
            poses.append(T)
        models = [_camera(camera) for camera in chain]
        if len(chain) == 2:
            T_right_left = Pose("right", "left", orthonormal(T[:3, :3]), T[:3, 3])
            return with_time_offsets(StereoRig(models[0], models[1], T_right_left), _time_offsets(chain))
        mounted = [
            MountedCamera(name, model, Pose("camera", "left", orthonormal(T[:3, :3]) if k else np.eye(3), T[:3, 3]))
            for k, (name, model, T) in enumerate(zip(names, models, poses, strict=True))
        ]
        return with_time_offsets(Rig(tuple(mounted)), _time_offsets(chain))
    except ValueError as error:
        raise InputError("bad_camchain", f"{path}: {error}", hint) from None


def _time_offsets(chain: Sequence[_Camera]) -> list[float]:
    """Offsets of all cameras but the first; Kalibr's timeshift_cam_imu takes stamps to the IMU's clock."""
    shifts = [camera.timeshift_cam_imu for camera in chain]
    if shifts[0] is None or None in shifts:
        return [0.0] * (len(chain) - 1)
    return [(shift or 0.0) - shifts[0] for shift in shifts[1:]]


def _between(before: _Camera, camera: _Camera) -> FloatArray | None:
    """(4,4) from one camera to the next: given directly, or through the IMU."""
    if camera.T_cn_cnm1 is not None:
        return np.array(camera.T_cn_cnm1)
    left, right = before.T_camera_imu(), camera.T_camera_imu()
    return None if left is None or right is None else right @ np.linalg.inv(left)


def _camera(data: _Camera) -> CameraModel:
    fx, fy, cx, cy = data.intrinsics
    model = _MODELS.get(data.distortion_model, "pinhole")
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    return CameraModel(data.resolution, K, np.array(data.distortion_coeffs), model)
