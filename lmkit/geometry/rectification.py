"""Rectification of points and images: matching points of the left and right image get the same row."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from lmkit.arrays import ByteArray, FloatArray
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.pose import Pose
from lmkit.geometry.rotations import rotation_exp
from lmkit.geometry.stereo_rig import StereoRig

LINES = (80, 220, 60)  # BGR


@dataclass(frozen=True, eq=False)
class Rectification:
    """Rotations (3,3) and projections (3,4) that make the two images' rows match."""

    R_left: FloatArray
    R_right: FloatArray
    P_left: FloatArray
    P_right: FloatArray

    @property
    def along(self) -> int:
        """0: the right camera is beside the left one, rows match; 1: above or below it, columns match."""
        return 0 if abs(self.P_right[0, 3]) >= abs(self.P_right[1, 3]) else 1

    @property
    def Q(self) -> FloatArray:
        """(4,4) from column, row, disparity, 1 to X Y Z W in the rectified left camera, as OpenCV's stereoRectify."""
        f, cx, cy = self.P_left[0, 0], self.P_left[0, 2], self.P_left[1, 2]
        t = self.P_right[self.along, 3] / f
        off = (self.P_left[self.along, 2] - self.P_right[self.along, 2]) / t
        return np.array([[1.0, 0, 0, -cx], [0, 1.0, 0, -cy], [0, 0, 0, f], [0, 0, -1 / t, off]])


def rectification(rig: StereoRig) -> Rectification:
    """The rectification of a rig (Bouguet's): rows match, or columns if one camera is above the other."""
    left, right, size = rig.left, rig.right, rectified_size(rig)
    if left.lens.is_equidistant or right.lens.is_equidistant:
        return _fisheye_rectification(rig)
    t = rig.T_right_left.t.reshape(3, 1)
    K_left, K_right = _resized(left, size), _resized(right, size)
    R1, R2, P1, P2, *_ = cv2.stereoRectify(
        K_left, left.distortion, K_right, right.distortion, size, rig.T_right_left.R, t, alpha=-1
    )
    return Rectification(*(np.asarray(m, dtype=np.float64) for m in (R1, R2, P1, P2)))


def rectified_size(rig: StereoRig) -> tuple[int, int]:
    """(width, height) of rectified images: that of the camera with the shorter focal length, in pixels."""
    return min((rig.left, rig.right), key=lambda camera: float(camera.K[1, 1])).image_size


def _resized(camera: CameraModel, size: tuple[int, int]) -> FloatArray:
    """(3,3) camera matrix of the camera's images resized to (width, height)."""
    if camera.image_size == size:
        return camera.K
    sx, sy = (new / old for new, old in zip(size, camera.image_size, strict=True))
    middle = np.array([[sx, 0, (sx - 1) / 2], [0, sy, (sy - 1) / 2], [0, 0, 1.0]])
    return middle @ camera.K


def _fisheye_rectification(rig: StereoRig) -> Rectification:
    """Rectification of fisheye cameras; OpenCV's fails on cameras that converge or are above each other."""
    # Each camera turns half of the way to the other, then both turn the baseline into the rows.
    half = rotation_exp(-rig.T_right_left.rvec / 2)
    t = half @ rig.T_right_left.t
    along = int(np.argmax(np.abs(t[:2])))
    axis = np.zeros(3)
    axis[along] = np.copysign(1.0, t[along])
    turn = np.cross(t, axis)
    sine = float(np.linalg.norm(turn) / np.linalg.norm(t))
    turn = turn * (np.arcsin(min(sine, 1.0)) / float(np.linalg.norm(turn)) if sine > 1e-12 else 0.0)
    level = rotation_exp(turn)
    width, height = rectified_size(rig)
    f = min(float(camera.K[k, k]) for camera in (rig.left, rig.right) for k in (0, 1))
    P_left = np.array([[f, 0, (width - 1) / 2, 0], [0, f, (height - 1) / 2, 0], [0, 0, 1.0, 0]])
    P_right = P_left.copy()
    P_right[along, 3] = f * float(axis @ level @ t) * float(axis[along])
    return Rectification(level @ half.T, level @ half, P_left, P_right)


def rectified_rig(rig: StereoRig) -> StereoRig:
    """The rig of the rectified images: no distortion, parallel cameras; its own rectification changes nothing."""
    maps = rectification(rig)
    size = rectified_size(rig)
    left, right = (CameraModel(size, P[:, :3], np.zeros(5)) for P in (maps.P_left, maps.P_right))
    T_right_left = Pose("right", "left", np.eye(3), maps.P_right[:, 3] / maps.P_left[0, 0])
    T_base_left = rig.T_base_left
    if T_base_left is not None:
        T_base_left = Pose("base", "left", T_base_left.R @ maps.R_left.T, T_base_left.t)
    return StereoRig(left, right, T_right_left, T_base_left)


def epipolar_errors(rig: StereoRig, left: FloatArray, right: FloatArray) -> FloatArray:
    """(N,) row differences, px, of matching points (N,2) after rectification.

    Columns instead of rows for cameras above each other.  For fisheye cameras, whose rectified
    images are stretched without bound toward their edges, it is the angle between the two points' epipolar
    planes, in pixels of the original images.  For unequal cameras, pixels are those of the coarser one.
    """
    maps = rectification(rig)
    across = 1 - maps.along
    ray_left, ray_right = _rays(rig.left, left) @ maps.R_left.T, _rays(rig.right, right) @ maps.R_right.T
    if rig.left.lens.is_equidistant or rig.right.lens.is_equidistant:
        planes, reaches = zip(*(_about_baseline(ray, across) for ray in (ray_left, ray_right)), strict=True)
        return np.asarray((planes[0] - planes[1]) * np.sqrt(reaches[0] * reaches[1]) * maps.P_left[0, 0])
    flat_left, flat_right = ray_left @ maps.P_left[:, :3].T, ray_right @ maps.P_right[:, :3].T
    return np.asarray(flat_left[:, across] / flat_left[:, 2] - flat_right[:, across] / flat_right[:, 2])


def _about_baseline(rays: FloatArray, across: int) -> tuple[FloatArray, FloatArray]:
    """Angle of each ray's plane about the baseline, rad, and its distance from the baseline's axis, of length 1."""
    unit = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    return np.arctan2(unit[:, across], unit[:, 2]), np.hypot(unit[:, across], unit[:, 2])


def rectify_pair(rig: StereoRig, left: ByteArray, right: ByteArray) -> tuple[ByteArray, ByteArray]:
    """The two images resampled so that matching points share a row."""
    maps = rectification(rig)
    images, size = [], rectified_size(rig)
    for camera, image, R, P in (
        (rig.left, left, maps.R_left, maps.P_left),
        (rig.right, right, maps.R_right, maps.P_right),
    ):
        x, y = camera.lens.maps(camera.K, camera.distortion, R, P[:, :3], size, cv2.CV_32FC1)
        images.append(np.asarray(cv2.remap(image, x, y, cv2.INTER_LINEAR), dtype=np.uint8))
    return images[0], images[1]


def with_lines_across(left: ByteArray, right: ByteArray, along: int = 0, step_px: int = 40) -> ByteArray:
    """A rectified pair in one image, with lines on which matching points lie.

    Args:
        along: 0: rows match, the images are side by side; 1: columns match, one image is above the other.
    """
    both = np.hstack([left, right]) if along == 0 else np.vstack([left, right])
    height, width = both.shape[:2]
    for at in range(step_px // 2, height if along == 0 else width, step_px):
        start, end = ((0, at), (width, at)) if along == 0 else ((at, 0), (at, height))
        cv2.line(both, start, end, LINES, 1)
    return np.asarray(both, dtype=np.uint8)


def _rays(camera: CameraModel, points: FloatArray) -> FloatArray:
    return np.column_stack([camera.unproject(points), np.ones(len(points))])
