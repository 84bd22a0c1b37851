"""Whitened reprojection errors of landmark corners, with derivatives, for many poses at once.

Corners are compared as rays x/z, y/z without distortion; ``whitener`` carries the lens and the corners' covariance.
"""

from __future__ import annotations

import ctypes
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.load import address, contiguous, function

Array = NDArray[np.float64]

NEAREST_M = 0.02  # corners nearer than that, or behind the camera, are not seen
NOWHERE = 1e2  # error as x/z of a landmark that is not seen


class Corners(NamedTuple):
    """S observed landmarks, whatever the pose.

    Attributes:
        points: (S,4,3) corners in the map, metres.
        rays: (S,4,2) observed corners as x/z, y/z in the camera that saw them.
        whitener: (S,8,8) from errors of rays to standard deviations.
        R_camera, t_camera: (S,3,3), (S,3): x_camera = R_camera x_rig + t_camera.
        arms: (S,4,3) from the landmark's centre to its corners, in the map; empty where no landmark moves.
    """

    points: Array
    rays: Array
    whitener: Array
    R_camera: Array
    t_camera: Array
    arms: Array

    @classmethod
    def of(cls, *arrays: Any) -> Corners:
        """Contiguous double arrays of consistent shapes.

        Raises:
            ValueError: a shape differs.
        """
        points = contiguous(arrays[0], (-1, 4, 3))
        count = len(points)
        shapes = ((count, 4, 2), (count, 8, 8), (count, 3, 3), (count, 3))
        rays, whitener, R, t = (contiguous(array, shape) for array, shape in zip(arrays[1:5], shapes, strict=True))
        arms = contiguous(arrays[5], (-1, 4, 3)) if len(arrays) > 5 else np.zeros((0, 4, 3))
        if len(arms) not in (0, count):
            raise ValueError(f"{len(arms)} arms for {count} landmarks")
        return cls(points, rays, whitener, R, t, arms)


class Errors(NamedTuple):
    """Residuals (H,S,8), and (H,S,8,6) derivatives of the expected corners' with a shift (m) and a turn (rad), both
    along the map's axes, of the rig and of the landmark; None where not asked for."""

    residuals: Array
    by_pose: Array | None
    by_landmark: Array | None


def reprojection_errors(corners: Corners, R: Array, p: Array, by_pose: bool, by_landmark: bool) -> Errors:
    """Observed minus expected corners in standard deviations, for H rig poses T_map_rig: R (H,3,3), p (H,3).

    Derivatives are those of the expected corners.  A landmark with a corner behind its camera has huge residuals.

    Raises:
        ValueError: a shape differs, or ``by_landmark`` without arms.
    """
    R = contiguous(R, (-1, 3, 3))
    p = contiguous(p, (len(R), 3))
    if by_landmark and len(corners.arms) != len(corners.points):
        raise ValueError("derivatives with landmarks need their arms")
    kernel = _kernel()
    if kernel is None:
        return reprojection_errors_numpy(corners, R, p, by_pose, by_landmark)
    shape = (len(R), len(corners.points), 8)
    residuals = np.empty(shape)
    J = np.empty((*shape, 6)) if by_pose else None
    K = np.empty((*shape, 6)) if by_landmark else None
    kernel(
        len(R),
        len(corners.points),
        address(corners.points),
        address(corners.arms),
        address(corners.R_camera),
        address(corners.t_camera),
        address(corners.rays),
        address(corners.whitener),
        address(R),
        address(p),
        NEAREST_M,
        NOWHERE,
        address(residuals),
        None if J is None else address(J),
        None if K is None else address(K),
    )
    return Errors(residuals, J, K)


def reprojection_errors_numpy(corners: Corners, R: Array, p: Array, by_pose: bool, by_landmark: bool) -> Errors:
    """Definition of :func:`reprojection_errors`."""
    offset = corners.points - p[:, None, None]
    R_camera_map = corners.R_camera @ R.transpose(0, 2, 1)[:, None]
    seen = offset @ R_camera_map.swapaxes(-1, -2) + corners.t_camera[:, None]
    depth = np.maximum(seen[..., 2:], NEAREST_M)
    expected = seen[..., :2] / depth
    errors = (corners.rays - expected).reshape(len(R), len(corners.points), 8)
    errors[(seen[..., 2] < NEAREST_M).any(axis=-1)] = NOWHERE
    residuals = (corners.whitener @ errors[..., None])[..., 0]
    across, along = R_camera_map[..., None, :2, :], R_camera_map[..., None, 2:, :]
    by_point = (across - expected[..., None] * along) / depth[..., None]  # (H,S,4,2,3)
    J = corners.whitener @ _eight(-by_point, np.cross(by_point, offset[..., None, :])) if by_pose else None
    K = None
    if by_landmark:
        K = corners.whitener @ _eight(by_point, -np.cross(by_point, corners.arms[..., None, :]))
    return Errors(residuals, J, K)


def _eight(by_shift: Array, by_turn: Array) -> Array:
    J = np.concatenate([by_shift, by_turn], axis=-1)
    return J.reshape(*J.shape[:-3], 8, 6)


@lru_cache(maxsize=1)
def _kernel() -> Any:
    pointer, count, number = ctypes.c_void_p, ctypes.c_int64, ctypes.c_double
    return function("lmkit_reprojection", count, count, *[pointer] * 8, number, number, *[pointer] * 3)
