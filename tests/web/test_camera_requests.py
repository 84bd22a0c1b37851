"""Cameras and their rig."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import lmkit
from lmkit.simulation.scene import make_rig
from lmkit.web.answers import MAX_JSON


@pytest.mark.slow
def test_a_look_through_the_cameras_names_what_is_wrong(serve, tmp_path):
    lmkit.write_example_files(tmp_path / "room", board_pairs=0, seconds=1)
    for kind in ("good", "swapped", "gray"):
        for side, other in (("left", "right"), ("right", "left")):
            image = Image.open(tmp_path / "room" / f"{other if kind == 'swapped' else side}.png")
            image = image.convert("L") if kind == "gray" else image
            (tmp_path / f"drives/{kind}/{side}").mkdir(parents=True)
            image.save(tmp_path / f"drives/{kind}/{side}/1.png")
    with serve(tmp_path) as page:
        assert "drives/good" in page.get("/api/cameras").json()["stand_ins"]
        good, swapped, gray = (
            page.post("/api/cameras/look", json={"sources": [f"drives/{kind}"]}).json()
            for kind in ("good", "swapped", "gray")
        )
        assert [v["faults"] for v in good["views"]] == [[], []] and not good["problems"]
        assert len(good["views"][0]["landmarks"]) > 1 and "drives/good/left" in good["command"]
        assert "swapped" in swapped["problems"][0]["message"]
        assert "gray" in gray["views"][0]["faults"][0]
        missing = page.post("/api/cameras/look", json={"sources": ["camera:63"]}).json()
        assert "camera:63" in missing["views"][0]["error"]
        for hostile in ("camera:x", "../room", "/dev/zero", "rtsp://e.x", "room", ""):
            assert page.post("/api/cameras/look", json={"sources": [hostile]}).status_code == 400


def test_the_rig_is_replaced_and_undone(serve, tmp_path):
    lmkit.write_rig(make_rig(), tmp_path / "other.yaml")
    first = (tmp_path / "other.yaml").read_bytes()
    other = first.replace(b"lmkit-rig/1", b"lmkit-rig/9")
    with serve(tmp_path / "room") as page:
        assert page.get("/api/rig").json() == {"cameras": [], "undo": 0, "mount": None}
        shown = page.put("/api/rig", content=first).json()
        assert [c["name"] for c in shown["cameras"]] == ["left", "right"] and shown["undo"] == 1
        assert [c["apart_m"] for c in shown["cameras"]] == pytest.approx([0.0, make_rig().baseline_m])
        text = (tmp_path / "room/rig.yaml").read_text()
        for wrong in (b"", b"\xff\xfe", b"{", other, b"- 1\n" * 9, b"a: &a [*a]", b"[" * 20_000, b"cameras: []"):
            reply = page.put("/api/rig", content=wrong)
            assert reply.status_code == 400 and reply.json()["hint"] and str(tmp_path) not in reply.text
            assert "/tmp" not in reply.text and (tmp_path / "room/rig.yaml").read_text() == text
        assert page.put("/api/rig", content=b" " * (MAX_JSON + 1)).status_code == 413
        assert page.put("/api/rig", content=first).json()["undo"] == 1  # the same rig again is no change
        assert page.post("/api/rig/undo").json()["undo"] == 0 and not (tmp_path / "room/rig.yaml").exists()
        assert page.post("/api/rig/undo").status_code == 400


def test_the_left_camera_is_placed_on_the_robot(tmp_path, serve):
    place = {"height_m": 0.85, "forward_m": 0.1, "left_m": 0.06, "turned_deg": 30.0, "raised_deg": 10.0}
    with serve(tmp_path) as page:
        assert page.put("/api/rig/mount", json=place).json()["code"] == "no_rig"
        lmkit.write_rig(replace(make_rig(), T_base_left=None), tmp_path / "rig.yaml")
        assert page.get("/api/rig").json()["mount"] is None
        assert page.put("/api/rig/mount", json=place).json()["mount"] == pytest.approx(place)
        T = lmkit.read_rig(tmp_path / "rig.yaml").T_base_left
        ahead, right = np.cos(np.radians(10)), np.array([0.5, -np.sqrt(0.75), 0.0])
        assert T.R[:, 2] == pytest.approx([ahead * np.sqrt(0.75), ahead / 2, np.sin(np.radians(10))])
        assert T.R[:, 0] == pytest.approx(right) and T.t.tolist() == [0.1, 0.06, 0.85]  # level, and not upside down
        for wrong in ({"height_m": 0}, place | {"raised_deg": 100}, place | {"left_m": 1e9}):
            assert page.put("/api/rig/mount", json=wrong).status_code == 400
        assert page.post("/api/rig/undo").json()["mount"] is None
