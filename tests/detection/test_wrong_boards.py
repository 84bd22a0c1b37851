"""If the images show another board than the one given, the message names it; a right board is never refused."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from lmkit.detection.boards import detect_board, likelier_board, same_orientation
from lmkit.errors import InputError
from lmkit.model.board import BoardSpec
from lmkit.model.charuco import charuco_board
from lmkit.pipelines.board_views import checked_board


def chessboard(columns: int, rows: int, rim: float = 1.0, background: int = 30, roll: float = 0.1) -> np.ndarray:
    """A board of these inner corners with a white rim, photographed at an angle."""
    square = 25
    n = int(rim * square)
    dark = np.add.outer(np.arange(rows + 1), np.arange(columns + 1)) % 2 == 0
    face = np.pad(np.kron(np.where(dark, 20, 235), np.ones((square, square))), n, constant_values=235)
    return photographed(face.astype(np.uint8), background, roll)


def photographed(face: np.ndarray, background: int = 200, roll: float = 0.1, width: int = 480) -> np.ndarray:
    h, w = face.shape
    ends = np.array([[0, 0], [w, 0], [w, h], [0, h]], np.float32)
    centered = ends - [w / 2, h / 2]
    turned = centered @ np.array([[np.cos(roll), np.sin(roll)], [-np.sin(roll), np.cos(roll)]])
    placed = turned / (1 + 0.2 * turned[:, :1] / w) * 1.1 + [width / 2, width * 3 / 8]
    H = cv2.getPerspectiveTransform(ends, placed.astype(np.float32))
    image = cv2.warpPerspective(face, H, (width, width * 3 // 4), flags=cv2.INTER_AREA, borderValue=background)
    noisy = cv2.GaussianBlur(image, (0, 0), 0.7) + np.random.default_rng(5).normal(0, 2, image.shape)
    return np.repeat(np.clip(noisy, 0, 255).astype(np.uint8)[:, :, None], 3, axis=2)


RIGHT = BoardSpec.parse("chessboard:9x6:30mm")


@pytest.mark.parametrize(("rim", "background", "roll"), [(0.3, 30, 0.1), (1.0, 30, 0.8), (1.0, 120, 3.0)])
def test_a_right_board_is_not_refused_for_its_rim(rim, background, roll):
    image = chessboard(9, 6, rim, background, roll)
    assert likelier_board([image], RIGHT) is None
    assert likelier_board([image], BoardSpec.parse("chessboard:6x9:30mm")) is None


@pytest.mark.parametrize("given", ["9x7", "8x6", "5x4"])
def test_the_size_of_another_board_is_named(given):
    with pytest.raises(InputError, match=r"show chessboard:9x6:30mm, not"):
        checked_board([chessboard(9, 6)], BoardSpec.parse(f"chessboard:{given}:30mm"))


def test_a_smaller_dictionary_within_the_given_one_is_not_named():
    spec = "charuco:4x5:54mm:40mm:DICT_4X4_{}"
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    markers = [np.pad(cv2.aruco.generateImageMarker(dictionary, k, 90), 30, constant_values=255) for k in range(6)]
    image = photographed(np.vstack([np.hstack(markers[:3]), np.hstack(markers[3:])]))
    # Markers alone, without a corner of the board.
    assert checked_board([image], BoardSpec.parse(spec.format(1000))) == BoardSpec.parse(spec.format(1000))
    assert likelier_board([image], BoardSpec.parse(spec.format(1000))) is None
    other = likelier_board([image], BoardSpec.parse("charuco:4x5:54mm:40mm:DICT_5X5_100"))
    assert other is not None and other.dictionary.startswith("DICT_4X4")


def test_a_camera_that_is_upside_down_sees_the_same_corners():
    upright, turned = (
        detect_board(image, RIGHT) for image in (chessboard(9, 6), chessboard(9, 6)[::-1, ::-1].copy())
    )
    assert upright is not None and turned is not None
    turned = same_orientation(upright, turned, RIGHT)
    assert np.abs(479 - turned.image_points[:, 0] - upright.image_points[:, 0]).max() < 0.3
    assert np.abs(359 - turned.image_points[:, 1] - upright.image_points[:, 1]).max() < 0.3


@pytest.mark.parametrize("size", ["7x7", "8x6"])
def test_boards_that_look_alike_when_turned_are_put_in_one_order(size):
    """Left sees the board rolled by just less, right by just more than 45 degrees."""
    board = BoardSpec.parse(f"chessboard:{size}:30mm")
    columns, rows = board.inner_corners
    left, right = (
        detect_board(chessboard(columns, rows, 0.5, roll=np.deg2rad(angle)), board) for angle in (43.5, 46.5)
    )
    assert left is not None and right is not None
    right = same_orientation(left, right, board)
    assert np.linalg.norm(left.image_points - right.image_points, axis=1).max() < 15


def test_charuco_ids_may_begin_elsewhere():
    board = BoardSpec.parse("charuco:6x5:30mm:22mm:DICT_5X5_100:30")
    assert str(board) == "charuco:6x5:30mm:22mm:DICT_5X5_100:30"
    image = photographed(charuco_board(board).generateImage((315, 262), marginSize=15))
    seen = detect_board(image, board)
    assert seen is not None and len(seen.ids) == 20
    with pytest.raises(InputError, match=r"give the board charuco:6x5:30mm:22mm:DICT_5X5_100:30 "):
        try:
            checked_board([image], BoardSpec.parse("charuco:6x5:30mm:22mm:DICT_5X5_100"))
        except InputError as error:
            raise InputError(error.code, f"{error.message}; {error.hint}", "") from None


@pytest.mark.parametrize(
    ("columns", "rows", "radius", "shift", "width"),
    [
        pytest.param(7, 5, 14, 0, 480, id="gaps as corners"),
        pytest.param(9, 6, 20, 0, 320, id="right size across", marks=pytest.mark.slow),
        pytest.param(4, 11, 18, 25, 480, id="shifted rows", marks=pytest.mark.slow),
    ],
)
def test_a_grid_of_circles_is_no_chessboard(columns, rows, radius, shift, width):
    """OpenCV finds chessboards of some sizes between the circles, one of them of the size given."""
    circles = np.full((50 * (rows + 1), 50 * (columns + 1)), 255, np.uint8)
    for k in range(columns * rows):
        row = k // columns
        center = (50 + 50 * (k % columns) + shift * (row % 2), 50 + 50 * row)
        cv2.circle(circles, center, radius, 0, -1, cv2.LINE_AA)
    scale = 0.7 * width / max(circles.shape)
    image = photographed(cv2.resize(circles, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), width=width)
    with pytest.raises(InputError, match="a grid of circles, not chessboard"):
        checked_board([image], RIGHT)


@pytest.mark.slow
def test_other_kinds_are_named():
    charuco = charuco_board(BoardSpec.parse("charuco:6x5:30mm:22mm:DICT_4X4_100"))
    with pytest.raises(InputError, match=r"show ArUco markers \(DICT_4X4_1000\), not chessboard"):
        checked_board([photographed(charuco.generateImage((315, 262), marginSize=15))], RIGHT)
    assert checked_board([photographed(np.full((225, 300), 180, np.uint8))], RIGHT) == RIGHT
