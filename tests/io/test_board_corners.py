"""Corner files: a calibration repeated without its images comes out the same."""

from __future__ import annotations

import json

import numpy as np
import pytest
from board_views import BOARD, views

from lmkit.errors import InputError
from lmkit.io.board_corners import SavedCorners, corners_to_json, read_corners


def test_corners_come_back(tmp_path):
    path = tmp_path / "corners.json"
    board = BOARD.measured(251.0, 174.0)
    saved = SavedCorners(board, (640, 480), tuple(views(4, 0.1)), (("09", "blurred"),))
    path.write_text(corners_to_json(saved))
    read = read_corners(path)
    assert read.board == board
    assert read.image_size == (640, 480)
    assert read.rejected == (("09", "blurred"),)
    for one, other in zip(saved.views, read.views, strict=True):
        assert np.array_equal(one.ids_left, other.ids_left)
        assert np.array_equal(one.right, other.right)  # to the last bit: the fit repeats exactly
        assert one.noise_left == other.noise_left


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda d: d.update(format="lmkit-corners/7"), "format"),
        (lambda d: d.update(extra=1), "extra: unknown key"),
        (lambda d: d["pairs"][1]["left"]["ids"].__setitem__(0, 999), "pairs[1].left"),
        (lambda d: d["pairs"][0]["right"]["points"].pop(), "pairs[0].right"),
        (lambda d: d["pairs"][0]["left"]["ids"].__setitem__(0, 1), "pairs[0].left"),
        (lambda d: d.update(board="chessboard:big"), "chessboard:big"),
    ],
)
def test_what_is_wrong_is_named(change, named, tmp_path):
    path = tmp_path / "corners.json"
    data = json.loads(corners_to_json(SavedCorners(BOARD, (640, 480), tuple(views(2, 0.1)), ())))
    change(data)
    path.write_text(json.dumps(data))
    with pytest.raises(InputError) as caught:
        read_corners(path)
    assert named in caught.value.message
