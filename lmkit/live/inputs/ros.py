"""Odometry and gyro from ROS 2: nav_msgs/Odometry and sensor_msgs/Imu (extra ``ros``)."""

from __future__ import annotations

import queue
from collections.abc import Sequence

from lmkit.live.inputs.base import InputLost, Reading
from lmkit.live.motion import GYRO, POSE
from lmkit.live.ros.address import RosAddress
from lmkit.live.ros.messages import IMU, ODOMETRY, Values, time_of
from lmkit.live.ros.transport import TransportLost, connect

MOST_WAITING = 1000


class RosInput:
    """Subscribes to one topic.

    Args:
        transport: from `choose`.
        is_gyro: the topic is an Imu, else an Odometry.

    Raises:
        InputLost: ROS 2 cannot be reached.
    """

    def __init__(self, address: RosAddress, transport: str, is_gyro: bool) -> None:
        self._queue: queue.Queue[Reading] = queue.Queue(MOST_WAITING)
        self._read = gyro_reading if is_gyro else odometry_reading
        try:
            self._transport = connect(address, transport)
            self._transport.subscribe(address.topic, IMU if is_gyro else ODOMETRY, self._heard)
        except TransportLost as lost:
            raise InputLost(str(lost)) from None

    def _heard(self, values: Values) -> None:
        if not self._queue.full():
            self._queue.put_nowait(self._read(values))

    def read(self, timeout_s: float) -> Sequence[Reading]:
        """See `MotionInput`."""
        try:
            self._transport.check()
        except TransportLost as lost:
            raise InputLost(str(lost)) from None
        try:
            found = [self._queue.get(timeout=timeout_s)]
        except queue.Empty:
            return ()
        while not self._queue.empty():
            found.append(self._queue.get_nowait())
        return found

    def close(self) -> None:
        """See `MotionInput`."""
        self._transport.close()


def odometry_reading(values: Values) -> Reading:
    """The reading in a nav_msgs/Odometry."""
    pose = values["pose"]["pose"]
    place = [_number(pose["position"][axis]) for axis in "xyz"]
    return Reading(POSE, time_of(values), (*place, *(_number(pose["orientation"][axis]) for axis in "xyzw")))


def gyro_reading(values: Values) -> Reading:
    """The reading in a sensor_msgs/Imu whose z axis is up."""
    return Reading(GYRO, time_of(values), (_number(values["angular_velocity"]["z"]),))


def _number(value: object) -> float:
    # rosbridge has null for what is not finite.
    return float("nan") if value is None else float(value)  # type: ignore[arg-type]
