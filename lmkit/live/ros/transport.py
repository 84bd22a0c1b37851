"""Interface of the transports to ROS 2, and the choice among them."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from typing import Protocol

from lmkit.errors import EXTRA, InputError
from lmkit.live.ros.address import RosAddress
from lmkit.live.ros.messages import Values

NODE = "lmkit"
Heard = Callable[[Values], None]
NEEDS = {
    "rclpy": ("rclpy",),
    "dds": ("rosless", "rosbags"),
    "zenoh": ("zenoh", "rosbags"),
    "rosbridge": ("websockets",),
}


class TransportLost(Exception):
    """ROS 2 cannot be reached; the message has the reason."""


class Transport(Protocol):
    """A connection to ROS 2.  Its methods raise `TransportLost`."""

    def advertise(self, topic: str, type_name: str) -> None:
        """Announce a topic before its first message."""

    def publish(self, topic: str, type_name: str, values: Values) -> None:
        """Send one message on an announced topic."""

    def subscribe(self, topic: str, type_name: str, heard: Heard) -> None:
        """Call ``heard`` with every message, from any thread."""

    def check(self) -> None:
        """Raise if the connection is lost."""

    def close(self) -> None:
        """Close the connection."""


def choose(address: RosAddress) -> str:
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


def connect(address: RosAddress, name: str) -> Transport:
    """Open a transport.

    Raises:
        TransportLost: it cannot be opened.
    """
    if name == "zenoh":
        from lmkit.live.ros.zenoh_transport import ZenohTransport

        return ZenohTransport(address)
    if name == "dds":
        from lmkit.live.ros.dds_transport import DdsTransport

        return DdsTransport(address)
    if name == "rclpy":
        from lmkit.live.ros.rclpy_transport import RclpyTransport

        return RclpyTransport(address)
    from lmkit.live.ros.rosbridge_transport import RosbridgeTransport

    return RosbridgeTransport(address)
