"""One true-scale page with a calibration board."""

from __future__ import annotations

import cv2
import numpy as np

from lmkit.generation.artwork import FilledPath
from lmkit.generation.page import GRAY, Page, PrintedFace, Text, rectangle
from lmkit.io.template import PAPERS_MM
from lmkit.model.board import BoardSpec
from lmkit.model.charuco import charuco_board, charuco_dictionary
from lmkit.model.landmark import LM8
from lmkit.model.palette import BLACK, WHITE

EDGE_MM = 8.0
LABEL_MM = 9.0


def compose_board_page(board: BoardSpec, paper: str = "a4") -> Page:
    """The board with a white rim and a label line.

    The page is the paper, portrait or landscape, if the board fits on it, else as large as the board
    needs, for a print shop.

    Args:
        paper: a key of ``PAPERS_MM``, upright.

    Raises:
        InputError: the board's markers cannot be made.
    """
    width, height = board.pattern_mm
    edge = EDGE_MM + _rim_mm(board)
    need = (width + 2 * edge, height + 2 * edge + LABEL_MM)
    w, h = PAPERS_MM[paper]
    page = next((p for p in ((w, h), (h, w)) if need[0] <= p[0] and need[1] <= p[1]), need)
    x0, y0 = (page[0] - width) / 2, (page[1] - LABEL_MM - height) / 2
    faces: tuple[PrintedFace, ...] = ()
    if board.kind == "landmarks":
        faces = _landmark_faces(board, x0, y0)
        items: list[FilledPath | Text] = [path for face in faces for path in face.artwork]
        across = "outer border to outer border"
    elif board.kind == "aprilgrid":
        items = _april_grid_items(board, x0, y0)
        across = "tags, without the small squares around them,"
    else:
        items = _charuco_items(board, x0, y0) if board.kind == "charuco" else _chessboard_items(board, x0, y0)
        across = f"{board.squares[0]} squares across and {board.squares[1]} down"
    text = f"{board}, print at 100 %; {across} must measure {width:g} x {height:g} mm"
    items.append(Text((page[0] / 2, y0 + height + edge + 2.5), text, min(3.6, width / 40), "middle", GRAY))
    return Page(page, tuple(items), f"lmkit board {board}", faces)


def largest_that_fits(board: BoardSpec, paper: str) -> str:
    """The largest squares, whole mm, at which a board of these proportions fits on the paper; tags of an AprilGrid.

    Examples:
        >>> largest_that_fits(BoardSpec.parse("chessboard:9x6:30mm"), "a4")
        'squares of 26 mm'
        >>> largest_that_fits(BoardSpec.parse("aprilgrid:6x6:24mm:0.3"), "a4")
        'tags of 23 mm'
    """
    gap = _rim_mm(board)
    width, height = (side + 2 * gap for side in board.pattern_mm)
    w, h = PAPERS_MM[paper]
    scale = max(min((x - 2 * EDGE_MM) / width, (y - 2 * EDGE_MM - LABEL_MM) / height) for x, y in ((w, h), (h, w)))
    word, side = ("tags", board.marker_mm) if board.kind == "aprilgrid" else ("squares", board.square_mm)
    return f"{word} of {int(scale * side + 1e-9)} mm"


def _rim_mm(board: BoardSpec) -> float:
    """Width of the small squares around an AprilGrid's tags."""
    return board.gap_mm if board.kind == "aprilgrid" else 0.0


def _april_grid_items(board: BoardSpec, x0: float, y0: float) -> list[FilledPath | Text]:
    """Tags with id 0 at the bottom left, and black squares between their corners, as Kalibr draws them."""
    gap, middle = board.gap_mm, board.marker_mm / 2
    items: list[FilledPath | Text] = []
    for code, (row, column) in zip(board.codes, np.ndindex(board.rows, board.columns), strict=True):
        at = (x0 + middle + column * board.square_mm, y0 + middle + row * board.square_mm)
        items += PrintedFace(board.tag_family, code, board.marker_mm, at).artwork
    for row, column in np.ndindex(board.rows + 1, board.columns + 1):
        x, y = x0 + column * board.square_mm - gap, y0 + row * board.square_mm - gap
        items.append(rectangle("mark", BLACK, x, y, gap, gap))
    return items


def _landmark_faces(board: BoardSpec, x0: float, y0: float) -> tuple[PrintedFace, ...]:
    middle = board.marker_mm / 2
    return tuple(
        PrintedFace(
            LM8,
            code,
            board.marker_mm,
            (x0 + middle + column * board.square_mm, y0 + middle + row * board.square_mm),
        )
        for code, (row, column) in zip(board.codes, np.ndindex(board.rows, board.columns), strict=True)
    )


def _chessboard_items(board: BoardSpec, x0: float, y0: float) -> list[FilledPath | Text]:
    """Squares whose row plus column is even are black, as in OpenCV's board."""
    columns, rows = board.squares
    side = board.square_mm
    return [
        rectangle("mark", BLACK, x0 + column * side, y0 + row * side, side, side)
        for row, column in np.ndindex(rows, columns)
        if (row + column) % 2 == 0
    ]


def _charuco_items(board: BoardSpec, x0: float, y0: float) -> list[FilledPath | Text]:
    """Squares and markers as rectangles, from OpenCV's own drawing of the board.

    Every cell of the drawing is a whole number of pixels, so the rectangles are exact.
    """
    dictionary = charuco_dictionary(board)
    cells = dictionary.markerSize + 2
    columns, rows = board.squares
    square, marker = board.square_mm, board.marker_mm
    cv_board = charuco_board(board)
    items: list[FilledPath | Text] = []
    rim = (square - marker) / 2
    ids = iter(range(len(cv_board.getIds())))
    object_points = [np.asarray(p) for p in cv_board.getObjPoints()]
    white_squares = {
        (
            round(float(p[0, 1]) * 1000 / square - rim / square),
            round(float(p[0, 0]) * 1000 / square - rim / square),
        )
        for p in object_points
    }
    for row in range(rows):
        for column in range(columns):
            x, y = x0 + column * square, y0 + row * square
            if (row, column) not in white_squares:
                items.append(rectangle("mark", BLACK, x, y, square, square))
    for index, corners in zip(ids, object_points, strict=True):
        marker_id = int(np.ravel(cv_board.getIds())[index])
        bits = cv2.aruco.generateImageMarker(dictionary, marker_id, cells, borderBits=1)
        x, y = x0 + float(corners[0, 0]) * 1000, y0 + float(corners[0, 1]) * 1000
        items.append(rectangle("mark", BLACK, x, y, marker, marker))
        step = marker / cells
        for r, c in np.argwhere(bits > 127):
            items.append(rectangle("mark", WHITE, x + c * step, y + r * step, step, step))
    return items
