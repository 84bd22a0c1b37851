"""`lmkit generate`: printable landmarks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lmkit.cli.common import print_line, warn
from lmkit.errors import InputError

if TYPE_CHECKING:
    from lmkit.formats.template import PageTemplate
    from lmkit.generate.page import Page
    from lmkit.model.landmark import LandmarkFamily

SUFFIXES = (".pdf", ".png", ".svg")
LEAST_SIZE_MM = 5.0  # below this, printers and eyes fail
READABLE_MM = 30.0  # below this, from a metre at most with a focal length of 600 px
READ_FROM_PX = 17.5  # side at which 95 of 100 are read, docs/printing.md
PAPERS = ("a4", "letter", "a3")
MOST_STRETCH = 0.05


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
    from lmkit.model.code import format_codes, parse_codes
    from lmkit.model.landmark import family_named
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
        _write_measured(landmark_map, kind, wanted, measured, output, force)
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
        from lmkit.generate.page import bare_landmark_page

        faces = {str(c): bare_landmark_page(kind, c, size_mm or kind.side_mm) for c in wanted}
        _write({path: [faces[label]] for label, path in _names(output, list(faces)).items()}, dpi, force)
        return
    layout = _Layout(kind, template, paper, size_mm, text, map_name, mirror, compensate)
    sets = [layout.pages(some) for some in ([[c] for c in wanted] if each or suffix != ".pdf" else [wanted])]
    if suffix == ".pdf":
        prints = dict(zip([str(c) for c in wanted], sets, strict=False))
    else:
        prints = {}
        for c, pages in zip(wanted, sets, strict=True):
            several = len(pages) > 1
            prints |= {f"{c}-{k}" if several else str(c): [page] for k, page in enumerate(pages, start=1)}
    files = {path: prints[label] for label, path in _names(output, list(prints)).items()}
    _write_proven(files, sets, layout.name, dpi, cmyk, force)


def _names(output: Path, labels: list[str]) -> dict[str, Path]:
    """The file for every label: the output's own name, or with the label where there are several."""
    if len(labels) == 1:
        return {labels[0]: output}
    return {label: output.with_name(f"{output.stem}-{label}{output.suffix}") for label in labels}


def _list_templates() -> None:
    from lmkit.formats.template import load_template, shipped_templates

    for name in shipped_templates():
        print_line(f"{name:<12} {load_template(name).description}")


@dataclass(frozen=True)
class _Layout:
    """How sheets are laid out: the options of the command that say so."""

    family: LandmarkFamily
    template: str | None
    paper: str
    size_mm: float | None
    text: str
    map_name: str
    mirror: bool
    compensate: str | None

    @cached_property
    def sheet(self) -> PageTemplate:
        """The template."""
        from lmkit.formats.template import load_template

        if self.template is None and self.paper not in PAPERS:
            raise InputError(
                "bad_paper", f"--paper {self.paper} is unknown", f"choose {', '.join(PAPERS)}, or give --template"
            )
        return load_template(self.template or self.paper)

    @property
    def tiled(self) -> bool:
        """Too large for its paper, and no template asked for."""
        if self.template is not None or self.size_mm is None:
            return False
        from lmkit.generate.sheet import largest_mm

        return self.size_mm > largest_mm(self.family, self.sheet)

    @property
    def name(self) -> str:
        """For the manifest."""
        return "tiles" if self.tiled else self.sheet.name

    def pages(self, codes: list[int]) -> list[Page]:
        """All pages for these codes."""
        from lmkit.generate.sheet import Wording, compose_sheets
        from lmkit.generate.tiles import compose_tiles

        sheet = self.sheet
        stretch = self.stretch(self.size_mm or sheet.size_mm)
        if self.tiled and self.size_mm is not None:
            tiles = [page for code in codes for page in compose_tiles(self.family, code, self.size_mm, self.paper)]
            return [replace(page, mirrored=self.mirror, stretch=stretch) for page in tiles]
        for option, placeholder, value in (("--text", "{text}", self.text), ("--map-name", "{map}", self.map_name)):
            if value and not any(placeholder in line.text for line in sheet.texts):
                raise InputError(
                    "no_room",
                    f"template {sheet.name} has no place for {option}",
                    f"use a4-door, or a template of your own with a text of {placeholder}",
                )
        wording = Wording(self.text, self.map_name)
        return compose_sheets(self.family, codes, sheet, self.size_mm, wording, self.mirror, stretch)

    def stretch(self, size_mm: float) -> tuple[float, float]:
        """What the drawing must be multiplied by."""
        if self.compensate is None:
            return (1.0, 1.0)
        width, height = _two_lengths(self.compensate, "--compensate")
        factors = (size_mm / width, size_mm / height)
        if max(abs(factor - 1) for factor in factors) > MOST_STRETCH:
            raise InputError(
                "bad_compensation",
                f"--compensate {self.compensate}: more than {MOST_STRETCH:.0%} from the {size_mm:g} mm it should be",
                "print at 100 % without fitting to the page, and measure the red border's outer edges in mm",
            )
        return factors


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
    from lmkit.formats.files import check_writable, write_file
    from lmkit.formats.manifest import manifest_path
    from lmkit.generate.manifest import manifest_of
    from lmkit.generate.pdf import pages_to_pdf
    from lmkit.verify.proof import prove_pages

    for path in files:
        check_writable(path, force)
        check_writable(manifest_path(path), force)
    drawn = [pages_to_pdf(pages, _title(pages), manifest_of(pages, layout).to_json(), cmyk) for pages in sets]
    for pdf, pages in zip(drawn, sets, strict=True):
        prove_pages(pdf, pages)
    for k, (path, pages) in enumerate(files.items()):
        data = drawn[k] if path.suffix.lower() == ".pdf" else _encode(pages[0], path, dpi)
        write_file(path, data, force)
        manifest = manifest_of(pages, layout).of_file(path.name, data)
        write_file(manifest_path(path), manifest.to_json(indent=1) + "\n", force)
        print_line(str(path))


def _write(files: dict[Path, list[Page]], dpi: float, force: bool) -> None:
    """All files, as they are."""
    from lmkit.formats.files import check_writable, write_file

    for path in files:
        check_writable(path, force)
    for path, pages in files.items():
        write_file(path, _encode(pages[0], path, dpi), force)
        print_line(str(path))


def _title(pages: list[Page]) -> str:
    titles = [page.title for page in pages if page.faces] or [pages[0].title]
    return titles[0] if len(titles) == 1 else f"lmkit landmarks, {titles[0]} and {len(titles) - 1} more pages"


def _encode(page: Page, path: Path, dpi: float) -> bytes:
    """The bytes of an SVG or PNG file."""
    if path.suffix.lower() == ".svg":
        from lmkit.generate.svg import page_to_svg

        return page_to_svg(page).encode()
    from lmkit.generate.png import page_to_png

    return page_to_png(page, dpi)


def _two_lengths(text: str, what: str) -> tuple[float, float]:
    """``178.6x179.4``, or one number for both; millimetres unless a unit says otherwise."""
    from lmkit.units import parse_length_mm

    pieces = text.lower().split("x")
    if len(pieces) not in (1, 2):
        raise InputError("bad_length", f"{what} {text!r} is not WIDTHxHEIGHT", "write it as 178.6x179.4, in mm")
    lengths = [parse_length_mm(p if p.strip()[-1:].isalpha() else f"{p}mm", what) for p in pieces]
    return lengths[0], lengths[-1]


def _write_measured(
    path: Path, family: LandmarkFamily, codes: list[int], measured: str, output: Path | None, force: bool
) -> None:
    """The map with the size that these landmarks really have."""
    from lmkit.formats.files import write_file
    from lmkit.formats.landmark_map import map_to_yaml, read_map
    from lmkit.model.landmark_map import LandmarkMap

    width, height = _two_lengths(measured, "--measured")
    landmarks = read_map(path)
    missing = [code for code in codes if landmarks.find(code, family.name) is None]
    if missing:
        raise InputError(
            "not_in_map", f"{path} has no {family.name} landmark of code {missing[0]}", "check --codes and --family"
        )
    if abs(width / height - 1) > 0.005:
        warn(f"width and height differ by {abs(width / height - 1):.1%}; the map takes their mean")
    true_size_m = round((width + height) / 2000, 7)
    mended = [
        replace(landmark, size_m=true_size_m)
        if landmark.family == family.name and landmark.code in codes
        else landmark
        for landmark in landmarks
    ]
    target = output or path
    write_file(target, map_to_yaml(LandmarkMap(mended)), force)
    print_line(f"{target}: size_m {true_size_m:.5f} for {len(codes)} landmarks")
