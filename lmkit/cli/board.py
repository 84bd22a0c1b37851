"""`lmkit board`: printable calibration boards."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lmkit.cli import options
from lmkit.cli.output import BOARD_HELP, print_line, write_outputs
from lmkit.errors import InputError


def run(
    spec: Annotated[str, typer.Argument(help=BOARD_HELP)],
    output: Annotated[Path, typer.Option("--output", "-o", help="File to write: .pdf, .png or .svg.")],
    dpi: options.Dpi = 300.0,
    force: options.Force = False,
) -> None:
    """Write a calibration board, true to scale."""
    from lmkit.generation.board import compose_board_page
    from lmkit.model.board import BoardSpec
    from lmkit.pipelines.prints import SUFFIXES, encode_page

    suffix = output.suffix.lower()
    if suffix not in SUFFIXES:
        hint = f"use a name ending in {', '.join(SUFFIXES)}"
        raise InputError("bad_suffix", f"cannot write {output}: unknown file type", hint)
    board = BoardSpec.parse(spec)
    page = compose_board_page(board)
    write_outputs({output: encode_page(page, output, dpi)}, force)
    width, height = page.size_mm
    print_line(f"{output}: {board} on {width:g} x {height:g} mm")
