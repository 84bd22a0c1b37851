"""Landmarks to printable files: layout, file names, encoding, and the proof before writing."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from lmkit.errors import InputError
from lmkit.generation.page import Page
from lmkit.generation.png import page_to_png
from lmkit.generation.sheet import Wording, compose_sheets, largest_mm
from lmkit.generation.tiles import compose_tiles
from lmkit.io.template import PageTemplate, load_template
from lmkit.model.landmark import LandmarkFamily
from lmkit.units import parse_two_lengths_mm

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
        """What the drawing must be multiplied by."""
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
