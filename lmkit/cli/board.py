"""`lmkit board`: printable calibration boards."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lmkit.cli import options
from lmkit.cli.output import BOARD_HELP, print_line, warn, write_outputs
from lmkit.cli.parsing import require_dpi
from lmkit.errors import InputError


def run(
    spec: Annotated[str, typer.Argument(help=BOARD_HELP)],
    output: Annotated[Path, typer.Option("--output", "-o", help="File to write: .pdf, .png or .svg.")],
    paper: Annotated[
        str,
        typer.Option("--paper", help="Paper: a4, letter, a3, a2, a1, a0 or tabloid; larger boards get their own."),
    ] = "a4",
    dpi: options.Dpi = 300.0,
    force: options.Force = False,
) -> None:
    """Write a calibration board, true to scale."""
    from lmkit.generation.board import compose_board_page, largest_that_fits
    from lmkit.io.template import PAPERS_MM
    from lmkit.model.board import BoardSpec
    from lmkit.pipelines.prints import PAPERS, SUFFIXES, encode_page

    suffix = output.suffix.lower()
    if suffix not in SUFFIXES:
        hint = f"use a name ending in {', '.join(SUFFIXES)}"
        raise InputError("bad_suffix", f"cannot write {output}: unknown file type", hint)
    if paper not in PAPERS:
        raise InputError("bad_paper", f"--paper {paper} is unknown", f"choose {', '.join(PAPERS)}")
    require_dpi(dpi)
    board = BoardSpec.parse(spec)
    page = compose_board_page(board, paper)
    write_outputs({output: encode_page(page, output, dpi)}, force)
    width, height = page.size_mm
    if sorted(page.size_mm) != sorted(PAPERS_MM[paper]):
        warn(
            f"the board is larger than {paper}: its page is {width:g} x {height:g} mm, for a print shop; "
            f"{largest_that_fits(board, paper)} would fit on {paper}"
        )
    print_line(f"{output}: {board} on {width:g} x {height:g} mm")
