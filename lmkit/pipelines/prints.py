"""Printable files of landmarks: layout, file names, encoding, and verification before writing."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from lmkit.errors import InputError
from lmkit.generation.grid_sheet import grid_template
from lmkit.generation.manifest import manifest_of
from lmkit.generation.page import Page, bare_landmark_page
from lmkit.generation.pdf import pages_to_pdf
from lmkit.generation.png import page_to_png
from lmkit.generation.sheet import Wording, compose_sheets, largest_mm, usual_size_mm
from lmkit.generation.tiles import compose_tiles
from lmkit.io.files import check_writable, write_file
from lmkit.io.manifest import manifest_path
from lmkit.io.template import PageTemplate, load_template
from lmkit.model.families import MarkerFamily
from lmkit.units import parse_two_lengths_mm
from lmkit.verification.proof import prove_pages

PAPERS = ("a4", "letter", "a3", "a2", "a1", "a0", "tabloid")
DEFAULT_PAPER = "a4"
SUFFIXES = (".pdf", ".png", ".svg")
MOST_STRETCH = 0.05
FONT_LETTERS = "cp1252"  # letters of Helvetica in a PDF (WinAnsiEncoding)
LEAST_SIZE_MM = 5.0  # no printer draws smaller ones cleanly
READABLE_MM = 30.0  # smaller landmarks are read up to one meter with a focal length of 600 px
READ_FROM_PX = 17.5  # side at which 95 % are read, docs/printing.md


def output_names(output: Path, labels: list[str]) -> dict[str, Path]:
    """The file for every label: the name of the output, with the label if there are several."""
    if len(labels) == 1:
        return {labels[0]: output}
    return {label: output.with_name(f"{output.stem}-{label}{output.suffix}") for label in labels}


@dataclass(frozen=True)
class PrintLayout:
    """Layout of the sheets.

    Attributes:
        template: name of an included template, or a TOML file; None for the plain sheet of ``paper``.
        paper: None for the template's own, or A4.
        size_mm: landmark size; None for the template's own.
        text, map_name: values for templates with these fields.
        mirror: mirrored, for the inside of glass.
        compensate: measured size of the last print, such as ``178.6x179.4``.
    """

    family: MarkerFamily
    template: str | None = None
    paper: str | None = None
    size_mm: float | None = None
    text: str = ""
    map_name: str = ""
    mirror: bool = False
    compensate: str | None = None

    @cached_property
    def sheet(self) -> PageTemplate:
        """The template.

        Raises:
            InputError: an unknown paper or template, or a paper other than the template's.
        """
        if self.template is None:
            if self._paper not in PAPERS:
                hint = f"choose {', '.join(PAPERS)} (--paper), or give a template (--template)"
                raise InputError("bad_paper", f"paper {self.paper!r} is unknown", hint)
            return load_template(self._paper)
        sheet = load_template(self.template)
        if self.paper not in (None, sheet.paper):
            width, height = sheet.page_mm
            hint = "leave the paper (--paper) out, or choose another template (lmkit generate --list-templates)"
            raise InputError(
                "template_paper",
                f"template {sheet.name} has its own paper of {width:g} x {height:g} mm, not {self.paper}",
                hint,
            )
        return sheet

    @property
    def _paper(self) -> str:
        return self.paper or DEFAULT_PAPER

    @property
    def tiled(self) -> bool:
        """Whether the landmark is larger than its paper, without a template."""
        if self.template is not None or self.size_mm is None:
            return False

        return self.size_mm > largest_mm(self.family, self.sheet)

    def sheet_for(self, codes: Sequence[int]) -> PageTemplate:
        """The template, or for several codes of a given size a sheet with as many landmarks as fit."""
        if self.template is None and self.size_mm is not None and len(codes) > 1:
            grid = grid_template(self.family, self.sheet.name, self.size_mm)
            if grid is not None and len(grid.all_places) > 1:
                return grid
        return self.sheet

    def name_for(self, codes: Sequence[int]) -> str:
        """Name of the layout, for the manifest."""
        return "tiles" if self.tiled else self.sheet_for(codes).name

    def pages(self, codes: Sequence[int]) -> list[Page]:
        """All pages for these codes."""
        sheet = self.sheet_for(codes)
        stretch = self.stretch(self.size_mm or usual_size_mm(self.family, sheet))
        if self.tiled and self.size_mm is not None:
            tiles = [page for code in codes for page in compose_tiles(self.family, code, self.size_mm, self._paper)]
            return [replace(page, mirrored=self.mirror, stretch=stretch) for page in tiles]
        for option, placeholder, value in (("--text", "{text}", self.text), ("--map-name", "{map}", self.map_name)):
            if value and not any(placeholder in line.text for line in sheet.texts):
                raise InputError(
                    "no_room",
                    f"template {sheet.name} has no place for {option}",
                    f"use a4-door or letter-door, or a template of your own with a text of {placeholder}",
                )
            _require_drawable(value, option)
        wording = Wording(self.text, self.map_name)
        return compose_sheets(self.family, codes, sheet, self.size_mm, wording, self.mirror, stretch)

    def stretch(self, size_mm: float) -> tuple[float, float]:
        """Factors of the drawing in x and y that compensate the printer."""
        if self.compensate is None:
            return (1.0, 1.0)
        width, height = parse_two_lengths_mm(self.compensate, "--compensate")
        factors = (size_mm / width, size_mm / height)
        if max(abs(factor - 1) for factor in factors) > MOST_STRETCH:
            raise InputError(
                "bad_compensation",
                f"--compensate {self.compensate}: more than {MOST_STRETCH:.0%} off the intended {size_mm:g} mm",
                "print at 100 % without fitting to the page, and measure the border's outer edges in mm",
            )
        return factors


def _require_drawable(text: str, option: str) -> None:
    """Refuse letters that the standard fonts of PDF do not have: viewers print black boxes for them.

    Raises:
        InputError: the letters are named.
    """
    missing = "".join(dict.fromkeys(letter for letter in text if not letter.encode(FONT_LETTERS, "ignore")))
    if missing:
        raise InputError(
            "no_letters",
            f"{option}: the print font has no {missing}",
            "write it in Latin letters, or write on the print by hand",
        )


def print_title(pages: list[Page]) -> str:
    titles = [page.title for page in pages if page.faces] or [pages[0].title]
    return titles[0] if len(titles) == 1 else f"lmkit landmarks, {titles[0]} and {len(titles) - 1} more pages"


def encode_page(page: Page, path: Path, dpi: float) -> bytes:
    """The bytes of a PDF, SVG or PNG file with one page.

    Args:
        path: its suffix gives the format.
    """
    if path.suffix.lower() == ".pdf":
        return pages_to_pdf([page], page.title)
    if path.suffix.lower() == ".svg":
        from lmkit.generation.svg import page_to_svg

        return page_to_svg(page).encode()

    return page_to_png(page, dpi)


@dataclass(frozen=True, eq=False)
class Prints:
    """Pages with landmarks, each verified by reading it from the drawn page.

    Attributes:
        pages: the pages.
        layout: name of the template, or ``tiles``.
        pdf: the bytes of the PDF file, with the manifest inside.
    """

    pages: tuple[Page, ...]
    layout: str
    pdf: bytes

    def save(self, path: str | os.PathLike[str], *, dpi: float = 300.0, overwrite: bool = False) -> list[Path]:
        """Write the pages with their manifests, all or none; the files written, without the manifests.

        Args:
            path: one .pdf file; .svg and .png get a file a page.
            dpi: of PNG files.

        Raises:
            InputError: no path, another suffix, a resolution out of range, or a file exists or cannot be written.
        """
        if not isinstance(path, str | os.PathLike):
            raise InputError("not_a_path", f"{path!r} is not a path", 'give a file name, such as "landmarks.pdf"')
        if not isinstance(dpi, int | float) or not dpi > 0:
            raise InputError("bad_dpi", f"dpi {dpi!r} is out of range", "give dots per inch, such as 300")
        target = Path(path)
        if target.suffix.lower() not in SUFFIXES:
            raise InputError(
                "bad_suffix", f"cannot write {target}: unknown file type", "use a name ending in .pdf, .svg or .png"
            )
        if target.suffix.lower() == ".pdf":
            files: dict[Path, tuple[bytes, list[Page]]] = {target: (self.pdf, list(self.pages))}
        else:
            labels = [str(number) for number in range(1, len(self.pages) + 1)]
            names = output_names(target, labels)
            files = {
                names[label]: (encode_page(page, target, dpi), [page])
                for label, page in zip(labels, self.pages, strict=True)
            }
        _require_writable(files, overwrite)
        _write_with_manifests(files, self.layout, overwrite)
        return list(files)

    def __repr__(self) -> str:
        return f"Prints({len(self.pages)} pages, {self.layout})"


def make_prints(
    family: MarkerFamily, codes: list[int], *, size_mm: float | None, paper: str | None, template: str | None
) -> Prints:
    """Lay landmarks out, draw them, and read every one back.

    Raises:
        InputError: an unknown code, paper or template, or a size that does not fit.
        LmkitError: a landmark does not read back.
    """
    for code in codes:
        family.require_code(code)
    layout = PrintLayout(family, template, paper, size_mm)
    pages = layout.pages(codes)
    name = layout.name_for(codes)
    pdf = pages_to_pdf(pages, print_title(pages), manifest_of(pages, name).to_json())
    prove_pages(pdf, pages)
    return Prints(tuple(pages), name, pdf)


def write_prints(
    layout: PrintLayout,
    codes: Sequence[int],
    output: Path,
    *,
    each: bool = False,
    dpi: float = 300.0,
    cmyk: bool = False,
    overwrite: bool = False,
) -> list[Path]:
    """Write sheets with their manifests, all or none: every page is read back before the first is written.

    Args:
        output: one PDF with all sheets, or one per code with ``each``; PNG and SVG get a file per page.
        dpi: resolution of PNG files.
        cmyk: process colors (PDF).

    Returns:
        The files, without their manifests.

    Raises:
        InputError: a size that does not fit, or a file exists or cannot be written.
        LmkitError: a landmark does not read back.
    """
    suffix = output.suffix.lower()
    groups = [[code] for code in codes] if each or suffix != ".pdf" else [list(codes)]
    sets, name = [layout.pages(group) for group in groups], layout.name_for(groups[0])
    labeled: dict[str, list[Page]] = {}
    if suffix == ".pdf":
        labeled = dict(zip(map(str, codes), sets, strict=False))
    else:
        for code, pages in zip(codes, sets, strict=True):
            several = len(pages) > 1
            labeled |= {f"{code}-{k}" if several else str(code): [page] for k, page in enumerate(pages, start=1)}
    files = {path: labeled[label] for label, path in output_names(output, list(labeled)).items()}
    _require_writable(files, overwrite)
    pdfs = [pages_to_pdf(pages, print_title(pages), manifest_of(pages, name).to_json(), cmyk) for pages in sets]
    # Tiles are read as a whole, so pages of one landmark are verified together.
    for pdf, pages in zip(pdfs, sets, strict=True):
        prove_pages(pdf, pages)
    contents = {
        path: (pdfs[k] if suffix == ".pdf" else encode_page(pages[0], path, dpi), pages)
        for k, (path, pages) in enumerate(files.items())
    }
    _write_with_manifests(contents, name, overwrite)
    return list(contents)


def write_faces(
    family: MarkerFamily,
    codes: Sequence[int],
    size_mm: float | None,
    output: Path,
    dpi: float = 300.0,
    overwrite: bool = False,
) -> list[Path]:
    """Write landmarks without a sheet around them, one PNG or SVG file per code; returns the files.

    Raises:
        InputError: a file exists or cannot be written.
    """
    names = output_names(output, [str(code) for code in codes])
    for path in names.values():
        check_writable(path, overwrite)
    for code in codes:
        path = names[str(code)]
        page = bare_landmark_page(family, code, size_mm or family.side_mm)
        write_file(path, encode_page(page, path, dpi), overwrite)
    return list(names.values())


def check_landmark_size(size_mm: float) -> str | None:
    """A warning if a landmark of this size can only be read from short distances, else None.

    Raises:
        InputError: the size is too small to print.
    """
    if size_mm < LEAST_SIZE_MM:
        raise InputError(
            "too_small",
            f"a size of {size_mm:g} mm is below {LEAST_SIZE_MM:g} mm, which no printer draws cleanly",
            f"choose {LEAST_SIZE_MM:g} mm or more (--size); 180mm is usual",
        )
    if size_mm >= READABLE_MM:
        return None
    farthest_m = size_mm * 600 / READ_FROM_PX / 1000
    return (
        f"a landmark of {size_mm:g} mm is read from at most {farthest_m:.1f} m with a focal length of 600 px; "
        "see docs/printing.md"
    )


def _require_writable(files: Iterable[Path], overwrite: bool) -> None:
    for path in files:
        check_writable(path, overwrite)
        check_writable(manifest_path(path), overwrite)


def _write_with_manifests(files: Mapping[Path, tuple[bytes, list[Page]]], layout: str, overwrite: bool) -> None:
    for path, (data, pages) in files.items():
        write_file(path, data, overwrite)
        manifest = manifest_of(pages, layout).of_file(path.name, data)
        write_file(manifest_path(path), manifest.to_json(indent=1) + "\n", overwrite)
