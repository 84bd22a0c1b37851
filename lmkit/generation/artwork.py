"""Drawing of a family and code as filled paths in millimeters, common to all output formats."""

from __future__ import annotations

import math
from dataclasses import dataclass

from lmkit.model.families import MarkerFamily
from lmkit.model.landmark import Ring
from lmkit.model.palette import BLACK, BLUE, RED, WHITE, Rgb
from lmkit.model.square_marker import SquareMarkerFamily

Point = tuple[float, float]
# A path command as in SVG: ("M", p), ("L", p), ("C", control, control, p) or ("Z",).
Command = tuple[str, *tuple[Point, ...]]


@dataclass(frozen=True)
class FilledPath:
    """A shape filled by the even-odd rule.

    Attributes:
        role: kind of shape: ``margin``, ``border``, ``ground``, ``ring``, ``triangle``, ``cell`` or ``mark``.
        color: sRGB fill.
        commands: closed subpaths, mm.
    """

    role: str
    color: Rgb
    commands: tuple[Command, ...]


def landmark_artwork(family: MarkerFamily, code: int, margin: bool = True) -> tuple[FilledPath, ...]:
    """The drawing of one landmark, back to front (docs/landmark.md, section 2).

    Args:
        margin: with the white margin behind it.

    Returns:
        Paths in the landmark's plane: mm at nominal size, origin at the center, x right, y up.

    Raises:
        InputError: the family has no such code.
    """
    if isinstance(family, SquareMarkerFamily):
        return _square_marker_artwork(family, code, margin)
    gaps = family.gaps(code)
    shapes = []
    if margin:
        shapes.append(_square("margin", WHITE, family.half_mm + family.margin_mm))
    shapes.append(_square("border", RED, family.half_mm))
    shapes.append(_square("ground", BLUE, family.ground_half_mm))
    first = 0
    for ring in family.rings:
        ring_gaps = gaps[first : first + ring.gap_count]
        first += ring.gap_count
        if commands := _ring_commands(ring, ring_gaps):
            shapes.append(FilledPath("ring", WHITE, commands))
    triangle = [(float(x), float(y)) for x, y in family.triangle_vertices_mm]
    shapes.append(FilledPath("triangle", WHITE, polygon_commands(triangle)))
    return tuple(shapes)


def _square_marker_artwork(family: SquareMarkerFamily, code: int, margin: bool) -> tuple[FilledPath, ...]:
    """White margin, black square, and the white cells of each row in runs."""
    shapes = [_square("margin", WHITE, family.half_mm + family.margin_mm)] if margin else []
    shapes.append(_square("border", BLACK, family.half_mm))
    commands: tuple[Command, ...] = ()
    cell = family.cell_mm
    for row, white in enumerate(family.darkness(code) == 0.0):
        top = family.half_mm - row * cell
        edges = [k for k in range(len(white)) if white[k] != (k > 0 and white[k - 1])]
        for start, end in zip(edges[::2], edges[1::2], strict=True):
            left, right = (k * cell - family.half_mm for k in (start, end))
            commands += polygon_commands([(left, top), (right, top), (right, top - cell), (left, top - cell)])
    if commands:
        shapes.append(FilledPath("cell", WHITE, commands))
    return tuple(shapes)


def polygon_commands(points: list[Point]) -> tuple[Command, ...]:
    """A closed polygon."""
    return (("M", points[0]), *(("L", p) for p in points[1:]), ("Z",))


def circle_commands(center: Point, radius: float) -> tuple[Command, ...]:
    """A closed circle."""
    x, y = center
    commands: list[Command] = [("M", (x, y + radius))]
    for name, *points in _arc(radius, 0.0, 360.0):
        commands.append((name, *((x + px, y + py) for px, py in points)))
    return (*commands, ("Z",))


def _square(role: str, color: Rgb, half: float) -> FilledPath:
    corners = [(-half, half), (half, half), (half, -half), (-half, -half)]
    return FilledPath(role, color, polygon_commands(corners))


def _ring_commands(ring: Ring, gaps: tuple[bool, ...]) -> tuple[Command, ...]:
    half_gap = ring.gap_width_deg / 2
    open_centers = [c for c, gap in zip(ring.gap_centers_deg, gaps, strict=True) if gap]
    if not open_centers:
        circles: tuple[Command, ...] = ()
        for radius in (ring.outer_mm, ring.inner_mm):
            circles += (("M", _on_circle(radius, 0.0)), *_arc(radius, 0.0, 360.0), ("Z",))
        return circles
    commands: tuple[Command, ...] = ()
    for center, following in zip(open_centers, [*open_centers[1:], open_centers[0] + 360.0], strict=True):
        start, end = center + half_gap, following - half_gap
        commands += (
            ("M", _on_circle(ring.outer_mm, start)),
            *_arc(ring.outer_mm, start, end),
            ("L", _on_circle(ring.inner_mm, end)),
            *_arc(ring.inner_mm, end, start),
            ("Z",),
        )
    return commands


def _on_circle(radius: float, angle_deg: float) -> Point:
    a = math.radians(angle_deg)
    return radius * math.sin(a), radius * math.cos(a)


def _arc(radius: float, start_deg: float, end_deg: float) -> tuple[Command, ...]:
    """Cubic Béziers of at most 30 degrees: error below 1e-6 of the radius."""
    pieces = math.ceil(abs(end_deg - start_deg) / 30.0)
    step = math.radians((end_deg - start_deg) / pieces)
    reach = 4 / 3 * math.tan(step / 4) * radius
    commands: list[Command] = []
    for k in range(pieces):
        a = math.radians(start_deg) + k * step
        b = a + step
        (x0, y0), (x1, y1) = (
            (radius * math.sin(a), radius * math.cos(a)),
            (radius * math.sin(b), radius * math.cos(b)),
        )
        control0 = (x0 + reach * math.cos(a), y0 - reach * math.sin(a))
        control1 = (x1 - reach * math.cos(b), y1 + reach * math.sin(b))
        commands.append(("C", control0, control1, (x1, y1)))
    return tuple(commands)
