"""Pairs of board images for `lmkit calibrate`: found in files, or saved before."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from lmkit.cli.output import ProgressBars
from lmkit.errors import InputError

if TYPE_CHECKING:
    from lmkit.model.board import BoardSpec
    from lmkit.pipelines.capture_board import Found


def both_sources(left: str | None, right: str | None) -> tuple[str, str]:
    """Two sources of images.

    Raises:
        InputError: one is missing, or both are the same.
    """
    if left is None or right is None:
        raise InputError("no_images", "images of a board are needed", "see lmkit calibrate --help")
    if left == right:
        raise InputError("same_images", f"LEFT and RIGHT are both {left}", "give the right camera's images as RIGHT")
    return left, right


def without_split(sources: Sequence[str], side_by_side: bool) -> tuple[list[str], bool]:
    """The sources, or the single source of ``split:SOURCE``; and whether each image shows two cameras."""
    from lmkit.io.image_groups import SPLIT

    if len(sources) == 1 and sources[0].startswith(SPLIT):
        return [sources[0].removeprefix(SPLIT)], True
    return list(sources), side_by_side


def written_lines(written: Sequence[Path], output: Path | None) -> list[str]:
    """Lines about the written files, and about a rig for which no file was given."""
    lines = [f"wrote                  {path}" for path in written]
    return lines if output is not None else [*lines, "not written            the rig; add -o rig.yaml to keep it"]


def saved_corners(path: Path) -> Found:
    """Corners of a file."""
    from lmkit.io.board_corners import read_corners
    from lmkit.pipelines.capture_board import Found

    return Found(read_corners(path), {})


def find_pairs(left: str, right: str, spec: BoardSpec) -> Found:
    """Corners of the board in pairs of images."""
    from lmkit.pipelines.capture_board import find_in_files

    with ProgressBars() as bars:
        return find_in_files(left, right, spec, bars.counter("finding the board"))
