"""OpenCV's ChArUco objects for a BoardSpec; printing and reading share them."""

from __future__ import annotations

import cv2
import numpy as np

from lmkit.errors import InputError
from lmkit.model.board import BoardSpec


def charuco_dictionary(board: BoardSpec) -> cv2.aruco.Dictionary:
    """The marker dictionary of a ChArUco board.

    Raises:
        InputError: OpenCV knows no dictionary of that name.
    """
    number = getattr(cv2.aruco, board.dictionary, None) if board.dictionary.startswith("DICT_") else None
    if not isinstance(number, int):
        known = ", ".join(sorted(n for n in dir(cv2.aruco) if n.startswith("DICT_")))
        raise InputError(
            "unknown_dictionary", f"there is no marker dictionary {board.dictionary!r}", f"known: {known}"
        )
    return cv2.aruco.getPredefinedDictionary(number)


def charuco_board(board: BoardSpec) -> cv2.aruco.CharucoBoard:
    """The board itself, lengths in meters.

    Raises:
        InputError: the dictionary is unknown or has too few markers.
    """
    dictionary = charuco_dictionary(board)
    needed = board.first_code + board.columns * board.rows // 2
    if needed > len(dictionary.bytesList):
        raise InputError(
            "dictionary_too_small",
            f"board {board} needs {needed} markers, {board.dictionary} has {len(dictionary.bytesList)}",
            "take a larger dictionary, such as DICT_5X5_1000",
        )
    result = cv2.aruco.CharucoBoard(
        (board.columns, board.rows), board.square_mm / 1000, board.marker_mm / 1000, dictionary,
        np.arange(board.first_code, needed, dtype=np.int32),
    )  # fmt: skip
    result.setLegacyPattern(board.legacy)
    return result
