"""Rig files: one or more calibrated cameras as YAML (docs/formats.md)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.errors import InputError
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.lens_models import LENS_MODELS
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import AnyRig, MountedCamera, Rig
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.io.document_head import head_of
from lmkit.io.documents import dump_yaml, read_text
from lmkit.io.layouts import FieldProblem, Layout, items, keys_of, matrix, number, read_layout, text

FORMAT = "lmkit-rig/1"
MOST_OFFSET_S = 10.0  # between clocks of two cameras; larger offsets, of unrelated clocks, are refused


def _lens_model(given: Any) -> str:
    name = text()(given)
    if name not in LENS_MODELS:
        raise FieldProblem(f"{name!r} is not a lens model; known: {', '.join(LENS_MODELS)}")
    return name


def _correlation(given: Any) -> list[list[float]]:
    rows = items(items(number()), 1)(given)
    if any(len(row) != len(rows) for row in rows):
        raise FieldProblem("a correlation matrix is square")
    values = np.array(rows)
    if not np.allclose(values, values.T, atol=1e-6) or not np.allclose(np.diag(values), 1, atol=1e-6):
        raise FieldProblem("a correlation matrix is symmetric, with 1 on its diagonal")
    if np.linalg.eigvalsh(values)[0] < -1e-6:
        raise FieldProblem("no numbers have these correlations: the matrix has a negative eigenvalue")
    return rows


LensModel = Annotated[str, _lens_model]
Correlation = Annotated[list[list[float]], _correlation]
Row = Annotated[list[float], items(number(), 3, 3)]
Matrix3 = Annotated[list[list[float]], matrix(3, 3)]
Matrix6 = Annotated[list[list[float]], matrix(6, 6)]


@dataclass(frozen=True, kw_only=True)
class _Camera(Layout):
    image_size: tuple[int, int]
    model: LensModel
    K: Matrix3
    distortion: list[float]
    time_offset_s: Annotated[float, number(-MOST_OFFSET_S, MOST_OFFSET_S)] = 0.0


@dataclass(frozen=True, kw_only=True)
class _Transform(Layout):
    R: Matrix3
    t: Row


@dataclass(frozen=True, kw_only=True)
class _Uncertainty(Layout):
    T_right_left: Matrix6
    left_sigma: list[float] | None = None
    right_sigma: list[float] | None = None
    left_correlation: Correlation | None = None
    right_correlation: Correlation | None = None


@dataclass(frozen=True, kw_only=True)
class _MountedCamera(_Camera):
    name: Annotated[str, text(1)]
    T_first_camera: _Transform | None = None
    T_base_camera: _Transform | None = None
    covariance: Matrix6 | None = None
    sigma: list[float] | None = None
    correlation: Correlation | None = None


@dataclass(frozen=True, kw_only=True)
class _RigFile(Layout):
    left: _Camera
    right: _Camera
    T_right_left: _Transform
    T_base_left: _Transform | None = None
    uncertainty: _Uncertainty | None = None


@dataclass(frozen=True, kw_only=True)
class _CamerasFile(Layout):
    cameras: Annotated[list[_MountedCamera], items(keys_of(_MountedCamera), 1)]


def read_rig(path: Path) -> AnyRig:
    """A rig from its file: a `Rig` where the file lists ``cameras``, else a `StereoRig`.

    Raises:
        InputError: not readable or not valid; names the key.
    """
    if _lists_cameras(path):
        return _read_cameras(path)
    data = read_layout(path, _RigFile, FORMAT, "rig file")
    covariance = sigma = correlation = None
    if data.uncertainty is not None:
        covariance = np.array(data.uncertainty.T_right_left)
        if data.uncertainty.left_sigma is not None and data.uncertainty.right_sigma is not None:
            sigma = (np.array(data.uncertainty.left_sigma), np.array(data.uncertainty.right_sigma))
            both = data.uncertainty.left_correlation, data.uncertainty.right_correlation
            if both[0] is not None and both[1] is not None:
                correlation = (
                    _correlations(path, "uncertainty.left_correlation", both[0], len(sigma[0])),
                    _correlations(path, "uncertainty.right_correlation", both[1], len(sigma[1])),
                )
    base = data.T_base_left
    _require_own_clock(path, "left", data.left)
    return StereoRig(
        left=_camera(path, "left", data.left),
        right=_camera(path, "right", data.right),
        T_right_left=_pose(path, "T_right_left", "right", "left", data.T_right_left),
        T_base_left=None if base is None else _pose(path, "T_base_left", "base", "left", base),
        covariance=covariance,
        intrinsics_sigma=sigma,
        intrinsics_correlation=correlation,
        right_time_offset_s=data.right.time_offset_s,
    )


def rig_to_yaml(rig: AnyRig) -> str:
    """The text of a rig file."""
    if isinstance(rig, Rig):
        return _cameras_to_yaml(rig)
    data: dict[str, Any] = {
        "format": FORMAT,
        "left": _camera_dict(rig.left),
        "right": {**_camera_dict(rig.right), **_time_offset(rig.right_time_offset_s)},
        "T_right_left": _pose_dict(rig.T_right_left),
    }
    if rig.T_base_left is not None:
        data["T_base_left"] = _pose_dict(rig.T_base_left)
    if rig.covariance is not None:
        data["uncertainty"] = {"T_right_left": rig.covariance.tolist()}
        if rig.intrinsics_sigma is not None:
            for key, sigma in zip(("left_sigma", "right_sigma"), rig.intrinsics_sigma, strict=True):
                data["uncertainty"][key] = sigma.tolist()
        if rig.intrinsics_correlation is not None:
            for key, values in zip(
                ("left_correlation", "right_correlation"), rig.intrinsics_correlation, strict=True
            ):
                data["uncertainty"][key] = values.tolist()
    return dump_yaml(data)


def _lists_cameras(path: Path) -> bool:
    return "cameras" in head_of(read_text(path, "rig file")).keys


def _read_cameras(path: Path) -> Rig:
    data = read_layout(path, _CamerasFile, FORMAT, "rig file")
    first = data.cameras[0]
    if first.T_first_camera is not None:
        raise InputError(
            "bad_value", f"{path}: cameras[0].T_first_camera: the first camera is the origin", "remove the key"
        )
    _require_own_clock(path, "cameras[0]", first)
    base = first.T_base_camera
    T_base_left = None if base is None else _pose(path, "cameras[0].T_base_camera", "base", "left", base)
    cameras = []
    for k, camera in enumerate(data.cameras):
        model = _camera(path, f"cameras[{k}]", camera)
        T = Pose.identity("camera", "left") if k == 0 else _from_first(path, k, camera, T_base_left)
        covariance = None if camera.covariance is None else np.array(camera.covariance)
        sigma = None if camera.sigma is None else np.array(camera.sigma)
        correlation = None
        if sigma is not None and camera.correlation is not None:
            correlation = _correlations(path, f"cameras[{k}].correlation", camera.correlation, len(sigma))
        offset_s = camera.time_offset_s
        cameras.append(MountedCamera(camera.name, model, T, covariance, sigma, correlation, offset_s))
    try:
        return Rig(tuple(cameras), T_base_left)
    except ValueError as error:
        raise InputError("bad_value", f"{path}: cameras: {error}", "see docs/formats.md") from None


def _from_first(path: Path, k: int, camera: _MountedCamera, T_base_left: Pose | None) -> Pose:
    """T_camera_left of camera k, from either of its two keys."""
    where = f"cameras[{k}]"
    if (camera.T_first_camera is None) == (camera.T_base_camera is None):
        raise InputError(
            "bad_value", f"{path}: {where}: not exactly one of T_first_camera and T_base_camera", "give one of them"
        )
    if camera.T_first_camera is not None:
        return _pose(path, f"{where}.T_first_camera", "left", "camera", camera.T_first_camera).inverse()
    assert camera.T_base_camera is not None
    if T_base_left is None:
        raise InputError(
            "bad_value", f"{path}: {where}.T_base_camera needs cameras[0].T_base_camera",
            "give T_base_camera of the first camera as well, or T_first_camera",
        )  # fmt: skip
    return _pose(path, f"{where}.T_base_camera", "base", "camera", camera.T_base_camera).inverse() @ T_base_left


def _cameras_to_yaml(rig: Rig) -> str:
    cameras = []
    for k, camera in enumerate(rig.cameras):
        offset = _time_offset(camera.time_offset_s)
        entry: dict[str, Any] = {"name": camera.name, **_camera_dict(camera.model), **offset}
        if k == 0 and rig.T_base_left is not None:
            entry["T_base_camera"] = _pose_dict(rig.T_base_left)
        elif k > 0:
            entry["T_first_camera"] = _pose_dict(camera.T_camera_left.inverse())
        if camera.covariance is not None:
            entry["covariance"] = camera.covariance.tolist()
        if camera.intrinsics_sigma is not None:
            entry["sigma"] = camera.intrinsics_sigma.tolist()
        if camera.intrinsics_correlation is not None:
            entry["correlation"] = camera.intrinsics_correlation.tolist()
        cameras.append(entry)
    return dump_yaml({"format": FORMAT, "cameras": cameras})


def _require_own_clock(path: Path, where: str, camera: _Camera) -> None:
    if camera.time_offset_s != 0.0:
        raise InputError(
            "bad_value", f"{path}: {where}.time_offset_s: the first camera's clock is the rig's",
            "remove the key, and take its value from those of the other cameras",
        )  # fmt: skip


def _time_offset(offset_s: float) -> dict[str, float]:
    return {"time_offset_s": offset_s} if offset_s else {}


def _correlations(path: Path, key: str, rows: list[list[float]], count: int) -> FloatArray:
    if len(rows) != count:
        raise InputError("bad_value", f"{path}: {key}: {len(rows)} rows for {count} standard deviations", "remove it")
    return np.array(rows)


def _pose_dict(pose: Pose) -> dict[str, Any]:
    return {"R": pose.R.tolist(), "t": pose.t.tolist()}


def _camera(path: Path, key: str, data: _Camera) -> CameraModel:
    try:
        return CameraModel(
            (data.image_size[0], data.image_size[1]), np.array(data.K), np.array(data.distortion), data.model
        )
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
