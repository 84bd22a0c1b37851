"""Parts of a sheet beside its landmarks: rulers, marks, color patches, text."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

from lmkit.generation.artwork import Command, FilledPath, Point, circle_commands, polygon_commands
from lmkit.generation.page import GRAY, Box, Item, PrintedFace, Text, box_of, rectangle
from lmkit.model.palette import BLACK, BLUE, RED, Rgb
from lmkit.units import MM_PER_INCH

LINE_MM = 0.25
THIN_MM = 0.2
CHECK_SQUARE_MM = 2 * MM_PER_INCH  # two inches: 50.8 mm
MARK_LENGTH_MM = 4.0
MARK_GAP_MM = 0.8  # between a white margin and the marks around it
PATCH_MM = 9.0
# The landmark's own inks, the printer's primaries, and grays.
PATCHES: tuple[Rgb, ...] = (
    RED,
    BLUE,
    (0, 0, 0),
    (85, 85, 85),
    (128, 128, 128),
    (192, 192, 192),
    (0, 174, 239),
    (236, 0, 140),
    (255, 242, 0),
)


@dataclass(frozen=True)
class Part:
    """Part of a sheet with a name for messages; parts must not overlap.

    Attributes:
        alone: whether it must not overlap other such parts; False for marks and lines.
    """

    name: str
    items: tuple[Item, ...]
    alone: bool = True

    @cached_property
    def box(self) -> Box:
        """The bounding box."""
        return box_of(self.items)


@lru_cache(maxsize=64)
def ruler(start: Point, length_mm: int, vertical: bool, slim: bool = False) -> Part:
    """Millimeters on one side of the line, inches on the other.

    The outer edges of its end ticks mark exactly 0 and ``length_mm``.

    Args:
        slim: with short ticks and small figures, for narrow edges.
    """
    x, y = start
    scale, letter = (0.38, 1.4) if slim else (1.0, 2.2)
    mm_line, inch_line = 2.6 * scale + 0.95 * letter, -2.2 * scale - 0.2 * letter
    items: list[Item] = []

    def bar(along: float, across: float, length: float, width: float) -> FilledPath:
        if vertical:
            return rectangle("mark", BLACK, x + across, y + along, width, length)
        return rectangle("mark", BLACK, x + along, y + across, length, width)

    def number(along: float, across: float, content: str, anchor: str = "middle") -> Text:
        if vertical:
            return Text((x + across, y + along), content, letter, anchor, rotation_deg=90)
        return Text((x + along, y + across), content, letter, anchor)

    items.append(bar(0, 0, length_mm, LINE_MM))
    for mm in range(0, length_mm + 1, 5):
        tick = scale * (2.6 if mm % 50 == 0 or mm == length_mm else 1.8 if mm % 10 == 0 else 1.1)
        # The end ticks are inside, so that the ruler's ends are edges of lines, not their centers.
        offset = 0.0 if mm == 0 else -THIN_MM if mm == length_mm else -THIN_MM / 2
        items.append(bar(mm + offset, 0, THIN_MM, tick))
        if mm % 50 == 0 and 0 < mm < length_mm - 15:
            items.append(number(mm, mm_line, f"{mm}"))
    items.append(number(length_mm, mm_line, f"{length_mm} mm", "start" if vertical else "end"))
    for eighth in range(int(length_mm / MM_PER_INCH * 8) + 1):
        tick = scale * (2.2 if eighth % 8 == 0 else 1.4 if eighth % 4 == 0 else 0.8)
        items.append(bar(eighth * MM_PER_INCH / 8 - (THIN_MM / 2 if eighth else 0), -tick, THIN_MM, tick))
        if eighth % 8 == 0 and eighth > 0:
            inches = eighth // 8
            items.append(number(inches * MM_PER_INCH, inch_line, f"{inches} in" if inches == 1 else f"{inches}"))
    return Part("vertical ruler" if vertical else "horizontal ruler", tuple(items))


@lru_cache(maxsize=64)
def check_square(at: Point) -> Part:
    """A square of two inches with ticks every 10 mm and every half inch."""
    x, y = at
    side = CHECK_SQUARE_MM
    items: list[Item] = [frame("mark", BLACK, (x, y, x + side, y + side), LINE_MM)]
    for k in range(1, 6):
        items.append(rectangle("mark", BLACK, x + 10 * k - THIN_MM / 2, y, THIN_MM, 1.6))
        items.append(rectangle("mark", BLACK, x, y + 10 * k - THIN_MM / 2, 1.6, THIN_MM))
    for k in range(1, 4):
        half_inch = k * MM_PER_INCH / 2
        items.append(rectangle("mark", BLACK, x + half_inch - THIN_MM / 2, y + side - 1.6, THIN_MM, 1.6))
        items.append(rectangle("mark", BLACK, x + side - 1.6, y + half_inch - THIN_MM / 2, 1.6, THIN_MM))
    words = (f"{side:g} x {side:g} mm", "2 x 2 in")
    for k, line in enumerate(words):
        items.append(Text((x + side / 2, y + side / 2 + 4.2 * k), line, 3.2, "middle"))
    return Part("check square", tuple(items))


@lru_cache(maxsize=64)
def patch_strip(at: Point, is_colored: bool) -> Part:
    """Nine patches: both inks of the ring landmark, black and grays, the printer's primaries."""
    x, y = at
    items: list[Item] = [
        rectangle("patch", color, x + k * (PATCH_MM + 1), y, PATCH_MM, PATCH_MM) for k, color in enumerate(PATCHES)
    ]
    if is_colored:
        words = "Print in color: without red and blue the landmark is not read."
        items.append(Text((x, y + PATCH_MM + 3), words, 2.4))
    return Part("patch strip", tuple(items))


@lru_cache(maxsize=64)
def up_arrow(at: Point) -> Part:
    """An arrow with its meaning."""
    x, y = at
    right: list[Point] = [(x + 5, y), (x + 10, y + 6), (x + 6.5, y + 6), (x + 6.5, y + 12)]
    left: list[Point] = [(x + 3.5, y + 12), (x + 3.5, y + 6), (x, y + 6)]
    arrow = FilledPath("mark", BLACK, polygon_commands(right + left))
    return Part("arrow", (arrow, Text((x + 5, y + 15.2), "this side up", 2.6, "middle")))


def label(at: Point, face: PrintedFace, codes: str, ruler_mm: int | None) -> Part:
    """``codes``, family, size, and how to print and mount."""
    x, y = at
    family = face.family
    span = f"{face.size_mm:g} mm over the {family.border_color} border's outer edges"
    scale = "Print at 100 %, without fitting to the page"
    check = f"{scale}: both rulers must measure {ruler_mm} mm." if ruler_mm is not None else f"{scale}."
    lines = (
        (codes, 9.0, BLACK, True),
        (f"lmkit {family.name} v{family.version}, {span}", 4.2, BLACK, False),
        (check, 3.6, GRAY, False),
        (family.print_hint, 3.6, GRAY, False),
    )
    items = []
    for content, height, color, bold in lines:
        y += height * 1.45
        items.append(Text((x, y), content, height, color=color, bold=bold))
    return Part("label", tuple(items))


def caption(face: PrintedFace, below_mm: float, height_mm: float) -> Part:
    """One line under a landmark (above, for an upside-down landmark)."""
    x, y = face.centre_mm
    words = f"{face.family.name} v{face.family.version}, code {face.code}, {face.size_mm:g} mm"
    way = -1 if face.upside_down else 1
    at = (x, y + way * (face.reach_mm + below_mm + 0.74 * height_mm))
    text = Text(at, words, height_mm, "middle", GRAY, 180 if face.upside_down else 0)
    return Part(f"caption of code {face.code}", (text,))


def dimension(face: PrintedFace) -> Part:
    """Dimension of the size: extension lines from the border's outer edges, and arrows between them."""
    x, y = face.centre_mm
    half = face.size_mm / 2
    top = y + face.reach_mm + MARK_GAP_MM
    line = top + 2.5
    items: list[Item] = []
    for side in (-1, 1):
        edge = x + side * half
        items.append(rectangle("mark", GRAY, edge - (THIN_MM if side > 0 else 0), top, THIN_MM, 4))
        tip: list[Point] = [(edge, line), (edge - side * 3, line - 0.8), (edge - side * 3, line + 0.8)]
        items.append(FilledPath("mark", GRAY, polygon_commands(tip)))
    color = face.family.border_color
    words = f"{face.size_mm:g} mm: {color} edge to {color} edge"
    height = min(3.2, face.size_mm / 18)
    text = Text((x, line + 0.35 * height), words, height, "middle", GRAY)
    left, _, right, _ = box_of((text,))
    for a, b in ((x - half, left - 2), (right + 2, x + half)):
        items.append(rectangle("mark", GRAY, a, line - THIN_MM / 2, b - a, THIN_MM))
    return Part("dimension", (*items, text))


def crop_marks(face: PrintedFace, bleed_mm: float) -> Part:
    """Two short lines at each corner of the white margin, in line with its edges."""
    left, top, right, bottom = face.margin_box
    away = bleed_mm + MARK_GAP_MM
    items = []
    for x, dx in ((left, -1), (right, 1)):
        for y, dy in ((top, -1), (bottom, 1)):
            start = x + dx * away if dx > 0 else x - away - MARK_LENGTH_MM
            items.append(rectangle("mark", BLACK, start, y - THIN_MM / 2, MARK_LENGTH_MM, THIN_MM))
            start = y + dy * away if dy > 0 else y - away - MARK_LENGTH_MM
            items.append(rectangle("mark", BLACK, x - THIN_MM / 2, start, THIN_MM, MARK_LENGTH_MM))
    return Part("crop marks", tuple(items), alone=False)


def centre_marks(face: PrintedFace) -> Part:
    """Ticks outside the white margin that point at the landmark's middle."""
    x, y = face.centre_mm
    left, top, right, bottom = face.margin_box
    gap, length = MARK_GAP_MM, 3.0
    items = (
        rectangle("mark", GRAY, x - THIN_MM / 2, top - gap - length, THIN_MM, length),
        rectangle("mark", GRAY, x - THIN_MM / 2, bottom + gap, THIN_MM, length),
        rectangle("mark", GRAY, left - gap - length, y - THIN_MM / 2, length, THIN_MM),
        rectangle("mark", GRAY, right + gap, y - THIN_MM / 2, length, THIN_MM),
    )
    return Part("center marks", items, alone=False)


def cut_contour(face: PrintedFace) -> Part:
    """The white margin's outline, for a cutting plotter."""
    return Part("cut contour", (frame("cut", (255, 0, 255), face.margin_box, LINE_MM),), alone=False)


@lru_cache(maxsize=64)
def hole(at: Point, diameter_mm: float) -> Part:
    """A circle with a cross, to be punched or drilled."""
    x, y = at
    outline = (*circle_commands(at, diameter_mm / 2), *circle_commands(at, diameter_mm / 2 - THIN_MM))
    items = (
        FilledPath("mark", GRAY, outline),
        rectangle("mark", GRAY, x - 1, y - THIN_MM / 2, 2, THIN_MM),
        rectangle("mark", GRAY, x - THIN_MM / 2, y - 1, THIN_MM, 2),
    )
    return Part("mounting hole", items)


def straight_line(segment: tuple[float, float, float, float], dashed: bool) -> Part:
    """A line along one of the paper's edges: solid to cut, dashed to fold."""
    x0, y0, x1, y1 = segment
    length = abs(x1 - x0) + abs(y1 - y0)
    x, y = min(x0, x1), min(y0, y1)
    dash, step = (2.0, 4.0) if dashed else (length, length)
    items = []
    along = 0.0
    while along < length - 1e-9:
        piece = min(dash, length - along)
        if y0 == y1:
            items.append(rectangle("mark", GRAY, x + along, y - THIN_MM / 2, piece, THIN_MM))
        else:
            items.append(rectangle("mark", GRAY, x - THIN_MM / 2, y + along, THIN_MM, piece))
        along += step
    return Part("fold line" if dashed else "cut line", tuple(items), alone=False)


def frame(role: str, color: Rgb, box: Box, width: float) -> FilledPath:
    """The outline of a box, its outer edge on the box."""
    left, top, right, bottom = box
    outer: list[Point] = [(left, top), (right, top), (right, bottom), (left, bottom)]
    w = width
    inner: list[Point] = [(left + w, top + w), (right - w, top + w), (right - w, bottom - w), (left + w, bottom - w)]
    commands: tuple[Command, ...] = (*polygon_commands(outer), *polygon_commands(inner))
    return FilledPath(role, color, commands)
