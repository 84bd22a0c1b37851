"""`lmkit.calibrate` of a list of cameras."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

import lmkit
from lmkit.errors import InputError
from lmkit.model.board import BoardSpec
from lmkit.pipelines import rig_views


def test_three_folders_are_a_rig(monkeypatch):
    given = []
    monkeypatch.setattr(rig_views, "calibrate_sources", lambda *values: given.append(values) or "rig")
    assert lmkit.calibrate([Path("front"), "side", "rear"], board="chessboard:9x6:25mm", model="pinhole") == "rig"
    sources, board, model, _ = given[0]
    assert (sources, str(board), model) == (["front", "side", "rear"], "chessboard:9x6:25mm", "pinhole")


@pytest.mark.parametrize(("left", "right"), [(["a", "b"], None), (["a", "b", "c"], "d")])
def test_two_cameras_are_no_list(left, right):
    with pytest.raises(InputError, match="no rig"):
        lmkit.calibrate(left, right, "chessboard:9x6:25mm")


def test_an_image_without_a_partner_serves_its_own_camera_alone(monkeypatch):
    found = SimpleNamespace(
        board=BoardSpec.parse("charuco:4x5:54mm:40mm:DICT_4X4_50"),
        views=[("0", "corners"), ("7", "more")],
        image_size=(9, 9),
        rejected=(),
    )
    calibrated = []
    monkeypatch.setattr(rig_views, "list_groups", lambda sources: [tuple(Path(s) / "0.png" for s in sources)])
    monkeypatch.setattr(rig_views, "find_board_images", lambda *_: found)
    monkeypatch.setattr(
        rig_views,
        "calibrate_camera",
        lambda views, *_: calibrated.append(len(views)) or SimpleNamespace(used=[name for name, _ in views]),
    )
    monkeypatch.setattr(rig_views, "calibrate_rig", lambda names, cameras, seen, board: seen)
    assert rig_views.calibrate_sources(["a", "b", "c"], found.board) == [{"0": "corners"}] * 3
    assert calibrated == [2, 2, 2]
