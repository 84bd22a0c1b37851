"""A landmark larger than the paper: sheets that overlap, to be glued together, and a plan of them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from lmkit.errors import InputError
from lmkit.generation.artwork import FilledPath
from lmkit.generation.page import GRAY, Box, Page, PrintedFace, Text, bare_landmark_page, rectangle
from lmkit.generation.png import page_to_image
from lmkit.generation.sheet_parts import LINE_MM, THIN_MM, frame, ruler
from lmkit.io.template import PAPERS_MM
from lmkit.model.families import MarkerFamily
from lmkit.model.palette import BLACK, WHITE
from lmkit.units import MM_PER_INCH

EDGE_MM = 8.0  # around the image on every sheet: the printer's blank edge, and room for marks
FOOT_MM = 7.0  # below it, for the label
OVERLAP_MM = 10.0
MAX_SHEETS = 400
TICK_MM = 2.5
WORD_MM = 3.2
LOOK_MM = 400.0  # size, and px, of a drawing used to find empty sheets
INK_BELOW = 250


@dataclass(frozen=True)
class _Tiling:
    """Division of a landmark with its margin into sheets.

    Attributes:
        paper: (width, height), mm.
        columns, rows: number of sheets.
        left, top: of the first sheet's image, relative to the landmark's middle, mm.
        width, height: of every sheet's image, mm.
    """

    paper: tuple[float, float]
    columns: int
    rows: int
    left: float
    top: float
    width: float
    height: float

    def center_on(self, row: int, column: int) -> tuple[float, float]:
        """Position of the landmark's center on a sheet, mm from its top left corner."""
        x = EDGE_MM - (self.left + column * (self.width - OVERLAP_MM))
        y = EDGE_MM - (self.top + row * (self.height - OVERLAP_MM))
        return x, y


def compose_tiles(family: MarkerFamily, code: int, size_mm: float, paper: str) -> list[Page]:
    """A plan, then the sheets row by row, T1, T2, ...; portrait or landscape, whichever needs fewer sheets.

    Sheets without any part of the landmark are omitted.

    Raises:
        InputError: more than ``MAX_SHEETS`` would be needed.
    """
    face = PrintedFace(family, code, size_mm, (0.0, 0.0))
    width, height = PAPERS_MM[paper]
    tiling = min((_tiling(face, p) for p in ((width, height), (height, width))), key=lambda t: t.columns * t.rows)
    if tiling.columns * tiling.rows > MAX_SHEETS:
        raise InputError(
            "landmark_too_large",
            f"{size_mm:g} mm would take {tiling.columns * tiling.rows} sheets of {paper}",
            f"at most {MAX_SHEETS}; choose larger paper (--paper), or have it printed in one piece (--template)",
        )
    names = _sheet_names(face, tiling)
    return [_plan(face, tiling, paper, names), *(_sheet(face, tiling, *at, name) for at, name in names.items())]


def _sheet_names(face: PrintedFace, tiling: _Tiling) -> dict[tuple[int, int], str]:
    """T1, T2, ... by row and column, for sheets with a part of the landmark."""
    small = bare_landmark_page(face.family, face.code, LOOK_MM)
    ink = np.asarray(page_to_image(small, MM_PER_INCH)).min(axis=2) < INK_BELOW
    scale = LOOK_MM / face.size_mm
    names: dict[tuple[int, int], str] = {}
    for row in range(tiling.rows):
        for column in range(tiling.columns):
            x, y = tiling.center_on(row, column)
            left, top = (LOOK_MM / 2 + (EDGE_MM - at) * scale for at in (x, y))
            columns = slice(max(0, math.floor(left)), max(0, math.ceil(left + tiling.width * scale)))
            rows = slice(max(0, math.floor(top)), max(0, math.ceil(top + tiling.height * scale)))
            if ink[rows, columns].any():
                names[row, column] = f"T{len(names) + 1}"
    return names


def _tiling(face: PrintedFace, paper: tuple[float, float]) -> _Tiling:
    width, height = paper[0] - 2 * EDGE_MM, paper[1] - 2 * EDGE_MM - FOOT_MM
    whole = 2 * face.reach_mm
    columns, rows = (max(1, math.ceil((whole - OVERLAP_MM) / (length - OVERLAP_MM))) for length in (width, height))
    covered = [n * (length - OVERLAP_MM) + OVERLAP_MM for n, length in ((columns, width), (rows, height))]
    return _Tiling(paper, columns, rows, -covered[0] / 2, -covered[1] / 2, width, height)


def _sheet(face: PrintedFace, tiling: _Tiling, row: int, column: int, name: str) -> Page:
    here = replace(face, centre_mm=tiling.center_on(row, column))
    window: Box = (EDGE_MM, EDGE_MM, EDGE_MM + tiling.width, EDGE_MM + tiling.height)
    left, top, right, bottom = window
    items: list[FilledPath | Text] = []
    # Cut lines (left and top, where the sheet covers its neighbors) and lines for the next sheet's edge.
    across = [(left, "cut" if column else "")]
    down = [(top, "cut" if row else "")]
    if column + 1 < tiling.columns:
        across.append((right - OVERLAP_MM, "glue"))
    if row + 1 < tiling.rows:
        down.append((bottom - OVERLAP_MM, "glue"))
    for x, word in across:
        for y in (top - TICK_MM - 0.5, bottom + 0.5):
            items.append(rectangle("mark", BLACK, x - THIN_MM / 2, y, THIN_MM, TICK_MM))
        if word:
            items.append(Text((x + 1, bottom + 3.2), word, WORD_MM, bold=True))
    for y, word in down:
        for x in (left - TICK_MM - 0.5, right + 0.5):
            items.append(rectangle("mark", BLACK, x, y - THIN_MM / 2, TICK_MM, THIN_MM))
        if word:
            items.append(Text((right + 3.2, y + 1), word, WORD_MM, "end", rotation_deg=90, bold=True))
    words = f"sheet {name}: {_title(face)}; print at 100 %"
    items.append(Text((left + 12, bottom + FOOT_MM), words, 3.2, color=GRAY))
    return Page(tiling.paper, tuple(items), f"{_title(face)}, sheet {name}", (here,), window, here.artwork)


def _title(face: PrintedFace) -> str:
    return f"{face.family.name} v{face.family.version}, code {face.code}, {face.size_mm:g} mm"


def _plan(face: PrintedFace, tiling: _Tiling, paper: str, names: Mapping[tuple[int, int], str]) -> Page:
    """The landmark at small size, with the sheets' outlines and names, and instructions."""
    width, height = tiling.paper
    whole = tiling.columns * (tiling.width - OVERLAP_MM) + OVERLAP_MM
    tall = tiling.rows * (tiling.height - OVERLAP_MM) + OVERLAP_MM
    scale = min((width - 40) / whole, (height - 110) / tall)
    center = (width / 2, 34 + tall * scale / 2)
    items: list[FilledPath | Text] = [
        Text((20, 22), f"{_title(face)}: {len(names)} sheets, {tiling.columns} across and {tiling.rows} down", 6.0)
    ]
    items += replace(face, size_mm=face.size_mm * scale, centre_mm=center).artwork
    for row in range(tiling.rows):
        for column in range(tiling.columns):
            x, y = tiling.center_on(row, column)
            left, top = center[0] + (EDGE_MM - x) * scale, center[1] + (EDGE_MM - y) * scale
            box = (left, top, left + tiling.width * scale, top + tiling.height * scale)
            items.append(frame("mark", BLACK, box, LINE_MM))
            name = names.get((row, column), "blank")
            letter = min(4.0, tiling.width * scale / 5, tiling.height * scale / 2.5)
            box = (left + 0.25 * letter, top + 0.25 * letter, (0.6 + 0.62 * len(name)) * letter, 1.3 * letter)
            items.append(rectangle("blank", WHITE, *box))
            at = (box[0] + box[2] / 2, box[1] + 1.02 * letter)
            items.append(Text(at, name, letter, "middle", bold=True))
    missing = len(names) < tiling.rows * tiling.columns
    steps = (
        f"1. Print all sheets on {paper} at 100 %, not fitted to the page; the ruler below must measure 150 mm.",
        *(["    Sheets marked blank are not printed: put plain paper there."] if missing else []),
        "2. Cut every sheet along the ticks marked cut, on its left and upper side.",
        f"3. Glue row by row, from left to right: each sheet lies {OVERLAP_MM:g} mm over the one before, its edge",
        "    on the ticks marked glue; then the rows from top to bottom. Flat, on something stiff.",
        f"4. Measure the {face.family.border_color} border's outer edges: {face.size_mm:g} mm."
        " Write what you measure into the map.",
        f"5. Leave {face.reach_mm - face.size_mm / 2:.0f} mm of white around the border.",
    )
    y = 34 + tall * scale + 10
    for k, line in enumerate(steps):
        items.append(Text((20, y + 5 * k), line, 3.4))
    items += ruler((20, y + 5 * len(steps) + 5), 150, vertical=False).items
    return Page(tiling.paper, tuple(items), f"{_title(face)}, plan of the sheets")
