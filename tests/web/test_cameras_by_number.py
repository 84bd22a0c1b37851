"""Cameras, Calibrate and Live from ``camera:N``, with a video in place of the device in every process."""

from __future__ import annotations

import importlib.util
import json
import struct
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

import lmkit
from lmkit.web import camera_clocks, cameras
from lmkit.web.camera_clocks import time_between
from lmkit.web.cameras import APART_S

STUB = Path(__file__).parent / "film_cameras"
BOARD = "chessboard:9x6:25mm"


@pytest.fixture
def room(tmp_path, monkeypatch, serve):
    """A page on a machine with camera:0 and camera:2, left and right before the landmarks of a surveyed room."""
    example = tmp_path / "example"
    lmkit.write_example_files(example, board_pairs=0, seconds=1)
    films, rng = {}, np.random.default_rng(0)
    (tmp_path / "dev").mkdir()
    for number, side in ((0, "left"), (2, "right")):
        image = cv2.imread(str(example / f"{side}.png"))
        films[number] = str(tmp_path / f"{side}.avi")
        film = cv2.VideoWriter(films[number], cv2.VideoWriter.fourcc(*"MJPG"), 10, image.shape[1::-1])
        for _ in range(4):  # with the noise of a camera, so that no image repeats the one before
            film.write(np.clip(image + rng.normal(0, 2, image.shape), 0, 255).astype(np.uint8))
        film.release()
        (tmp_path / f"dev/video{number}").touch()
    (tmp_path / "dev/video-other").touch()
    monkeypatch.setenv("FILM_CAMERAS", json.dumps(films))
    monkeypatch.setenv("PYTHONPATH", str(STUB))
    monkeypatch.setattr(cameras, "DEVICES", tmp_path / "dev")
    monkeypatch.setattr(cv2, "VideoCapture", cv2.VideoCapture)  # the stub replaces it in this process too
    spec = importlib.util.spec_from_file_location("film_cameras", STUB / "sitecustomize.py")
    spec.loader.exec_module(importlib.util.module_from_spec(spec))
    for name in ("rig", "map"):
        (tmp_path / f"room/{name}.yaml").parent.mkdir(exist_ok=True)
        (tmp_path / f"room/{name}.yaml").write_bytes((example / f"{name}.yaml").read_bytes())
    with serve(tmp_path / "room") as page:
        yield page


@pytest.mark.slow
def test_cameras_calibrate_and_live_run_from_cameras_by_number(room):
    assert room.get("/api/cameras").json()["cameras"] == ["camera:0", "camera:2"]
    seen = room.post("/api/cameras/look", json={"sources": ["camera:0", "camera:2"]}).json()
    assert all(len(v["landmarks"]) > 1 and not v["faults"] for v in seen["views"])
    assert 0 <= seen["apart_s"] <= 0.05 and len(seen["problems"]) == (seen["apart_s"] > APART_S)

    body = {"source": "camera:0", "second": "camera:2", "board": BOARD}
    job = room.post("/api/jobs/guide", json=body).json()
    guided = _progress_of(room, job, lambda p: p.get("done", 0) > 2)
    assert guided["image"].startswith("data:image/jpeg") and "total" in guided and guided["total"] is None
    room.post(f"/api/jobs/{job['id']}/cancel")

    job = room.post("/api/jobs/run", json=body).json()
    assert job["command"] == "lmkit run camera:0 camera:2 --rig rig.yaml --map map.yaml"
    with room.websocket_connect("/api/live", headers={"host": "127.0.0.1:8600"}) as socket:
        for _ in range(100):
            data = socket.receive_bytes()
            length = struct.unpack("<I", data[:4])[0]
            state = json.loads(data[4 : 4 + length])
            if state["status"] == "ok" and len(data) > 4 + length:
                break
    assert state["status"] == "ok" and data[4 + length :].startswith(b"\xff\xd8")
    assert [source["name"] for source in state["sources"]] == ["camera:0", "camera:2"]
    room.post(f"/api/jobs/{job['id']}/cancel")


def _progress_of(room, job, holds):
    for _ in range(300):
        now = room.get(f"/api/jobs/{job['id']}").json()
        assert now["state"] in ("waiting", "running"), now
        if now["progress"] and holds(now["progress"]):
            return now["progress"]
        time.sleep(0.1)
    raise AssertionError("the job tells nothing")


def test_the_time_between_two_cameras_is_that_of_their_nearest_images(monkeypatch):
    class Regular:
        """Ten images a second, the first one at ``start_s``."""

        def __init__(self, start_s):
            self._next_s = start_s

        def read(self):
            self._next_s += 0.1
            return self._next_s, ()

        def close(self):
            pass

    starts = {"camera:0": 5.0, "camera:2": 5.287}
    monkeypatch.setattr(camera_clocks, "open_capture", lambda address, clock: Regular(starts[address.text]))
    assert time_between(["camera:0", "camera:2"]) == pytest.approx(0.013)


@pytest.mark.parametrize(
    ("source", "second", "code"),
    [
        ("camera:0", "camera:0", "unpaired"),
        ("camera:0", "runs/a.mcap", "unpaired"),
        ("camera:0", "../camera:1", "unpaired"),
        ("camera:0", "camera:1", "no_rig"),
        ("camera:100", "", "no_recording"),
    ],
)
def test_cameras_that_cannot_run_are_refused(client, source, second, code):
    assert client.post("/api/jobs/run", json={"source": source, "second": second}).json()["code"] == code
