"""Odometry and gyro from ROS 2: nav_msgs/Odometry and sensor_msgs/Imu (extra ``ros``)."""

from __future__ import annotations

from collections.abc import Sequence

from lmkit.live.inputs.base import InputLost, Reading
from lmkit.live.inputs.waiting import WaitingReadings
from lmkit.live.motion import GYRO, POSE
from lmkit.live.ros.address import RosAddress
from lmkit.live.ros.messages import IMU, ODOMETRY, Values, time_of
from lmkit.live.ros.transport import TransportLost, connect


class RosInput:
    """Subscribes to one topic.

    Args:
        transport: from `choose`.
        is_gyro: the topic is an Imu, else an Odometry.

    Raises:
        InputLost: ROS 2 cannot be reached.
    """

    def __init__(self, address: RosAddress, transport: str, is_gyro: bool) -> None:
        self._waiting = WaitingReadings()
        self._read = gyro_reading if is_gyro else odometry_reading
        try:
            self._transport = connect(address, transport)
            self._transport.subscribe(address.topic, IMU if is_gyro else ODOMETRY, self._heard)
        except TransportLost as lost:
            raise InputLost(str(lost)) from None

    def _heard(self, values: Values) -> None:
        self._waiting.put(self._read(values))

    def read(self, timeout_s: float) -> Sequence[Reading]:
        """See `MotionInput`."""
        try:
            self._transport.check()
        except TransportLost as lost:
            raise InputLost(str(lost)) from None
        return self._waiting.take(timeout_s)

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
