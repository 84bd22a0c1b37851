"""ROS 2 by Zenoh, in the protocol of ``rmw_zenoh``: keys, CDR, attachments, liveliness tokens (extra ``ros``)."""

from __future__ import annotations

import hashlib
import json
import struct
import time
from typing import Any

from lmkit.live.ros.address import ZENOH_ROUTER, RosAddress
from lmkit.live.ros.cdr import Cdr
from lmkit.live.ros.messages import Values
from lmkit.live.ros.transport import NODE, Heard, TransportLost

NO_HASH = "TypeHashNotSupported"
QOS = "1:2:1,10:,:,:,,"  # reliable, volatile, the last ten
PUBLISHER, SUBSCRIBER = "MP", "MS"


def dds_type(type_name: str) -> str:
    """A type's name in keys.

    Examples:
        >>> dds_type("nav_msgs/msg/Odometry")
        'nav_msgs::msg::dds_::Odometry_'
    """
    package, kind, name = type_name.split("/")
    return f"{package}::{kind}::dds_::{name}_"


class ZenohTransport:
    """A session like that of a ROS 2 node: a peer that connects to the router."""

    def __init__(self, address: RosAddress) -> None:
        import zenoh

        self._cdr, self._address = Cdr(), address
        config = zenoh.Config()
        # Like rmw_zenoh's sessions: the router is known, without discovery.
        config.insert_json5("mode", '"peer"')
        config.insert_json5("connect/endpoints", json.dumps([address.url or ZENOH_ROUTER]))
        config.insert_json5("connect/exit_on_failure", "true")
        config.insert_json5("connect/timeout_ms", "2000")
        config.insert_json5("listen/endpoints", '["tcp/localhost:0"]')
        config.insert_json5("scouting/multicast/enabled", "false")
        try:
            self._session: Any = zenoh.open(config)
        except zenoh.ZError as error:
            where = address.url or ZENOH_ROUTER
            raise TransportLost(f"no Zenoh router at {where}: {str(error).splitlines()[0][:120]}") from None
        self._publishers: dict[str, tuple[Any, bytes]] = {}
        self._numbers: dict[str, int] = {}
        self._held: list[Any] = []  # references that keep tokens and subscribers alive
        self._token("NN")

    def _token(self, kind: str, topic: str = "", type_name: str = "") -> str:
        a, number = self._address, len(self._held)
        token = f"@ros2_lv/{a.domain}/{self._session.zid()}/0/{number}/{kind}/%/%/{NODE}"
        if topic:
            token += f"/{topic.replace('/', '%')}/{dds_type(type_name)}/{self._hash(type_name)}/{QOS}"
        self._held.append(self._session.liveliness().declare_token(token))
        return token

    def _hash(self, type_name: str) -> str:
        return self._cdr.type_hash(type_name) if self._address.hashes else NO_HASH

    def _key(self, topic: str, type_name: str) -> str:
        return f"{self._address.domain}/{topic.strip('/')}/{dds_type(type_name)}/{self._hash(type_name)}"

    def advertise(self, topic: str, type_name: str) -> None:
        """See `Transport`."""
        token = self._token(PUBLISHER, topic, type_name)
        gid = hashlib.md5(token.encode(), usedforsecurity=False).digest()
        self._publishers[topic] = self._session.declare_publisher(self._key(topic, type_name)), gid

    def publish(self, topic: str, type_name: str, values: Values) -> None:
        """See `Transport`."""
        publisher, gid = self._publishers[topic]
        number = self._numbers[topic] = self._numbers.get(topic, 0) + 1
        # Sequence number, nanoseconds, length of the id, id.
        attachment = struct.pack("<qqB", number, time.time_ns(), len(gid)) + gid
        publisher.put(self._cdr.encode(type_name, values), attachment=attachment)

    def subscribe(self, topic: str, type_name: str, heard: Heard) -> None:
        """See `Transport`."""
        self._token(SUBSCRIBER, topic, type_name)
        # Any hash: the sender's distribution may have none.
        key = f"{self._address.domain}/{topic.strip('/')}/{dds_type(type_name)}/*"
        take = lambda sample: heard(self._cdr.decode(type_name, bytes(sample.payload)))  # noqa: E731
        self._held.append(self._session.declare_subscriber(key, take))

    def check(self) -> None:
        """See `Transport`."""
        info = self._session.info
        if self._session.is_closed() or not (info.routers_zid() or info.peers_zid()):
            raise TransportLost(f"the Zenoh router at {self._address.url or ZENOH_ROUTER} is gone")

    def close(self) -> None:
        """See `Transport`."""
        self._session.close()
