"""The map, its pins and its walls: edits, undo, and requests that are refused."""

from __future__ import annotations

import numpy as np
import pytest

import lmkit
from lmkit.geometry.pose import Pose
from lmkit.io.floor_plan import read_floor
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import MappedLandmark, wall_pose
from lmkit.web.project import open_project


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


def test_a_pin_holds_in_the_next_survey_and_goes_with_its_landmark(mapped):
    from lmkit.web.verbs import VERBS, JobBody

    page, folder = mapped
    (folder / "drives/a").mkdir(parents=True)
    (folder / "drives/a/detections.csv").touch()
    (folder / "rig.yaml").touch()

    def command():
        body = JobBody(source="drives/a", walls=("5,6",), heights=("6,7",))
        return VERBS["survey"](open_project(folder), body).command

    assert "--known map.yaml --known-sigma 20mm,2deg" in command() and "--wall 5,6 --same-height 6,7" in command()
    shown = _edit(page, {"id": "lm8:6", "pin_mm": 4.0})
    assert shown["pins"] == {"lm8:6": pytest.approx(4.0)} and "--known pins.yaml " in command()
    shown = _edit(page, {"id": "lm8:6", "position": [3.5, 0.0, 1.4]})
    pin = lmkit.read_map(folder / "pins.yaml").find(LandmarkId("lm8", 6))
    assert pin.T_map_landmark.t.tolist() == [3.5, 0.0, 1.4] and pin.covariance[0, 0] == pytest.approx(16e-6)
    assert _edit(page, {"id": "lm8:6", "pin_mm": 0.0})["pins"] == {} and not (folder / "pins.yaml").exists()
    assert page.post("/api/map/undo").json()["pins"] == {"lm8:6": pytest.approx(4.0)}
    assert page.post("/api/map/undo").json()["landmarks"][1]["position"] == [3.0, 0.0, 1.2]
    assert page.post("/api/map/undo").json()["pins"] == {} and page.post("/api/map/undo").status_code == 400
    for codes in ("5", "5,--force", "5 6", ",,"):
        assert page.post("/api/jobs/survey", json={"source": "drives/a", "walls": [codes]}).status_code == 400


def _edit(page, change):
    version = page.get("/api/map").json()["version"]
    return page.put("/api/map", json={"version": version, "edits": [change]}).json()


ROOM = [((0, 0), (4, 0)), ((4, 0), (4, 3)), ((4, 3), (0, 3)), ((0, 3), (0, 0))]


def _walls(lines):
    return [{"start": start, "end": end} for start, end in lines]


def test_walls_are_written_and_undone_in_the_order_of_the_edits(mapped):
    page, folder = mapped
    assert page.get("/api/floor").json()["walls"] == []
    shown = page.put("/api/floor", json={"version": "", "walls": _walls(ROOM[:2])}).json()
    assert len(shown["walls"]) == 2 and shown["gap"]
    _edit(page, {"id": "lm8:6", "name": "dock"})
    walls = [*_walls(ROOM[:3]), _walls(ROOM)[3] | {"name": "glass", "landmarks": False}]
    shown = page.put("/api/floor", json={"version": shown["version"], "walls": walls}).json()
    assert (
        shown["problem"] is shown["gap"] is None
        and shown["walls"][3]["name"] == "glass"
        and not shown["walls"][3]["landmarks"]
    )
    assert read_floor(folder / "floor.yaml").is_free(np.array([2.0, 1.5]))
    assert len(page.get("/api/live/map").json()["walls"]) == 4
    assert len(page.post("/api/map/undo").json()["floor"]["walls"]) == 2
    assert page.post("/api/map/undo").json()["landmarks"][1]["name"] is None
    assert page.post("/api/map/undo").json()["floor"]["walls"] == [] and not (folder / "floor.yaml").exists()
    (folder / "floor.yaml").write_text("walls: 3\n")
    shown = page.get("/api/floor").json()
    assert shown["walls"] == [] and "lmkit-floor" in shown["problem"] and shown["hint"]


def test_walls_that_do_not_close_say_where(mapped):
    page, _ = mapped
    short = [ROOM[3][0], (ROOM[3][0][0], ROOM[3][0][1] + 0.8 * (ROOM[3][1][1] - ROOM[3][0][1]))]
    shown = page.put("/api/floor", json={"version": "", "walls": _walls([*ROOM[:3], short])}).json()
    assert any(shown["gap"] == pytest.approx(end) for end in (short[1], ROOM[0][0]))  # both ends of the gap
    inner = [(1.0, 1.0), (2.0, 1.0)]  # a free-standing wall in a room neither closes nor opens anything
    shown = page.put("/api/floor", json={"version": shown["version"], "walls": _walls([*ROOM, inner])}).json()
    assert shown["gap"] is None


def test_places_of_a_floor_plan_survive_its_edits_and_other_plans_are_taken(mapped):
    page, folder = mapped
    text = "format: lmkit-floor/1\nwalls:\n" + "".join(f"  - {{from: {list(a)}, to: {list(b)}}}\n" for a, b in ROOM)
    places = "places:\n  dock: {position: [1, 1], heading_deg: 90}\n"
    shown = page.put("/api/floor/plan.yaml", content=(text + places).encode()).json()
    walls = [*shown["walls"][:3], shown["walls"][3] | {"name": "door"}]
    page.put("/api/floor", json={"version": shown["version"], "walls": walls})
    assert read_floor(folder / "floor.yaml").places["dock"] == pytest.approx((1, 1, np.pi / 2))
    path = b'<path fill="none" stroke="black" d="M0 0H500V400H0Z"/>'
    svg = b'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 500 400">' + path + b"</svg>"
    shown = page.put("/api/floor/plan.svg?scale=0.01", content=svg).json()
    assert len(shown["walls"]) == 4 and shown["problem"] is None
    assert {tuple(w["start"]) for w in shown["walls"]} <= {(0, 0), (5, 0), (5, 4), (0, 4)}


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("a.svg", b"<svg"), ("a.svg?scale=x", b"<svg/>"), ("a.svg?scale=-1", b"<svg/>"), ("a.html", b"x"),
        ("a.png?scale=0.01", b"no image"), ("a.png", b""), ("a.yaml", b"walls: []"), ("a.yaml", b"a: &a [*a]"),
        ("a.yaml", b"image: /etc/passwd\nresolution: 1\norigin: [0, 0, 0]"),
        ("a.svg?scale=0.01", b'<!DOCTYPE s [<!ENTITY e SYSTEM "file:///etc/passwd">]><svg>&e;</svg>'),
    ],
)  # fmt: skip
def test_what_is_no_floor_plan_is_not_taken(mapped, name, data):
    page, folder = mapped
    reply = page.put(f"/api/floor/{name}", content=data)
    assert (
        reply.status_code == 400 and reply.json()["hint"] and "/tmp" not in reply.text and "root:" not in reply.text
    )
    assert not (folder / "floor.yaml").exists() and page.get("/api/map").json()["undo"] == 0


@pytest.mark.parametrize(
    "walls",
    [[{"start": [0, 0], "end": [0, 0]}], [{"start": [0], "end": [1, 0]}], [{"start": [0, 1e300], "end": [1, 0]}],
     [{"start": [0, 0], "end": [1, 0], "name": "x" * 99}], [{"start": [0, 0], "end": [1, 0]}] * 2001],
)  # fmt: skip
def test_wrong_walls_change_nothing(mapped, walls):
    page, folder = mapped
    assert page.put("/api/floor", json={"version": "", "walls": walls}).status_code == 400
    assert page.put("/api/floor", json={"version": "stale", "walls": _walls(ROOM)}).status_code == 409
    assert not (folder / "floor.yaml").exists()
