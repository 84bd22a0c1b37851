"""`lmkit generate`: printable landmarks."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lmkit.cli.output import print_line, warn
from lmkit.errors import InputError

if TYPE_CHECKING:
    from lmkit.generation.page import Page

SUFFIXES = (".pdf", ".png", ".svg")
LEAST_SIZE_MM = 5.0  # below this, printers and eyes fail
READABLE_MM = 30.0  # below this, from a metre at most with a focal length of 600 px
READ_FROM_PX = 17.5  # side at which 95 of 100 are read, docs/printing.md


def run(
    code: Annotated[int | None, typer.Option("--code", help="One code, such as 137.")] = None,
    codes: Annotated[str | None, typer.Option("--codes", help="Several codes, as in 0-15,42.")] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="FILE.pdf, FILE.png or FILE.svg.")] = None,
    family: Annotated[str, typer.Option("--family", help="lm8, lm4, lm8p, lm12 or lm12h4.")] = "lm8",
    template: Annotated[str | None, typer.Option("--template", help="Page template: a name or a .toml file.")] = None,
    size: Annotated[
        str | None, typer.Option("--size", help="Outer edge to outer edge of the red border, such as 180mm.")
    ] = None,
    dpi: Annotated[float, typer.Option("--dpi", help="Resolution of PNG files.")] = 300.0,
    paper: Annotated[str, typer.Option("--paper", help="a4, letter or a3, where no template is given.")] = "a4",
    text: Annotated[str, typer.Option("--text", help="A line for templates that have room for one.")] = "",
    map_name: Annotated[str, typer.Option("--map-name", help="Name of the map, for templates that show it.")] = "",
    compensate: Annotated[
        str | None, typer.Option("--compensate", help="What the last print measured, as in 178.6x179.4.")
    ] = None,
    cmyk: Annotated[bool, typer.Option("--cmyk", help="Process colours instead of RGB (PDF).")] = False,
    mirror: Annotated[bool, typer.Option("--mirror", help="Mirrored, for the inside of glass.")] = False,
    bare: Annotated[bool, typer.Option("--bare", help="The face alone, nothing around it (PNG, SVG).")] = False,
    each: Annotated[bool, typer.Option("--each", help="One file per code (PNG and SVG always are).")] = False,
    measured: Annotated[
        str | None,
        typer.Option("--measured", help="Print nothing; write this size, as in 179.2x179.0, into --map."),
    ] = None,
    landmark_map: Annotated[Path | None, typer.Option("--map", help="The map that --measured mends.")] = None,
    list_templates: Annotated[bool, typer.Option("--list-templates", help="Show them, and nothing else.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite files.")] = False,
) -> None:
    """Write printable landmarks as PDF, PNG or SVG, true to scale, each proven to read."""
    from lmkit.cli.resize_map import write_measured_map
    from lmkit.model.codewords import format_codes, parse_codes
    from lmkit.model.landmark import family_named
    from lmkit.pipelines.prints import PrintLayout, output_names
    from lmkit.units import parse_length_mm

    if list_templates:
        _list_templates()
        return
    kind = family_named(family)
    if (code is None) == (codes is None):
        raise InputError("no_code", "no code given, or two ways of giving it", "give --code 137 or --codes 0-15,42")
    wanted = parse_codes(str(code) if codes is None else codes, kind.code_count)
    if (measured is None) != (landmark_map is None):
        raise InputError("no_map", "--measured and --map go together", "give --measured 179.2x179.0 --map map.yaml")
    if measured is not None and landmark_map is not None:
        write_measured_map(landmark_map, kind, wanted, measured, output, force)
        return
    size_mm = None if size is None else parse_length_mm(size, "--size")
    _check_size(size_mm)
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
    if cmyk and suffix != ".pdf":
        raise InputError("cmyk_pdf", f"--cmyk is for PDF, not {suffix}", "name the file .pdf")

    if bare:
        said = {"--template": template, "--text": text, "--map-name": map_name, "--compensate": compensate}
        ignored = [name for name, value in said.items() if value] + (["--mirror"] if mirror else [])
        if ignored:
            raise InputError("bare_alone", f"--bare has no sheet for {', '.join(ignored)}", "leave one of them out")
        from lmkit.generation.page import bare_landmark_page

        faces = {str(c): bare_landmark_page(kind, c, size_mm or kind.side_mm) for c in wanted}
        _write({path: [faces[label]] for label, path in output_names(output, list(faces)).items()}, dpi, force)
        return
    layout = PrintLayout(kind, template, paper, size_mm, text, map_name, mirror, compensate)
    sets = [layout.pages(some) for some in ([[c] for c in wanted] if each or suffix != ".pdf" else [wanted])]
    if suffix == ".pdf":
        prints = dict(zip([str(c) for c in wanted], sets, strict=False))
    else:
        prints = {}
        for c, pages in zip(wanted, sets, strict=True):
            several = len(pages) > 1
            prints |= {f"{c}-{k}" if several else str(c): [page] for k, page in enumerate(pages, start=1)}
    files = {path: prints[label] for label, path in output_names(output, list(prints)).items()}
    _write_proven(files, sets, layout.name, dpi, cmyk, force)


def _list_templates() -> None:
    from lmkit.io.template import load_template, shipped_templates

    for name in shipped_templates():
        print_line(f"{name:<12} {load_template(name).description}")


def _check_size(size_mm: float | None) -> None:
    if size_mm is None:
        return
    if size_mm < LEAST_SIZE_MM:
        raise InputError(
            "too_small",
            f"--size {size_mm:g} mm is smaller than {LEAST_SIZE_MM:g} mm, which no printer draws cleanly",
            f"choose {LEAST_SIZE_MM:g} mm or more; 180mm is usual",
        )
    if size_mm < READABLE_MM:
        warn(
            f"a landmark of {size_mm:g} mm is read from {size_mm * 600 / READ_FROM_PX / 1000:.1f} m at most "
            "with a focal length of 600 px; see docs/printing.md"
        )


def _write_proven(
    files: dict[Path, list[Page]], sets: list[list[Page]], layout: str, dpi: float, cmyk: bool, force: bool
) -> None:
    """All files with their manifests, or none: every page is proven before the first is written.

    Args:
        sets: the same pages, those of one landmark or one PDF together: tiles are read as a whole.
    """
    from lmkit.generation.manifest import manifest_of
    from lmkit.generation.pdf import pages_to_pdf
    from lmkit.io.files import check_writable, write_file
    from lmkit.io.manifest import manifest_path
    from lmkit.pipelines.prints import encode_page, print_title
    from lmkit.verification.proof import prove_pages

    for path in files:
        check_writable(path, force)
        check_writable(manifest_path(path), force)
    drawn = [pages_to_pdf(pages, print_title(pages), manifest_of(pages, layout).to_json(), cmyk) for pages in sets]
    for pdf, pages in zip(drawn, sets, strict=True):
        prove_pages(pdf, pages)
    for k, (path, pages) in enumerate(files.items()):
        data = drawn[k] if path.suffix.lower() == ".pdf" else encode_page(pages[0], path, dpi)
        write_file(path, data, force)
        manifest = manifest_of(pages, layout).of_file(path.name, data)
        write_file(manifest_path(path), manifest.to_json(indent=1) + "\n", force)
        print_line(str(path))


def _write(files: dict[Path, list[Page]], dpi: float, force: bool) -> None:
    """All files, as they are."""
    from lmkit.io.files import check_writable, write_file
    from lmkit.pipelines.prints import encode_page

    for path in files:
        check_writable(path, force)
    for path, pages in files.items():
        write_file(path, encode_page(pages[0], path, dpi), force)
        print_line(str(path))
