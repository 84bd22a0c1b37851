"""Rigid transforms; neighboring frame names must agree: ``T_map_camera @ T_camera_landmark``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lmkit.arrays import FloatArray, frozen
from lmkit.geometry.rotations import (
    is_rotation,
    matrix_to_quaternion,
    orthonormal,
    quaternion_to_matrix,
    rotation_exp,
    rotation_log,
)


@dataclass(frozen=True, eq=False)
class Pose:
    """The transform T_to_from: ``x_to = R @ x_from + t``.

    Attributes:
        to_frame, from_frame: names of the two frames.
        R: (3,3) rotation.
        t: (3,) position of from_frame's origin in to_frame, meters.

    Raises:
        ValueError: R is no rotation (to 1e-6), or a shape is wrong.

    Examples:
        >>> import lmkit
        >>> T_map_base = lmkit.Pose("map", "base", [[0, -1, 0], [1, 0, 0], [0, 0, 1]], [2.0, 1.0, 0.0])
        >>> T_base_left = lmkit.Pose.from_quaternion("base", "left", [0.1, 0.0, 0.3], [0, 0, 0, 1])
        >>> (T_map_base @ T_base_left).t.tolist()
        [2.0, 1.1, 0.3]
        >>> T_map_base.apply([[1.0, 0.0, 0.0]]).tolist()
        [[2.0, 2.0, 0.0]]
    """

    to_frame: str
    from_frame: str
    R: FloatArray
    t: FloatArray

    def __post_init__(self) -> None:
        R = frozen(self.R, (3, 3), "R")
        if not is_rotation(R):
            raise ValueError(f"R of T_{self.to_frame}_{self.from_frame} is not a rotation matrix")
        object.__setattr__(self, "R", R)
        object.__setattr__(self, "t", frozen(self.t, (3,), "t"))

    @classmethod
    def identity(cls, to_frame: str, from_frame: str) -> Pose:
        """The two frames coincide."""
        return cls(to_frame, from_frame, np.eye(3), np.zeros(3))

    @classmethod
    def from_matrix(cls, to_frame: str, from_frame: str, matrix: ArrayLike) -> Pose:
        """From a (4,4) homogeneous matrix.

        Raises:
            ValueError: another shape, a last row other than 0 0 0 1, or no rotation.
        """
        T = frozen(matrix, (4, 4), "matrix")
        if np.abs(T[3] - [0.0, 0.0, 0.0, 1.0]).max() > 1e-9:
            raise ValueError("the last row of a homogeneous matrix must be 0 0 0 1")
        return cls(to_frame, from_frame, T[:3, :3], T[:3, 3])

    @property
    def matrix(self) -> FloatArray:
        """(4,4) homogeneous matrix: ``x_to = matrix @ [*x_from, 1]``."""
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = self.R, self.t
        return T

    @classmethod
    def from_quaternion(
        cls, to_frame: str, from_frame: str, position: Sequence[float], quaternion_xyzw: Sequence[float]
    ) -> Pose:
        """From a position in meters and a quaternion x y z w, normalized here.

        Raises:
            ValueError: the quaternion is further than 1e-2 from unit length, or does not have four numbers.
        """
        q = np.asarray(quaternion_xyzw, dtype=np.float64)
        norm = float(np.linalg.norm(q))
        if q.shape != (4,):
            raise ValueError(f"quaternion has shape {q.shape}, expected (4,): x y z w, after the position")
        if not abs(norm - 1) <= 1e-2:
            raise ValueError(f"quaternion {list(quaternion_xyzw)} has length {norm:.4g}, expected 1")
        return cls(to_frame, from_frame, quaternion_to_matrix(q / norm), np.asarray(position, dtype=np.float64))

    @classmethod
    def from_rvec(cls, to_frame: str, from_frame: str, rvec: FloatArray, t: FloatArray) -> Pose:
        """From a rotation vector (axis times angle, rad) and a translation in meters."""
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
        """(..., 3) points of from_frame, in to_frame; meters.

        Raises:
            ValueError: points of another shape.
        """
        try:
            return np.asarray(points @ self.R.T + self.t)
        except (TypeError, ValueError):
            raise ValueError(
                f"T_{self.to_frame}_{self.from_frame} takes points of shape (..., 3), not {np.shape(points)}"
            ) from None

    def __matmul__(self, other: Pose) -> Pose:
        """Chain T_a_b @ T_b_c = T_a_c.

        Raises:
            TypeError: the right one is no Pose.
            ValueError: the inner frames differ.
        """
        if not isinstance(other, Pose):
            raise TypeError(
                f"T_{self.to_frame}_{self.from_frame} chains with a Pose, not with {type(other).__name__}: "
                "move points with Pose.apply, make a Pose of a matrix with Pose.from_matrix"
            )
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


def require_frames(pose: Pose, to_frame: str, from_frame: str) -> None:
    """Refuse a pose between other frames.

    Raises:
        TypeError: it is no Pose.
        ValueError: it joins other frames.
    """
    name = f"T_{to_frame}_{from_frame}"
    if not isinstance(pose, Pose):
        raise TypeError(f"{name} must be a Pose, not {type(pose).__name__}; see Pose.from_matrix")
    if (pose.to_frame, pose.from_frame) != (to_frame, from_frame):
        raise ValueError(f"{name} joins the wrong frames: {pose!r}")
