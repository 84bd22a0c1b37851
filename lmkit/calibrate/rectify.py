"""Rectification: rows of the left and right picture made to match."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from lmkit.arrays import ByteArray, FloatArray
from lmkit.model.camera import CameraModel
from lmkit.model.stereo_rig import StereoRig


@dataclass(frozen=True, eq=False)
class Rectification:
    """Rotations (3,3) and projections (3,4) that make the two pictures' rows match."""

    R_left: FloatArray
    R_right: FloatArray
    P_left: FloatArray
    P_right: FloatArray


def rectification(rig: StereoRig) -> Rectification:
    """The rectification of a rig (Bouguet's, as OpenCV has it)."""
    left, right = rig.left, rig.right
    R, t = rig.T_right_left.R, rig.T_right_left.t.reshape(3, 1)
    if left.model == "fisheye":
        R1, R2, P1, P2, _ = cv2.fisheye.stereoRectify(
            left.K,
            left.distortion,
            right.K,
            right.distortion,
            left.image_size,
            R,
            t,
            cv2.CALIB_ZERO_DISPARITY,
        )
    else:
        R1, R2, P1, P2, *_ = cv2.stereoRectify(
            left.K, left.distortion, right.K, right.distortion, left.image_size, R, t, alpha=-1
        )
    return Rectification(*(np.asarray(m, dtype=np.float64) for m in (R1, R2, P1, P2)))


def epipolar_errors(rig: StereoRig, left: FloatArray, right: FloatArray) -> FloatArray:
    """(N,) row differences, px, of matching points (N,2) after rectification.

    Columns instead of rows for eyes that stand above each other.
    """
    maps = rectification(rig)
    across = 1 if abs(maps.P_right[0, 3]) >= abs(maps.P_right[1, 3]) else 0
    flat_left = _rectify_points(rig.left, left, maps.R_left, maps.P_left)
    flat_right = _rectify_points(rig.right, right, maps.R_right, maps.P_right)
    return np.asarray(flat_left[:, across] - flat_right[:, across])


def rectify_pair(rig: StereoRig, left: ByteArray, right: ByteArray) -> tuple[ByteArray, ByteArray]:
    """The two pictures resampled so that matching points share a row."""
    maps = rectification(rig)
    pictures = []
    for camera, image, R, P in (
        (rig.left, left, maps.R_left, maps.P_left),
        (rig.right, right, maps.R_right, maps.P_right),
    ):
        make = cv2.fisheye.initUndistortRectifyMap if camera.model == "fisheye" else cv2.initUndistortRectifyMap
        x, y = make(camera.K, camera.distortion, R, P[:, :3], camera.image_size, cv2.CV_32FC1)
        pictures.append(np.asarray(cv2.remap(image, x, y, cv2.INTER_LINEAR), dtype=np.uint8))
    return pictures[0], pictures[1]


def _rectify_points(camera: CameraModel, points: FloatArray, R: FloatArray, P: FloatArray) -> FloatArray:
    rays = np.column_stack([camera.unproject(points), np.ones(len(points))]) @ R.T
    flat = rays @ P[:, :3].T
    return np.asarray(flat[:, :2] / flat[:, 2:])
