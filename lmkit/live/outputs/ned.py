"""Poses and covariances in the frames of autopilots: north, east, down; forward, right, down."""

from __future__ import annotations

import math

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.geometry.pose import Pose

NED_FROM_MAP = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # x = y_map, y = x_map, z = -z_map
FLU_FROM_FRD = np.diag([1.0, -1.0, -1.0])
STEEP = 0.999  # sine of the pitch beyond which roll and yaw cannot be separated


def ned_pose(T_map_base: Pose) -> tuple[FloatArray, FloatArray]:
    """(3,) position in NED, m, and (3,3) rotation from FRD to NED.

    Examples:
        >>> import numpy as np
        >>> from lmkit.geometry.planar import planar_pose
        >>> position, R = ned_pose(planar_pose(np.array([1.0, 2.0, 0.0])))
        >>> position.tolist()
        [2.0, 1.0, 0.0]
        >>> round(float(roll_pitch_yaw(R)[2]), 4)
        1.5708
    """
    return NED_FROM_MAP @ T_map_base.t, NED_FROM_MAP @ T_map_base.R @ FLU_FROM_FRD


def roll_pitch_yaw(R: FloatArray) -> FloatArray:
    """(3,) roll, pitch, yaw (rad) of R = Rz(yaw) Ry(pitch) Rx(roll)."""
    pitch = math.asin(min(max(-float(R[2, 0]), -1.0), 1.0))
    if abs(R[2, 0]) > STEEP:
        return np.array([0.0, pitch, math.atan2(-R[0, 1], R[1, 1])])
    return np.array([math.atan2(R[2, 1], R[2, 2]), pitch, math.atan2(R[1, 0], R[0, 0])])


def ned_covariance(C: FloatArray, rpy: FloatArray) -> FloatArray:
    """(6,6) covariance of north, east, down (m), roll, pitch, yaw (rad), from x y z and rotations in the map."""
    pitch, yaw = float(rpy[1]), float(rpy[2])
    # Columns: rotations about the axes of NED by a change of roll, pitch and yaw.
    axes = np.array(
        [
            [math.cos(yaw) * math.cos(pitch), -math.sin(yaw), 0.0],
            [math.sin(yaw) * math.cos(pitch), math.cos(yaw), 0.0],
            [-math.sin(pitch), 0.0, 1.0],
        ]
    )
    J = np.zeros((6, 6))
    J[:3, :3] = NED_FROM_MAP
    J[3:, 3:] = np.linalg.pinv(axes, rcond=1e-3) @ NED_FROM_MAP
    return np.asarray(J @ C @ J.T)


def upper_triangle(C: FloatArray) -> list[float]:
    """21 numbers of a symmetric (6,6): the upper triangle, row by row."""
    return [float(v) for v in C[np.triu_indices(6)]]
