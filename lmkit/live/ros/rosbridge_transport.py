"""ROS 2 by a rosbridge server: JSON over WebSocket (extra ``web``)."""

from __future__ import annotations

import base64
import json
import threading
from contextlib import ExitStack
from typing import Any

import numpy as np

from lmkit.live.ros.address import ROSBRIDGE, RosAddress
from lmkit.live.ros.messages import Values
from lmkit.live.ros.transport import Heard, TransportLost


class RosbridgeTransport:
    """A client of a rosbridge server."""

    def __init__(self, address: RosAddress) -> None:
        from websockets.exceptions import WebSocketException
        from websockets.sync.client import connect

        self._url = address.url or ROSBRIDGE
        self._stack = ExitStack()
        try:
            self._socket: Any = self._stack.enter_context(connect(self._url, open_timeout=3, compression=None))
        except (OSError, WebSocketException) as error:
            raise TransportLost(f"no rosbridge at {self._url}: {error}") from None
        self._closed: type[Exception] = WebSocketException
        self._heard: dict[str, Heard] = {}
        self._gone = ""
        # Reads also keep the connection alive.
        threading.Thread(target=self._listen, name="lmkit-rosbridge", daemon=True).start()

    def _listen(self) -> None:
        try:
            for text in self._socket:
                message = json.loads(text)
                heard = self._heard.get(message.get("topic", "")) if message.get("op") == "publish" else None
                if heard is not None:
                    heard(message["msg"])
        except (self._closed, ValueError) as error:
            self._gone = str(error)
        self._gone = self._gone or "closed"

    def _send(self, **message: Any) -> None:
        try:
            self._socket.send(json.dumps(message, allow_nan=False))
        except self._closed as error:
            raise TransportLost(f"rosbridge at {self._url}: {error}") from None

    def advertise(self, topic: str, type_name: str) -> None:
        """See `Transport`."""
        self._send(op="advertise", topic=topic, type=type_name)

    def publish(self, topic: str, type_name: str, values: Values) -> None:
        """See `Transport`."""
        self._send(op="publish", topic=topic, msg=_plain(values))

    def subscribe(self, topic: str, type_name: str, heard: Heard) -> None:
        """See `Transport`."""
        self._heard[topic] = heard
        self._send(op="subscribe", topic=topic, type=type_name, queue_length=10)

    def check(self) -> None:
        """See `Transport`."""
        if self._gone:
            raise TransportLost(f"rosbridge at {self._url}: {self._gone}")

    def close(self) -> None:
        """See `Transport`."""
        self._stack.close()


def _plain(values: Values) -> Values:
    """Bytes in the encoding of rosbridge: base64."""
    return {
        name: base64.b64encode(value.tobytes()).decode() if isinstance(value, np.ndarray) else value
        for name, value in values.items()
    }
