"""Interface of the transports to ROS 2."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from lmkit.live.ros.messages import Values

NODE = "lmkit"
Heard = Callable[[Values], None]


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
