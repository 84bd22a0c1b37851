"""`lmkit calibrate --capture`: guided capture of calibration pairs."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from lmkit.cli.output import print_line
from lmkit.errors import InputError

if TYPE_CHECKING:
    from lmkit.model.board import BoardSpec
    from lmkit.pipelines.capture_board import Found


def capture_pairs(
    left: str | None, right: str | None, side_by_side: bool, spec: BoardSpec, folder: Path | None, quiet: bool
) -> Found:
    """Keep pairs until the views are complete, the source ends or the user stops it.

    Raises:
        InputError: no source, a source that cannot be read, or a folder that is not empty.
    """
    from lmkit.io.board_corners import SavedCorners
    from lmkit.io.files import write_file
    from lmkit.io.image_groups import SPLIT, frame_groups
    from lmkit.io.image_sources import are_moving
    from lmkit.pipelines.capture_board import Found, look_at_frames
    from lmkit.visualization.overlay import encode_png

    if left is None or (right is None) != side_by_side:
        raise InputError(
            "no_source",
            "--capture needs LEFT and RIGHT, or LEFT with --side-by-side",
            "give sources such as camera:0",
        )
    if folder is not None and folder.exists() and any(folder.iterdir()):
        raise InputError("not_empty", f"folder {folder} is not empty", "give a new folder for --save-pairs")
    found = Found(SavedCorners(spec, (1, 1), (), ()), {})
    missing: tuple[str, ...] = ("the whole board in both cameras",)
    status = _StatusLine()
    try:
        sources = [f"{SPLIT}{left}"] if right is None else [left, right]
        pairs = ((frames[0], frames[1]) for frames in frame_groups(sources))
        for looked in look_at_frames(pairs, spec, are_moving(left)):
            if looked.judgment.kept:
                found = looked.found
                missing = looked.coverage.advice
                name = found.corners.views[-1].name
                if folder is not None:
                    for side, image in (("left", looked.left), ("right", looked.right)):
                        write_file(folder / side / f"{name}.png", encode_png(image), False)
                status.clear()
                if not quiet:
                    count = len(found.corners.views)
                    print_line(f"kept {name} ({count}); next: {missing[0] if missing else 'complete'}")
            status.show(f"{len(found.corners.views)} kept | {looked.judgment.words} | next: {', '.join(missing[:1])}")
    except KeyboardInterrupt:
        pass  # the user ends the capture; the kept pairs are calibrated
    status.clear()
    if missing and not quiet:
        print_line(f"ended before the views were complete; missing: {'; '.join(missing)}")
    return found


class _StatusLine:
    """A status line that overwrites itself, on a terminal only."""

    def __init__(self) -> None:
        self._on = sys.stderr.isatty()

    def show(self, text: str) -> None:
        if self._on:
            sys.stderr.write(f"\r\x1b[2K{text[:118]}")
            sys.stderr.flush()

    def clear(self) -> None:
        self.show("")
