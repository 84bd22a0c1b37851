"""ROS 2 by rclpy, with a sourced ROS installation."""

from __future__ import annotations

import threading
from array import array
from importlib import import_module
from typing import Any

import numpy as np

from lmkit.live.ros.address import RosAddress
from lmkit.live.ros.messages import Values
from lmkit.live.ros.transport import NODE, Heard, TransportLost


class RclpyTransport:
    """A node of an installed ROS 2, in its own context."""

    def __init__(self, address: RosAddress) -> None:
        self._rclpy: Any = import_module("rclpy")
        self._set: Any = import_module("rosidl_runtime_py.set_message").set_message_fields
        self._to_dict: Any = import_module("rosidl_runtime_py.convert").message_to_ordereddict
        self._find: Any = import_module("rosidl_runtime_py.utilities").get_message
        self._context = self._rclpy.Context()
        try:
            self._rclpy.init(context=self._context, domain_id=address.domain)
        except RuntimeError as error:
            raise TransportLost(f"rclpy: {error}") from None
        self._node = self._rclpy.create_node(NODE, context=self._context)
        self._publishers: dict[str, Any] = {}
        self._executor: Any = import_module("rclpy.executors").SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        threading.Thread(target=self._executor.spin, name="lmkit-rclpy", daemon=True).start()

    def advertise(self, topic: str, type_name: str) -> None:
        """See `Transport`; a type whose package is not installed stays silent."""
        try:
            self._publishers[topic] = self._node.create_publisher(self._find(type_name), topic, 10)
        except (AttributeError, ModuleNotFoundError, ValueError):
            self._node.get_logger().warning(f"{topic}: {type_name} is not installed")

    def publish(self, topic: str, type_name: str, values: Values) -> None:
        """See `Transport`."""
        publisher = self._publishers.get(topic)
        if publisher is None:
            return
        message = self._find(type_name)()
        self._set(message, as_bytes(values))
        publisher.publish(message)

    def subscribe(self, topic: str, type_name: str, heard: Heard) -> None:
        """See `Transport`."""
        take = lambda message: heard(self._to_dict(message))  # noqa: E731
        quality = import_module("rclpy.qos").qos_profile_sensor_data
        self._node.create_subscription(self._find(type_name), topic, take, quality)

    def check(self) -> None:
        """See `Transport`."""
        if not self._context.ok():
            raise TransportLost("rclpy was shut down")

    def close(self) -> None:
        """See `Transport`."""
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()


def as_bytes(values: Any) -> Any:
    """The values in the types of rclpy: a diagnostic's level as bytes, images as arrays of the standard library."""
    if isinstance(values, np.ndarray):
        return array("B", values.tobytes())
    if isinstance(values, dict):
        return {k: bytes([v]) if k == "level" else as_bytes(v) for k, v in values.items()}
    return [as_bytes(v) for v in values] if isinstance(values, list) else values
