"""Pictures of a calibration board -> its corners, pair by pair."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lmkit.arrays import ByteArray
from lmkit.calibrate.problem import PairView
from lmkit.detect.boards import detect_board, likelier_board, same_orientation
from lmkit.errors import InputError
from lmkit.formats.images import read_image
from lmkit.model.board import BoardSpec

SPEC_CHECK_PICTURES = 3
MIN_COMMON_CORNERS = 6


@dataclass(frozen=True)
class BoardPairs:
    """The corners of all pairs in which both eyes see the board.

    Attributes:
        views: those pairs.
        rejected: (pair, reason) of the others.
        files: (left, right) file of every pair by name.
        image_size: (width, height).
    """

    views: tuple[PairView, ...]
    rejected: tuple[tuple[str, str], ...]
    files: dict[str, tuple[Path, Path]]
    image_size: tuple[int, int]


def find_board_pairs(
    left: Sequence[Path],
    right: Sequence[Path],
    board: BoardSpec,
    on_pair: Callable[[int, int], None] = lambda done, total: None,
) -> BoardPairs:
    """Read all pairs and find the board in them.

    Args:
        left, right: picture files, paired in the order given.
        on_pair: told after every pair how many are done, of how many.

    Raises:
        InputError: different numbers of pictures, different sizes, an unreadable picture, or
            another board than the one specified.
    """
    if len(left) != len(right):
        raise InputError(
            "unpaired",
            f"{len(left)} left and {len(right)} right pictures do not make pairs",
            "give folders or globs with as many pictures each, sorted alike",
        )
    views: list[PairView] = []
    rejected: list[tuple[str, str]] = []
    size: tuple[int, int] | None = None
    sample: list[ByteArray] = []
    for done, (left_file, right_file) in enumerate(zip(left, right, strict=True), start=1):
        name = left_file.stem
        images = (read_image(left_file), read_image(right_file))
        for file, image in zip((left_file, right_file), images, strict=True):
            here = (image.shape[1], image.shape[0])
            size = size or here
            if here != size:
                raise InputError(
                    "sizes_differ",
                    f"{file} is {here[0]} x {here[1]} pixels, the pictures before it {size[0]} x {size[1]}",
                    "all pictures of both eyes must have the same size; set both cameras alike",
                )
        seen = [detect_board(image, board) for image in images]
        # A sample for the check of the specification: found ones tell of a larger board.
        if len(sample) < SPEC_CHECK_PICTURES:
            sample.append(images[0])
            if len(sample) == SPEC_CHECK_PICTURES:
                _check_spec(sample, board)
        on_pair(done, len(left))
        if seen[0] is None or seen[1] is None:
            where = "both pictures" if seen[0] is seen[1] else "the left picture" if seen[0] is None else "the right picture"
            rejected.append((name, f"board not found in {where}"))
            continue
        if board.kind == "chessboard":
            seen[1] = same_orientation(seen[0], seen[1])
        if len(np.intersect1d(seen[0].ids, seen[1].ids)) < MIN_COMMON_CORNERS:
            rejected.append((name, f"fewer than {MIN_COMMON_CORNERS} corners seen by both eyes"))
            continue
        views.append(PairView(name, seen[0].ids, seen[0].image_points, seen[1].ids, seen[1].image_points))
    assert size is not None
    if len(sample) < SPEC_CHECK_PICTURES:
        _check_spec(sample, board)
    files = {lf.stem: (lf, rf) for lf, rf in zip(left, right, strict=True)}
    return BoardPairs(tuple(views), tuple(rejected), files, size)


def _check_spec(sample: Sequence[ByteArray], board: BoardSpec) -> None:
    other = likelier_board(sample, board)
    if other is not None:
        raise InputError(
            "wrong_board",
            f"the pictures show a {other.columns}x{other.rows} chessboard, not {board.columns}x{board.rows}",
            f"give --board {other} (columns x rows count inner corners)",
        )
