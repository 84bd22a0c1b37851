"""Every kind of board, of every family: the printed page is read back, its corners lie where the model says."""

import cv2
import numpy as np
import pytest
from board_pages import corners_on_page, onto, seen_at

from lmkit.detection.boards import detect_board
from lmkit.model.board import BoardSpec

VIEW = [[80, 70], [385, 95], [360, 290], [66, 310]]
KINDS = (
    "chessboard:8x5:30mm",
    "charuco:6x4:40mm:30mm:DICT_4X4_50",
    "charuco:6x4:40mm:30mm:DICT_4X4_50:legacy",
    "charuco:5x4:40mm:30mm:DICT_5X5_100:60",
    "charuco:5x4:40mm:30mm:DICT_6X6_250",
    "charuco:5x4:40mm:30mm:DICT_7X7_1000",
    "charuco:5x4:40mm:30mm:DICT_ARUCO_ORIGINAL",
    "charuco:5x4:40mm:30mm:DICT_ARUCO_MIP_36H12",
    "charuco:5x4:40mm:30mm:DICT_APRILTAG_36H11",
    "charuco:5x4:40mm:30mm:DICT_APRILTAG_16H5",
    "landmarks:3x2:70mm:56mm:17",
    "aprilgrid:4x3:40mm:0.3",
    "aprilgrid:4x3:40mm:0.3:tag36h10",
    "aprilgrid:4x3:40mm:0.3:tag25h9",
    "aprilgrid:4x3:40mm:0.3:tag16h5",
)


def off_of(board, view, size):
    """(N,) distances of the found corners from their true places, px."""
    H = onto(board, view)
    seen = detect_board(seen_at(board, H, size, np.random.default_rng(3)), board)
    assert seen is not None
    true = cv2.perspectiveTransform(corners_on_page(board)[None, seen.ids], H)[0]
    return np.linalg.norm(seen.image_points - true, axis=1)


@pytest.mark.parametrize("spec", KINDS)
def test_every_corner_is_where_the_model_says(spec):
    board = BoardSpec.parse(spec)
    off = off_of(board, VIEW, (450, 380))
    assert len(off) == len(board.object_points)
    assert np.median(off) < 0.12 and off.max() < 0.5


@pytest.mark.parametrize("dictionary", ["DICT_4X4_50", "DICT_APRILTAG_16H5"])
def test_small_markers_of_a_charuco_board_are_read(dictionary):
    board = BoardSpec.parse(f"charuco:8x6:30mm:22mm:{dictionary}")
    off = off_of(board, np.array([[50, 50], [210, 56], [208, 172], [48, 168]]), (260, 220))  # markers of 15 px
    assert len(off) > 20
    assert np.median(off) < 0.12 and off.max() < 0.5


def test_in_a_large_image_a_chessboard_is_searched_around_where_a_smaller_copy_shows_it(monkeypatch):
    board = BoardSpec.parse("chessboard:8x5:30mm")
    size, corner = (1280, 720), np.array([700, 330])  # near two edges of the image
    view = np.array(VIEW) + corner
    searched = []
    search = cv2.findChessboardCornersSB

    def watched(image, *args, **options):
        searched.append(image.shape)
        return search(image, *args, **options)

    monkeypatch.setattr(cv2, "findChessboardCornersSB", watched)
    off = off_of(board, view, size)
    assert len(off) == len(board.object_points)
    assert np.median(off) < 0.12 and off.max() < 0.5
    copy, window = searched
    assert copy == (360, 640)
    assert window[0] < 400 and window[1] < 600


def test_in_a_large_image_a_chessboard_that_its_smaller_copy_does_not_show_is_found(monkeypatch):
    board = BoardSpec.parse("chessboard:8x5:30mm")
    monkeypatch.setattr("lmkit.detection.boards.LOOK_PX", 60)
    off = off_of(board, np.array(VIEW) + np.array([300, 200]), (1280, 720))
    assert len(off) == len(board.object_points)
    assert np.median(off) < 0.12 and off.max() < 0.5
