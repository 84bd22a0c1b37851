"""ROS 2 messages of a step as plain values; each transport converts them to its own objects."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.geometry.homography import homography_from_points
from lmkit.geometry.pose import Pose
from lmkit.live.annotated_image import annotated_jpeg
from lmkit.live.events import Health
from lmkit.live.ros.address import RosAddress
from lmkit.live.state import CameraView, LiveState
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.observation import Detection
from lmkit.model.pose_status import PoseStatus

POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
ODOMETRY = "nav_msgs/msg/Odometry"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
DETECTIONS = "apriltag_msgs/msg/AprilTagDetectionArray"
DOCK = "geometry_msgs/msg/PoseStamped"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
IMAGE = "sensor_msgs/msg/CompressedImage"
IMU = "sensor_msgs/msg/Imu"

# Types that are not in ROS 2's own packages; from the package apriltag_msgs.
DEFINITIONS = {
    "apriltag_msgs/msg/Point": "float64 x\nfloat64 y\n",
    "apriltag_msgs/msg/AprilTagDetection": "string family\nint32 id\nint32 hamming\nfloat32 goodness\n"
    "float32 decision_margin\napriltag_msgs/Point center\napriltag_msgs/Point[4] corners\nfloat64[9] homography\n",
    DETECTIONS: "std_msgs/Header header\napriltag_msgs/AprilTagDetection[] detections\n",
}
# AprilTag orders corners counterclockwise from the lower left, lmkit clockwise from the upper left.
APRILTAG_ORDER = [3, 2, 1, 0]
APRILTAG_CORNERS = np.array([[-1.0, 1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]])
DIAGNOSTICS_S = 1.0
EARLY = 0.1  # share of the interval by which an image may be early: cameras' stamps are not evenly spaced
LEVELS = {True: 0, False: 1}  # OK, WARN
UNKNOWN_VARIANCE = 1e9

Values = dict[str, Any]


@dataclass(frozen=True)
class RosMessage:
    """One message for a topic.

    Attributes:
        topic: with its leading slash.
        type_name: such as ``nav_msgs/msg/Odometry``.
        values: fields by name; nested messages are dictionaries.
    """

    topic: str
    type_name: str
    values: Values


class StepMessages:
    """The messages of every step."""

    def __init__(self, address: RosAddress, landmarks: LandmarkMap) -> None:
        self._address = address
        self._dock_pose = next((m.T_map_landmark for m in landmarks if m.id == address.dock), None)
        self._diagnosed_at = self._shown_at = -math.inf

    def topics(self, cameras: Sequence[str]) -> list[tuple[str, str]]:
        """Name and type of every topic that is published."""
        a, prefix = self._address, "/" + self._address.namespace
        names = [(f"{prefix}/pose", POSE), ("/diagnostics", DIAGNOSTICS)]
        names += [(f"{prefix}/{camera}/detections", DETECTIONS) for camera in cameras]
        names += [("/tf", TRANSFORMS)] if a.tf != "no" else []
        names += [(f"{prefix}/odometry", ODOMETRY)] if a.odometry else []
        names += [(f"{prefix}/image/compressed", IMAGE)] if a.images_hz else []
        return names + ([("/detected_dock_pose", DOCK)] if a.dock is not None else [])

    def of_step(self, state: LiveState) -> Iterator[RosMessage]:
        """Messages of one step: detections always, poses only with status ``ok``."""
        a, prefix = self._address, "/" + self._address.namespace
        for view in state.views:
            if view.image is not None or view.detections:
                stamp = state.time_s if not view.time_s else view.time_s
                yield RosMessage(f"{prefix}/{view.name}/detections", DETECTIONS, detections_values(view, stamp))
        if state.T_map_base is not None and state.covariance is not None:
            head = header(state.time_s, a.map_frame)
            pose = {"pose": pose_values(state.T_map_base), "covariance": state.covariance.ravel().tolist()}
            yield RosMessage(f"{prefix}/pose", POSE, {"header": head, "pose": pose})
            if a.odometry:
                values = {"header": head, "child_frame_id": a.base_frame, "pose": pose, "twist": _no_twist()}
                yield RosMessage(f"{prefix}/odometry", ODOMETRY, values)
            yield from self._transform(state, state.T_map_base)
            yield from self._dock(state, state.T_map_base)
        yield from self._image(state)
        if state.time_s - self._diagnosed_at >= DIAGNOSTICS_S or state.time_s < self._diagnosed_at:
            self._diagnosed_at = state.time_s
            yield RosMessage("/diagnostics", DIAGNOSTICS, diagnostics_values(state))

    def _image(self, state: LiveState) -> Iterator[RosMessage]:
        """All cameras side by side, with outlined detections; drawn only at the requested rate."""
        hz = self._address.images_hz
        if not hz or 0 <= state.time_s - self._shown_at < (1 - EARLY) / hz:
            return
        jpeg = annotated_jpeg(state)
        if jpeg:
            self._shown_at = state.time_s
            values = {
                "header": header(state.time_s, ""),
                "format": "jpeg",
                "data": np.frombuffer(jpeg, dtype=np.uint8),
            }
            yield RosMessage(f"/{self._address.namespace}/image/compressed", IMAGE, values)

    def _transform(self, state: LiveState, T_map_base: Pose) -> Iterator[RosMessage]:
        """One transform: a frame has one parent only."""
        a = self._address
        if a.tf == "auto" and state.T_map_odometry is not None:
            child, T = a.odom_frame, state.T_map_odometry
        elif a.tf == "base":
            child, T = a.base_frame, T_map_base
        else:
            return
        pose = pose_values(T)
        values = {
            "header": header(state.time_s, a.map_frame),
            "child_frame_id": child,
            "transform": {"translation": pose["position"], "rotation": pose["orientation"]},
        }
        yield RosMessage("/tf", TRANSFORMS, {"transforms": [values]})

    def _dock(self, state: LiveState, T_map_base: Pose) -> Iterator[RosMessage]:
        """The dock's landmark relative to the robot, if this landmark agrees with the pose."""
        if self._dock_pose is None or self._address.dock not in state.ids:
            return
        T = T_map_base.inverse() @ self._dock_pose
        values = {"header": header(state.time_s, self._address.base_frame), "pose": pose_values(T)}
        yield RosMessage("/detected_dock_pose", DOCK, values)


def header(time_s: float, frame: str) -> Values:
    """A std_msgs/Header.

    Examples:
        >>> header(1.25, "map")["stamp"]
        {'sec': 1, 'nanosec': 250000000}
    """
    nanoseconds = round(time_s * 1e9)
    return {"stamp": {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}, "frame_id": frame}


def time_of(values: Values) -> float:
    """Seconds of a header's stamp."""
    stamp = values["header"]["stamp"]
    return float(stamp["sec"]) + 1e-9 * float(stamp["nanosec"])


def pose_values(T: Pose) -> Values:
    """A geometry_msgs/Pose."""
    x, y, z, w = T.quaternion_xyzw.tolist()
    return {"position": _point(T.t), "orientation": {"x": x, "y": y, "z": z, "w": w}}


def pose_of(values: Values, to_frame: str, from_frame: str) -> Pose:
    """A pose from a geometry_msgs/Pose."""
    p, q = values["position"], values["orientation"]
    return Pose.from_quaternion(to_frame, from_frame, [p[a] for a in "xyz"], [q[a] for a in "xyzw"])


def detections_values(view: CameraView, time_s: float) -> Values:
    """An apriltag_msgs/AprilTagDetectionArray, corners in AprilTag's order."""
    return {"header": header(time_s, view.name), "detections": [_detection(d) for d in view.detections]}


def _detection(detection: Detection) -> Values:
    corners = np.asarray(detection.corners, dtype=float)[APRILTAG_ORDER]
    H = homography_from_points(APRILTAG_CORNERS, corners)
    center = H[:2, 2] / H[2, 2]
    return {
        "family": detection.id.family,
        "id": detection.id.code,
        "hamming": 0,
        "goodness": float(detection.confidence),
        "decision_margin": float(detection.margin),
        "center": {"x": float(center[0]), "y": float(center[1])},
        "corners": [{"x": float(x), "y": float(y)} for x, y in corners],
        "homography": (H / H[2, 2]).ravel().tolist(),
    }


def diagnostics_values(state: LiveState) -> Values:
    """A diagnostic_msgs/DiagnosticArray: the pose, and every source and output."""
    ok = state.status == PoseStatus.OK
    values = {
        "status": str(state.status),
        "landmarks": ", ".join(map(str, state.ids)),
        "outliers": ", ".join(map(str, state.outliers)),
        "nis": f"{state.nis / state.nis_dof:.2f}" if state.nis_dof else "",
        "rate_hz": f"{state.rate_hz:.1f}",
        "latency_ms": "" if state.latency_s is None else f"{1000 * state.latency_s:.1f}",
        "resets": str(state.resets),
        "profile": state.profile,
    }
    rows = [_diagnostic("lmkit: pose", LEVELS[ok], state.reason or str(state.status), values)]
    rows += [_condition(f"lmkit: {kind} {h.name}", h) for kind, all_ in
             (("source", state.sources), ("output", state.outputs)) for h in all_]  # fmt: skip
    return {"header": header(state.time_s, ""), "status": rows}


def _condition(name: str, health: Health) -> Values:
    values = {"rate_hz": f"{health.rate_hz:.1f}", "count": str(health.count), "lost": str(health.lost)}
    return _diagnostic(name, LEVELS[health.good], health.problem or "works", values)


def _diagnostic(name: str, level: int, message: str, values: dict[str, str]) -> Values:
    pairs = [{"key": key, "value": value} for key, value in values.items()]
    return {"level": level, "name": name, "message": message, "hardware_id": "lmkit", "values": pairs}


def _no_twist() -> Values:
    zero = {"x": 0.0, "y": 0.0, "z": 0.0}
    covariance = (np.eye(6) * UNKNOWN_VARIANCE).ravel().tolist()
    return {"twist": {"linear": zero, "angular": zero}, "covariance": covariance}


def _point(t: FloatArray) -> Values:
    x, y, z = t.tolist()
    return {"x": x, "y": y, "z": z}
