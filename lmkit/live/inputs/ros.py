"""Odometry and gyro from ROS 2: nav_msgs/Odometry and sensor_msgs/Imu (extra ``ros``)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lmkit.geometry.imu_axes import about, upward_axis
from lmkit.live.inputs.base import InputLost, Reading
from lmkit.live.inputs.waiting import WaitingReadings
from lmkit.live.motion import GYRO, POSE
from lmkit.live.ros.address import RosAddress
from lmkit.live.ros.messages import IMU, ODOMETRY, Values, time_of
from lmkit.live.ros.open_transport import open_transport
from lmkit.live.ros.transport import TransportLost

ENOUGH = 50  # accelerations, half a second of a usual IMU


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
        self._read = UprightGyro().reading if is_gyro else odometry_reading
        try:
            self._transport = open_transport(address, transport)
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


class UprightGyro:
    """Yaw rates from messages of sensor_msgs/Imu, with axes determined by gravity (`geometry/imu_axes`).

    Until there are enough accelerations, and without accelerations, z is up.
    """

    def __init__(self) -> None:
        self._accelerations: list[list[float]] = []
        self._up = np.array([0.0, 0.0, 1.0])

    def reading(self, values: Values) -> Reading:
        """The reading in one message; its notice names the upward axis, once, if this is not z."""
        notice = self._learn_axis(values)
        rates = np.array([_number(values["angular_velocity"][axis]) for axis in "xyz"])
        return Reading(GYRO, time_of(values), (float(about(self._up, rates)),), notice)

    def _learn_axis(self, values: Values) -> str:
        """Add the acceleration; returns a sentence about the axes when they become known."""
        covariance = values.get("linear_acceleration_covariance")
        unmeasured = covariance is not None and len(covariance) > 0 and covariance[0] == -1
        if len(self._accelerations) == ENOUGH or "linear_acceleration" not in values or unmeasured:
            return ""
        self._accelerations.append([_number(values["linear_acceleration"][axis]) for axis in "xyz"])
        if len(self._accelerations) < ENOUGH:
            return ""
        self._up, sentence = upward_axis(np.array(self._accelerations))
        return sentence or ""


def _number(value: object) -> float:
    # rosbridge writes null for values that are not finite.
    return float("nan") if value is None else float(value)  # type: ignore[arg-type]
