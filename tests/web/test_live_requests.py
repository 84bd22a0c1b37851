"""Live states: what a run sends, and what browsers get."""

from __future__ import annotations

import io
import json
import os
import struct
import time

import numpy as np
import pytest
from PIL import Image
from starlette.testclient import TestClient

from lmkit.errors import NegativeAnswer
from lmkit.live.annotated_image import annotated_jpeg
from lmkit.model.landmark_id import LandmarkId
from lmkit.web.app import build_app, state_of_app
from lmkit.web.live import IMAGE, LiveHub, innovation_band
from lmkit.web.project import open_project
from lmkit.web.workers import Workers


def test_live_states_arrive_with_their_image(tmp_path):
    app = build_app(open_project(tmp_path), workers=Workers(0))
    hub = state_of_app(app).live
    with TestClient(app, base_url="http://127.0.0.1:8600") as page:
        hub.publish({"status": "ok", "number": 1}, b"jpeg")
        with page.websocket_connect("/api/live", headers={"host": "127.0.0.1:8600"}) as socket:
            data = socket.receive_bytes()
            length = struct.unpack("<I", data[:4])[0]
            assert json.loads(data[4 : 4 + length])["number"] == 1 and data[4 + length :] == b"jpeg"
            assert hub.watched
            hub.publish({"status": "lost", "number": 2})
            assert b'"number":2' in socket.receive_bytes()
        for _ in range(50):
            if not hub.watched:
                break
            time.sleep(0.05)
        assert not hub.watched


def test_a_step_of_the_live_loop_is_published_with_its_images():
    from lmkit.live.state import CameraView, LiveState
    from lmkit.model.pose_status import PoseStatus

    image = np.full((120, 160, 3), 90, np.uint8)
    views = (CameraView("left", image, 0.0), CameraView("right", image, 0.0), CameraView("rear", None, 0.0))
    step = LiveState(4, 1.5, PoseStatus.OK, None, None, views)
    jpeg = annotated_jpeg(step)
    assert Image.open(io.BytesIO(jpeg)).size == (960, 360)
    hub = LiveHub()
    hub(step)
    hub.publish_line(b"no json\n")
    hub.publish_line(b'{"other": 1}\n')
    assert hub._last is not None and b'"number":4' in hub._last and not hub._last.endswith(jpeg)
    hub.publish_line(b'{"status": "lost", "number": 5}\n')
    assert b'"number":5' in hub._last


def test_a_run_sends_its_map_and_then_its_steps():
    from lmkit.web.watched_run import run

    to_run, from_page = os.pipe()
    stream = io.BytesIO()
    with io.FileIO(to_run) as wishes, io.FileIO(from_page, "w"), pytest.raises(NegativeAnswer):
        run({"sources": ["sim:?seconds=1&fps=2&size=160x120&cameras=1&speed=max"]}, wishes, stream)
    first, *steps = stream.getvalue().splitlines()
    hub = LiveHub()
    for line in (first, *steps):
        hub.publish_line(line)
    assert hub.run == 1 and len(hub.landmarks) == 6
    length = struct.unpack("<I", hub._last[:4])[0]
    state = json.loads(hub._last[4 : 4 + length])
    assert (
        state["run"] == 1
        and {h["name"] for h in state["outputs"]} == {"page"}
        and "sim" in state["sources"][0]["name"]
    )
    assert steps and not any(IMAGE in step for step in steps)


def test_images_go_out_only_while_someone_looks_and_not_too_often():
    from lmkit.live.state import CameraView, LiveState
    from lmkit.model.pose_status import PoseStatus
    from lmkit.web.watched_run import PageOutput

    view = CameraView("left", np.full((48, 64, 3), 90, np.uint8), 0.0)
    step, stream = LiveState(0, 0.0, PoseStatus.LOST, None, None, (view,)), io.BytesIO()
    page = PageOutput(stream)
    for page.watched in (False, True, True):
        page.send(step)
    assert [IMAGE in line for line in stream.getvalue().splitlines()] == [False, True, False]
    hub = LiveHub()
    hub.publish_line(stream.getvalue().splitlines()[1])
    assert Image.open(io.BytesIO(hub._last[4 + struct.unpack("<I", hub._last[:4])[0] :])).size == (480, 360)


def test_contradicting_landmarks_are_red_and_expected_ones_magenta():
    from lmkit.live.state import CameraView, LiveState
    from lmkit.model.observation import Detection
    from lmkit.model.pose_status import PoseStatus

    box = np.array([[100.0, 100], [300, 100], [300, 300], [100, 300]])
    good, bad, unread = (LandmarkId("lm8", k) for k in (1, 2, 3))
    read = (Detection(good, box, 1.0, 9.0), Detection(bad, box + np.array([400, 0]), 1.0, 9.0))
    black = np.zeros((480, 960, 3), np.uint8)
    view = CameraView("left", black, 0.0, read, {good: box, unread: box + np.array([0, 150])})
    state = LiveState(0, 0.0, PoseStatus.OK, None, None, (view,), ids=(good,), outliers=(bad,))
    drawn = np.asarray(Image.open(io.BytesIO(annotated_jpeg(state))))
    green, red, magenta = drawn[75, 50], drawn[75, 250], drawn[200, 50]
    assert green[1] > 150 > green[0] and red[0] > 150 > red[1] and magenta[0] > 150 > magenta[1] and magenta[2] > 120


def test_the_innovation_band_is_that_of_chi_squared():
    draws = np.random.default_rng(1).chisquare(8, 20_000) / 8
    low, high = innovation_band(8)
    assert np.mean((draws > low) & (draws < high)) == pytest.approx(0.95, abs=0.01)


def test_a_slow_watcher_misses_states_and_holds_one():
    import asyncio

    async def watch():
        hub = LiveHub()
        queues = [hub.watch() for _ in range(9)]
        assert queues[-1] is None and all(queues[:-1])
        for number in range(100):
            hub.publish({"number": number})
        await asyncio.sleep(0)
        assert queues[0].qsize() == 1 and b"99" in queues[0].get_nowait()

    asyncio.run(watch())
