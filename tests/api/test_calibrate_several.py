"""`lmkit.calibrate` of a list of cameras."""

from __future__ import annotations

from pathlib import Path

import pytest

import lmkit
from lmkit.errors import InputError
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
