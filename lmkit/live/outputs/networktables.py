"""NetworkTables, with the keys of a Limelight, so that FRC robots read lmkit like this camera."""

from __future__ import annotations

import json
import math
import time
from typing import Any

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.errors import InputError
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import AnyRig, T_map_cameras, mounted_cameras
from lmkit.live.outputs.base import OutputLost
from lmkit.live.state import LiveState
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.observation import Detection

TABLE = "limelight-lmkit"
PORT = 5810
CONNECTS_S = 3.0
NUMBERS = ("tv", "tx", "ty", "ta", "tl", "cl", "tid", "hb")
ARRAYS = ("botpose_wpiblue", "stddevs")


def parse_networktables(text: str) -> tuple[str, int]:
    """Host and port of ``HOST`` or ``HOST:PORT``.

    Raises:
        InputError: no host, or the port is not a number from 1 to 65535.
    """
    host, _, port = text.partition(":")
    if not host or (port and (not port.isdecimal() or not 0 < int(port) < 65536)):
        raise InputError(
            "bad_output", f"nt:{text}: not the address of a server", "write nt:HOST, such as nt:10.12.34.2"
        )
    return host, int(port) if port else PORT


class NetworkTablesOutput:
    """A client that writes the table ``limelight-lmkit``.

    Raises:
        OutputLost: no server answers.
    """

    def __init__(self, host: str, port: int, rig: AnyRig, landmarks: LandmarkMap) -> None:
        import ntcore

        self._rig, self._landmarks = rig, landmarks
        self._peer = f"NetworkTables at {host}:{port}"
        self._instance = ntcore.NetworkTableInstance.create()
        self._instance.startClient4("lmkit")
        self._instance.setServer(host, port)
        table = self._instance.getTable(TABLE)
        self._numbers = {key: table.getDoubleTopic(key).publish() for key in NUMBERS}
        self._arrays: dict[str, Any] = {key: table.getDoubleArrayTopic(key).publish() for key in ARRAYS}
        self._json = table.getStringTopic("json").publish()
        end = time.monotonic() + CONNECTS_S
        while not self._instance.isConnected():
            if time.monotonic() > end:
                self.close()
                raise OutputLost(f"{self._peer}: no server answers")
            time.sleep(0.02)

    def send(self, state: LiveState) -> bool:
        """See `Output`."""
        if not self._instance.isConnected():
            raise OutputLost(f"{self._peer}: the server is gone")
        numbers, arrays = entries(state, self._rig, self._landmarks)
        for key, value in numbers.items():
            self._numbers[key].set(value)
        for key, values in arrays.items():
            self._arrays[key].set(values)
        self._json.set(json.dumps(state.to_dict(), allow_nan=False))
        self._instance.flush()
        return True

    def close(self) -> None:
        """See `Output`."""
        import ntcore

        self._instance.stopClient()
        ntcore.NetworkTableInstance.destroy(self._instance)


def entries(state: LiveState, rig: AnyRig, landmarks: LandmarkMap) -> tuple[dict[str, float], dict[str, list[float]]]:
    """Numbers and arrays by the keys of a Limelight; angles in degrees, lengths in meters, shares in percent."""
    latency_ms = 1000 * (state.latency_s or 0.0)
    seen = [
        _target(detection, camera.model, k)
        for k, (camera, view) in enumerate(zip(mounted_cameras(rig), state.views, strict=False))
        for detection in view.detections
        if detection.id in landmarks
    ]
    seen.sort(key=lambda target: -target["ta"])
    first = seen[0] if seen else {"tx": 0.0, "ty": 0.0, "ta": 0.0, "tid": -1.0}
    numbers = {
        "tv": float(state.T_map_base is not None), "tl": latency_ms, "cl": 0.0, "hb": float(state.number),
        **{key: float(first[key]) for key in ("tx", "ty", "ta", "tid")},
    }  # fmt: skip
    if state.T_map_base is None or state.covariance is None:
        return numbers, {"botpose_wpiblue": [0.0] * 11, "stddevs": [0.0] * 12}
    pose = [*state.T_map_base.t.tolist(), *_degrees(state.T_map_base.R)]
    sigmas = np.sqrt(np.diag(state.covariance)) * np.repeat([1.0, 180 / np.pi], 3)
    used = [target for target in seen if target["detection"].id in state.ids]
    rows = [_row(target, state.T_map_base, rig, landmarks) for target in used]
    places = np.array([_place(target["detection"], landmarks) for target in used]).reshape(-1, 3)
    span = max((float(np.linalg.norm(a - b)) for a in places for b in places), default=0.0)
    far = float(np.mean([row[4] for row in rows])) if rows else 0.0
    area = float(np.mean([row[3] for row in rows])) if rows else 0.0
    heading = [latency_ms, float(len(rows)), span, far, area]
    return numbers, {
        "botpose_wpiblue": [*pose, *heading, *(value for row in rows for value in row)],
        "stddevs": [*sigmas.tolist(), *sigmas.tolist()],
    }


def _target(detection: Detection, model: Any, camera: int) -> dict[str, Any]:
    x, y = model.unproject(detection.center[None])[0]
    c = detection.corners
    area = 0.5 * abs(float(np.sum(c[:, 0] * np.roll(c[:, 1], -1) - c[:, 1] * np.roll(c[:, 0], -1))))
    return {
        "detection": detection, "camera": camera, "tx": math.degrees(math.atan(x)), "ty": -math.degrees(math.atan(y)),
        "ta": 100 * area / (model.image_size[0] * model.image_size[1]), "tid": float(detection.code),
    }  # fmt: skip


def _row(target: dict[str, Any], T_map_base: Pose, rig: AnyRig, landmarks: LandmarkMap) -> list[float]:
    """One landmark: id, tx, ty, area, distances to camera and robot, ambiguity (0: one pose only)."""
    place = _place(target["detection"], landmarks)
    left = T_map_base if rig.T_base_left is None else T_map_base @ rig.T_base_left
    cameras = T_map_cameras(rig, Pose("map", "left", left.R, left.t))
    to_camera = float(np.linalg.norm(place - cameras[target["camera"]].t))
    to_robot = float(np.linalg.norm(place - T_map_base.t))
    return [target["tid"], target["tx"], target["ty"], target["ta"], to_camera, to_robot, 0.0]


def _place(detection: Detection, landmarks: LandmarkMap) -> FloatArray:
    landmark = landmarks.find(detection.id)
    assert landmark is not None
    return landmark.T_map_landmark.t


def _degrees(R: FloatArray) -> list[float]:
    """Roll, pitch, yaw in degrees."""
    roll, pitch = math.atan2(R[2, 1], R[2, 2]), math.asin(max(-1.0, min(1.0, -R[2, 0])))
    return [math.degrees(a) for a in (roll, pitch, math.atan2(R[1, 0], R[0, 0]))]
