"""Many poses between two frames at once, as arrays."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from lmkit.arrays import FloatArray, IntArray
from lmkit.geometry.pose import Pose
from lmkit.geometry.rotations import orthonormal, rotation_exp, skew


@dataclass(frozen=True, eq=False)
class PoseArray:
    """Transforms T_to_from: ``x_to = R[k] @ x_from + t[k]``.

    Solvers make millions of these, so the rotations are not checked; :meth:`pose` checks one.

    Attributes:
        to_frame, from_frame: names of the two frames.
        R: (N,3,3) rotations.
        t: (N,3) positions of from_frame's origin in to_frame, meters.

    Raises:
        ValueError: R or t has another shape.

    Examples:
        >>> import lmkit
        >>> poses = lmkit.PoseArray.from_poses("map", "base", [lmkit.Pose.identity("map", "base")] * 3)
        >>> len(poses), poses.inverse().to_frame
        (3, 'base')
    """

    to_frame: str
    from_frame: str
    R: FloatArray
    t: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "R", np.asarray(self.R))
        object.__setattr__(self, "t", np.asarray(self.t))
        R, t = self.R.shape, self.t.shape
        if len(t) != 2 or t[1] != 3 or (t[0], 3, 3) != R:
            raise ValueError(f"T_{self.to_frame}_{self.from_frame}: R has shape {R} and t {t}, not (N,3,3) and (N,3)")

    @classmethod
    def from_poses(cls, to_frame: str, from_frame: str, poses: Iterable[Pose]) -> PoseArray:
        """Stack single poses; the frames name the result, also where there is no pose.

        Raises:
            ValueError: a pose is between other frames.
        """
        listed = list(poses)
        for pose in listed:
            if (pose.to_frame, pose.from_frame) != (to_frame, from_frame):
                raise ValueError(f"{pose!r} is not T_{to_frame}_{from_frame}")
        R = np.array([pose.R for pose in listed]).reshape(-1, 3, 3)
        return cls(to_frame, from_frame, R, np.array([pose.t for pose in listed]).reshape(-1, 3))

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        return f"PoseArray({len(self)} x T_{self.to_frame}_{self.from_frame})"

    def only(self, rows: IntArray) -> PoseArray:
        """The poses at some rows."""
        return PoseArray(self.to_frame, self.from_frame, self.R[rows], self.t[rows])

    def pose(self, k: int) -> Pose:
        """Pose ``k``, its rotation made orthonormal."""
        return Pose(self.to_frame, self.from_frame, orthonormal(self.R[k]), self.t[k])

    def inverse(self) -> PoseArray:
        """T_from_to."""
        back = self.R.swapaxes(-1, -2)
        return PoseArray(self.from_frame, self.to_frame, back, -(back @ self.t[..., None])[..., 0])

    def apply(self, points: FloatArray) -> FloatArray:
        """(N,K,3) points of from_frame, given as (K,3) or (N,K,3), in to_frame; meters.

        Raises:
            ValueError: points of another shape.
        """
        try:
            return np.asarray(points @ self.R.swapaxes(-1, -2) + self.t[:, None])
        except (TypeError, ValueError):
            raise ValueError(f"{self!r} takes points of shape (K,3) or (N,K,3), not {np.shape(points)}") from None

    def __matmul__(self, other: Pose | PoseArray) -> PoseArray:
        """Chain T_a_b @ T_b_c = T_a_c, row by row, or each row with one pose.

        Raises:
            ValueError: the inner frames differ.
        """
        if self.from_frame != other.to_frame:
            raise ValueError(
                f"T_{self.to_frame}_{self.from_frame} @ T_{other.to_frame}_{other.from_frame} does not chain"
            )
        t = self.t + (self.R @ other.t[..., None])[..., 0]
        return PoseArray(self.to_frame, other.from_frame, self.R @ other.R, t)

    def retract(self, steps: FloatArray) -> PoseArray:
        """Poses after steps (N,6): a shift (m), and a rotation vector applied on the left (rad), both in to_frame."""
        return PoseArray(self.to_frame, self.from_frame, rotation_exp(steps[:, 3:]) @ self.R, self.t + steps[:, :3])


def moved_covariance(covariance: FloatArray, offset: FloatArray) -> FloatArray:
    """Covariance (...,6,6) of a point of a rigid body, from that of another point of the body.

    Args:
        covariance: (...,6,6) x y z (m), then rotation about x y z (rad).
        offset: (...,3) from the point it is of to the point wanted, in the axes of the covariance, meters.
    """
    J = np.zeros((*np.shape(offset)[:-1], 6, 6))
    J[...] = np.eye(6)
    J[..., :3, 3:] = -skew(offset)
    return np.asarray(J @ covariance @ J.swapaxes(-1, -2))
