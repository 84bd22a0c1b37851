"""Uncertainty of projected pixels and of depth, from the covariance of a calibration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.calibration.board_equations import POSE
from lmkit.calibration.bundle_adjustment import Solution
from lmkit.calibration.intrinsics import intrinsics_vector
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.rotations import skew

DEPTHS_M = (1.0, 2.0, 4.0, 8.0)
NEAR_M = 1.0
MATCHING_PX = 0.1  # standard deviation of a matched corner, in each camera


@dataclass(frozen=True)
class DepthError:
    """Standard deviations of the depth of a point at the center of what both cameras see.

    Attributes:
        depth_m: of the point.
        calibration_m: from what is not known of the rig.
        total_m: with pixels matched to ``MATCHING_PX`` besides.
    """

    depth_m: float
    calibration_m: float
    total_m: float


def projection_uncertainty(
    camera: CameraModel, covariance: FloatArray, depth_m: float | None, columns: int = 16, rows: int = 12
) -> FloatArray:
    """(rows,columns) standard deviation, px, of where a point projects, over the image; NaN beyond the lens model.

    A camera's own pose is free: what a small turn (and for near points a shift) of the camera can make up for is no
    error of the intrinsics (after mrcal's projection uncertainty, Kogan 2021).

    Args:
        covariance: of fx fy cx cy and the distortion.
        depth_m: distance of the points; None for far away.
    """
    width, height = camera.image_size
    u, v = np.meshgrid(
        (np.arange(columns) + 0.5) / columns * width - 0.5, (np.arange(rows) + 0.5) / rows * height - 0.5
    )
    pixels = np.column_stack([u.ravel(), v.ravel()])
    reached = camera.reaches(pixels)
    rays = camera.unproject(pixels[reached])
    points = np.column_stack([rays, np.ones(len(rays))]) * (depth_m or 1.0)
    _, by_point, by_camera = camera.project_with_jacobian(points)
    by_turn = np.cross(points[:, None, :], by_point)
    by_pose = by_turn if depth_m is None else np.concatenate([by_turn, by_point], axis=2)
    flat_pose, flat_camera = by_pose.reshape(2 * len(points), -1), by_camera.reshape(2 * len(points), -1)
    made_up = flat_pose @ np.linalg.lstsq(flat_pose, flat_camera, rcond=None)[0]
    J = (flat_camera - made_up).reshape(len(points), 2, -1)
    variance = np.einsum("nia,ab,nib->n", J, covariance, J) / 2
    deviation = np.full(rows * columns, np.nan)
    deviation[reached] = np.sqrt(np.maximum(variance, 0))
    return deviation.reshape(rows, columns)


def depth_errors(s: Solution, depths_m: tuple[float, ...] = DEPTHS_M) -> tuple[DepthError, ...]:
    """Depth errors of the rig, straight ahead between its optical axes; see :class:`DepthError`."""
    assert s.covariance is not None
    nl, nr = len(intrinsics_vector(s.left)), len(intrinsics_vector(s.right))
    shared = s.covariance[: nl + nr + POSE, : nl + nr + POSE]
    errors = []
    for depth in depths_m:
        point = _in_both_middles(s, depth)
        in_right = s.R @ point + s.t
        _, left_by_point, by_left = s.left.project_with_jacobian(point[None])
        _, right_by_point, by_right = s.right.project_with_jacobian(in_right[None])
        by_point = np.concatenate([left_by_point[0], right_by_point[0] @ s.R])
        by_shared = np.zeros((4, nl + nr + POSE))
        by_shared[:2, :nl] = by_left[0]
        by_shared[2:, nl : nl + nr] = by_right[0]
        by_shared[2:, nl + nr :] = right_by_point[0] @ np.concatenate([-skew(s.R @ point), np.eye(3)], axis=1)
        # The point that explains the same four pixels moves so with what is known of the rig.
        back = np.linalg.pinv(by_point)
        from_rig, from_pixels = back @ by_shared, back * MATCHING_PX
        calibration = from_rig[2] @ shared @ from_rig[2]
        total = calibration + from_pixels[2] @ from_pixels[2]
        errors.append(DepthError(depth, float(np.sqrt(calibration)), float(np.sqrt(total))))
    return tuple(errors)


def _in_both_middles(s: Solution, depth: float) -> FloatArray:
    """(3,) the point at this depth of the left camera, half way between what the two cameras have at the center."""
    middles = [(np.array([camera.image_size]) - 1) / 2 for camera in (s.left, s.right)]
    left = np.append(s.left.unproject(middles[0])[0], 1.0) * depth
    ray = s.R.T @ np.append(s.right.unproject(middles[1])[0], 1.0)
    right_center = -s.R.T @ s.t
    right = right_center + ray * (depth - right_center[2]) / ray[2] if ray[2] > 0.1 else left
    return np.asarray((left + right) / 2)
