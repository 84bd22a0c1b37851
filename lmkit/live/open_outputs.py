"""Outputs by their address, such as ``ws:9000`` or ``mavlink:udpout:127.0.0.1:14550``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from lmkit.errors import InputError, InputWarning, warn_caller
from lmkit.geometry.rig import AnyRig, mounted_cameras
from lmkit.live.clock import LoopClock
from lmkit.live.mavlink_link import parse_mavlink
from lmkit.live.outputs.base import Output, OutputRunner
from lmkit.live.outputs.extras import require
from lmkit.live.outputs.json_lines import JsonLines
from lmkit.live.outputs.mavlink import MavlinkOutput
from lmkit.live.outputs.networktables import NetworkTablesOutput, parse_networktables
from lmkit.live.outputs.recorder import Recorder, attached_files
from lmkit.live.outputs.ros import RosOutput
from lmkit.live.outputs.websocket import PORT, WebSocketServer
from lmkit.live.ros.address import parse_ros
from lmkit.live.ros.messages import StepMessages
from lmkit.live.ros.open_transport import choose_transport
from lmkit.live.run_settings import LOOP_KEYS, RunSettings
from lmkit.model.landmark_map import LandmarkMap

ROBOT_KINDS = ("mavlink", "nt", "ros2")  # their messages require a body frame with x ahead and z up
KINDS = "stdout, ws, mavlink:CONNECTION, nt:HOST, ros2"


def open_outputs(
    settings: RunSettings, rig: AnyRig, landmarks: LandmarkMap, clock: LoopClock, motion: str
) -> list[OutputRunner]:
    """Runners of all outputs of a run, including the recording.

    Args:
        motion: motion input of the filter, for the recording.

    Raises:
        InputError: an unknown output, or its extra is not installed.
    """
    warn_of_camera_poses(settings.values.to, rig)
    runners = [OutputRunner(text, opener(text, rig, landmarks), clock.now) for text in settings.values.to]
    if settings.values.record is not None:
        live = settings.sources[0].is_live
        record = _recorder(settings, rig, landmarks, motion)
        runners.append(OutputRunner(f"record {settings.values.record}", record, clock.now, keeps_all=not live))
    return runners


def warn_of_camera_poses(outputs: Sequence[str], rig: AnyRig) -> None:
    """Warn if outputs whose receivers expect a robot's pose would send the first camera's pose."""
    robots = [text for text in outputs if text.split(":")[0].split("?")[0] in ROBOT_KINDS]
    if robots and rig.T_base_left is None:
        sentence = (
            f"the rig does not say where the cameras are on the robot: {', '.join(robots)} gets the first camera's "
            "pose (x right, y down, z ahead) as the robot's; add T_base_left or T_base_camera to the rig file"
        )
        warn_caller(InputWarning(sentence))


def _recorder(settings: RunSettings, rig: AnyRig, landmarks: LandmarkMap, motion: str) -> Callable[[], Output]:
    values = settings.values
    path = Path(str(values.record))
    if path.suffix.lower() != ".mcap":
        raise InputError("bad_output", f"--record {path}: not an MCAP file", "write for example --record drive.mcap")
    if path.exists():
        raise InputError("exists", f"{path} exists", "choose another name, or remove it")
    require("mcap", "--record", "bags")
    require("rosbags", "--record", "bags")
    kept = {**values.model_dump(include=set(LOOP_KEYS)), "motion": motion}
    # Without its markers' family or size, the map file in the recording could not be read again.
    map_path = settings.path(values.map) if values.family is None and values.size is None else None
    attached = attached_files(settings.path(values.rig), map_path, rig, landmarks)
    names = [camera.name for camera in mounted_cameras(rig)]
    return partial(Recorder, path, attached, kept, StepMessages(parse_ros("?odometry=yes"), landmarks), names)


def opener(text: str, rig: AnyRig, landmarks: LandmarkMap) -> Callable[[], Output]:
    """A function that opens an output.

    Raises:
        InputError: an unknown output, or its extra is not installed.
    """
    kind, _, rest = text.partition(":")
    if kind == "stdout" and not rest:
        return JsonLines
    if kind == "ws":
        require("websockets", "WebSocket", "web")
        return partial(WebSocketServer, *host_and_port(rest, PORT, text))
    if kind == "mavlink":
        connection = parse_mavlink(rest)
        require("pymavlink", "MAVLink", "mavlink")
        return partial(MavlinkOutput, connection)
    if kind == "nt":
        host, port = parse_networktables(rest)
        require("ntcore", "NetworkTables", "nt")
        return partial(NetworkTablesOutput, host, port, rig, landmarks)
    if text == "ros2" or text.startswith("ros2?"):
        address = parse_ros(text.removeprefix("ros2"))
        names = [camera.name for camera in mounted_cameras(rig)]
        return partial(RosOutput, address, choose_transport(address), landmarks, names)
    raise InputError("bad_output", f"{text}: unknown output", f"known: {KINDS}")


def host_and_port(text: str, default: int, what: str) -> tuple[str, int]:
    """Host and port of ``HOST:PORT``, ``PORT`` or nothing; the host is 127.0.0.1 unless given.

    Raises:
        InputError: the port is not a number from 0 to 65535.
    """
    host, _, port = text.rpartition(":")
    if not port:
        return host or "127.0.0.1", default
    if not port.isdecimal() or not 0 <= int(port) <= 65535:
        raise InputError("bad_output", f"{what}: {port!r} is not a port", "write HOST:PORT, such as 127.0.0.1:8765")
    return host or "127.0.0.1", int(port)
