"""Reasons why a board is not found in an image, in words."""

from __future__ import annotations

import cv2
import numpy as np

from lmkit.arrays import ByteArray
from lmkit.detection.boards import detect_board, grid_corners
from lmkit.errors import InputError
from lmkit.model.board import BoardSpec
from lmkit.pipelines.board_views import checked_board

DARK = 45.0  # mean value of an image that is too dark
AT_EDGE = 1.6  # squares: a board is cut off if its outermost corner is closer to the image's edge
SHOW = "show the whole board with its white rim"


def explain_absence(image: ByteArray, board: BoardSpec) -> str:
    """One sentence with the reason why the board is not found, and advice.

    Args:
        image: (H,W,3) BGR, in which `detect_board` finds nothing.
    """
    if float(image.mean()) < DARK:
        return "the image is dark: more light, or a longer exposure"
    if board.kind == "chessboard":
        return _of_chessboard(image, board)
    mirrored = np.ascontiguousarray(image[:, ::-1])
    if detect_board(mirrored, board) is not None:
        return "the image is mirrored: switch mirroring off in the camera's settings"
    try:
        checked_board([image], board)
    except InputError as error:
        return f"{error.message}: {error.hint}"
    return f"no board in view: {SHOW}"


def _of_chessboard(image: ByteArray, board: BoardSpec) -> str:
    grid = grid_corners(np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8))
    if grid is None:
        return f"no chessboard in view, or it is too far away: {SHOW}, nearer"
    seen, given = sorted(grid.shape[:2]), sorted(board.inner_corners)
    if seen == given:
        return "the board is in view, but its corners are not clear: hold still, more light, less tilt"
    counted = f"{seen[1]} x {seen[0]} of {given[1]} x {given[0]} inner corners are in view"
    if seen[0] > given[0] or seen[1] > given[1]:
        shown = f"the image shows a board of {seen[1]} x {seen[0]} inner corners, not {given[1]} x {given[0]}"
        return f"{shown}: correct the board above"
    step = float(np.median(np.linalg.norm(np.diff(grid, axis=1), axis=2)))
    far = np.array([image.shape[1], image.shape[0]]) - 1
    if min(float(grid.min()), float((far - grid).min())) < AT_EDGE * step:
        return f"{counted}: the board is too near, or cut off; move it away and to the middle"
    return f"{counted}: a hand or a shadow covers the rest, or the board is given too large"
