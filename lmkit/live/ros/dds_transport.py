"""ROS 2 by DDS, without a ROS installation, by rosless (extra ``ros``)."""

from __future__ import annotations

import threading
from typing import Any

from lmkit.live.ros.address import RosAddress
from lmkit.live.ros.cdr import Cdr
from lmkit.live.ros.messages import DEFINITIONS, Values
from lmkit.live.ros.transport import Heard, TransportLost

POLL_S = 0.2


class DdsTransport:
    """A DDS participant in a domain."""

    def __init__(self, address: RosAddress) -> None:
        import rosless

        for name, text in DEFINITIONS.items():
            rosless.register_type(name, text)
        self._cdr = Cdr()
        try:
            self._node: Any = rosless.Node(address.domain)
        except (OSError, RuntimeError, ValueError) as error:
            raise TransportLost(f"no DDS in domain {address.domain}: {error}") from None
        self._publishers: dict[str, Any] = {}
        self._threads: list[threading.Thread] = []
        self._stop = threading.Event()

    def advertise(self, topic: str, type_name: str) -> None:
        """See `Transport`."""
        self._publishers[topic] = self._node.advertise(topic, type_name)

    def publish(self, topic: str, type_name: str, values: Values) -> None:
        """See `Transport`."""
        self._publishers[topic].send_payload(self._cdr.encode(type_name, values))

    def subscribe(self, topic: str, type_name: str, heard: Heard) -> None:
        """See `Transport`."""
        subscription = self._node.subscribe(topic, type_name, depth=100)

        def listen() -> None:
            while not self._stop.is_set():
                message = subscription.read(POLL_S)
                if message is not None:
                    heard(message.to_dict())
            subscription.close()

        self._threads.append(threading.Thread(target=listen, name=f"lmkit-{topic}", daemon=True))
        self._threads[-1].start()

    def check(self) -> None:
        """See `Transport`: there is no peer that all goes through."""

    def close(self) -> None:
        """See `Transport`."""
        self._stop.set()
        for thread in self._threads:
            thread.join(2 * POLL_S)
        for publisher in self._publishers.values():
            publisher.close()
