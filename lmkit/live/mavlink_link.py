"""A MAVLink connection over UDP, TCP or a serial line, through pymavlink (extra ``mavlink``)."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any
from urllib.parse import parse_qsl

from lmkit.errors import InputError

COMPONENT = 197  # MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY
HEARTBEAT_S = 1.0
MESSAGES = ("vision", "odometry", "both")
MOST_READ = 200  # messages per call, so that many messages do not block the loop
_HINT = "such as mavlink:udpout:127.0.0.1:14550, mavlink:udpin:0.0.0.0:14551 or mavlink:/dev/ttyTHS1?baud=921600"


@dataclass(frozen=True)
class MavlinkAddress:
    """A connection.

    Attributes:
        device: device string of pymavlink.
        baud: of a serial line.
        system: own system id, equal to the autopilot's.
        message: ``vision``, ``odometry`` or ``both``.
    """

    device: str
    baud: int = 921600
    system: int = 1
    message: str = "vision"


def parse_mavlink(text: str) -> MavlinkAddress:
    """The address after ``mavlink:``.

    Raises:
        InputError: an unknown kind of connection or option.

    Examples:
        >>> parse_mavlink("udpout:127.0.0.1:14550?message=both").message
        'both'
    """
    device, _, query = text.partition("?")
    kind, _, rest = device.partition(":")
    options = dict(parse_qsl(query, keep_blank_values=True))
    serial = device.startswith(("/dev/", "COM"))
    if not serial and (kind not in ("udpout", "udpin", "tcp", "tcpin") or not rest.rpartition(":")[2].isdecimal()):
        raise InputError("bad_mavlink", f"mavlink:{text}: unknown connection", _HINT)
    baud, system = options.pop("baud", "921600"), options.pop("system", "1")
    message = options.pop("message", "vision")
    if options or not baud.isdecimal() or not system.isdecimal() or message not in MESSAGES or int(system) > 255:
        raise InputError(
            "bad_mavlink", f"mavlink:{text}: bad option", "known: baud, system, message=vision|odometry|both"
        )
    return MavlinkAddress(device, int(baud), int(system), message)


class MavlinkLink:
    """One connection: sends a heartbeat every second and answers TIMESYNC.

    Raises:
        OSError: the device or the port cannot be opened.
    """

    def __init__(self, address: MavlinkAddress, wall_s: Callable[[], float] = time.time) -> None:
        os.environ["MAVLINK20"] = "1"  # covariances and reset counters are fields of version 2
        from pymavlink import mavutil

        self._wall_s = wall_s
        self.mavlink: Any = mavutil.mavlink
        self._connection: Any = mavutil.mavlink_connection(
            address.device,
            baud=address.baud,
            source_system=address.system,
            source_component=COMPONENT,
            dialect="common",
            autoreconnect=False,
        )
        self.send: Any = self._connection.mav
        self._heartbeat_at = float("-inf")

    def heartbeat(self) -> None:
        """A heartbeat as an onboard computer, if it is time."""
        if time.monotonic() - self._heartbeat_at < HEARTBEAT_S:
            return
        self._heartbeat_at = time.monotonic()
        m = self.mavlink
        self.send.heartbeat_send(m.MAV_TYPE_ONBOARD_CONTROLLER, m.MAV_AUTOPILOT_INVALID, 0, 0, m.MAV_STATE_ACTIVE)

    def receive(self, timeout_s: float = 0.0) -> Iterator[Any]:
        """Received messages; waits for the first one."""
        for k in range(MOST_READ):
            # With a timeout of 0, pymavlink would not read.
            waits = {"blocking": True, "timeout": timeout_s} if timeout_s > 0 and k == 0 else {}
            message = self._connection.recv_match(**waits)
            if message is None:
                return
            if message.get_type() == "TIMESYNC" and message.tc1 == 0:
                self.send.timesync_send(int(self._wall_s() * 1e9), message.ts1)
            yield message

    def close(self) -> None:
        """Release the device."""
        self._connection.close()
