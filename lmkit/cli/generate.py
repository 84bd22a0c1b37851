"""`lmkit generate`: printable landmarks."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lmkit.cli.common import print_line, warn
from lmkit.errors import InputError

if TYPE_CHECKING:
    from lmkit.generate.page import Page
    from lmkit.model.landmark import LandmarkFamily

SUFFIXES = (".pdf", ".png", ".svg")
LEAST_SIZE_MM = 5.0  # below this, printers and eyes fail
READABLE_MM = 30.0  # below this, it is read from less than half a metre by most cameras
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

    separate = each or suffix != ".pdf"
    proven = bare
    if bare:
        from lmkit.generate.page import bare_landmark_page

        groups = [(str(c), [bare_landmark_page(kind, c, size_mm or kind.side_mm)], "bare") for c in wanted]
    else:
        groups = []
        for some in [[c] for c in wanted] if separate else [wanted]:
            pages, name = _pages(kind, some, template, paper, size_mm, _Extras(text, map_name, mirror, compensate))
            if suffix == ".pdf" or len(pages) == 1:
                groups.append((str(some[0]), pages, name))
            else:
                # Pages of one landmark are proven together, then written one by one.
                _prove(pages)
                groups += [(f"{some[0]}-{number}", [page], name) for number, page in enumerate(pages, start=1)]
                proven = True
    if len(groups) == 1:
        files = {output: groups[0]}
    else:
        files = {output.with_name(f"{output.stem}-{label}{suffix}"): (label, p, n) for label, p, n in groups}
    _write(files, dpi, cmyk, force, bare, proven)
    for path in files:
        print_line(str(path))


def _list_templates() -> None:
    from lmkit.formats.template import load_template, shipped_templates

    for name in shipped_templates():
        print_line(f"{name:<12} {load_template(name).description}")


class _Extras:
    """What is said beside code and size."""

    def __init__(self, text: str, map_name: str, mirror: bool, compensate: str | None) -> None:
        self.text = text
        self.map_name = map_name
        self.mirror = mirror
        self.compensate = compensate

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


def _pages(
    family: LandmarkFamily,
    codes: list[int],
    template: str | None,
    paper: str,
    size_mm: float | None,
    extras: _Extras,
) -> tuple[list[Page], str]:
    """The pages, and the name of how they were laid out."""
    from dataclasses import replace

    from lmkit.formats.template import load_template
    from lmkit.generate.sheet import Wording, compose_sheets
    from lmkit.generate.tiles import compose_tiles

    if template is None and paper not in ("a4", "letter", "a3"):
        raise InputError("bad_paper", f"--paper {paper} is unknown", "choose a4, letter or a3, or give --template")
    layout = load_template(template or paper)
    wording = Wording(extras.text, extras.map_name)
    size = size_mm or layout.size_mm
    stretch = extras.stretch(size)
    try:
        return compose_sheets(family, codes, layout, size_mm, wording, extras.mirror, stretch), layout.name
    except InputError as error:
        if error.code != "landmark_too_large" or template is not None:
            raise
    pages = [page for code in codes for page in compose_tiles(family, code, size, paper)]
    return [replace(page, mirrored=extras.mirror, stretch=stretch) for page in pages], "tiles"


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
            f"a landmark of {size_mm:g} mm is read from {size_mm * 600 / 20 / 1000:.1f} m at most "
            "with a focal length of 600 px; see docs/printing.md"
        )


def _write(
    files: dict[Path, tuple[str, list[Page], str]], dpi: float, cmyk: bool, force: bool, bare: bool, proven: bool
) -> None:
    """All files with their manifests; nothing at all where one of them would fail."""
    from lmkit.formats.files import check_writable, write_file
    from lmkit.formats.manifest import manifest_path

    for path in files:
        check_writable(path, force)
        if not bare:
            check_writable(manifest_path(path), force)
    for path, (_, pages, name) in files.items():
        if bare:
            write_file(path, _encode(pages, path.suffix.lower(), dpi, "", cmyk), force)
            continue
        from lmkit.generate.manifest import manifest_of
        from lmkit.generate.pdf import pages_to_pdf

        manifest = manifest_of(pages, name)
        pdf = pages_to_pdf(pages, _title(pages), manifest.to_json(), cmyk)
        if not proven:
            _prove(pages, pdf)
        content = pdf if path.suffix.lower() == ".pdf" else _encode(pages, path.suffix.lower(), dpi, "", cmyk)
        data = content.encode() if isinstance(content, str) else content
        write_file(path, data, force)
        write_file(manifest_path(path), manifest.of_file(path.name, data).to_json(indent=1) + "\n", force)


def _prove(pages: list[Page], pdf: bytes | None = None) -> None:
    from lmkit.generate.pdf import pages_to_pdf
    from lmkit.verify.proof import prove_pages

    prove_pages(pages_to_pdf(pages, "") if pdf is None else pdf, pages)


def _title(pages: list[Page]) -> str:
    titles = [page.title for page in pages if page.faces] or [pages[0].title]
    return titles[0] if len(titles) == 1 else f"lmkit landmarks, {titles[0]} and {len(titles) - 1} more pages"


def _encode(pages: list[Page], suffix: str, dpi: float, keywords: str, cmyk: bool) -> bytes | str:
    if suffix == ".pdf":
        from lmkit.generate.pdf import pages_to_pdf

        return pages_to_pdf(pages, _title(pages), keywords, cmyk)
    if suffix == ".svg":
        from lmkit.generate.svg import page_to_svg

        return page_to_svg(pages[0])
    from lmkit.generate.png import page_to_png

    return page_to_png(pages[0], dpi)


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
    from dataclasses import replace

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
