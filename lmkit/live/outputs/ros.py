"""ROS 2: poses, transforms, detections and diagnostics, by the available transport."""

from __future__ import annotations

from collections.abc import Sequence

from lmkit.live.outputs.base import OutputLost
from lmkit.live.ros.address import RosAddress
from lmkit.live.ros.messages import StepMessages
from lmkit.live.ros.open_transport import open_transport
from lmkit.live.ros.transport import TransportLost
from lmkit.live.state import LiveState
from lmkit.model.landmark_map import LandmarkMap


class RosOutput:
    """Publishes every step; topics as in docs/live.md.

    Args:
        transport: from `choose`.

    Raises:
        OutputLost: ROS 2 cannot be reached.
    """

    def __init__(self, address: RosAddress, transport: str, landmarks: LandmarkMap, cameras: Sequence[str]) -> None:
        self._messages = StepMessages(address, landmarks)
        try:
            self._transport = open_transport(address, transport)
            for topic, type_name in self._messages.topics(cameras):
                self._transport.advertise(topic, type_name)
        except TransportLost as lost:
            raise OutputLost(str(lost)) from None

    def send(self, state: LiveState) -> bool:
        """See `Output`."""
        try:
            self._transport.check()
            for message in self._messages.of_step(state):
                self._transport.publish(message.topic, message.type_name, message.values)
        except TransportLost as lost:
            raise OutputLost(str(lost)) from None
        return state.T_map_base is not None

    def close(self) -> None:
        """See `Output`."""
        self._transport.close()
