"""A true-scale sheet: where the landmark, its rulers and its label stand on the paper.

Page coordinates are millimetres from the top left corner of the paper, x right, y down.
"""

from __future__ import annotations

from dataclasses import dataclass

from lmkit.errors import InputError
from lmkit.formats.template import PageTemplate
from lmkit.generate.artwork import Command, FilledPath, Point, landmark_artwork, polygon_commands
from lmkit.model.landmark import LandmarkFamily
from lmkit.model.palette import BLACK, Rgb

RULER_MM = 180
GREY: Rgb = (90, 90, 90)


@dataclass(frozen=True)
class Text:
    """A line of text; ``at`` is the baseline's start (or middle, or end, by ``anchor``)."""

    at: Point
    content: str
    height_mm: float
    anchor: str = "start"
    color: Rgb = BLACK
    vertical: bool = False
    bold: bool = False


@dataclass(frozen=True)
class Page:
    """One sheet, ready to be written in any format.

    Attributes:
        size_mm: (width, height) of the paper.
        items: paths and texts, back to front.
        title: what the sheet is, in one line.
    """

    size_mm: tuple[float, float]
    items: tuple[FilledPath | Text, ...]
    title: str


def compose_landmark_page(family: LandmarkFamily, code: int, size_mm: float, template: PageTemplate) -> Page:
    """One landmark on one sheet, with rulers on both axes and a label.

    Raises:
        InputError: the landmark with its white margin does not fit on the paper, or the code is none
            of the family's.
    """
    scale = size_mm / family.side_mm
    cx, cy = template.centre_mm
    reach = (family.half_mm + family.margin_mm) * scale
    width, height = template.paper_mm
    free = min(cx, cy, width - cx, height - cy)
    if reach > free:
        raise InputError(
            "landmark_too_large",
            f"a landmark of {size_mm:g} mm with its white margin does not fit on template {template.name}",
            f"the largest that fits there is {free / reach * size_mm:.0f} mm; choose a smaller --size",
        )
    items: list[FilledPath | Text] = [
        _placed(shape, scale, (cx, cy)) for shape in landmark_artwork(family, code, margin=False)
    ]
    title = f"{family.name} v{family.version}, code {code}, {size_mm:g} mm"
    if template.rulers is not None:
        items += _ruler(template.rulers.horizontal_mm, vertical=False)
        items += _ruler(template.rulers.vertical_mm, vertical=True)
    if template.label is not None:
        x, y = template.label.at_mm
        span = f"{size_mm:g} mm over the red border's outer edges"
        check = f"Print at 100 %, without fitting to the page: both rulers must measure {RULER_MM} mm."
        lines = (
            (f"code {code}", 9.0, BLACK, True),
            (f"lmkit {family.name} v{family.version}, {span}", 4.2, BLACK, False),
            (check, 3.6, GREY, False),
            ("Keep the white margin. Mount flat, with the triangle pointing up.", 3.6, GREY, False),
        )
        for content, text_height, color, bold in lines:
            y += text_height * 1.45
            items.append(Text((x, y), content, text_height, color=color, bold=bold))
    return Page(template.paper_mm, tuple(items), title)


def bare_landmark_page(family: LandmarkFamily, code: int, size_mm: float) -> Page:
    """The face alone, its border at the very edge of the page."""
    scale = size_mm / family.side_mm
    shapes = landmark_artwork(family, code, margin=False)
    items = tuple(_placed(shape, scale, (size_mm / 2, size_mm / 2)) for shape in shapes)
    return Page((size_mm, size_mm), items, f"{family.name} v{family.version}, code {code}, {size_mm:g} mm")


def rectangle(role: str, color: Rgb, x: float, y: float, width: float, height: float) -> FilledPath:
    """An axis-parallel rectangle in page coordinates."""
    corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height)]
    return FilledPath(role, color, polygon_commands(corners))


def _placed(shape: FilledPath, scale: float, centre: Point) -> FilledPath:
    def move(command: Command) -> Command:
        return (command[0], *((centre[0] + x * scale, centre[1] - y * scale) for x, y in command[1:]))

    return FilledPath(shape.role, shape.color, tuple(move(c) for c in shape.commands))


def _ruler(start: Point, vertical: bool) -> list[FilledPath | Text]:
    """A ruler of RULER_MM from ``start``; its outer tick edges mark exactly 0 and RULER_MM."""
    x, y = start
    line, thin = 0.25, 0.2
    items: list[FilledPath | Text] = []

    def bar(along: float, across: float, length: float, width: float) -> FilledPath:
        if vertical:
            return rectangle("mark", BLACK, x + across, y + along, width, length)
        return rectangle("mark", BLACK, x + along, y + across, length, width)

    items.append(bar(0, 0, RULER_MM, line))
    for mm in range(0, RULER_MM + 1, 5):
        tick = 2.6 if mm % 50 == 0 or mm == RULER_MM else 1.8 if mm % 10 == 0 else 1.1
        # The end ticks lie inside, so that the ruler's ends are edges and not middles of lines.
        offset = 0.0 if mm == 0 else -thin if mm == RULER_MM else -thin / 2
        items.append(bar(mm + offset, 0, thin, tick))
        if mm in (50, 100, 150):
            label = f"{mm}"
            if vertical:
                items.append(Text((x + 4.6, y + mm), label, 2.2, "middle", vertical=True))
            else:
                items.append(Text((x + mm, y + 5.0), label, 2.2, "middle"))
    end = f"{RULER_MM} mm"
    if vertical:
        items.append(Text((x + 4.6, y + RULER_MM), end, 2.2, "start", vertical=True))
    else:
        items.append(Text((x + RULER_MM, y + 5.0), end, 2.2, "end"))
    return items
