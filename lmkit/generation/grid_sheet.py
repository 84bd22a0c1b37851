"""Sheets with as many landmarks of a given size as the paper holds, computed from paper and size."""

from __future__ import annotations

from dataclasses import dataclass

from lmkit.generation.page import PrintedFace
from lmkit.generation.sheet_parts import MARK_GAP_MM, MARK_LENGTH_MM
from lmkit.io.template import PAPERS_MM, Caption, Grid, PageTemplate, RulerPlaces
from lmkit.model.families import MarkerFamily

EDGE_MM = 5.0  # the printer's blank edge
MARKS_MM = MARK_GAP_MM + MARK_LENGTH_MM + 0.2  # crop marks beside a white margin
GAP_MM = 6.0  # between two white margins: crop marks, and the caption below a landmark
CUT_BELOW_MM = 4.5  # cut lines below the caption if there is no space for crop marks
CAPTION_MM = 3.0
RULER_LEFT_MM, RULER_BELOW_MM = 5.5, 10.5  # bands for the rulers
SHORTEST_RULER_MM, LONGEST_RULER_MM = 50, 300


@dataclass(frozen=True)
class _Grid:
    """Landmarks of one size in rows and columns on one paper.

    Attributes:
        paper: a key of ``PAPERS_MM``.
        whole_mm: side of a landmark with its white margin.
        margin_mm: width of this margin.
        has_marks: whether landmarks have crop marks; else cut lines, and white margins up to the edge of the paper.
        has_rulers: whether there are rulers at the left and below.
    """

    paper: str
    whole_mm: float
    margin_mm: float
    has_marks: bool
    has_rulers: bool

    @property
    def start_mm(self) -> tuple[float, float]:
        """Left and upper end of the space for white margins."""
        # A white margin may overlap the printer's blank edge, since nothing is printed in it.
        edge = EDGE_MM + MARKS_MM if self.has_marks else max(0.0, EDGE_MM - self.margin_mm)
        return edge + RULER_LEFT_MM * self.has_rulers, edge

    @property
    def space_mm(self) -> tuple[float, float]:
        """Width and height of the space for white margins."""
        (width, height), (left, top) = PAPERS_MM[self.paper], self.start_mm
        if not self.has_marks:
            return width - 2 * left, height - top - EDGE_MM - CAPTION_MM
        edge = EDGE_MM + MARKS_MM
        return width - left - edge, height - top - edge - RULER_BELOW_MM * self.has_rulers

    @property
    def counts(self) -> tuple[int, int]:
        """Columns and rows."""
        columns, rows = (int((space + GAP_MM) / (self.whole_mm + GAP_MM)) for space in self.space_mm)
        return columns, rows

    def template(self, size_mm: float) -> PageTemplate:
        """The sheet, the landmarks in the center of the space."""
        step = self.whole_mm + GAP_MM
        (columns, rows), (width, height) = self.counts, self.space_mm
        left = self.start_mm[0] + (width - columns * step + GAP_MM) / 2
        top = self.start_mm[1] + (height - rows * step + GAP_MM) / 2
        return PageTemplate(
            format="lmkit-template/1",
            name=f"{self.paper}-grid",
            paper=self.paper,
            printer_margin_mm=EDGE_MM,
            size_mm=size_mm,
            grid=Grid(
                columns=columns,
                rows=rows,
                first_mm=(left + self.whole_mm / 2, top + self.whole_mm / 2),
                step_mm=(step, step),
            ),
            caption=Caption(below_mm=0.6, height_mm=2.2),
            crop_marks=self.has_marks,
            cut_lines=() if self.has_marks else self._cut_lines(left, top),
            rulers=self._rulers() if self.has_rulers else None,
        )

    def _cut_lines(self, left: float, top: float) -> tuple[tuple[float, float, float, float], ...]:
        """Lines between columns and between rows, from edge to edge."""
        (columns, rows), (width, height) = self.counts, PAPERS_MM[self.paper]
        step = self.whole_mm + GAP_MM
        across = [left + k * step - GAP_MM / 2 for k in range(1, columns)]
        down = [top + k * step - GAP_MM + CUT_BELOW_MM for k in range(1, rows)]
        return (
            *((x, EDGE_MM, x, height - EDGE_MM) for x in across),
            *((EDGE_MM, y, width - EDGE_MM, y) for y in down),
        )

    def _rulers(self) -> RulerPlaces:
        length = min(LONGEST_RULER_MM, int(min(self.space_mm)) // 10 * 10)
        left = EDGE_MM + 2.4
        return RulerPlaces(
            horizontal_mm=(left + RULER_LEFT_MM, PAPERS_MM[self.paper][1] - EDGE_MM - 5.5),
            vertical_mm=(left, EDGE_MM + MARKS_MM),
            length_mm=max(SHORTEST_RULER_MM, length),
            slim_vertical=True,
        )


def grid_template(family: MarkerFamily, paper: str, size_mm: float) -> PageTemplate | None:
    """The sheet, portrait or landscape, with most landmarks; None if no landmark fits.

    Rulers and crop marks are added if they do not reduce the number of landmarks.

    Args:
        paper: a key of ``PAPERS_MM``, upright.
    """
    whole = 2 * PrintedFace(family, 0, size_mm, (0.0, 0.0)).reach_mm
    grids = [
        _Grid(name, whole, (whole - size_mm) / 2, has_marks, has_rulers)
        for has_marks, has_rulers in ((True, True), (True, False), (False, False))
        for name in (paper, f"{paper}-landscape")
    ]
    best = max(grids, key=lambda grid: grid.counts[0] * grid.counts[1])
    return best.template(size_mm) if min(best.counts) > 0 else None
