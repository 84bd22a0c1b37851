"""Every endpoint: good, wrong and hostile requests."""

from __future__ import annotations

import io
import json
import os
import struct
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

import lmkit
from lmkit.errors import InputError, NegativeAnswer
from lmkit.geometry.pose import Pose
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark, wall_pose
from lmkit.simulation.scene import make_rig
from lmkit.web.answers import MAX_JSON, MAX_UPLOAD
from lmkit.web.app import build_app, state_of_app
from lmkit.web.live import IMAGE, LiveHub, image_of, innovation_band
from lmkit.web.project import open_project
from lmkit.web.verbs import VERBS, JobBody
from lmkit.web.workers import Workers

HOSTILE = [
    "../secret", "..%2fsecret", "%2e%2e/secret", "/etc/passwd", "prints/../../secret", "prints\\..\\secret",
    ".lmkit-undo/x", "prints/.hidden", "prints/a%00b", "reports/" + "a" * 300, "map.yaml", "photos/link/secret",
]  # fmt: skip


@pytest.fixture(scope="module")
def printed(client):
    return client.post("/api/prints/pdf", json={"codes": "3,7", "size": "60mm"}).json()


@pytest.fixture
def mapped(tmp_path):
    """A page over a project with a map of three landmarks."""
    places = [(1.0, 0.0, 1.2), (3.0, 0.0, 1.2), (4.0, 2.0, 1.3)]
    landmarks = [
        MappedLandmark(LandmarkId("lm8", 5 + k), 0.18, wall_pose(p, np.radians(90 + 45 * k)), 1e-6 * np.eye(6))
        for k, p in enumerate(places)
    ]
    lmkit.write_map(LandmarkMap(landmarks), tmp_path / "map.yaml")
    with TestClient(build_app(open_project(tmp_path), workers=Workers(0)), base_url="http://localhost:8600") as page:
        yield page, tmp_path


def test_a_print_is_previewed_and_its_command_parses(client):
    p = client.post("/api/prints/preview", json={"codes": "0-11", "size": "180mm", "paper": "a4"}).json()
    assert (p["landmarks"], p["count"], len(p["pages"])) == (12, 12, 6)
    assert p["pages"][0]["svg"].startswith("<?xml") and p["command"].startswith("lmkit generate --codes 0-11")
    assert p["reads_from_m"] == pytest.approx(0.18 * 600 / 17.5)


def test_the_pdf_is_proven_and_can_be_fetched(client, printed, folder):
    assert printed["landmarks"] == 2
    reply = client.get(f"/api/files/{printed['file']}?download")
    assert reply.content[:4] == b"%PDF" and "sandbox" in reply.headers["content-security-policy"]
    assert reply.headers["content-disposition"].startswith("attachment")
    assert (folder / f"{printed['file']}.json").is_file()


@pytest.mark.parametrize(
    ("body", "code"),
    [
        ({"codes": "0-99999"}, None),
        ({"codes": "x"}, None),
        ({"codes": "1", "size": "-4mm"}, None),
        ({"codes": "1", "template": "../../etc/passwd"}, "unknown_template"),
        ({"codes": "1", "family": "nope"}, "unknown_family"),
        ({"codes": "1", "else": 1}, "bad_value"),
        ({}, "bad_value"),
    ],
)
def test_a_wrong_print_is_refused_with_a_hint(client, body, code):
    for end in ("preview", "pdf"):
        reply = client.post(f"/api/prints/{end}", json=body)
        assert reply.status_code == 400 and reply.json()["hint"]
        assert code is None or reply.json()["code"] == code


def test_bodies_are_bounded_and_must_be_json(client):
    assert client.post("/api/prints/preview", content=b"{" * (MAX_JSON + 2)).status_code == 413
    assert client.post("/api/prints/preview", content=b"\xff{").status_code == 400
    assert client.put("/api/prints/preview", json={}).status_code == 405


def test_the_check_of_a_print_finds_what_is_printed(client, printed, folder):
    data = (folder / printed["file"]).read_bytes()
    name = client.put("/api/photos/scan.pdf", content=data).json()["name"]
    checked = client.post(f"/api/photos/{name}/check", json={"print": printed["file"]}).json()
    assert sorted(r["code"] for r in checked["results"]) == [3, 7]
    assert all(r["grade"] == "A" for r in checked["results"])
    assert checked["results"][0]["image"].startswith("data:image/jpeg;base64,")
    assert len(checked["history"]["lm8:3"]) == 1
    made = client.post(f"/api/photos/{name}/certificate", json={}).json()
    assert client.get(f"/api/files/{made['file']}").content[:4] == b"%PDF"


def test_an_image_without_a_landmark_says_what_to_do(client):
    image = io.BytesIO()
    Image.fromarray(np.full((200, 300, 3), 160, np.uint8)).save(image, "PNG")
    name = client.put("/api/photos/plain.png", content=image.getvalue()).json()["name"]
    reply = client.post(f"/api/photos/{name}/check", json={"size": "180mm"})
    assert reply.status_code == 400 and "fill" in reply.json()["hint"]


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("a.png", b"no image"), ("a.png", b""), ("a.svg", b"<svg onload='alert(1)'/>"), ("a.html", b"<script>"),
        ("a.png", b"%PDF-1.7"), ("a.pdf", b"GIF89a"), ("a.png", b"\x89PNG\r\n\x1a\n" + b"\xff" * 99),
    ],
)  # fmt: skip
def test_what_is_no_image_is_not_stored(client, folder, name, data):
    before = set((folder / "photos").glob("*")) if (folder / "photos").exists() else set()
    assert client.put(f"/api/photos/{name}", content=data).status_code == 400
    assert (set((folder / "photos").glob("*")) if (folder / "photos").exists() else set()) == before


@pytest.mark.parametrize("name", HOSTILE)
def test_no_path_leads_out_of_the_project(client, folder, name):
    (folder.parent / "secret").write_text("TOP SECRET")
    (folder / "map.yaml").touch()
    (folder / "photos").mkdir(exist_ok=True)
    link = folder / "photos" / "link"
    if not link.is_symlink():
        link.symlink_to(folder.parent)
    try:
        reply = client.get(f"/api/files/{name}")
        assert reply.status_code in (400, 404) and "TOP" not in reply.text
        with pytest.raises(InputError):
            open_project(folder).public(name)
        assert client.get(f"/static/{name}").status_code in (404, 405)
        body = {"source": name, "board": "chessboard:9x6:25mm"}
        for verb in ("survey", "track", "calibrate", "guide"):
            assert client.post(f"/api/jobs/{verb}", json=body).status_code == 400
    finally:
        link.unlink()
        (folder / "map.yaml").unlink()


def test_foreign_sites_are_refused(client):
    assert client.get("/api/project", headers={"host": "evil.example"}).status_code == 403
    for headers in ({"origin": "http://evil.example"}, {"origin": "null"}, {"sec-fetch-site": "cross-site"}):
        assert client.post("/api/jobs/example", json={}, headers=headers).status_code == 403
    assert client.post(
        "/api/prints/preview", json={"codes": "1"}, headers={"origin": "http://127.0.0.1:8600"}
    ).is_success
    foreign = {"host": "127.0.0.1:8600", "origin": "http://evil.example"}
    with pytest.raises(WebSocketDisconnect), client.websocket_connect("/api/live", headers=foreign):
        pass


def test_with_a_host_every_request_needs_the_token(tmp_path):
    app = build_app(open_project(tmp_path), "sesame", "http://10.0.0.2:8600/?token=sesame", Workers(0))
    with TestClient(app, base_url="http://10.0.0.2:8600") as page:
        for path in ("/", "/static/app.js", "/api/project", "/?token=wrong", "/api/phone.png"):
            assert page.get(path).status_code == 403
        with pytest.raises(WebSocketDisconnect), page.websocket_connect("/api/live"):
            pass
        first = page.get("/?token=sesame", follow_redirects=False)
        assert first.status_code == 303 and first.headers["location"] == "/"
        assert "HttpOnly" in first.headers["set-cookie"] and "samesite=strict" in first.headers["set-cookie"].lower()
        assert page.get("/api/project").json()["address"].endswith("sesame")
        assert page.get("/api/phone.png").content[:4] == b"\x89PNG"


def test_the_page_asks_for_nothing_from_elsewhere(client):
    reply = client.get("/")
    assert "default-src 'none'" in reply.headers["content-security-policy"]
    static = Path(lmkit.__file__).parent / "web/static"
    for path in static.rglob("*.*"):
        text = path.read_text(encoding="utf-8").replace("http://www.w3.org/2000/svg", "")
        assert "http://" not in text and "https://" not in text and "innerHTML" not in text, path.name
    assert sum(path.stat().st_size for path in static.rglob("*.*")) < 500_000


def test_the_map_is_edited_and_undone(mapped):
    page, folder = mapped
    before = page.get("/api/map").json()
    assert [m["id"] for m in before["landmarks"]] == ["lm8:5", "lm8:6", "lm8:7"]
    change = {"id": "lm8:6", "position": [3.5, 0.0, 1.4], "facing_deg": 80.0, "name": "dock"}
    after = page.put("/api/map", json={"version": before["version"], "edits": [change]}).json()
    moved = lmkit.read_map(folder / "map.yaml").find(LandmarkId("lm8", 6))
    assert moved.T_map_landmark.t.tolist() == [3.5, 0.0, 1.4] and moved.covariance is None and moved.name == "dock"
    assert after["landmarks"][1]["facing_deg"] == pytest.approx(80) and after["landmarks"][0]["sigma_m"] is not None
    stale = page.put("/api/map", json={"version": before["version"], "edits": [{"id": "lm8:5", "remove": True}]})
    assert stale.status_code == 409
    gone = page.put("/api/map", json={"version": after["version"], "edits": [{"id": "lm8:5", "remove": True}]}).json()
    assert len(gone["landmarks"]) == 2 and gone["undo"] == 2
    assert page.post("/api/map/undo").json()["version"] == after["version"]
    assert page.post("/api/map/undo").json()["landmarks"] == before["landmarks"]
    assert page.post("/api/map/undo").status_code == 400


def test_turning_a_landmark_keeps_its_tilt(tmp_path):
    from lmkit.web.maps import Edit, _changed, facing_deg

    tilt = Pose("map", "landmark", wall_pose((0, 0, 1), 0.3).R @ _about_x(0.2), np.zeros(3))
    turned = _changed(
        MappedLandmark(LandmarkId("lm8", 1), 0.18, tilt), Edit(id="lm8:1", facing_deg=120)
    ).T_map_landmark
    assert facing_deg(turned.R) == pytest.approx(120) and turned.R[2] == pytest.approx(tilt.R[2])


def _about_x(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


@pytest.mark.parametrize(
    "edits",
    [
        [{"id": "lm8:99", "name": "x"}], [{"id": "lm8:5", "position": [1, 2]}], [{"id": "lm8:5", "size_m": -1}], [],
        [{"id": f"lm8:{k}", "remove": True} for k in (5, 6, 7)], [{"id": "lm8:5", "position": [1e300, 0, 0]}],
    ],
)  # fmt: skip
def test_wrong_edits_change_nothing(mapped, edits):
    page, folder = mapped
    text = (folder / "map.yaml").read_text()
    version = page.get("/api/map").json()["version"]
    assert page.put("/api/map", json={"version": version, "edits": edits}).status_code == 400
    assert (folder / "map.yaml").read_text() == text and page.get("/api/map").json()["undo"] == 0


@pytest.mark.slow
def test_a_survey_and_a_track_run_as_jobs_with_their_reports(tmp_path):
    lmkit.write_example_files(tmp_path / "drives/a", board_pairs=0, seconds=8)
    with TestClient(build_app(open_project(tmp_path), workers=Workers(0)), base_url="http://127.0.0.1:8600") as page:
        survey = _ended(page, page.post("/api/jobs/survey", json={"source": "drives/a"}).json())
        assert survey["state"] == "done", survey
        assert survey["command"].startswith("lmkit survey --detections drives/a/detections.csv")
        assert len(lmkit.read_map(tmp_path / "map.yaml")) > 3 and page.get("/api/map").json()["landmarks"]
        report = page.get(f"/api/files/{survey['outputs'][0]}")
        assert "<html" in report.text and "sandbox" in report.headers["content-security-policy"]
        track = _ended(page, page.post("/api/jobs/track", json={"source": "drives/a"}).json())
        assert track["state"] == "done" and (tmp_path / "reports/drives-a-track.tum").is_file()
        assert [job["verb"] for job in page.get("/api/jobs").json()["jobs"]] == ["track", "survey"]


@pytest.mark.parametrize("size", ["--force", "0", "180 parsecs", ""])
def test_a_survey_of_a_wrong_size_is_not_started(tmp_path, size):
    (tmp_path / "drives/a").mkdir(parents=True)
    (tmp_path / "drives/a/detections.csv").touch()
    (tmp_path / "rig.yaml").touch()
    with TestClient(build_app(open_project(tmp_path), workers=Workers(0)), base_url="http://127.0.0.1:8600") as page:
        assert page.post("/api/jobs/survey", json={"source": "drives/a", "size": size}).status_code == 400
        assert page.get("/api/jobs").json()["jobs"] == []


def test_a_job_is_cancelled_and_another_follows(tmp_path):
    with TestClient(build_app(open_project(tmp_path), workers=Workers(0)), base_url="http://127.0.0.1:8600") as page:
        first = page.post("/api/jobs/example", json={}).json()
        time.sleep(0.5)
        page.post(f"/api/jobs/{first['id']}/cancel")
        ended = _ended(page, first)
        assert ended["state"] == "cancelled" and ended["seconds"] < 20
        assert page.get("/api/jobs/99").status_code == 404
        assert page.post("/api/jobs/format-disk", json={}).status_code == 404


@pytest.mark.slow
def test_a_job_that_fails_says_why(tmp_path):
    lmkit.write_example_files(tmp_path / "drives/a", board_pairs=0, seconds=2)
    (tmp_path / "drives/a/detections.csv").write_text("nonsense\n")
    with TestClient(build_app(open_project(tmp_path), workers=Workers(0)), base_url="http://127.0.0.1:8600") as page:
        job = _ended(page, page.post("/api/jobs/survey", json={"source": "drives/a"}).json())
        assert job["state"] == "failed" and "detections.csv" in job["error"] and not (tmp_path / "map.yaml").exists()


def _ended(page, job):
    for _ in range(600):
        job = page.get(f"/api/jobs/{job['id']}").json()
        if job["state"] not in ("waiting", "running"):
            return job
        time.sleep(0.1)
    raise AssertionError(f"still {job['state']}")


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
    jpeg = image_of(step)
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


def test_a_run_from_the_page_names_its_command_and_its_recording(tmp_path):
    project = open_project(tmp_path)
    plan = VERBS["run"](project, JobBody(source="sim:", record=True))
    assert plan.command == "lmkit run sim: --record runs/run.mcap" and plan.outputs == ("runs/run.mcap",)
    (tmp_path / "run.yaml").write_text("sources: ['sim:']\n")
    assert VERBS["run"](project, JobBody(source="run.yaml")).command == "lmkit run run.yaml"
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs/run.mcap").touch()
    assert VERBS["run"](project, JobBody(source="runs/run.mcap")).command == "lmkit run replay:runs/run.mcap"
    with pytest.raises(InputError):
        VERBS["run"](project, JobBody(source="camera:0"))


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
    drawn = np.asarray(Image.open(io.BytesIO(image_of(state))))
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


def test_work_in_processes_ends_when_it_takes_too_long():
    import asyncio
    import os

    async def try_all():
        workers = Workers(1, longest_s=60)
        try:
            assert await workers.run(abs, -3) == 3
            with pytest.raises(InputError, match="reading this file failed"):
                await workers.run(os._exit, 3)
            assert await workers.run(abs, -4) == 4
            workers._longest_s = 0.2
            with pytest.raises(InputError, match="not done"):
                await workers.run(time.sleep, 60)
        finally:
            workers.close()

    asyncio.run(try_all())


@pytest.mark.slow
def test_a_look_through_the_cameras_names_what_is_wrong(tmp_path):
    lmkit.write_example_files(tmp_path / "room", board_pairs=0, seconds=1)
    for kind in ("good", "swapped", "gray"):
        for side, other in (("left", "right"), ("right", "left")):
            image = Image.open(tmp_path / "room" / f"{other if kind == 'swapped' else side}.png")
            image = image.convert("L") if kind == "gray" else image
            (tmp_path / f"drives/{kind}/{side}").mkdir(parents=True)
            image.save(tmp_path / f"drives/{kind}/{side}/1.png")
    with TestClient(build_app(open_project(tmp_path), workers=Workers(0)), base_url="http://127.0.0.1:8600") as page:
        assert "drives/good" in page.get("/api/cameras").json()["stand_ins"]
        good, swapped, gray = (
            page.post("/api/cameras/look", json={"sources": [f"drives/{kind}"]}).json()
            for kind in ("good", "swapped", "gray")
        )
        assert [v["faults"] for v in good["views"]] == [[], []] and not good["problems"]
        assert len(good["views"][0]["landmarks"]) > 1 and "drives/good/left" in good["command"]
        assert "swapped" in swapped["problems"][0]
        assert "gray" in gray["views"][0]["faults"][0]
        missing = page.post("/api/cameras/look", json={"sources": ["camera:63"]}).json()
        assert "camera:63" in missing["views"][0]["error"]
        for hostile in ("camera:x", "../room", "/dev/zero", "rtsp://e.x", "room", ""):
            assert page.post("/api/cameras/look", json={"sources": [hostile]}).status_code == 400


def test_the_rig_is_replaced_and_undone(tmp_path):
    lmkit.write_rig(make_rig(), tmp_path / "other.yaml")
    first = (tmp_path / "other.yaml").read_bytes()
    other = first.replace(b"lmkit-rig/1", b"lmkit-rig/9")
    with TestClient(
        build_app(open_project(tmp_path / "room"), workers=Workers(0)), base_url="http://localhost"
    ) as page:
        assert page.get("/api/rig").json() == {"cameras": [], "undo": 0}
        shown = page.put("/api/rig", content=first).json()
        assert [c["name"] for c in shown["cameras"]] == ["left", "right"] and shown["undo"] == 0
        text = (tmp_path / "room/rig.yaml").read_text()
        for wrong in (b"", b"\xff\xfe", b"{", other, b"- 1\n" * 9, b"a: &a [*a]", b"[" * 20_000, b"cameras: []"):
            reply = page.put("/api/rig", content=wrong)
            assert reply.status_code == 400 and reply.json()["hint"] and str(tmp_path) not in reply.text
            assert "/tmp" not in reply.text and (tmp_path / "room/rig.yaml").read_text() == text
        assert page.put("/api/rig", content=b" " * (MAX_JSON + 1)).status_code == 413
        assert page.put("/api/rig", content=first).json()["undo"] == 1
        assert page.post("/api/rig/undo").json()["undo"] == 0 and page.post("/api/rig/undo").status_code == 400


def test_an_upload_may_have_64_mib_and_no_byte_more(client, folder, monkeypatch):
    from lmkit.web import photos

    assert MAX_UPLOAD == 64 << 20
    before = set(folder.rglob("*"))
    assert client.put("/api/photos/large.png", content=bytes(MAX_UPLOAD + 1)).json()["code"] == "too_large"
    monkeypatch.setattr(photos, "MAX_UPLOAD", 1000)
    image = io.BytesIO()
    Image.fromarray(np.zeros((8, 8, 3), np.uint8)).save(image, "PNG")
    full = image.getvalue() + bytes(1000 - len(image.getvalue()))
    assert client.put("/api/photos/full.png", content=full).is_success
    assert client.put("/api/photos/over.png", content=full + b"0").status_code == 413
    assert {p.name for p in set(folder.rglob("*")) - before} <= {"full.png", "photos"}


def test_planning_jobs_name_their_commands_and_what_is_missing(mapped):
    page, folder = mapped
    project = open_project(folder)
    for verb, code in (("coverage", "no_floor"), ("place", "no_floor")):
        assert page.post(f"/api/jobs/{verb}", json={}).json()["code"] == code
    assert VERBS["sheet"](project, JobBody()).command == (
        "lmkit plan sheet --map map.yaml -o reports/mounting-sheet.pdf --force"
    )
    (folder / "floor.yaml").touch()
    assert page.post("/api/jobs/coverage", json={}).json()["code"] == "no_rig"
    (folder / "rig.yaml").touch()
    plan = VERBS["place"](project, JobBody(error="3cm", camera_height="40cm"))
    assert "--floor floor.yaml --rig rig.yaml --error 3cm --camera-height 40cm --map map.yaml" in plan.command
    for body in ({"error": "--force"}, {"camera_height": "-o x"}, {"error": ""}):
        assert page.post("/api/jobs/coverage", json=body).status_code == 400
