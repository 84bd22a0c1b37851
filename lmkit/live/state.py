"""The result of one step of the live loop, for outputs, listeners and the page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from lmkit.arrays import ByteArray, FloatArray
from lmkit.geometry.pose import Pose
from lmkit.live.events import Event, Health
from lmkit.live.frame_group import FrameGroup
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.observation import Detection
from lmkit.model.pose_status import PoseStatus


@dataclass(frozen=True, eq=False)
class CameraView:
    """One camera's part in a step.

    Attributes:
        name: of the camera in the rig.
        image: (H,W,3) BGR, not to be modified; None if the camera gave none.
        time_s: stamp of the image.
        detections: landmarks read in the image.
        expected: corners (4,2), px, of the map's landmarks, predicted from the pose.
        search: ``whole``, ``near`` (windows around predictions), or ``none``.
    """

    name: str
    image: ByteArray | None
    time_s: float
    detections: tuple[Detection, ...] = ()
    expected: Mapping[LandmarkId, FloatArray] = field(default_factory=dict)
    search: str = "none"


@dataclass(frozen=True, eq=False)
class LiveState:
    """One step of the live loop.

    Attributes:
        number: of the step, from 0.
        time_s: stamp of the images, seconds of Unix time (of a recording: its own time).
        status: whether the pose can be used, or why not.
        T_map_base: pose of the robot's base (of the first camera if the rig has no base); None unless the status
            is ``ok``.
        covariance: (6,6) x y z (m), rotation about x y z (rad) of the map; None without a pose.
        views: of every camera, in the order of the rig.
        ids: landmarks that agree with the pose.
        outliers: landmarks that do not agree.
        restarted: whether the robot was located again: at the start, or after it was lost or carried away.
        resets: number of restarts so far.
        nis, nis_dof: normalized innovation squared, and its degrees of freedom.
        latency_s: from the stamp of the images to the end of the step; None for a recording.
        rate_hz: poses per second, over the last seconds.
        profile: of the detector in this step.
        reason: one sentence about the status.
        T_map_odometry: frame of the odometry in the map, if odometry has poses.
        events: events since the previous step.
        sources, outputs: their condition.
        truth: true pose of the base, of a simulation only.
        group: input of the loop; None without images.
    """

    number: int
    time_s: float
    status: PoseStatus
    T_map_base: Pose | None
    covariance: FloatArray | None
    views: tuple[CameraView, ...]
    ids: tuple[LandmarkId, ...] = ()
    outliers: tuple[LandmarkId, ...] = ()
    restarted: bool = False
    resets: int = 0
    nis: float = 0.0
    nis_dof: int = 0
    latency_s: float | None = None
    rate_hz: float = 0.0
    profile: str = "balanced"
    reason: str = ""
    T_map_odometry: Pose | None = None
    events: tuple[Event, ...] = ()
    sources: tuple[Health, ...] = ()
    outputs: tuple[Health, ...] = ()
    truth: Pose | None = None
    group: FrameGroup | None = None

    def to_dict(self) -> dict[str, Any]:
        """The step as JSON values, for standard output and WebSocket; without images."""
        pose, C = self.T_map_base, self.covariance
        return {
            "number": self.number,
            "time_s": self.time_s,
            "status": str(self.status),
            "position": None if pose is None else pose.t.tolist(),
            "quaternion": None if pose is None else pose.quaternion_xyzw.tolist(),
            "covariance": None if C is None else C.tolist(),
            "frame": "map",
            "codes": [i.code for i in self.ids],
            "ids": [str(i) for i in self.ids],
            "outliers": [i.code for i in self.outliers],
            "outlier_ids": [str(i) for i in self.outliers],
            "innovation": self.nis / self.nis_dof if self.nis_dof else None,
            "restarted": self.restarted,
            "resets": self.resets,
            "latency_ms": None if self.latency_s is None else 1000 * self.latency_s,
            "rate_hz": self.rate_hz,
            "profile": self.profile,
            "reason": self.reason,
            "events": [event.to_dict() for event in self.events],
        }
