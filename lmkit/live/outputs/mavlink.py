"""MAVLink: VISION_POSITION_ESTIMATE or ODOMETRY to an autopilot (extra ``mavlink``)."""

from __future__ import annotations

import math

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.geometry.rotations import matrix_to_quaternion
from lmkit.live.mavlink_link import MavlinkAddress, MavlinkLink
from lmkit.live.outputs.base import OutputLost
from lmkit.live.outputs.ned import ned_covariance, ned_pose, roll_pitch_yaw, upper_triangle
from lmkit.live.state import LiveState

SURE_M = 0.05  # standard deviation at which the quality is 50 %


class MavlinkOutput:
    """Sends every pose; steps without a pose only continue the heartbeat.

    Raises:
        OutputLost: the device or the port cannot be opened.
    """

    def __init__(self, address: MavlinkAddress) -> None:
        self._address = address
        try:
            self._link = MavlinkLink(address)
        except (OSError, ValueError) as error:
            raise OutputLost(f"cannot open {address.device}: {error}") from None

    def send(self, state: LiveState) -> bool:
        """See `Output`."""
        try:
            for _ in self._link.receive():  # answers requests for the time
                pass
            self._link.heartbeat()
            if state.T_map_base is None or state.covariance is None:
                return False
            position, R = ned_pose(state.T_map_base)
            rpy = roll_pitch_yaw(R)
            C = ned_covariance(state.covariance, rpy)
            if self._address.message in ("vision", "both"):
                self._vision(state, position, rpy, C)
            if self._address.message in ("odometry", "both"):
                self._odometry(state, position, R, C)
        except OSError as error:
            raise OutputLost(error.strerror or str(error)) from None
        return True

    def _vision(self, state: LiveState, position: FloatArray, rpy: FloatArray, C: FloatArray) -> None:
        self._link.send.vision_position_estimate_send(
            _microseconds(state), *position.tolist(), *rpy.tolist(), upper_triangle(C), state.resets % 256
        )

    def _odometry(self, state: LiveState, position: FloatArray, R: FloatArray, C: FloatArray) -> None:
        m = self._link.mavlink
        x, y, z, w = matrix_to_quaternion(R).tolist()
        unknown = [math.nan, math.nan, math.nan]
        sigma = math.sqrt(float(np.linalg.eigvalsh(C[:3, :3])[-1]))
        self._link.send.odometry_send(
            _microseconds(state),
            m.MAV_FRAME_LOCAL_NED,
            m.MAV_FRAME_BODY_FRD,
            *position.tolist(),
            [w, x, y, z],
            *unknown,
            *unknown,
            upper_triangle(C),
            [math.nan] * 21,
            state.resets % 256,
            m.MAV_ESTIMATOR_TYPE_VISION,
            round(100 * SURE_M / (SURE_M + sigma)),
        )

    def close(self) -> None:
        """See `Output`."""
        self._link.close()


def _microseconds(state: LiveState) -> int:
    return max(0, int(state.time_s * 1e6))
