"""Odometry and gyro from MAVLink: ODOMETRY, and the gyro of HIGHRES_IMU or SCALED_IMU (extra ``mavlink``)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from lmkit.geometry.rotations import matrix_to_quaternion, quaternion_to_matrix
from lmkit.live.inputs.base import InputLost, Reading
from lmkit.live.mavlink_link import MavlinkAddress, MavlinkLink
from lmkit.live.motion import GYRO, POSE
from lmkit.live.outputs.ned import FLU_FROM_FRD, NED_FROM_MAP


class MavlinkInput:
    """Reads a connection.

    Raises:
        InputLost: the device or the port cannot be opened.
    """

    def __init__(self, address: MavlinkAddress) -> None:
        try:
            self._link = MavlinkLink(address)
        except (OSError, ValueError) as error:
            raise InputLost(f"cannot open {address.device}: {error}") from None

    def read(self, timeout_s: float) -> Sequence[Reading]:
        """See `MotionInput`."""
        try:
            self._link.heartbeat()
            return [r for r in map(reading_of, self._link.receive(timeout_s)) if r is not None]
        except OSError as error:
            raise InputLost(error.strerror or str(error)) from None

    def close(self) -> None:
        """See `MotionInput`."""
        self._link.close()


def reading_of(message: Any) -> Reading | None:
    """The reading in a message, with axes converted to z up; None without one."""
    kind = message.get_type()
    if kind == "ODOMETRY":
        w, x, y, z = message.q
        q = np.array([x, y, z, w])
        if not np.isfinite(q).all() or np.linalg.norm(q) < 0.5:
            return Reading(POSE, message.time_usec * 1e-6, (np.nan,) * 7)
        R = NED_FROM_MAP.T @ quaternion_to_matrix(q / np.linalg.norm(q)) @ FLU_FROM_FRD.T
        t = NED_FROM_MAP.T @ np.array([message.x, message.y, message.z])
        return Reading(POSE, message.time_usec * 1e-6, (*t.tolist(), *matrix_to_quaternion(R).tolist()))
    if kind == "HIGHRES_IMU":
        return Reading(GYRO, message.time_usec * 1e-6, (-message.zgyro,))
    if kind in ("SCALED_IMU", "SCALED_IMU2"):
        return Reading(GYRO, message.time_boot_ms * 1e-3, (-message.zgyro * 1e-3,))
    return None
