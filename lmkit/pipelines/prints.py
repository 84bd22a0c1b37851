"""Landmarks to printable files: layout, file names, encoding, and the proof before writing."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from lmkit.errors import InputError
from lmkit.generation.manifest import manifest_of
from lmkit.generation.page import Page
from lmkit.generation.pdf import pages_to_pdf
from lmkit.generation.png import page_to_png
from lmkit.generation.sheet import Wording, compose_sheets, largest_mm
from lmkit.generation.tiles import compose_tiles
from lmkit.io.files import check_writable, write_file
from lmkit.io.manifest import manifest_path
from lmkit.io.template import PageTemplate, load_template
from lmkit.model.landmark import LandmarkFamily
from lmkit.units import parse_two_lengths_mm
from lmkit.verification.proof import prove_pages

PAPERS = ("a4", "letter", "a3")


MOST_STRETCH = 0.05


def output_names(output: Path, labels: list[str]) -> dict[str, Path]:
    """The file for every label: the output's own name, or with the label where there are several."""
    if len(labels) == 1:
        return {labels[0]: output}
    return {label: output.with_name(f"{output.stem}-{label}{output.suffix}") for label in labels}


@dataclass(frozen=True)
class PrintLayout:
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

        return self.size_mm > largest_mm(self.family, self.sheet)

    @property
    def name(self) -> str:
        """For the manifest."""
        return "tiles" if self.tiled else self.sheet.name

    def pages(self, codes: list[int]) -> list[Page]:
        """All pages for these codes."""

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
        """Factors of the drawing in x and y that compensate the printer."""
        if self.compensate is None:
            return (1.0, 1.0)
        width, height = parse_two_lengths_mm(self.compensate, "--compensate")
        factors = (size_mm / width, size_mm / height)
        if max(abs(factor - 1) for factor in factors) > MOST_STRETCH:
            raise InputError(
                "bad_compensation",
                f"--compensate {self.compensate}: more than {MOST_STRETCH:.0%} from the {size_mm:g} mm it should be",
                "print at 100 % without fitting to the page, and measure the red border's outer edges in mm",
            )
        return factors


def print_title(pages: list[Page]) -> str:
    titles = [page.title for page in pages if page.faces] or [pages[0].title]
    return titles[0] if len(titles) == 1 else f"lmkit landmarks, {titles[0]} and {len(titles) - 1} more pages"


def encode_page(page: Page, path: Path, dpi: float) -> bytes:
    """The bytes of an SVG or PNG file."""
    if path.suffix.lower() == ".svg":
        from lmkit.generation.svg import page_to_svg

        return page_to_svg(page).encode()

    return page_to_png(page, dpi)


@dataclass(frozen=True, eq=False)
class Prints:
    """Pages with landmarks, every one of which has been read back from the drawn page.

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
            InputError: another suffix, or a file exists or cannot be written.
        """
        target = Path(path)
        if target.suffix.lower() not in (".pdf", ".svg", ".png"):
            raise InputError("bad_suffix", f"cannot write {target}: unknown kind", "name it .pdf, .svg or .png")
        if target.suffix.lower() == ".pdf":
            files: dict[Path, tuple[bytes, list[Page]]] = {target: (self.pdf, list(self.pages))}
        else:
            labels = [str(number) for number in range(1, len(self.pages) + 1)]
            names = output_names(target, labels)
            files = {
                names[label]: (encode_page(page, target, dpi), [page])
                for label, page in zip(labels, self.pages, strict=True)
            }
        for file in files:
            check_writable(file, overwrite)
            check_writable(manifest_path(file), overwrite)
        for file, (data, pages) in files.items():
            write_file(file, data, overwrite)
            manifest = manifest_of(pages, self.layout).of_file(file.name, data)
            write_file(manifest_path(file), manifest.to_json(indent=1) + "\n", overwrite)
        return list(files)

    def __repr__(self) -> str:
        return f"Prints({len(self.pages)} pages, {self.layout})"


def make_prints(
    family: LandmarkFamily, codes: list[int], *, size_mm: float | None, paper: str, template: str | None
) -> Prints:
    """Lay landmarks out, draw them, and read every one back.

    Raises:
        InputError: an unknown code, paper or template, or a size that does not fit.
        LmkitError: a landmark does not read back.
    """
    for code in codes:
        family.gaps(code)
    layout = PrintLayout(family, template, paper, size_mm, "", "", False, None)
    pages = layout.pages(codes)
    pdf = pages_to_pdf(pages, print_title(pages), manifest_of(pages, layout.name).to_json())
    prove_pages(pdf, pages)
    return Prints(tuple(pages), layout.name, pdf)
