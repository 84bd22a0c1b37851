"""A trajectory: poses with times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lmkit.arrays import FloatArray, IntArray, frozen
from lmkit.geometry.pose import Pose
from lmkit.geometry.rotations import quaternion_to_matrix

UNIT_WITHIN = 1e-2  # of the length of a quaternion, as in `Pose.from_quaternion`


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses of one thing in one frame, in the order of time.

    Attributes:
        times_s: (N,) seconds, increasing.
        positions: (N,3) meters.
        quaternions: (N,4) x y z w of unit length.

    Raises:
        ValueError: another shape, values that are not finite, times that fall, or quaternions not of unit length.

    Examples:
        >>> import lmkit
        >>> lmkit.Trajectory([0.0, 0.5], [[0, 0, 0], [0.2, 0, 0]], [[0, 0, 0, 1], [0, 0, 0, 1]])
        Trajectory(2 poses, 0.5 s)
    """

    times_s: FloatArray
    positions: FloatArray
    quaternions: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "times_s", frozen(self.times_s, (-1,), "times_s"))
        count = len(self.times_s)
        object.__setattr__(self, "positions", frozen(self.positions, (count, 3), "positions"))
        object.__setattr__(self, "quaternions", frozen(self.quaternions, (count, 4), "quaternions"))
        if (falls := np.flatnonzero(np.diff(self.times_s) < 0)).size:
            raise ValueError(f"times_s of a trajectory fall after row {falls[0]}: sort the rows by time")
        lengths = np.linalg.norm(self.quaternions, axis=1)
        if (off := np.flatnonzero(np.abs(lengths - 1) > UNIT_WITHIN)).size:
            raise ValueError(f"the quaternion of row {off[0]} has length {lengths[off[0]]:.3g}, not 1")

    def __len__(self) -> int:
        return len(self.times_s)

    def __repr__(self) -> str:
        seconds = float(np.ptp(self.times_s)) if len(self) else 0.0
        return f"Trajectory({len(self)} poses, {seconds:.1f} s)"

    @property
    def rotations(self) -> FloatArray:
        """(N,3,3)."""
        return quaternion_to_matrix(self.quaternions)

    def pose(self, k: int, to_frame: str, from_frame: str) -> Pose:
        """One of the poses."""
        R = quaternion_to_matrix(self.quaternions[k])
        return Pose(to_frame, from_frame, R, self.positions[k])

    def rows(self, rows: IntArray) -> Trajectory:
        """Some of the poses."""
        return Trajectory(self.times_s[rows], self.positions[rows], self.quaternions[rows])

    def shifted(self, seconds: float) -> Trajectory:
        """Poses with times of another clock."""
        return Trajectory(self.times_s + seconds, self.positions, self.quaternions)

    def moved(self, R: FloatArray, t: FloatArray, scale: float = 1.0) -> Trajectory:
        """In another frame: x -> scale R x + t."""
        from scipy.spatial.transform import Rotation  # takes a quarter of a second to load

        turned = (Rotation.from_matrix(R) * Rotation.from_quat(self.quaternions)).as_quat()
        return Trajectory(self.times_s, scale * self.positions @ R.T + t, turned)
