"""`lmkit generate`: printable landmarks."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lmkit.cli import options
from lmkit.cli.output import print_line, warn
from lmkit.cli.parsing import require_dpi
from lmkit.errors import InputError
from lmkit.units import parse_length_mm


def run(
    code: Annotated[int | None, typer.Option("--code", help="One code, such as 137.")] = None,
    codes: Annotated[str | None, typer.Option("--codes", help="Several codes, such as 0-15,42.")] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="File to write: .pdf, .png or .svg. Default: landmark-CODE.pdf."),
    ] = None,
    family: options.OneFamily = "lm8",
    template: Annotated[str | None, typer.Option("--template", help="Page template: a name or a .toml file.")] = None,
    size: options.OptionalSize = None,
    dpi: options.Dpi = 300.0,
    paper: Annotated[
        str | None,
        typer.Option(
            "--paper", help="Paper, if there is no --template: a4, letter, a3, a2, a1, a0 or tabloid. Default: a4."
        ),
    ] = None,
    text: Annotated[str, typer.Option("--text", help="Line of text to print, in templates with a text field.")] = "",
    map_name: Annotated[
        str, typer.Option("--map-name", help="Name of the map to print, in templates with a map field.")
    ] = "",
    compensate: Annotated[
        str | None,
        typer.Option(
            "--compensate",
            help="Measured size of the last print, mm, such as 178.6x179.4. The new print is scaled to correct it.",
        ),
    ] = None,
    cmyk: Annotated[bool, typer.Option("--cmyk", help="Use process colors (CMYK) instead of RGB (PDF).")] = False,
    mirror: Annotated[bool, typer.Option("--mirror", help="Print mirrored, to be read through glass.")] = False,
    bare: Annotated[
        bool, typer.Option("--bare", help="Write the landmark alone, without a sheet (PNG, SVG).")
    ] = False,
    each: Annotated[
        bool, typer.Option("--each", help="Write one PDF per code. PNG and SVG always have one file per code.")
    ] = False,
    measured: Annotated[
        str | None,
        typer.Option(
            "--measured", help="Write this measured size, such as 179.2x179.0, into --map, and print nothing."
        ),
    ] = None,
    landmark_map: Annotated[
        Path | None, typer.Option("--map", help="Map file in which --measured corrects the size.")
    ] = None,
    list_templates: Annotated[bool, typer.Option("--list-templates", help="List the templates and exit.")] = False,
    jobs: options.Jobs = None,
    force: options.Force = False,
) -> None:
    """Write printable landmarks, true to scale. Each is read back before the file is written."""
    from lmkit.cli.resize_map import write_measured_map
    from lmkit.model.codewords import format_codes, parse_codes
    from lmkit.model.families import family_named
    from lmkit.pipelines.prints import PrintLayout, check_landmark_size, write_faces, write_prints

    if list_templates:
        _list_templates()
        return
    kind = family_named(family)
    if (code is None) == (codes is None):
        given = "no code given" if code is None else "--code and --codes given"
        raise InputError("no_code", given, "give either --code 137 or --codes 0-15,42")
    wanted = parse_codes(str(code) if codes is None else codes, kind.code_count)
    if (measured is None) != (landmark_map is None):
        raise InputError("no_map", "--measured and --map go together", "give --measured 179.2x179.0 --map map.yaml")
    if measured is not None and landmark_map is not None:
        write_measured_map(landmark_map, kind, wanted, measured, output, force)
        return
    size_mm = None if size is None else parse_length_mm(size, "--size")
    if size_mm is not None and (warning := check_landmark_size(size_mm)):
        warn(warning)
    require_dpi(dpi)
    if output is None:
        stem = f"landmark-{wanted[0]}" if len(wanted) == 1 else f"landmarks-{format_codes(wanted)}"
        output = Path(f"{stem}.png" if bare else f"{stem}.pdf")
    _check_suffix(output, bare, cmyk)
    if bare:
        for_sheets = {
            "--template": template, "--paper": paper, "--text": text, "--map-name": map_name,
            "--compensate": compensate, "--mirror": mirror,
        }  # fmt: skip
        if ignored := [name for name, value in for_sheets.items() if value]:
            raise InputError("bare_alone", f"--bare has no sheet for {', '.join(ignored)}", "leave one of them out")
        written = write_faces(kind, wanted, size_mm, output, dpi, force)
    else:
        layout = PrintLayout(kind, template, paper, size_mm, text, map_name, mirror, compensate)
        written = write_prints(layout, wanted, output, each=each, dpi=dpi, cmyk=cmyk, overwrite=force)
    for path in written:
        print_line(str(path))


def _check_suffix(output: Path, bare: bool, cmyk: bool) -> None:
    from lmkit.pipelines.prints import SUFFIXES

    suffix = output.suffix.lower()
    if suffix not in SUFFIXES:
        hint = f"use a name ending in {', '.join(SUFFIXES)}"
        raise InputError("bad_suffix", f"cannot write {output}: unknown file type", hint)
    if bare and suffix == ".pdf":
        raise InputError("bare_pdf", "--bare writes PNG or SVG, not PDF", "use a name ending in .png or .svg")
    if cmyk and suffix != ".pdf":
        raise InputError("cmyk_pdf", f"--cmyk is for PDF, not {suffix}", "use a name ending in .pdf")


def _list_templates() -> None:
    from lmkit.io.template import load_template, shipped_templates

    for name in shipped_templates():
        print_line(f"{name:<12} {load_template(name).description}")
