"""Rigid transforms whose names and ends chain by eye: ``T_map_camera @ T_camera_landmark``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lmkit.arrays import FloatArray, frozen


@dataclass(frozen=True, eq=False)
class Pose:
    """The transform T_to_from: ``x_to = R @ x_from + t``.

    Attributes:
        to_frame, from_frame: names of the two frames.
        R: (3,3) rotation.
        t: (3,) position of from_frame's origin in to_frame, metres.

    Raises:
        ValueError: R is no rotation (to 1e-6), or a shape is wrong.
    """

    to_frame: str
    from_frame: str
    R: FloatArray
    t: FloatArray

    def __post_init__(self) -> None:
        R = frozen(self.R, (3, 3), "R")
        if np.abs(R @ R.T - np.eye(3)).max() > 1e-6 or np.linalg.det(R) < 0:
            raise ValueError(f"R of T_{self.to_frame}_{self.from_frame} is not a rotation matrix")
        object.__setattr__(self, "R", R)
        object.__setattr__(self, "t", frozen(self.t, (3,), "t"))

    @classmethod
    def identity(cls, to_frame: str, from_frame: str) -> Pose:
        """The two frames coincide."""
        return cls(to_frame, from_frame, np.eye(3), np.zeros(3))

    @classmethod
    def from_quaternion(
        cls, to_frame: str, from_frame: str, position: Sequence[float], quaternion_xyzw: Sequence[float]
    ) -> Pose:
        """From a position in metres and a quaternion x y z w, normalised here.

        Raises:
            ValueError: the quaternion is further than 1e-2 from unit length.
        """
        q = np.asarray(quaternion_xyzw, dtype=np.float64)
        norm = float(np.linalg.norm(q))
        if q.shape != (4,) or not abs(norm - 1) <= 1e-2:
            raise ValueError(f"quaternion {list(quaternion_xyzw)} has length {norm:.4g}, expected 1")
        return cls(to_frame, from_frame, quaternion_to_matrix(q / norm), np.asarray(position, dtype=np.float64))

    @classmethod
    def from_rvec(cls, to_frame: str, from_frame: str, rvec: FloatArray, t: FloatArray) -> Pose:
        """From a rotation vector (axis times angle, rad) and a translation in metres."""
        return cls(to_frame, from_frame, rotation_exp(np.ravel(rvec)), np.ravel(t))

    @property
    def quaternion_xyzw(self) -> FloatArray:
        """(4,) unit quaternion x y z w with w >= 0."""
        return matrix_to_quaternion(self.R)

    @property
    def rvec(self) -> FloatArray:
        """(3,) rotation vector, rad."""
        return rotation_log(self.R)

    def inverse(self) -> Pose:
        """T_from_to."""
        return Pose(self.from_frame, self.to_frame, self.R.T, -self.R.T @ self.t)

    def apply(self, points: FloatArray) -> FloatArray:
        """(..., 3) points of from_frame, in to_frame; metres."""
        return np.asarray(points @ self.R.T + self.t)

    def __matmul__(self, other: Pose) -> Pose:
        """Chain T_a_b @ T_b_c = T_a_c.

        Raises:
            ValueError: the inner frames differ.
        """
        if self.from_frame != other.to_frame:
            raise ValueError(
                f"T_{self.to_frame}_{self.from_frame} @ T_{other.to_frame}_{other.from_frame} does not chain: "
                f"the left one takes points of {self.from_frame!r}, the right one gives {other.to_frame!r}; "
                "invert one of them or name the frames alike"
            )
        return Pose(self.to_frame, other.from_frame, orthonormal(self.R @ other.R), self.R @ other.t + self.t)

    def __repr__(self) -> str:
        t = ", ".join(f"{v:.4f}" for v in self.t)
        q = ", ".join(f"{v:.4f}" for v in self.quaternion_xyzw)
        return f"Pose(T_{self.to_frame}_{self.from_frame}, t=[{t}], q_xyzw=[{q}])"


def planar_pose(state: FloatArray) -> Pose:
    """T_map_base of a robot on a level floor, of its x, y (m) and heading (rad, from x towards y)."""
    return Pose.from_rvec("map", "base", np.array([0.0, 0.0, state[2]]), np.array([state[0], state[1], 0.0]))


def skew(v: FloatArray) -> FloatArray:
    """(3,3) matrix with ``skew(v) @ w == cross(v, w)``."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def rotation_exp(rvec: FloatArray) -> FloatArray:
    """(3,3) rotation of a rotation vector (Rodrigues' formula)."""
    angle = float(np.linalg.norm(rvec))
    W = skew(rvec)
    if angle < 1e-8:
        return orthonormal(np.eye(3) + W)
    return np.asarray(np.eye(3) + np.sin(angle) / angle * W + (1 - np.cos(angle)) / angle**2 * (W @ W))


def rotation_log(R: FloatArray) -> FloatArray:
    """(3,) rotation vector of a rotation, the inverse of :func:`rotation_exp`; angle in 0..pi."""
    q = matrix_to_quaternion(R)
    length = float(np.linalg.norm(q[:3]))
    if length < 1e-12:
        return 2 * q[:3]
    return np.asarray(q[:3] * (2 * np.arctan2(length, q[3]) / length))


def rotation_angle(R: FloatArray) -> float:
    """Angle of a rotation, rad, 0..pi."""
    return float(np.linalg.norm(rotation_log(R)))


def quaternion_to_matrix(q: FloatArray) -> FloatArray:
    """(3,3) rotation of a unit quaternion x y z w."""
    v, w = q[:3], q[3]
    return np.asarray((w * w - v @ v) * np.eye(3) + 2 * np.outer(v, v) + 2 * w * skew(v))


def matrix_to_quaternion(R: FloatArray) -> FloatArray:
    """(4,) unit quaternion x y z w with w >= 0, by the largest of the four (Shepperd 1978)."""
    trace = np.trace(R)
    squares = np.array([1 + 2 * R[0, 0] - trace, 1 + 2 * R[1, 1] - trace, 1 + 2 * R[2, 2] - trace, 1 + trace])
    # Row k of this symmetric matrix is 4 q_k q.
    products = np.array(
        [
            [squares[0], R[0, 1] + R[1, 0], R[0, 2] + R[2, 0], R[2, 1] - R[1, 2]],
            [R[0, 1] + R[1, 0], squares[1], R[1, 2] + R[2, 1], R[0, 2] - R[2, 0]],
            [R[0, 2] + R[2, 0], R[1, 2] + R[2, 1], squares[2], R[1, 0] - R[0, 1]],
            [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], squares[3]],
        ]
    )
    q = products[int(np.argmax(squares))]
    q = q / np.linalg.norm(q)
    return np.asarray(-q if q[3] < 0 else q)


def orthonormal(R: FloatArray) -> FloatArray:
    """The rotation nearest to an almost-rotation, so that long chains do not drift."""
    U, _, Vt = np.linalg.svd(R)
    return np.asarray(U @ Vt)
