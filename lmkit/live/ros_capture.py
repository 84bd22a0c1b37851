"""Images of a ROS 2 topic as a source: sensor_msgs/Image, or CompressedImage if the topic ends in ``/compressed``."""

from __future__ import annotations

import base64
import threading

import cv2
import numpy as np

from lmkit.arrays import ByteArray
from lmkit.errors import InputError
from lmkit.io.ros_images import COMPRESSED, IMAGE, decoded, pixels_of
from lmkit.live.captures import SourceLost
from lmkit.live.clock import LoopClock, StampGuard
from lmkit.live.ros.address import parse_ros
from lmkit.live.ros.messages import Values, time_of
from lmkit.live.ros.open_transport import choose_transport, open_transport
from lmkit.live.ros.transport import TransportLost
from lmkit.live.source_address import SourceAddress

SILENT_S = 1.5


class RosCapture:
    """Subscribes to a topic; only the newest image is kept.

    Stamps are the messages' own, converted to the loop's time if the sender has another clock.

    Raises:
        SourceLost: ROS 2 cannot be reached.
    """

    def __init__(self, address: SourceAddress, clock: LoopClock) -> None:
        self._address = parse_ros(address.target)
        self._is_compressed = self._address.topic.endswith("/compressed")
        self._clock, self._guard = clock, StampGuard()
        self._news = threading.Condition()
        self._newest: tuple[float, Values] | None = None  # arrival, message
        try:
            self._transport = open_transport(self._address, choose_transport(self._address))
            self._transport.subscribe(self._address.topic, COMPRESSED if self._is_compressed else IMAGE, self._heard)
        except TransportLost as lost:
            raise SourceLost(str(lost)) from None

    def _heard(self, values: Values) -> None:
        with self._news:
            self._newest = self._clock.now(), values
            self._news.notify_all()

    def read(self) -> tuple[float, tuple[ByteArray, ...]]:
        """See `Capture`."""
        with self._news:
            self._news.wait_for(lambda: self._newest is not None, SILENT_S)
            newest, self._newest = self._newest, None
        try:
            self._transport.check()
        except TransportLost as lost:
            raise SourceLost(str(lost)) from None
        if newest is None:
            raise SourceLost(f"no image on {self._address.topic}")
        arrival, values = newest
        try:
            image = image_of(values, self._is_compressed, self._address.topic)
        except InputError as error:
            raise SourceLost(str(error)) from None
        return self._guard.to_loop(time_of(values), arrival), (image,)

    def close(self) -> None:
        """See `Capture`."""
        self._transport.close()


def image_of(values: Values, is_compressed: bool, topic: str) -> ByteArray:
    """(H,W,3) BGR of a message.

    Raises:
        InputError: it contains no image that lmkit reads.
    """
    data = values["data"]
    # rosbridge writes bytes as base64.
    data = base64.b64decode(data) if isinstance(data, str) else data
    data = np.asarray(data, dtype=np.uint8) if isinstance(data, list) else data
    if is_compressed:
        return decoded(data, topic)
    size = int(values["width"]), int(values["height"])
    pixels = pixels_of(values["encoding"], size, int(values["step"]), data, topic)
    if pixels.shape[2] == 3:
        return np.ascontiguousarray(pixels)
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(pixels), cv2.COLOR_GRAY2BGR), dtype=np.uint8)
