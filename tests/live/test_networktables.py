"""NetworkTables on loopback: a client of WPILib's own library reads what a Limelight would write."""

from __future__ import annotations

import math
import time
from dataclasses import replace

import numpy as np
import pytest

from lmkit.errors import InputError
from lmkit.geometry.planar import planar_pose
from lmkit.live.outputs.base import OutputLost
from lmkit.live.outputs.networktables import NetworkTablesOutput, entries, parse_networktables
from lmkit.live.state import CameraView, LiveState
from lmkit.model.pose_status import PoseStatus
from lmkit.simulation.robot_course import RobotCourse


@pytest.fixture(scope="module")
def course() -> RobotCourse:
    return RobotCourse(1, 6.0)


@pytest.fixture(scope="module")
def step(course: RobotCourse) -> LiveState:
    T = course.T_map_base(4.0)
    views = tuple(
        CameraView(n, None, 4.0, tuple(s)) for n, s in zip(("left", "right"), course.corners(T), strict=True)
    )
    ids = tuple({d.id for view in views for d in view.detections})
    assert ids
    return LiveState(
        7, 4.0, PoseStatus.OK, T, np.diag([0.01, 0.04, 0.09, 0, 0, 1.0]) ** 2, views, ids, latency_s=0.03
    )


def test_keys_hold_pose_deviations_and_targets(course, step):
    numbers, arrays = entries(step, course.rig, course.landmarks)
    pose = arrays["botpose_wpiblue"]
    assert pose[:2] == pytest.approx(course.state(4.0)[:2])
    assert math.radians(pose[5]) == pytest.approx(math.remainder(course.state(4.0)[2], math.tau))
    assert pose[6] == pytest.approx(30.0)
    assert len(pose) == 11 + 7 * int(pose[7])
    # Each landmark stands where pose, angle and distance put it, to a few percent.
    for k in range(int(pose[7])):
        id_, tx, _, _, to_camera, to_robot, _ = pose[11 + 7 * k : 18 + 7 * k]
        landmark = next(m for m in course.landmarks if m.code == id_)
        bearing = math.radians(pose[5] - tx)
        left = planar_pose(np.array([pose[0], pose[1], math.radians(pose[5])])) @ course.rig.T_base_left
        to = landmark.T_map_landmark.t - left.t
        assert to_camera == pytest.approx(np.linalg.norm(to), abs=0.15)
        assert abs(math.remainder(math.atan2(to[1], to[0]) - bearing, math.tau)) < 0.1
        assert abs(to_robot - to_camera) < 1.0
    assert arrays["stddevs"][:6] == pytest.approx([0.01, 0.04, 0.09, 0, 0, math.degrees(1.0)])
    assert numbers["tv"] == 1.0
    lost = replace(step, T_map_base=None, covariance=None, views=())
    numbers, arrays = entries(lost, course.rig, course.landmarks)
    assert (numbers["tv"], numbers["tid"], arrays["botpose_wpiblue"]) == (0.0, -1.0, [0.0] * 11)


def test_a_client_reads_the_table_and_a_lost_server_is_named(course, step):
    ntcore = pytest.importorskip("ntcore")
    server = ntcore.NetworkTableInstance.create()
    server.startServer("", "127.0.0.1", 0, 15810)
    reader = ntcore.NetworkTableInstance.create()
    reader.startClient4("robot")
    reader.setServer("127.0.0.1", 15810)
    held = reader.getTable("limelight-lmkit").getDoubleArrayTopic("botpose_wpiblue").subscribe([])
    number = reader.getTable("limelight-lmkit").getDoubleTopic("hb").subscribe(-1.0)
    output = NetworkTablesOutput("127.0.0.1", 15810, course.rig, course.landmarks)
    end = time.monotonic() + 10
    while time.monotonic() < end and (not held.get() or number.get() != 7.0):
        output.send(step)
        time.sleep(0.02)
    assert held.get()[:3] == pytest.approx(step.T_map_base.t)
    assert number.get() == 7.0
    server.stopServer()
    with pytest.raises(OutputLost, match="gone"):
        while time.monotonic() < end:
            output.send(step)
            time.sleep(0.05)
    output.close()
    reader.stopClient()
    for instance in (reader, server):
        ntcore.NetworkTableInstance.destroy(instance)


@pytest.mark.parametrize("text", ["", ":5810", "host:port", "host:0"])
def test_a_bad_address_is_refused(text):
    with pytest.raises(InputError):
        parse_networktables(text)
