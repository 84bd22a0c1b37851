"""Odometry and gyro from outside: read, brought into the loop's time, and lost without harm."""

from __future__ import annotations

import json
import math
import threading
import time

import numpy as np
import pytest

from lmkit.errors import InputError
from lmkit.geometry.planar import planar_pose
from lmkit.geometry.rotations import rotation_angle
from lmkit.live.clock import LoopClock
from lmkit.live.inputs.base import InputLost, InputRunner, Reading, pose_or_none
from lmkit.live.inputs.json_lines import reading_of
from lmkit.live.inputs.ros import ENOUGH, UprightGyro, odometry_reading
from lmkit.live.motion import GYRO, POSE, WHEELS, MotionInbox
from lmkit.live.open_inputs import open_inputs
from lmkit.live.run_settings import RunFile

T = planar_pose(np.array([1.0, 2.0, 0.5]))
NUMBERS = (*T.t.tolist(), *T.quaternion_xyzw.tolist())


class Silent:
    """An input that only its test feeds."""

    def read(self, timeout_s: float):
        time.sleep(timeout_s)
        return ()

    def close(self) -> None: ...


@pytest.fixture
def runner():
    inbox = MotionInbox()
    runner = InputRunner("test", Silent, inbox, time.time, WHEELS)
    yield runner, inbox
    runner.close()


def test_poses_become_motion_and_what_is_no_pose_is_named(runner):
    runner, inbox = runner
    now = time.time()
    for k in range(3):
        T = planar_pose(np.array([0.1 * k, 0.0, 0.02 * k]))
        runner.take(Reading(POSE, now - 0.3 + 0.1 * k, (*T.t.tolist(), *T.quaternion_xyzw.tolist())))
    runner.take(Reading(POSE, now, (math.nan,) * 7))
    runner.take(Reading(GYRO, math.nan, (0.1,)))
    rows, events = inbox.take()
    assert [row.kind for row in rows] == [WHEELS, WHEELS]
    assert np.array([row.values for row in rows]) == pytest.approx(np.array([[0.1, 0.02]] * 2), abs=1e-3)
    assert {e.code for e in events} == {"wheels_not_finite", "gyro_not_finite"}


def test_stamps_of_another_clock_are_brought_into_the_loops_time(runner):
    runner, inbox = runner
    before = time.time()
    runner.take(Reading(GYRO, 12.0, (0.1,)))  # seconds since the autopilot was switched on
    runner.take(Reading(GYRO, 12.02, (0.2,)))
    rows, _ = inbox.take()
    assert all(abs(row.time_s - before) < 1 for row in rows)
    assert rows[1].time_s - rows[0].time_s <= 0.021
    runner.take(Reading(GYRO, 5000.0, (0.2,)))
    assert [e.code for e in runner.events()] == ["input_clock_jump"]


def test_odometry_that_jumps_moves_nothing():
    inbox = MotionInbox()
    for k, x in enumerate([0.0, 0.1, 0.2, 7.2, 7.3]):
        inbox.add_pose(0.1 * k, planar_pose(np.array([x, 0.0, 0.0])))
    rows, events = inbox.take()
    assert [e.code for e in events] == ["pose_jump"]
    assert [round(float(row.T_smooth_base.t[0]), 3) for row in rows] == [0.0, 0.1, 0.2, 0.2, 0.3]
    assert rows[-1].T_odometry_base.t[0] == 7.3


def test_a_lost_input_is_named_and_opened_again(monkeypatch):
    monkeypatch.setattr("lmkit.live.inputs.base.FIRST_WAIT_S", 0.02)
    tries: list[int] = []

    class Flaky(Silent):
        def read(self, timeout_s: float):
            tries.append(1)
            if len(tries) == 2:
                raise InputLost("unplugged")
            time.sleep(0.01)
            return [Reading(GYRO, None, (0.1,))]

    runner = InputRunner("test", Flaky, MotionInbox(), time.time, WHEELS)
    codes: list[str] = []
    end = time.monotonic() + 5
    while time.monotonic() < end and len(codes) < 2:
        codes += [event.code for event in runner.events()]
        time.sleep(0.01)
    runner.close()
    assert codes == ["input_lost", "input_back"]


def test_a_robot_sends_json_lines_over_websocket():
    client = pytest.importorskip("websockets.sync.client")
    inbox = MotionInbox()
    (runner,) = open_inputs(
        RunFile(sources=["camera:0"], odometry="ws:18766", gyro="ws:18766"), inbox, LoopClock(), WHEELS
    )
    deadline = time.monotonic() + 5
    while True:
        try:
            peer = client.connect("ws://127.0.0.1:18766")
            break
        except OSError:
            assert time.monotonic() < deadline
            time.sleep(0.02)
    with peer as peer:
        peer.send('{"forward_m": 0.02, "turn_rad": 0.001}\nnonsense\n' + json.dumps({"rate_radps": 0.3}))
        rows: list = []
        while len(rows) < 2 and time.monotonic() < deadline:
            rows += inbox.take()[0]
            time.sleep(0.01)
    runner.close()
    assert {row.kind: row.values for row in rows} == {WHEELS: (0.02, 0.001), GYRO: (0.3,)}
    assert reading_of("[1]") is None
    assert reading_of(json.dumps({"position": [1, 2, 0], "quaternion": NUMBERS[3:]})).kind == POSE


def test_mavlink_odometry_is_the_pose_in_the_map_again():
    mavutil = pytest.importorskip("pymavlink.mavutil")
    from lmkit.live.inputs.mavlink import MavlinkInput
    from lmkit.live.mavlink_link import parse_mavlink
    from lmkit.live.outputs.mavlink import MavlinkOutput
    from lmkit.live.state import LiveState
    from lmkit.model.pose_status import PoseStatus

    port = 24551
    read = MavlinkInput(parse_mavlink(f"udpin:127.0.0.1:{port}"))
    output = MavlinkOutput(parse_mavlink(f"udpout:127.0.0.1:{port}?message=odometry"))
    output.send(LiveState(0, 12.5, PoseStatus.OK, T, np.eye(6), ()))
    peer = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", dialect="common")
    peer.mav.highres_imu_send(12600000, 0, 0, 9.8, 0, 0, -0.25, 0, 0, 0, 0, 0, 0, 0, 0)
    found: list[Reading] = []
    end = time.monotonic() + 5
    while len(found) < 2 and time.monotonic() < end:
        found += read.read(0.2)
    for link in (read, output, peer):
        link.close()
    pose = pose_or_none(found[0].values)
    assert found[0].time_s == pytest.approx(12.5)
    assert pose.t == pytest.approx(T.t, abs=1e-6)
    assert rotation_angle(pose.R @ T.R.T) < 1e-5
    assert found[1].values == pytest.approx((0.25,))


def test_ros_messages_become_readings():
    stamp = {"stamp": {"sec": 5, "nanosec": 500000000}, "frame_id": "odom"}
    position, quaternion = dict(zip("xyz", NUMBERS, strict=False)), dict(zip("xyzw", NUMBERS[3:], strict=True))
    pose = {"position": position, "orientation": quaternion}
    assert odometry_reading({"header": stamp, "pose": {"pose": pose}}) == Reading(POSE, 5.5, NUMBERS)
    # Without accelerations z is up.
    assert UprightGyro().reading({"header": stamp, "angular_velocity": {"x": 0, "y": 0, "z": 0.5}}).values == (0.5,)


def imu(up, rate, acceleration=9.8, **more):
    """A message of an IMU whose axes see the vertical as ``up``."""
    named = lambda v: dict(zip("xyz", v.tolist(), strict=True))  # noqa: E731
    stamp = {"stamp": {"sec": 5, "nanosec": 0}}
    return {
        "header": stamp, "angular_velocity": named(rate * up), "linear_acceleration": named(acceleration * up), **more
    }  # fmt: skip


@pytest.mark.parametrize("up", [(0, -1, 0), (0, 0, -1), (1, 0, 0), (0, 0.1, 0.995), (0.6, 0, 0.8)])
def test_the_axis_of_an_imu_that_points_up_follows_from_gravity(up):
    gyro, up = UprightGyro(), np.array(up, dtype=float)
    found = [gyro.reading(imu(up, 0.4)) for _ in range(ENOUGH + 5)]
    assert found[-1].values == pytest.approx((0.4,), rel=0.01)
    notices = [reading.notice for reading in found if reading.notice]
    assert len(notices) == (0 if up[2] > 0.9 else 1)
    assert all("gravity" in notice for notice in notices)


def test_accelerations_that_were_not_measured_tell_nothing():
    gyro, up = UprightGyro(), np.array([0.0, -1.0, 0.0])
    zero = [gyro.reading(imu(up, 0.4, 0.0)) for _ in range(ENOUGH + 5)]
    unknown = [gyro.reading(imu(up, 0.4, linear_acceleration_covariance=[-1.0, *[0.0] * 8])) for _ in range(ENOUGH)]
    assert {reading.values for reading in (*zero, *unknown)} == {(0.0,)}


def test_a_notice_of_a_sensor_becomes_an_event(runner):
    runner, _ = runner
    runner.take(Reading(GYRO, 1.0, (0.1,), "z points down"))
    assert [(e.code, e.message) for e in runner.events()] == [("imu_axes", f"{runner.name}: z points down")]


def test_a_rosbridge_server_gives_odometry():
    server = pytest.importorskip("websockets.sync.server")
    stamp = {"stamp": {"sec": 5, "nanosec": 0}, "frame_id": "odom"}

    def talk(peer) -> None:
        asked = json.loads(next(iter(peer)))
        z = {"x": 0, "y": 0, "z": 0.5}
        peer.send(
            json.dumps({"op": "publish", "topic": asked["topic"], "msg": {"header": stamp, "angular_velocity": z}})
        )
        time.sleep(0.5)

    with server.serve(talk, "127.0.0.1", 0) as serving:
        threading.Thread(target=serving.serve_forever, daemon=True).start()
        port, inbox = serving.socket.getsockname()[1], MotionInbox()
        values = RunFile(
            sources=["camera:0"], odometry="ws:18767", gyro=f"ros2:/imu?transport=rosbridge&url=ws://127.0.0.1:{port}"
        )
        runners = open_inputs(values, inbox, LoopClock(), WHEELS)
        rows: list = []
        end = time.monotonic() + 5
        while not rows and time.monotonic() < end:
            rows += inbox.take()[0]
            time.sleep(0.02)
        for runner in runners:
            runner.close()
        serving.shutdown()
    assert rows[0].values == (0.5,)


@pytest.mark.parametrize("text", ["ros2:/odom!", "mavlink:fax", "ws:port", "odometry.csv"])
def test_a_bad_input_is_refused(text):
    with pytest.raises(InputError):
        open_inputs(RunFile(sources=["camera:0"], odometry=text), MotionInbox(), LoopClock(), WHEELS)
