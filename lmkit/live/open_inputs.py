"""Inputs of odometry and gyro by their address, such as ``ros2:/odom``, ``mavlink:/dev/ttyTHS1`` or ``ws:8766``."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from lmkit.errors import InputError
from lmkit.live.clock import LoopClock
from lmkit.live.inputs.base import InputRunner, MotionInput
from lmkit.live.inputs.json_lines import PORT, JsonInput
from lmkit.live.inputs.mavlink import MavlinkInput
from lmkit.live.inputs.ros import RosInput
from lmkit.live.mavlink_link import parse_mavlink
from lmkit.live.motion import MotionInbox
from lmkit.live.open_outputs import host_and_port
from lmkit.live.outputs.extras import require
from lmkit.live.ros.address import parse_ros
from lmkit.live.ros.open_transport import choose_transport
from lmkit.live.run_settings import RunFile

SCHEMES = ("ros2:", "mavlink:", "ws:")


def is_live_input(text: str | None) -> bool:
    """Whether odometry or gyro comes from a live input instead of a file."""
    return text is not None and text.startswith(SCHEMES)


def open_inputs(values: RunFile, inbox: MotionInbox, clock: LoopClock, motion: str) -> list[InputRunner]:
    """Runners of odometry and gyro; one runner for both if they have the same address.

    Raises:
        InputError: a file together with live images, an unknown address, or an extra that is missing.
    """
    given = {"odometry": values.odometry, "gyro": values.gyro}
    runners: list[InputRunner] = []
    for text in dict.fromkeys(text for text in given.values() if text is not None):
        kinds = frozenset(kind for kind, other in given.items() if other == text)
        if not is_live_input(text):
            raise InputError(
                "no_live_odometry",
                f"{text}: live images need a live input, not a file",
                "give for example ros2:/odom, mavlink:... or ws:8766",
            )
        if text.startswith("mavlink:") and text in values.to:
            raise InputError(
                "same_connection", f"{text} is an output as well", "give a second port, such as by mavlink-router"
            )
        opener = _opener(text, kinds)
        runners.append(InputRunner(text, opener, inbox, clock.now, motion, kinds))
    return runners


def _opener(text: str, kinds: frozenset[str]) -> Callable[[], MotionInput]:
    kind, _, rest = text.partition(":")
    if kind == "ws":
        require("websockets", "WebSocket", "web")
        return partial(JsonInput, *host_and_port(rest, PORT, text))
    if kind == "mavlink":
        connection = parse_mavlink(rest)
        require("pymavlink", "MAVLink", "mavlink")
        return partial(MavlinkInput, connection)
    address = parse_ros(":" + rest)
    if not address.topic or len(kinds) > 1:
        raise InputError(
            "bad_ros", f"{text}: one topic is needed for each of odometry and gyro", "give for example ros2:/odom"
        )
    return partial(RosInput, address, choose_transport(address), kinds == {"gyro"})
