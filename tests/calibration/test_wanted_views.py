"""The view wanted next as a place in the image, and why a board is not found."""

from __future__ import annotations

import numpy as np
import pytest
from board_views import BOARD

from lmkit.calibration.capture_guide import CaptureGuide
from lmkit.calibration.view_coverage import WantedView, coverage_of
from lmkit.geometry.camera import CameraModel
from lmkit.model.board import BoardSpec
from lmkit.model.observation import PairView
from lmkit.pipelines.board_absence import explain_absence

CAMERA = CameraModel((640, 480), np.array([[600, 0, 319.5], [0, 600, 239.5], [0, 0, 1.0]]), np.zeros(5))
SPEC = BoardSpec.parse("chessboard:9x6:25mm")


def test_a_board_held_where_the_ghost_is_completes_the_views():
    views, rotations, translations = [], [], []
    ids = np.arange(len(BOARD.object_points))
    for _ in range(40):
        coverage = coverage_of(views, np.array(rotations).reshape(-1, 3, 3), np.array(translations).reshape(-1, 3),
                               (640, 480), (640, 480))  # fmt: skip
        if coverage.wanted is None:
            break
        R, t = coverage.wanted.pose(BOARD.object_points, CAMERA)
        points = CAMERA.project(BOARD.object_points @ R.T + t)
        views.append(PairView(f"{len(views)}", ids, points, ids, points))
        rotations.append(R)
        translations.append(t)
    assert coverage.advice == () and 10 <= len(views) < 20


@pytest.mark.parametrize("center", [(0.2, 0.2), (0.5, 0.5), (0.8, 0.2), (0.2, 0.8)])
@pytest.mark.parametrize("tilt", [(0.0, 0.0), (35.0, 0.0), (0.0, -35.0)])
def test_the_outline_is_where_the_view_is_wanted(center, tilt):
    outline = WantedView(center=center, fills=0.4, tilt_deg=tilt).outline(BOARD.object_points, CAMERA)
    diagonals = np.cross([*outline[0], 1], [*outline[2], 1]), np.cross([*outline[1], 1], [*outline[3], 1])
    middle = np.cross(*diagonals)
    assert middle[:2] / middle[2] == pytest.approx(np.array(center) * [640, 480])
    left, right = np.linalg.norm(outline[3] - outline[0]), np.linalg.norm(outline[2] - outline[1])
    if center == (0.5, 0.5):
        assert np.sign(round(right - left)) == np.sign(tilt[0])  # positive: the right edge is nearer


def test_the_guide_shows_no_ghost_where_no_view_is_wanted():
    guide = CaptureGuide(BOARD.object_points, (640, 480))
    side, outline = guide.ghost(guide.coverage)
    assert side == 0 and outline.shape == (4, 2)


def chessboard(columns=9, rows=6, square=40, margin=60, brightness=220):
    """A chessboard with this number of inner corners on white, (H,W,3)."""
    squares = np.add.outer(np.arange(rows + 1), np.arange(columns + 1)) % 2
    board = np.kron(squares, np.ones((square, square))) * (brightness - 20) + 20
    page = np.pad(board, margin, constant_values=brightness).astype(np.uint8)
    return np.repeat(page[:, :, None], 3, axis=2)


@pytest.mark.parametrize(
    ("image", "words"),
    [
        (chessboard(brightness=30), "dark"),
        (np.full((480, 640, 3), 128, np.uint8), "no chessboard in view"),
        (chessboard(10, 7), "a board of 10 x 7 inner corners, not 9 x 6"),
        (np.ascontiguousarray(chessboard()[:, 200:]), "too near, or cut off"),
        (chessboard(8, 5), "8 x 5 of 9 x 6 inner corners are in view: a hand"),
    ],
    ids=["dark", "none", "size", "cut", "smaller"],
)
def test_a_board_that_is_not_found_is_explained(image, words):
    assert words in explain_absence(image, SPEC)


def test_a_mirrored_charuco_board_is_named():
    from lmkit.model.charuco import charuco_board

    spec = BoardSpec.parse("charuco:6x4:30mm:22mm:DICT_4X4_50")
    drawn = charuco_board(spec).generateImage((720, 480), marginSize=30)
    image = np.repeat(np.ascontiguousarray(drawn[:, ::-1])[:, :, None], 3, axis=2)
    assert "mirrored" in explain_absence(image, spec)
