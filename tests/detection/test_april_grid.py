"""AprilGrids: Kalibr's layout, and every corner found in a view of one."""

import cv2
import numpy as np
import pytest
from board_pages import corners_on_page, onto, seen_at

from lmkit.detection.boards import detect_board
from lmkit.errors import InputError
from lmkit.generation.board import compose_board_page
from lmkit.model.board import BoardSpec

FIRST_OF_36H11 = 0xD5D628584  # the AprilTag project's code 0, row by row from the top left


def test_the_layout_is_kalibr_s():
    board = BoardSpec.parse("aprilgrid:3x2:40mm:0.3")
    assert str(board) == "aprilgrid:3x2:40mm:0.3"
    assert board.codes == (3, 4, 5, 0, 1, 2)  # Kalibr counts from the bottom left
    assert board.pattern_mm == pytest.approx((144.0, 92.0))
    family = board.tag_family
    assert (family.border_cells, family.cells) == (2, 10)
    first = family.white[0].ravel()
    assert int("".join(str(int(cell)) for cell in first), 2) == FIRST_OF_36H11
    squares = [item for item in compose_board_page(board).items if getattr(item, "role", "") == "mark"]
    assert len(squares) == 4 * 3


def test_every_corner_is_found_though_squares_touch_the_tags():
    board = BoardSpec.parse("aprilgrid:4x3:40mm:0.3")
    H = onto(board, [[70, 60], [330, 85], [310, 250], [60, 270]])
    seen = detect_board(seen_at(board, H, (400, 320), np.random.default_rng(1)), board)
    assert seen is not None and len(seen.ids) == 48
    true = cv2.perspectiveTransform(corners_on_page(board)[None, seen.ids], H)[0]
    off = np.linalg.norm(seen.image_points - true, axis=1)
    assert np.median(off) < 0.12 and off.max() < 0.5


@pytest.mark.parametrize(
    "spec",
    ["aprilgrid:6x6:24mm", "aprilgrid:6x6:24mm:2", "aprilgrid:6x6:24mm:0.3:lm8", "aprilgrid:9x9:9mm:0.3:tag16h5"],
)
def test_other_grids_are_refused(spec):
    with pytest.raises(InputError) as refused:
        BoardSpec.parse(spec)
    assert refused.value.code == "bad_board"
