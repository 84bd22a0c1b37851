"""`lmkit board`: printable calibration boards."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lmkit.cli.output import BOARD_HELP, print_line
from lmkit.errors import InputError


def run(
    spec: Annotated[str, typer.Argument(help=BOARD_HELP)],
    output: Annotated[Path, typer.Option("--output", "-o", help="FILE.pdf, FILE.png or FILE.svg.")],
    dpi: Annotated[float, typer.Option("--dpi", help="Resolution of PNG files.")] = 300.0,
    force: Annotated[bool, typer.Option("--force", help="Overwrite files.")] = False,
) -> None:
    """Write a calibration board, true to scale."""
    from lmkit.generation.board import compose_board_page
    from lmkit.io.files import write_file
    from lmkit.model.board import BoardSpec

    board = BoardSpec.parse(spec)
    page = compose_board_page(board)
    suffix = output.suffix.lower()
    content: bytes | str
    if suffix == ".pdf":
        from lmkit.generation.pdf import pages_to_pdf

        content = pages_to_pdf([page], page.title)
    elif suffix == ".svg":
        from lmkit.generation.svg import page_to_svg

        content = page_to_svg(page)
    elif suffix == ".png":
        from lmkit.generation.png import page_to_png

        content = page_to_png(page, dpi)
    else:
        raise InputError("bad_suffix", f"cannot write {output}: unknown kind", "name it .pdf, .png or .svg")
    write_file(output, content, force)
    width, height = page.size_mm
    print_line(f"{output}: {board} on {width:g} x {height:g} mm")
