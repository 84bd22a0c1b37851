"""The result of tracking: poses over time with covariances, outliers and innovations."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.geometry.pose import Pose
from lmkit.geometry.stereo_rig import ahead_of
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.pose_status import PoseStatus

PARAMETER_WORDS = {
    "forward_scale": "distance scale (true / measured)",
    "turn_scale": "rotation scale (true / measured)",
    "turn_per_s": "yaw drift, rad/s",
    "turn_per_m": "yaw drift, rad/m",
    "slowing_s": "distance lost while turning, share per rad/s",
    "delay_s": "delay of the images after the odometry, s",
    "scale": "distance scale (true / measured)",
}


@dataclass(frozen=True, eq=False, repr=False)
class TrackedTrajectory:
    """The robot at every frame.

    Attributes:
        times_s: (N,).
        poses: of the base where there is one, else of the left camera.
        covariances: (N,6,6) x y z (m), rotation about x y z (rad), in the map.
        statuses: ``ok``, ``ambiguous``, ``inconsistent`` or ``lost``.
        outliers: landmarks that were rejected, of every pose.
        parameters: estimated errors of the odometry, by name.
        of_base: the poses look along x, not along z.
        remarks: warnings for the user.
        nis: (N,2) of what was believed at every frame: the sum of its squared errors, in standard
            deviations, and how many numbers that is of.  Live they are those of the prediction, else what is left
            once the recording is solved.
        parameter_sigmas: standard deviations of the parameters, by name; none where they are not computed.
    """

    times_s: FloatArray
    poses: Sequence[Pose]
    covariances: FloatArray
    statuses: Sequence[PoseStatus]
    outliers: Sequence[tuple[LandmarkId, ...]]
    parameters: dict[str, float] = field(default_factory=dict)
    of_base: bool = True
    remarks: tuple[str, ...] = ()
    nis: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    parameter_sigmas: dict[str, float] = field(default_factory=dict)

    @property
    def positions(self) -> FloatArray:
        """(N,3) meters, in the map."""
        return np.array([pose.t for pose in self.poses]).reshape(-1, 3)

    def __len__(self) -> int:
        return len(self.times_s)

    def __repr__(self) -> str:
        counts = ", ".join(f"{count} {status}" for status, count in Counter(map(str, self.statuses)).items())
        return f"TrackedTrajectory({len(self)} poses: {counts})"

    @property
    def sure(self) -> list[tuple[float, Pose]]:
        """Times and poses with status ``ok``."""
        rows = zip(self.times_s.tolist(), self.poses, self.statuses, strict=True)
        return [(time_s, pose) for time_s, pose, status in rows if status == PoseStatus.OK]

    def to_dict(self, k: int) -> dict[str, Any]:
        """JSON of frame ``k``: one line of ``lmkit track --json`` (docs/formats.md)."""
        return {
            "time_s": float(self.times_s[k]),
            "status": self.statuses[k],
            "position": self.poses[k].t.tolist(),
            "quaternion": self.poses[k].quaternion_xyzw.tolist(),
            "covariance": self.covariances[k].tolist(),
            "outliers": [i.code for i in self.outliers[k]],
            "outlier_ids": [str(i) for i in self.outliers[k]],
            "innovation": self.nis[k][0] / self.nis[k][1] if self.nis[k][1] else None,
            "warnings": list(self.remarks),
        }

    def at_times(self, times_s: FloatArray) -> TrackedTrajectory:
        """The poses at some of its times; observations in between are assigned to the nearest of them.

        If most of the poses assigned to one time were inconsistent, its pose is, too.
        """
        kept = np.flatnonzero(np.isin(self.times_s, times_s))
        if len(kept) == 0:
            raise ValueError("no pose at any of these times")
        nearest = np.abs(self.times_s[:, None] - self.times_s[kept]).argmin(axis=1)
        statuses, outliers, nis = [], [], []
        for k, row in enumerate(kept.tolist()):
            joined = np.flatnonzero(nearest == k).tolist()
            observed = [j for j in joined if self.outliers[j] or self.nis[j, 1] > 0]
            off = sum(self.statuses[j] is PoseStatus.INCONSISTENT for j in observed)
            own = self.statuses[row]
            agreeing = PoseStatus.INCONSISTENT if 2 * off > len(observed) else PoseStatus.OK
            statuses.append(agreeing if own in (PoseStatus.OK, PoseStatus.INCONSISTENT) else own)
            outliers.append(tuple(id_ for j in joined for id_ in self.outliers[j]))
            nis.append(self.nis[joined].sum(axis=0))
        return replace(
            self,
            times_s=self.times_s[kept],
            poses=[self.poses[k] for k in kept.tolist()],
            covariances=self.covariances[kept],
            statuses=statuses,
            outliers=outliers,
            nis=np.array(nis),
        )

    def looking(self, k: int) -> Pose:
        """Pose of a camera that looks along the robot's x axis, for drawing."""
        return ahead_of(self.poses[k]) if self.of_base else self.poses[k]


def _six(C: FloatArray) -> FloatArray:
    """(N,6,6) from covariances (N,3,3) of x, y, heading; the other entries are zero."""
    six = np.zeros((len(C), 6, 6))
    places = np.array([0, 1, 5])
    six[:, places[:, None], places[None]] = C
    return six


def tracked_lines(drive: TrackedTrajectory) -> list[str]:
    """A summary as lines of text."""
    counts = ", ".join(f"{count} {status}" for status, count in Counter(map(str, drive.statuses)).items())
    lines = [f"{len(drive)} frames: {counts}"]
    if drive.parameters:
        lines.append("odometry errors:")
        for name, value in drive.parameters.items():
            sigma = f" ± {drive.parameter_sigmas[name]:.2g}" if name in drive.parameter_sigmas else ""
            lines.append(f"  {PARAMETER_WORDS.get(name, name)}: {value:.4g}{sigma}")
    return lines


def tracked_csv(drive: TrackedTrajectory) -> str:
    """The text of a CSV file: all poses with standard deviations."""
    lines = ["time_s,status,x_m,y_m,z_m,qx,qy,qz,qw,sigma_x_m,sigma_y_m,sigma_heading_rad"]
    for k in range(len(drive.times_s)):
        pose, C = drive.poses[k], drive.covariances[k]
        numbers = [*pose.t, *pose.quaternion_xyzw, *(math.sqrt(max(C[j, j], 0.0)) for j in (0, 1, 5))]
        lines.append(f"{drive.times_s[k]:.6f},{drive.statuses[k]}," + ",".join(f"{v:.6f}" for v in numbers))
    return "\n".join(lines) + "\n"
