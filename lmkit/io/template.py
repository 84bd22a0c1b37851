"""Page templates: TOML files with the positions of all parts on the paper.

Included templates are in ``templates/`` of the project; users give their own by path.  All lengths are
millimeters; positions are from the paper's top left corner, x right, y down.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from lmkit.errors import InputError
from lmkit.io.documents import read_text
from lmkit.io.field_problems import first_problem

LARGEST_BYTES = 1 << 20  # of a template: tomllib takes 0.6 s a megabyte
PAPERS_MM = {
    "a0": (841.0, 1189.0),
    "a1": (594.0, 841.0),
    "a2": (420.0, 594.0),
    "a3": (297.0, 420.0),
    "a4": (210.0, 297.0),
    "letter": (215.9, 279.4),
    "tabloid": (279.4, 431.8),
}
PAPERS_MM |= {f"{name}-landscape": (height, width) for name, (width, height) in PAPERS_MM.items()}

Millimeters = Annotated[float, Field(ge=0, le=5000, allow_inf_nan=False)]
Length = Annotated[float, Field(gt=0, le=5000, allow_inf_nan=False)]
PointMm = tuple[Millimeters, Millimeters]
SegmentMm = tuple[Millimeters, Millimeters, Millimeters, Millimeters]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Place(_Part):
    """Position of a landmark: its center, and whether it is upside down (the far side of a folded stand)."""

    centre_mm: PointMm
    upside_down: bool = False


class Grid(_Part):
    """Landmarks in rows and columns: the center of the first, and the steps between centers."""

    columns: Annotated[int, Field(ge=1, le=50)]
    rows: Annotated[int, Field(ge=1, le=50)]
    first_mm: PointMm
    step_mm: PointMm


class RulerPlaces(_Part):
    """The two rulers: start (left end, top end), length, and whether the upright one is slim."""

    horizontal_mm: PointMm
    vertical_mm: PointMm
    length_mm: Annotated[int, Field(ge=50, le=1000, multiple_of=10)] = 180
    slim_vertical: bool = False


class LabelPlace(_Part):
    """Top left of the label: code, family, size, and how to print and mount."""

    at_mm: PointMm


class Caption(_Part):
    """A line under each landmark, ``below_mm`` under its white margin."""

    below_mm: Millimeters = 1.0
    height_mm: Length = 2.8


class TextLine(_Part):
    """A line of text; ``{code}``, ``{family}``, ``{size}``, ``{text}`` and ``{map}`` are filled in."""

    at_mm: PointMm
    text: str
    height_mm: Length = 4.0
    anchor: Literal["start", "middle", "end"] = "start"
    bold: bool = False
    upside_down: bool = False


class TemplateSlot(_Part):
    """Top left of a part of fixed size: the check square, the patch strip or the arrow."""

    at_mm: PointMm


class Holes(_Part):
    """Mounting holes: their centers and their width."""

    at_mm: tuple[PointMm, ...]
    diameter_mm: Length = 5.0


class PageTemplate(_Part):
    """Layout of one sheet.

    Attributes:
        name: its name for ``--template``.
        description: its purpose, in one line.
        paper: a key of ``PAPERS_MM``, or ``paper_mm`` with width and height.
        printer_margin_mm: nothing is printed nearer to the paper's edge.
        size_mm: size of the landmarks without ``--size``.
        centre_mm, grid, places: positions of the landmarks; one of the three.
        repeat: whether all places have the same code; otherwise codes are consecutive.
        rulers, check_square: to measure the print's scale, in millimeters and inches.
        label, caption, texts: text on the sheet.
        patches: reference colors for photographs.
        dimension: a dimension line of the size.
        arrow: an arrow "this side up".
        holes: for mounting.
        crop_marks: marks for cutting, at the corners of each white margin.
        bleed_mm: distance of the crop marks from the cut.
        cut_contour: the cut as a line of the spot color ``CutContour``, for cutting plotters.
        centre_marks: ticks around each landmark that point at its center.
        cut_lines, fold_lines: x0, y0, x1, y1, along the paper's edges; cut solid, fold dashed.
        mirrored: mirrored, for the inside of a window.
        contents: whether the first page is a table of contents.
    """

    format: Literal["lmkit-template/1"]
    name: str
    description: str = ""
    paper: str | None = None
    paper_mm: tuple[Length, Length] | None = None
    printer_margin_mm: Millimeters = 5.0
    size_mm: Length = 180.0
    centre_mm: PointMm | None = None
    grid: Grid | None = None
    places: tuple[Place, ...] = ()
    repeat: bool = False
    rulers: RulerPlaces | None = None
    check_square: TemplateSlot | None = None
    label: LabelPlace | None = None
    caption: Caption | None = None
    texts: tuple[TextLine, ...] = ()
    patches: TemplateSlot | None = None
    dimension: bool = False
    arrow: TemplateSlot | None = None
    holes: Holes | None = None
    crop_marks: bool = False
    bleed_mm: Millimeters = 0.0
    cut_contour: bool = False
    centre_marks: bool = False
    cut_lines: tuple[SegmentMm, ...] = ()
    fold_lines: tuple[SegmentMm, ...] = ()
    mirrored: bool = False
    contents: bool = False

    @model_validator(mode="after")
    def _is_whole(self) -> PageTemplate:
        if (self.paper is None) == (self.paper_mm is None):
            raise ValueError("give either paper or paper_mm")
        if self.paper is not None and self.paper not in PAPERS_MM:
            raise ValueError(f"paper {self.paper!r} is unknown; known: {', '.join(PAPERS_MM)}; or give paper_mm")
        if [self.centre_mm is None, self.grid is None, not self.places].count(False) != 1:
            raise ValueError("give exactly one of centre_mm, grid and places")
        for line in (*self.cut_lines, *self.fold_lines):
            if (line[0] != line[2]) == (line[1] != line[3]):
                raise ValueError(f"line {list(line)} must run along one of the paper's edges")
        return self

    @property
    def page_mm(self) -> tuple[float, float]:
        """(width, height) of the paper."""
        return PAPERS_MM[self.paper] if self.paper is not None else self.paper_mm or (0.0, 0.0)

    @property
    def all_places(self) -> tuple[Place, ...]:
        """Positions of the landmarks of one sheet, row by row."""
        if self.centre_mm is not None:
            return (Place(centre_mm=self.centre_mm),)
        if self.grid is None:
            return self.places
        x, y = self.grid.first_mm
        dx, dy = self.grid.step_mm
        cells = [(column, row) for row in range(self.grid.rows) for column in range(self.grid.columns)]
        return tuple(Place(centre_mm=(x + column * dx, y + row * dy)) for column, row in cells)


def templates_folder() -> Path:
    """Folder of the included templates: inside the wheel, or beside the package in a checkout."""
    inside = Path(__file__).resolve().parents[1] / "templates"
    return inside if inside.is_dir() else Path(__file__).resolve().parents[2] / "templates"


def shipped_templates() -> list[str]:
    """Names of the included templates, in order."""
    return sorted(path.stem for path in templates_folder().glob("*.toml"))


def load_template(name_or_file: str) -> PageTemplate:
    """An included template by name, or a user's by path.

    Raises:
        InputError: no such template, or the file is not valid.
    """
    path = Path(name_or_file)
    if path.suffix != ".toml":
        path = templates_folder() / f"{name_or_file}.toml"
    if not path.is_file():
        raise InputError(
            "unknown_template",
            f"there is no template {name_or_file!r}",
            f"known: {', '.join(shipped_templates())}; or give a .toml file",
        )
    try:
        return PageTemplate.model_validate(tomllib.loads(read_text(path, "template", LARGEST_BYTES)))
    except ValidationError as error:
        where, problem = first_problem(error)
        raise InputError("bad_template", f"{path}: {where}: {problem}", "see docs/formats.md") from None
    except (ValueError, RecursionError) as error:
        raise InputError("bad_template", f"{path}: not a TOML file: {error}", "fix the line it names") from None
