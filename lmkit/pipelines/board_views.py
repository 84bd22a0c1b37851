"""Corners of a calibration board in images, pair by pair."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from lmkit.arrays import ByteArray
from lmkit.detection.board_kinds import shown_instead
from lmkit.detection.boards import detect_board, likelier_board, same_orientation
from lmkit.errors import InputError
from lmkit.io.images import read_image
from lmkit.model.board import BoardSpec
from lmkit.model.observation import BoardObservation, PairView
from lmkit.parallel import map_in_processes, map_in_threads

SPEC_CHECK_IMAGES = 3
MIN_COMMON_CORNERS = 6


@dataclass(frozen=True)
class BoardPairs:
    """The corners of all pairs in which both cameras see the board.

    Attributes:
        views: those pairs.
        rejected: (pair, reason) of the others.
        files: (left, right) file of every pair by name.
        image_size: (width, height) of the left images.
        board: as specified, or with the other ChArUco layout if the images show that layout.
        right_size: (width, height) of the right images.
    """

    views: tuple[PairView, ...]
    rejected: tuple[tuple[str, str], ...]
    files: dict[str, tuple[Path, Path]]
    image_size: tuple[int, int]
    board: BoardSpec
    right_size: tuple[int, int]


def find_board_pairs(
    files: Sequence[tuple[Path, Path]],
    board: BoardSpec,
    on_pair: Callable[[int, int], None] = lambda done, total: None,
) -> BoardPairs:
    """Read all pairs and find the board in them.

    Args:
        files: left and right image of every pair.
        on_pair: called after every pair with the number of finished pairs and of all pairs.

    Raises:
        InputError: one camera's images differ in size, one is unreadable, or they show another board.
    """
    views: list[PairView] = []
    rejected: list[tuple[str, str]] = []
    sizes: tuple[tuple[int, int], tuple[int, int]] | None = None
    board = checked_board([read_image(left) for left, _ in files[:SPEC_CHECK_IMAGES]], board)
    both = [file for pair in files for file in pair]
    with closing(mapped_for(board)(partial(_look, board=board), both)) as looked:
        for done, (left_file, right_file) in enumerate(files, start=1):
            name = left_file.stem
            (size_left, seen_left), (size_right, seen_right) = next(looked), next(looked)
            sizes = sizes or (size_left, size_right)
            require_same_size(str(left_file), size_left, sizes[0])
            require_same_size(str(right_file), size_right, sizes[1])
            on_pair(done, len(files))
            view = pair_view(name, seen_left, seen_right, board)
            if isinstance(view, str):
                rejected.append((name, view))
            else:
                views.append(view)
    assert sizes is not None
    names = {left.stem: (left, right) for left, right in files}
    return BoardPairs(tuple(views), tuple(rejected), names, sizes[0], board, sizes[1])


def mapped_for(board: BoardSpec) -> Callable[..., Generator[Any, None, None]]:
    """Parallel map for images of a board: threads for chessboards, since OpenCV does most of the work."""
    return map_in_threads if board.kind == "chessboard" else map_in_processes


def require_same_size(name: str, here: tuple[int, int], size: tuple[int, int]) -> None:
    """Refuse an image whose (width, height) differs from the previous images.

    Raises:
        InputError: the sizes differ.
    """
    if here != size:
        raise InputError(
            "sizes_differ",
            f"{name} is {here[0]} x {here[1]} pixels, the images before it {size[0]} x {size[1]}",
            "give images of one camera at one resolution",
        )


def checked_board(images: Sequence[ByteArray], board: BoardSpec) -> BoardSpec:
    """The board as specified, or with the other ChArUco layout if the images show that layout.

    Raises:
        InputError: they show another board.
    """
    other = likelier_board(images, board)
    if other is None:
        # Searching for other kinds takes seconds; usually the first image shows the right board.
        if not board.is_grid and not any(detect_board(image, board) for image in images):
            shown = shown_instead(images, board.dictionary)
            if shown is not None:
                raise InputError("wrong_board", f"the images show {shown[0]}, not {board}", shown[1])
        return board
    if other == replace(board, legacy=not board.legacy):
        return other
    counted = "inner corners" if board.kind == "chessboard" else "squares"
    raise InputError(
        "wrong_board",
        f"the images show {other}, not {board}",
        f"give the board {other} (--board); columns x rows count {counted}",
    )


def pair_view(
    name: str, left: BoardObservation | None, right: BoardObservation | None, board: BoardSpec
) -> PairView | str:
    """The board as both cameras saw it, corners in the same order; or the reason why there is no such view."""
    if left is None or right is None:
        where = "left image" if right is not None else "right image"
        if left is None and right is None:
            where = "left and the right image"
        return f"board not found in the {where}"
    if board.kind == "chessboard":
        right = same_orientation(left, right, board)
    if len(np.intersect1d(left.ids, right.ids)) < MIN_COMMON_CORNERS:
        return f"fewer than {MIN_COMMON_CORNERS} corners seen by both cameras"
    return PairView(name, left.ids, left.image_points, right.ids, right.image_points, left.noise_px, right.noise_px)


def _look(file: Path, board: BoardSpec) -> tuple[tuple[int, int], BoardObservation | None]:
    """(width, height) of an image, and the board in it."""
    image = read_image(file)
    return (image.shape[1], image.shape[0]), detect_board(image, board)
