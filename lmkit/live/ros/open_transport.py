"""Choose and open a transport to ROS 2."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec

from lmkit.errors import EXTRA, InputError
from lmkit.live.ros.address import RosAddress
from lmkit.live.ros.dds_transport import DdsTransport
from lmkit.live.ros.rclpy_transport import RclpyTransport
from lmkit.live.ros.rosbridge_transport import RosbridgeTransport
from lmkit.live.ros.transport import Transport
from lmkit.live.ros.zenoh_transport import ZenohTransport

NEEDS = {
    "rclpy": ("rclpy",),
    "dds": ("rosless", "rosbags"),
    "zenoh": ("zenoh", "rosbags"),
    "rosbridge": ("websockets",),
}
TRANSPORTS: dict[str, Callable[[RosAddress], Transport]] = {
    "rclpy": RclpyTransport,
    "dds": DdsTransport,
    "zenoh": ZenohTransport,
    "rosbridge": RosbridgeTransport,
}


def choose_transport(address: RosAddress) -> str:
    """The requested transport, else the first one with installed packages.

    Raises:
        InputError: it is not installed, or no transport is.
    """
    asked = list(NEEDS) if address.transport == "auto" else [address.transport]
    for name in asked:
        if all(find_spec(module) is not None for module in NEEDS[name]):
            return name
    missing = next(module for module in NEEDS[asked[-1]] if find_spec(module) is None)
    hint = "source the setup of a ROS 2 installation" if asked == ["rclpy"] else EXTRA.format("ros")
    raise InputError("extra_missing", f"ros2 by {asked[-1]} needs the package {missing}", hint)


def open_transport(address: RosAddress, name: str) -> Transport:
    """Open a transport.

    Raises:
        TransportLost: it cannot be opened.
    """
    return TRANSPORTS[name](address)
