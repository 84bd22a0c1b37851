"""A true-scale sheet: paths and texts on paper, and the places of its landmarks.

Page coordinates are millimeters from the top left corner of the paper, x right, y down.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

from lmkit.generation.artwork import Command, FilledPath, Point, landmark_artwork, polygon_commands
from lmkit.model.families import MarkerFamily
from lmkit.model.palette import BLACK, Rgb

GRAY: Rgb = (90, 90, 90)
Box = tuple[float, float, float, float]  # left, top, right, bottom


@dataclass(frozen=True)
class Text:
    """A line of text; ``at`` is the baseline's start (or middle, or end, by ``anchor``).

    Attributes:
        rotation_deg: 0, 90 (upwards) or 180 (upside down), anticlockwise about ``at``.
    """

    at: Point
    content: str
    height_mm: float
    anchor: str = "start"
    color: Rgb = BLACK
    rotation_deg: int = 0
    bold: bool = False


Item = FilledPath | Text


@dataclass(frozen=True)
class PrintedFace:
    """One landmark on a page.

    Attributes:
        size_mm: nominal size over the border's outer edges.
        centre_mm: its middle on the page.
        upside_down: whether it is rotated by 180 degrees.
    """

    family: MarkerFamily
    code: int
    size_mm: float
    centre_mm: Point
    upside_down: bool = False

    @property
    def reach_mm(self) -> float:
        """From the middle to the outer edge of the white margin."""
        return (self.family.half_mm + self.family.margin_mm) * self.size_mm / self.family.side_mm

    @property
    def margin_box(self) -> Box:
        """The face with its white margin."""
        x, y = self.centre_mm
        return (x - self.reach_mm, y - self.reach_mm, x + self.reach_mm, y + self.reach_mm)

    @property
    def artwork(self) -> tuple[FilledPath, ...]:
        """The drawing, without the margin, in page coordinates."""
        scale = self.size_mm / self.family.side_mm
        cx, cy = self.centre_mm
        way = -1 if self.upside_down else 1

        def moved(shape: FilledPath) -> FilledPath:
            def move(command: Command) -> Command:
                return (command[0], *((cx + way * x * scale, cy - way * y * scale) for x, y in command[1:]))

            return FilledPath(shape.role, shape.color, tuple(move(c) for c in shape.commands))

        return tuple(moved(shape) for shape in landmark_artwork(self.family, self.code, margin=False))


@dataclass(frozen=True)
class Page:
    """One sheet, ready to be written in any format.

    Attributes:
        size_mm: (width, height) of the paper.
        items: paths and texts, back to front.
        title: description of the sheet in one line.
        faces: the landmarks among the items.
        window, windowed: a box, and paths that are clipped to it and drawn under the items.
        mirrored: left and right are swapped when it is printed.
        stretch: factors in x and y, about the paper's center, that compensate the printer's scale errors.
    """

    size_mm: tuple[float, float]
    items: tuple[Item, ...]
    title: str
    faces: tuple[PrintedFace, ...] = ()
    window: Box | None = None
    windowed: tuple[FilledPath, ...] = ()
    mirrored: bool = False
    stretch: tuple[float, float] = (1.0, 1.0)

    def on_paper(self, point: Point) -> Point:
        """Position on the paper of a point of the page."""
        (x, y), (width, height) = point, self.size_mm
        sx = -self.stretch[0] if self.mirrored else self.stretch[0]
        return width / 2 + (x - width / 2) * sx, height / 2 + (y - height / 2) * self.stretch[1]


def bare_landmark_page(family: MarkerFamily, code: int, size_mm: float) -> Page:
    """The face alone, its border at the very edge of the page."""
    face = PrintedFace(family, code, size_mm, (size_mm / 2, size_mm / 2))
    title = f"{family.name} v{family.version}, code {code}, {size_mm:g} mm"
    return Page((size_mm, size_mm), face.artwork, title, (face,))


def rectangle(role: str, color: Rgb, x: float, y: float, width: float, height: float) -> FilledPath:
    """An axis-parallel rectangle in page coordinates."""
    corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height)]
    return FilledPath(role, color, polygon_commands(corners))


def box_of(items: tuple[Item, ...]) -> Box:
    """Bounding box of the items."""
    lefts, tops, rights, bottoms = zip(*map(item_box, items), strict=True)
    return (min(lefts), min(tops), max(rights), max(bottoms))


@lru_cache(maxsize=4096)  # sheets of a set share their rulers and marks
def item_box(item: Item) -> Box:
    """Bounding box of one item."""
    return _text_box(item) if isinstance(item, Text) else _path_box(item)


def overlap(a: Box, b: Box) -> bool:
    """Whether two boxes share more than an edge."""
    slack = 1e-6
    return a[0] < b[2] - slack and b[0] < a[2] - slack and a[1] < b[3] - slack and b[1] < a[3] - slack


def _path_box(path: FilledPath) -> Box:
    # Control points of the short arcs lie within 2 % of the curve.
    points = [point for command in path.commands for point in command[1:]]
    x, y = zip(*points, strict=True)
    return (min(x), min(y), max(x), max(y))


def _text_box(text: Text) -> Box:
    from reportlab.pdfbase.pdfmetrics import stringWidth

    font = "Helvetica-Bold" if text.bold else "Helvetica"
    width = float(stringWidth(text.content, font, text.height_mm))
    start = {"start": 0.0, "middle": -width / 2, "end": -width}[text.anchor]
    # Baseline at 0: capitals reach 0.74 of the height above it, tails 0.21 below.
    left, top, right, bottom = start, -0.74 * text.height_mm, start + width, 0.21 * text.height_mm
    x, y = text.at
    if text.rotation_deg == 90:
        return (x + top, y - right, x + bottom, y - left)
    if text.rotation_deg == 180:
        return (x - right, y - bottom, x - left, y - top)
    return (x + left, y + top, x + right, y + bottom)
