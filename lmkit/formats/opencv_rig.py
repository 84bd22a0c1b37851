"""Rigs as OpenCV's own YAML: M1 D1 M2 D2 R T R1 R2 P1 P2 Q, as its stereo_calib sample names them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from lmkit.arrays import FloatArray
from lmkit.errors import InputError
from lmkit.formats.document import read_text
from lmkit.model.camera import CameraModel
from lmkit.model.pose import Pose, orthonormal
from lmkit.model.rectification import rectification
from lmkit.model.stereo_rig import StereoRig

# Other names that people's own scripts give the same matrices.
_NAMES = {
    "M1": ("M1", "K1", "cameraMatrix1", "camera_matrix_left"),
    "M2": ("M2", "K2", "cameraMatrix2", "camera_matrix_right"),
    "D1": ("D1", "distCoeffs1", "dist1"),
    "D2": ("D2", "distCoeffs2", "dist2"),
    "R": ("R",),
    "T": ("T", "t"),
}
_MODEL_OF_COUNT = {0: "pinhole", 4: "pinhole", 5: "pinhole", 8: "rational", 12: "rational", 14: "rational"}


def rig_to_opencv_yaml(rig: StereoRig) -> str:
    """The text of the file; lengths in metres.  ``model`` is there since fisheye has four coefficients as well."""
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


def read_opencv_rig(path: Path) -> StereoRig:
    """A rig from OpenCV's YAML.

    Raises:
        InputError: not readable, a matrix or the picture size is missing, or a matrix is of the wrong shape.
    """
    text = read_text(path, "OpenCV rig file")
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    except (cv2.error, SystemError):
        raise InputError("bad_opencv", f"{path}: OpenCV cannot read it", "write it with cv2.FileStorage") from None
    found = {name: _matrix(storage, names) for name, names in _NAMES.items()}
    missing = [name for name, matrix in found.items() if matrix is None]
    size = (int(storage.getNode("image_width").real()), int(storage.getNode("image_height").real()))
    if min(size) < 1:
        missing.append("image_width and image_height")
    if missing:
        raise InputError("bad_opencv", f"{path}: {', '.join(missing)} missing", "add them (M1 D1 M2 D2 R T, size)")
    stated = storage.getNode("model").string()
    try:
        M1, D1, M2, D2, R, T = (_doubles(found[name]) for name in ("M1", "D1", "M2", "D2", "R", "T"))
        cameras = [
            CameraModel(size, M, D.ravel(), stated or _MODEL_OF_COUNT.get(D.size, "?"))
            for M, D in ((M1, D1), (M2, D2))
        ]
        # Files of few digits hold almost-rotations.
        R = orthonormal(R) if R.shape == (3, 3) and np.abs(R @ R.T - np.eye(3)).max() < 1e-3 else R
        return StereoRig(cameras[0], cameras[1], Pose("right", "left", R, T.ravel()))
    except ValueError as error:
        raise InputError("bad_opencv", f"{path}: {error}", "see docs/formats.md") from None


def _doubles(matrix: FloatArray | None) -> FloatArray:
    return np.asarray(matrix, dtype=np.float64)


def _matrix(storage: cv2.FileStorage, names: tuple[str, ...]) -> FloatArray | None:
    for name in names:
        node = storage.getNode(name)
        if not node.empty():
            matrix = node.mat()
            return None if matrix is None else np.asarray(matrix, dtype=np.float64)
    return None
