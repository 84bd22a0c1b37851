"""A landmark larger than the paper: sheets that overlap, to be glued together, and a plan of them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from lmkit.errors import InputError
from lmkit.generation.artwork import FilledPath
from lmkit.generation.page import GREY, Box, Page, PrintedFace, Text, rectangle
from lmkit.generation.sheet_parts import LINE_MM, THIN_MM, frame, ruler
from lmkit.io.template import PAPERS_MM
from lmkit.model.families import MarkerFamily
from lmkit.model.palette import BLACK, WHITE

EDGE_MM = 8.0  # around the image on every sheet: the printer's blank edge, and room for marks
FOOT_MM = 7.0  # below it, for the label
OVERLAP_MM = 10.0
MAX_SHEETS = 400
TICK_MM = 2.5


@dataclass(frozen=True)
class _Tiling:
    """How the landmark with its margin is cut into sheets.

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

    def centre_on(self, row: int, column: int) -> tuple[float, float]:
        """Position of the landmark's center on a sheet, mm from its top left corner."""
        x = EDGE_MM - (self.left + column * (self.width - OVERLAP_MM))
        y = EDGE_MM - (self.top + row * (self.height - OVERLAP_MM))
        return x, y


def compose_tiles(family: MarkerFamily, code: int, size_mm: float, paper: str) -> list[Page]:
    """A plan, then the sheets row by row; upright or across, whichever takes fewer.

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
            f"at most {MAX_SHEETS}; choose a larger --paper or have it printed in one piece (--template)",
        )
    sheets = [_sheet(face, tiling, row, column) for row in range(tiling.rows) for column in range(tiling.columns)]
    return [_plan(face, tiling, paper), *sheets]


def sheet_name(row: int, column: int) -> str:
    """A1 at the top left, B1 below it."""
    letters = ""
    row += 1
    while row > 0:
        row, rest = divmod(row - 1, 26)
        letters = chr(ord("A") + rest) + letters
    return f"{letters}{column + 1}"


def _tiling(face: PrintedFace, paper: tuple[float, float]) -> _Tiling:
    width, height = paper[0] - 2 * EDGE_MM, paper[1] - 2 * EDGE_MM - FOOT_MM
    whole = 2 * face.reach_mm
    columns, rows = (max(1, math.ceil((whole - OVERLAP_MM) / (length - OVERLAP_MM))) for length in (width, height))
    covered = [n * (length - OVERLAP_MM) + OVERLAP_MM for n, length in ((columns, width), (rows, height))]
    return _Tiling(paper, columns, rows, -covered[0] / 2, -covered[1] / 2, width, height)


def _sheet(face: PrintedFace, tiling: _Tiling, row: int, column: int) -> Page:
    here = replace(face, centre_mm=tiling.centre_on(row, column))
    window: Box = (EDGE_MM, EDGE_MM, EDGE_MM + tiling.width, EDGE_MM + tiling.height)
    left, top, right, bottom = window
    name = sheet_name(row, column)
    items: list[FilledPath | Text] = []
    # Where to cut (left and top, the sheet lies on its neighbours) and where the next sheet's edge comes.
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
            items.append(Text((x + 1, bottom + 2.6), word, 2.2, color=GREY))
    for y, word in down:
        for x in (left - TICK_MM - 0.5, right + 0.5):
            items.append(rectangle("mark", BLACK, x, y - THIN_MM / 2, TICK_MM, THIN_MM))
        if word:
            items.append(Text((right + 2.6, y + 1), word, 2.2, "end", GREY, rotation_deg=90))
    words = f"sheet {name}: {_title(face)}; print at 100 %"
    items.append(Text((left + 12, bottom + FOOT_MM), words, 3.2, color=GREY))
    return Page(tiling.paper, tuple(items), f"{_title(face)}, sheet {name}", (here,), window, here.artwork)


def _title(face: PrintedFace) -> str:
    return f"{face.family.name} v{face.family.version}, code {face.code}, {face.size_mm:g} mm"


def _plan(face: PrintedFace, tiling: _Tiling, paper: str) -> Page:
    """The landmark small, with the sheets' outlines and names, and what to do."""
    width, height = tiling.paper
    whole = tiling.columns * (tiling.width - OVERLAP_MM) + OVERLAP_MM
    tall = tiling.rows * (tiling.height - OVERLAP_MM) + OVERLAP_MM
    scale = min((width - 40) / whole, (height - 110) / tall)
    centre = (width / 2, 34 + tall * scale / 2)
    items: list[FilledPath | Text] = [Text((20, 22), f"{_title(face)}: {tiling.rows} x {tiling.columns} sheets", 6.0)]
    items += replace(face, size_mm=face.size_mm * scale, centre_mm=centre).artwork
    for row in range(tiling.rows):
        for column in range(tiling.columns):
            x, y = tiling.centre_on(row, column)
            left, top = centre[0] + (EDGE_MM - x) * scale, centre[1] + (EDGE_MM - y) * scale
            box = (left, top, left + tiling.width * scale, top + tiling.height * scale)
            items.append(frame("mark", BLACK, box, LINE_MM))
            items.append(rectangle("blank", WHITE, left + 1, top + 1, 8, 5.5))
            items.append(Text((left + 5, top + 5.2), sheet_name(row, column), 4.0, "middle", bold=True))
    steps = (
        f"1. Print all sheets on {paper} at 100 %, not fitted to the page; the ruler below must measure 150 mm.",
        "2. Cut every sheet along the ticks marked cut, on its left and upper side.",
        f"3. Glue row by row, from left to right: each sheet lies {OVERLAP_MM:g} mm over the one before, its edge",
        "    on the ticks marked glue; then the rows from top to bottom. Flat, on something stiff.",
        f"4. Measure the red border's outer edges: {face.size_mm:g} mm. Write what you measure into the map.",
        f"5. Leave {face.reach_mm - face.size_mm / 2:.0f} mm of white around the border.",
    )
    y = 34 + tall * scale + 10
    for k, line in enumerate(steps):
        items.append(Text((20, y + 5 * k), line, 3.4))
    items += ruler((20, y + 40), 150, vertical=False).items
    return Page(tiling.paper, tuple(items), f"{_title(face)}, plan of the sheets")
