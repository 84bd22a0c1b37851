"""MAVLink on loopback UDP, read back by pymavlink's own parser."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest

from lmkit.errors import InputError
from lmkit.geometry.pose import Pose
from lmkit.geometry.rotations import rotation_exp
from lmkit.live.mavlink_link import parse_mavlink
from lmkit.live.outputs.ned import ned_covariance, ned_pose, roll_pitch_yaw
from lmkit.live.state import LiveState
from lmkit.model.pose_status import PoseStatus

# Yaw of 0.5 rad, then a little pitch and roll.
T = Pose(
    "map", "base", rotation_exp(np.array([0, 0, 0.5])) @ rotation_exp(np.array([0.02, 0.05, 0.0])), [1.0, 2.0, 0.3]
)
C = np.diag([0.01, 0.04, 0.09, 1e-4, 4e-4, 9e-4])
C[0, 1] = C[1, 0] = 0.005


def states(resets: int) -> LiveState:
    return LiveState(4, 1700000000.25, PoseStatus.OK, T, C, (), resets=resets)


@pytest.fixture
def autopilot():
    """An autopilot's side of the connection, and our output to it."""
    mavutil = pytest.importorskip("pymavlink.mavutil")
    from lmkit.live.outputs.mavlink import MavlinkOutput

    peer = mavutil.mavlink_connection("udpin:127.0.0.1:0", dialect="common")
    port = peer.port.getsockname()[1]
    output = MavlinkOutput(parse_mavlink(f"udpout:127.0.0.1:{port}?message=both"))
    yield peer, output
    output.close()
    peer.close()


def test_position_signs_covariance_and_reset_counter_are_read_back(autopilot):
    peer, output = autopilot
    assert output.send(states(259))
    assert peer.recv_match(type="HEARTBEAT", blocking=True, timeout=5).type == 18
    vision = peer.recv_match(type="VISION_POSITION_ESTIMATE", blocking=True, timeout=5)
    assert [vision.x, vision.y, vision.z] == pytest.approx([2.0, 1.0, -0.3])
    # A heading of 0.5 rad from the map's x (east) is 90 deg - 0.5 rad from north; nose down is pitch below zero.
    assert vision.yaw == pytest.approx(math.pi / 2 - 0.5, abs=2e-3)
    assert vision.pitch == pytest.approx(-0.05, abs=1e-3)
    assert vision.roll == pytest.approx(0.02, abs=1e-3)
    assert vision.usec == 1700000000250000
    assert vision.reset_counter == 3
    upper = np.zeros((6, 6))
    upper[np.triu_indices(6)] = vision.covariance
    assert np.diag(upper)[:3] == pytest.approx([0.04, 0.01, 0.09])
    assert upper[0, 1] == pytest.approx(0.005)
    odometry = peer.recv_match(type="ODOMETRY", blocking=True, timeout=5)
    assert (odometry.frame_id, odometry.child_frame_id, odometry.estimator_type) == (1, 12, 2)
    assert odometry.pose_covariance == pytest.approx(vision.covariance)
    w, x, y, z = odometry.q
    assert math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)) == pytest.approx(vision.yaw, abs=1e-5)


def test_the_covariance_of_roll_pitch_and_yaw_is_that_of_samples():
    rng = np.random.default_rng(1)
    small = C / 100
    turns = rng.multivariate_normal(np.zeros(6), small, 20000)
    rows = []
    for row in turns:
        moved = Pose("map", "base", rotation_exp(row[3:]) @ T.R, T.t + row[:3])
        position, R = ned_pose(moved)
        rows.append([*position, *roll_pitch_yaw(R)])
    position, R = ned_pose(T)
    said = ned_covariance(small, roll_pitch_yaw(R))
    spread = np.cov(np.array(rows).T)
    scale = np.sqrt(np.outer(np.diag(said), np.diag(said)))
    assert np.abs((spread - said) / scale).max() < 0.04


def test_requests_for_the_time_are_answered_and_steps_without_a_pose_are_silent(autopilot):
    peer, output = autopilot
    assert not output.send(LiveState(1, 1.0, PoseStatus.LOST, None, None, ()))
    assert peer.recv_match(type="HEARTBEAT", blocking=True, timeout=5) is not None
    peer.mav.timesync_send(0, 77)
    time.sleep(0.05)
    output.send(LiveState(2, 2.0, PoseStatus.LOST, None, None, ()))
    answer = peer.recv_match(type="TIMESYNC", blocking=True, timeout=5)
    assert answer.ts1 == 77
    assert abs(answer.tc1 / 1e9 - time.time()) < 5
    assert peer.recv_match(type="VISION_POSITION_ESTIMATE", blocking=False) is None


@pytest.mark.parametrize("text", ["", "udpout:host", "udpout:1.2.3.4:1?messages=x", "tcp:h:1?message=all", "fax:1:2"])
def test_a_bad_connection_is_refused(text):
    with pytest.raises(InputError, match="mavlink:"):
        parse_mavlink(text)
