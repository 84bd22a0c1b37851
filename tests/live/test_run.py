"""Live runs of a simulated robot: poses are right, faults are named, and no wrong pose is published."""

from __future__ import annotations

import json
import sys
import threading
import time
import urllib.error
import urllib.request
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace

import cv2
import numpy as np
import pytest

from lmkit.demos import live_run
from lmkit.errors import InputError, InputWarning
from lmkit.geometry.planar import planar_pose
from lmkit.live.captures import PipeCapture, SourceLost, take_jpeg
from lmkit.live.clock import LoopClock, StampGuard
from lmkit.live.frame_group import FrameGroup
from lmkit.live.live_run import LiveRun
from lmkit.live.loop import LiveLoop, LoopSettings
from lmkit.live.motion import WHEELS, MotionInbox, MotionRow
from lmkit.live.open_outputs import warn_of_camera_poses
from lmkit.live.open_run import open_run
from lmkit.live.outputs.base import OutputLost, OutputRunner
from lmkit.live.publication import PublicationRule
from lmkit.live.reader import Reader
from lmkit.live.recorded_feed import StepFeed
from lmkit.live.run_settings import RunFile, RunSettings, read_run_file
from lmkit.live.service import HealthPage
from lmkit.live.simulated_source import SimulatedRun
from lmkit.live.source_address import parse_source
from lmkit.live.state import LiveState
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.pose_status import PoseStatus

CORNERS = "sim:?seconds=12&speed=max&images=no&seed=1"
WRONG_M = 0.5


def states_of(change: Callable[[Iterator[FrameGroup]], Iterator[FrameGroup]], landmarks=None) -> list[LiveState]:
    """All steps of a simulated run whose frames are changed."""
    simulated = SimulatedRun(parse_source(CORNERS))
    course = simulated.course
    loop = LiveLoop(
        course.rig, landmarks(course.landmarks) if landmarks else course.landmarks, LoopSettings("wheels")
    )
    run = LiveRun(loop, StepFeed("sim", change(simulated.groups())))
    states: list[LiveState] = []
    run.listeners.append(states.append)
    run.run()
    return states


def off_m(state: LiveState) -> float:
    """Distance of a published pose from the truth."""
    assert state.T_map_base is not None
    assert state.truth is not None
    return float(np.linalg.norm(state.T_map_base.t[:2] - state.truth.t[:2]))


def published(states: list[LiveState]) -> list[LiveState]:
    return [state for state in states if state.T_map_base is not None]


def test_poses_of_corners_are_right_and_their_covariance_holds():
    every = states_of(lambda groups: groups)
    assert not any(s.status == PoseStatus.INCONSISTENT for s in every), "a start that waits contradicts nothing"
    states = published(every)
    errors = np.array([off_m(s) for s in states])
    assert len(states) > 200
    assert np.sqrt(np.mean(errors**2)) < 0.02
    nees = [
        float(d @ np.linalg.solve(s.covariance[:2, :2], d)) / 2
        for s in states
        if s.covariance is not None and (d := (s.T_map_base.t - s.truth.t)[:2]) is not None
    ]
    assert np.mean(nees) < 3
    assert all(np.linalg.eigvalsh(s.covariance).min() > 0 for s in states if s.covariance is not None)


def test_the_robots_on_the_plan_stand_on_their_path(monkeypatch):
    simulated = SimulatedRun(parse_source("sim:?seconds=3&speed=max&images=no&seed=1"))
    loop = LiveLoop(simulated.course.rig, simulated.course.landmarks, LoopSettings("wheels"))
    run = LiveRun(loop, StepFeed("sim", simulated.groups()))
    states: list[LiveState] = []
    run.listeners.append(states.append)
    run.run()
    drawn = {}
    monkeypatch.setattr("lmkit.demos.live_run.draw_plan", lambda _, found, **rest: drawn.update(rest, found=found))
    live_run._plan(loop, published(states))
    path = drawn["polylines"][1].points
    assert drawn["found"]
    assert all((np.linalg.norm(path - one.pose.t[:2], axis=1) < 1e-9).any() for one in drawn["found"])


@pytest.mark.slow
def test_rendered_images_give_poses_and_windows_are_searched():
    run = open_run(RunSettings(RunFile(sources=["sim:?seconds=3&fps=10&speed=max&seed=1"], confirm=1)))
    states: list[LiveState] = []
    run.listeners.append(states.append)
    run.run()
    assert len(published(states)) > 15
    assert max(off_m(s) for s in published(states)) < 0.05
    assert {view.search for s in states for view in s.views} == {"whole", "near"}


def test_whole_images_are_searched_at_once_where_windows_show_nothing(monkeypatch):
    """Without odometry, the robot is not at the predicted place; landmarks in view are still read."""
    course = SimulatedRun(parse_source(CORNERS)).course
    image = np.zeros((*course.rig.left.image_size[::-1], 3), np.uint8)
    places = [course.T_map_base(t) for t in (1.0, 1.1, 6.0)]
    seen = {}
    monkeypatch.setattr(
        "lmkit.live.search.detect_landmarks",
        lambda image, _, near=None: seen[id(image)] if near is None or (len(near) and not jumped) else [],
    )
    loop = LiveLoop(course.rig, course.landmarks, LoopSettings("none", rule=PublicationRule(confirm=1)))
    states, jumped = [], False
    for k, T in enumerate(places):
        jumped = k == 2
        images = tuple(image.copy() for _ in range(2))
        seen = {id(i): found for i, found in zip(images, course.corners(T), strict=True)}
        states.append(loop.step(FrameGroup(0.1 * k, images, (0.1 * k,) * 2)))
    assert all(states[2].views[k].detections for k in range(2))
    assert states[1].status == PoseStatus.OK
    assert states[2].status == PoseStatus.INCONSISTENT
    assert [{view.search for view in state.views} for state in states] == [{"whole"}, {"near"}, {"whole"}]


@pytest.mark.slow
def test_outputs_about_a_robots_body_need_the_cameras_place_on_it():
    rig = SimulatedRun(parse_source("sim:?seconds=1")).rig
    outputs = ["stdout", "mavlink:udpout:127.0.0.1:14550", "ros2?transport=dds"]
    alone = replace(rig, T_base_left=None)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warn_of_camera_poses(outputs, rig)
        warn_of_camera_poses(["stdout", "ws:9000"], alone)
    with pytest.warns(InputWarning, match=r"mavlink:udpout:127.0.0.1:14550, ros2\?transport=dds gets"):
        warn_of_camera_poses(outputs, alone)


def test_a_robot_that_is_carried_off_publishes_nothing_wrong():
    def carried(groups: Iterator[FrameGroup]) -> Iterator[FrameGroup]:
        simulated = SimulatedRun(parse_source(CORNERS))
        for k, group in enumerate(groups):
            if k < 150:
                yield group
                continue
            assert group.truth is not None
            state = simulated.course.state(group.time_s)
            T = planar_pose(np.array([state[0] - 1.2, state[1] + 0.6, state[2] + 1.5]))
            yield replace(group, truth=T, seen=simulated.course.corners(T))

    states = states_of(carried)
    assert max(off_m(s) for s in published(states)) < WRONG_M
    assert any(s.status != PoseStatus.OK for s in states[150:160])


@pytest.mark.slow
def test_darkness_ends_the_poses_and_light_brings_them_back():
    def dark(groups: Iterator[FrameGroup]) -> Iterator[FrameGroup]:
        for k, group in enumerate(groups):
            yield replace(group, seen=((), ())) if 120 <= k < 240 else group

    states = states_of(dark)
    assert not published(states[160:240])
    assert published(states[240:])
    assert max(off_m(s) for s in published(states)) < WRONG_M


def test_a_wrong_map_publishes_nothing_wrong():
    def moved(landmarks: LandmarkMap) -> LandmarkMap:
        some = list(landmarks)
        T = some[0].T_map_landmark
        some[0] = replace(some[0], T_map_landmark=replace(T, t=T.t + np.array([0.9, 0.0, 0.0])))
        return LandmarkMap(some)

    states = states_of(lambda groups: groups, moved)
    assert max((off_m(s) for s in published(states)), default=0.0) < WRONG_M


def test_odometry_that_cannot_be_is_left_out_and_named():
    inbox = MotionInbox()
    inbox.add(MotionRow(WHEELS, 1.0, (0.1, 0.0)))
    inbox.add(MotionRow(WHEELS, 1.1, (float("nan"), 0.0)))
    inbox.add(MotionRow(WHEELS, 1.1, (50.0, 0.0)))
    inbox.add(MotionRow(WHEELS, 0.9, (0.1, 0.0)))
    inbox.add(MotionRow(WHEELS, 1.2, (0.1, 0.0)))
    rows, events = inbox.take()
    assert [row.time_s for row in rows] == [1.0, 1.2]
    assert {e.code for e in events} == {"wheels_not_finite", "wheels_jump", "wheels_out_of_order"}


def test_a_jump_of_the_clock_reaches_no_stamp():
    wall, monotonic = [1000.0], [5.0]
    clock = LoopClock(lambda: wall[0], lambda: monotonic[0])
    wall[0], monotonic[0] = 1000.0 + 3600 + 1, 6.0
    assert clock.now() == pytest.approx(1001.0)
    assert clock.check() == pytest.approx(3600.0)
    assert clock.check() is None
    guard = StampGuard()
    assert guard.to_loop(10.0, 10.05) == pytest.approx(10.0)
    assert guard.to_loop(3610.0, 10.15) == pytest.approx(10.15)
    assert guard.jumps == 1


class Flaky:
    """A capture that ends after three images."""

    def __init__(self) -> None:
        self.left = 3

    def read(self):
        if self.left == 0:
            raise SourceLost("unplugged")
        self.left -= 1
        time.sleep(0.01)
        return time.time(), (np.zeros((4, 4, 3), np.uint8),)

    def close(self) -> None: ...


def test_an_unplugged_camera_is_named_and_opened_again(monkeypatch):
    monkeypatch.setattr("lmkit.live.reader.FIRST_WAIT_S", 0.02)
    reader = Reader("camera:0", Flaky, time.time, threading.Condition())
    end = time.monotonic() + 5
    codes: list[str] = []
    while time.monotonic() < end and "camera_back" not in codes:
        codes += [event.code for event in reader.events()]
        time.sleep(0.01)
    reader.close()
    assert codes[:2] == ["camera_lost", "camera_back"]


def test_a_simulated_robot_ends_its_run_at_the_end_of_its_course():
    run = open_run(RunSettings(RunFile(sources=["sim:?seconds=1&size=160x120&fps=10"])))
    guard = threading.Timer(20, run.stop)
    guard.start()
    summary = run.run()
    guard.cancel()
    assert summary.seconds < 15
    assert "camera_lost" not in summary.events


class Failing:
    """An output whose peer is gone at first."""

    tries = 0

    def __init__(self) -> None:
        Failing.tries += 1
        if Failing.tries < 3:
            raise OutputLost("no peer")

    def send(self, state: LiveState) -> bool:
        return True

    def close(self) -> None: ...


def test_a_lost_output_is_named_opened_again_and_holds_nobody_up(monkeypatch):
    monkeypatch.setattr("lmkit.live.outputs.base.FIRST_WAIT_S", 0.02)
    Failing.tries = 0
    runner = OutputRunner("peer", Failing, time.time)
    start = time.monotonic()
    for number in range(100):
        runner.put(LiveState(number, 0.0, PoseStatus.LOST, None, None, ()))
    assert time.monotonic() - start < 1.0
    end = time.monotonic() + 5
    codes: list[str] = []
    while time.monotonic() < end and "output_back" not in codes:
        codes += [event.code for event in runner.events()]
        time.sleep(0.01)
    runner.close()
    assert codes == ["output_lost", "output_back"]
    assert runner.health().lost > 0


def test_jpeg_images_are_taken_out_of_a_pipe():
    data = cv2.imencode(".jpg", np.full((16, 16, 3), 90, np.uint8))[1].tobytes()
    stream = bytearray(b"noise" + data + data[:20])
    assert take_jpeg(stream) == data
    assert take_jpeg(stream) is None
    code = f"import sys; sys.stdout.buffer.write(bytes.fromhex('{data.hex()}'))"
    capture = PipeCapture(parse_source(f'pipe:{sys.executable} -c "{code}"'), LoopClock())
    assert capture.read()[1][0].shape == (16, 16, 3)
    with pytest.raises(SourceLost, match="ended"):
        capture.read()
    capture.close()


@pytest.mark.parametrize("text", ["camera:front", "camera:0?fsp=3", "pipe:", "nowhere.png", "sim:?speed=max&x=1"])
def test_a_bad_source_is_refused(text):
    with pytest.raises(InputError):
        parse_source(text)


def test_a_run_file_is_validated_and_equals_the_options(tmp_path, lmkit):
    path = tmp_path / "run.yaml"
    path.write_text(
        "format: lmkit-run/1\nsources: ['sim:?seconds=2&speed=max&images=no']\nto: [stdout]\nconfirm: 1\n"
    )
    assert read_run_file(path).values.confirm == 1
    one = lmkit("run", path)
    other = lmkit("run", "sim:?seconds=2&speed=max&images=no", "--json", "--confirm", 1)
    rows = [json.loads(line) for line in one.out.splitlines()]
    assert one.code == 0
    assert len(rows) > 40
    again = [json.loads(line) for line in other.out.splitlines()]
    assert [row["position"] for row in rows[:20]] == [row["position"] for row in again[:20]]
    path.write_text("format: lmkit-run/1\nsources: ['sim:']\nspeed: 3\n")
    refused = lmkit("run", path, "--check")
    assert refused.code == 2
    assert "speed" in refused.err


def test_websocket_and_health_page_are_read():
    client = pytest.importorskip("websockets.sync.client")
    from lmkit.live.outputs.websocket import WebSocketServer

    server = WebSocketServer(port=0)
    with client.connect(f"ws://127.0.0.1:{server.port}") as peer:
        end = time.monotonic() + 5
        state = LiveState(4, 1.5, PoseStatus.OK, planar_pose(np.array([1.0, 2.0, 0.3])), np.eye(6), ())
        while not server.send(state) and time.monotonic() < end:
            time.sleep(0.01)
        read = json.loads(peer.recv(timeout=5))
    server.close()
    assert read["position"] == [1.0, 2.0, 0.0]
    assert read["number"] == 4
    run = open_run(RunSettings(RunFile(sources=["sim:?seconds=1&speed=max&images=no"])))
    page = HealthPage(run, "127.0.0.1:0")
    run.run()
    # The source has ended, so the run is not healthy any more.
    with pytest.raises(urllib.error.HTTPError) as refused:
        urllib.request.urlopen(f"http://127.0.0.1:{page.port}/health")
    assert refused.value.code == 503
    assert json.loads(refused.value.read())["steps"] == 30
    page.close()
