"""`lmkit generate`: printable landmarks."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lmkit.cli.common import print_line
from lmkit.errors import InputError

if TYPE_CHECKING:
    from lmkit.generate.page import Page

SUFFIXES = (".pdf", ".png", ".svg")


def run(
    code: Annotated[int | None, typer.Option("--code", help="One code, 0 to 255.")] = None,
    codes: Annotated[str | None, typer.Option("--codes", help="Several codes, as in 0-15,42.")] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="FILE.pdf, FILE.png or FILE.svg.")] = None,
    template: Annotated[str | None, typer.Option("--template", help="Page template: a name or a .toml file.")] = None,
    size: Annotated[str, typer.Option("--size", help="Outer edge to outer edge of the red border.")] = "180mm",
    dpi: Annotated[float, typer.Option("--dpi", help="Resolution of PNG files.")] = 300.0,
    paper: Annotated[str, typer.Option("--paper", help="a4 or letter, where no template is given.")] = "a4",
    bare: Annotated[bool, typer.Option("--bare", help="The face alone, nothing around it (PNG, SVG).")] = False,
    each: Annotated[bool, typer.Option("--each", help="One file per code (PNG and SVG always are).")] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite files.")] = False,
) -> None:
    """Write printable landmarks as PDF, PNG or SVG, true to scale."""
    from lmkit.formats.files import check_writable, write_file
    from lmkit.formats.template import load_template
    from lmkit.generate.page import bare_landmark_page, compose_landmark_page
    from lmkit.model.code import format_codes, parse_codes
    from lmkit.model.landmark import LM8
    from lmkit.units import parse_length_mm

    if (code is None) == (codes is None):
        raise InputError("no_code", "no code given, or two ways of giving it", "give --code 137 or --codes 0-15,42")
    wanted = parse_codes(str(code) if codes is None else codes, LM8.code_count)
    size_mm = parse_length_mm(size, "--size")
    if not 1 <= dpi <= 4800:
        raise InputError("bad_dpi", f"--dpi {dpi:g} is outside 1 to 4800", "300 suits most printers")
    if output is None:
        stem = f"landmark-{wanted[0]}" if len(wanted) == 1 else f"landmarks-{format_codes(wanted)}"
        output = Path(f"{stem}.png" if bare else f"{stem}.pdf")
    suffix = output.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError("bad_suffix", f"cannot write {output}: unknown kind", f"name it {', '.join(SUFFIXES)}")
    if bare and suffix == ".pdf":
        raise InputError("bare_pdf", "--bare writes PNG or SVG, not PDF", "name the file .png or .svg")

    pages: dict[int, Page] = {}
    if bare:
        pages = {c: bare_landmark_page(LM8, c, size_mm) for c in wanted}
    else:
        layout = load_template(template or paper)
        pages = {c: compose_landmark_page(LM8, c, size_mm, layout) for c in wanted}

    separate = each or suffix != ".pdf"
    if separate and len(wanted) > 1:
        files = {c: output.with_name(f"{output.stem}-{c}{suffix}") for c in wanted}
    else:
        files = dict.fromkeys(wanted, output)
    for path in dict.fromkeys(files.values()):
        check_writable(path, force)
    if separate:
        for c, page in pages.items():
            write_file(files[c], _encode([page], suffix, dpi, page.title), force)
    else:
        title = next(iter(pages.values())).title if len(pages) == 1 else f"lmkit landmarks {format_codes(wanted)}"
        write_file(output, _encode(list(pages.values()), suffix, dpi, title), force)
    for path in dict.fromkeys(files.values()):
        print_line(str(path))


def _encode(pages: list[Page], suffix: str, dpi: float, title: str) -> bytes | str:
    if suffix == ".pdf":
        from lmkit.generate.pdf import pages_to_pdf

        return pages_to_pdf(pages, title)
    if suffix == ".svg":
        from lmkit.generate.svg import page_to_svg

        return page_to_svg(pages[0])
    from lmkit.generate.png import page_to_png

    return page_to_png(pages[0], dpi)
