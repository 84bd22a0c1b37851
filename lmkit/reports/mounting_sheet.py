"""Sheets for mounting: each room with its landmarks, and their distances from corners for a tape measure; PDF."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lmkit.generation.page import Item, Page, Text, rectangle
from lmkit.generation.pdf import pages_to_pdf
from lmkit.io.template import load_template
from lmkit.model.floor_plan import FloorPlan, Wall
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.model.palette import BLACK
from lmkit.model.rooms import Room, split_rooms, tape_ends, wall_of
from lmkit.reports.sheet_plan import PALE, RULE, plan_items

MARGIN_MM, GAP_MM = 12.0, 4.0
ROW_MM, TEXT_MM, SMALL_MM = 6.4, 2.9, 2.4
LARGEST_PLAN = 0.5  # of the page's height
SHOWN_ROLL_DEG, SHOWN_TILT_DEG = 3.0, 5.0
FONT_LETTERS = "cp1252"
ALONG_WALLS = (
    "Face the wall: left and right are as you see them. Distances run along the wall to the landmark's center, from "
    "the corner with the wall that is named, or from the end of the wall at an opening. Walls are the lines of the "
    "floor plan: if both distances do not add up to what you measure between the corners, the wall differs from the "
    "plan. Write down what you measured."
)
IN_THE_MAP = "Positions of the landmarks' centers in the map; angles from x toward y."
# Columns of the table: heading, second line of the heading, and share of the width.
COLUMNS = (
    ("", "", 6),
    ("code", "", 20),
    ("wall", "", 16),
    ("from left corner", "to the center", 34),
    ("from right corner", "to the center", 34),
    ("height", "of the center", 18),
    ("upper edge", "of the border", 19),
    ("size", "", 14),
    ("measured", "from left", 18),
    ("measured", "height", 18),
)


@dataclass(frozen=True)
class Row:
    """A line of the table.

    Attributes:
        cells: texts of the columns; both corner columns are joined if a landmark is not on a wall.
        note: below the code, such as ``rotated 90° left``.
    """

    cells: tuple[str, ...]
    note: str = ""


def mounting_sheets(landmarks: LandmarkMap, floor: FloorPlan | None, name: str, paper: str = "a4") -> bytes:
    """The PDF: an overview of several rooms, then each room with a table of its landmarks.

    Args:
        floor: floor plan; None: positions are given in the map instead of along walls.
        name: name of the map, for the headings.
    """
    page_mm = load_template(paper).page_mm
    if floor is None:
        pages = _room_pages(list(landmarks), None, None, f"{name}: {len(landmarks)} landmarks", page_mm)
    else:
        rooms, numbers = split_rooms(floor)
        of_room: dict[int, list[MappedLandmark]] = {number: [] for number in range(len(rooms) + 1)}
        for landmark in landmarks:
            T = landmark.T_map_landmark
            before = T.t[:2] + 2.5 * floor.cell_m * T.R[:2, 2]
            of_room[int(numbers[floor.cells(before)]) if floor.is_free(before) else 0].append(landmark)
        used = [room for room in rooms if of_room[room.number]]
        pages = _overview(landmarks, floor, used, of_room, name, page_mm) if len(used) > 1 else []
        for room in used:
            some = of_room[room.number]
            pages += _room_pages(some, floor, room, f"{room.title}: {_count(some)}", page_mm)
        if of_room[0]:
            title = f"On no free floor of the plan: {_count(of_room[0])}"
            pages += _room_pages(of_room[0], None, None, title, page_mm)
    numbered = [_with_foot(page, name, k + 1, len(pages)) for k, page in enumerate(pages)]
    return pages_to_pdf(numbered, f"mounting sheet of {name}")


def _count(landmarks: Sequence[MappedLandmark]) -> str:
    return f"{len(landmarks)} landmark{'s' if len(landmarks) != 1 else ''}"


def _overview(
    landmarks: LandmarkMap,
    floor: FloorPlan,
    rooms: Sequence[Room],
    of_room: dict[int, list[MappedLandmark]],
    name: str,
    page_mm: tuple[float, float],
) -> list[Page]:
    width, height = page_mm
    box = (MARGIN_MM, MARGIN_MM + 16, width - MARGIN_MM, height * 0.72)
    middles = [(f"{room.number}", room.middle) for room in rooms]
    drawn, bottom = plan_items(list(landmarks), floor, None, box, middles)
    title = f"{name}: {_count(list(landmarks))} in {len(rooms)} rooms"
    items = [_text((MARGIN_MM, MARGIN_MM + 5), title, 5.0, bold=True), *drawn]
    y = bottom + 8
    for room in rooms:
        codes = ", ".join(_label(m, list(landmarks)) for m in sorted(of_room[room.number], key=lambda m: m.id))
        for line in _wrapped(f"{room.title}: {codes}", int((width - 2 * MARGIN_MM) / (0.52 * TEXT_MM))):
            items.append(_text((MARGIN_MM, y), line, TEXT_MM))
            y += 1.5 * TEXT_MM
    return [Page(page_mm, tuple(items), name)]


def _room_pages(
    landmarks: Sequence[MappedLandmark],
    floor: FloorPlan | None,
    room: Room | None,
    title: str,
    page_mm: tuple[float, float],
) -> list[Page]:
    """A plan with the table below it; the table continues on further pages."""
    width, height = page_mm
    rows = [row for _, row in sorted((_row(m, floor, landmarks) for m in landmarks), key=lambda pair: pair[0])]
    top = MARGIN_MM + 19
    box = (MARGIN_MM, top, width - MARGIN_MM, top + LARGEST_PLAN * height)
    items: list[Item] = [_text((MARGIN_MM, MARGIN_MM + 5), title, 5.0, bold=True)]
    items += _lines_below_title(floor, width)
    drawn, bottom = plan_items(landmarks, floor, room, box)
    items += drawn
    y, pages = bottom + GAP_MM, []
    while True:
        fitting = max(1, int((height - MARGIN_MM - 8 - y - 2 * ROW_MM) / ROW_MM))
        items += _table(rows[:fitting], y, width)
        pages.append(Page(page_mm, tuple(items), title))
        rows = rows[fitting:]
        if not rows:
            return pages
        items, y = [_text((MARGIN_MM, MARGIN_MM + 5), f"{title}, continued", 5.0, bold=True)], MARGIN_MM + 10


def _lines_below_title(floor: FloorPlan | None, width: float) -> list[Item]:
    text = IN_THE_MAP if floor is None else ALONG_WALLS
    lines = _wrapped(text, int((width - 2 * MARGIN_MM) / (0.47 * SMALL_MM)))
    return [_text((MARGIN_MM, MARGIN_MM + 10 + 3.4 * k), line, SMALL_MM, RULE) for k, line in enumerate(lines)]


def _row(
    landmark: MappedLandmark, floor: FloorPlan | None, others: Sequence[MappedLandmark]
) -> tuple[tuple[str, float, str], Row]:
    """The sort key of a row, and the row."""
    T = landmark.T_map_landmark
    wall = None if floor is None else wall_of(floor, T.t, T.R[:, 2])
    label, z = _label(landmark, others), float(T.t[2])
    common = (f"{z:.3f} m", f"{z + landmark.size_m / 2:.3f} m", f"{1000 * landmark.size_m:.0f} mm", "", "")
    if floor is None or wall is None:
        facing = np.degrees(np.arctan2(T.R[1, 2], T.R[0, 2])) % 360
        looks = f"faces {facing:.0f}°" if np.hypot(*T.R[:2, 2]) > 0.3 else ("up" if T.R[2, 2] > 0 else "down")
        where = f"x {T.t[0]:.3f} m, y {T.t[1]:.3f} m, {looks}"
        return ("~", landmark.id.code, label), Row(("", label, "", where, "", *common), _turned(landmark, None))
    along = float((T.t[:2] - wall.left) @ wall.along)
    left, right = tape_ends(floor, wall, along)
    cells = ("", label, wall.name, str(left), str(right), *common)
    return (wall.name, along, label), Row(cells, _turned(landmark, wall))


def _turned(landmark: MappedLandmark, wall: Wall | None) -> str:
    """Note about a landmark that is not upright and flat on its wall."""
    R = landmark.T_map_landmark.R
    if np.hypot(R[0, 2], R[1, 2]) < 0.3:
        return ""
    level = np.array([-R[1, 2], R[0, 2], 0.0]) / np.hypot(R[0, 2], R[1, 2])
    roll = np.degrees(np.arctan2(R[2, 0], R[:, 0] @ level))
    notes = [f"rotated {abs(roll):.0f}° {'left' if roll > 0 else 'right'}"] if abs(roll) > SHOWN_ROLL_DEG else []
    tilt = np.degrees(np.arcsin(np.clip(R[2, 2], -1.0, 1.0)))
    if abs(tilt) > SHOWN_TILT_DEG:
        notes.append(f"looks {abs(tilt):.0f}° {'up' if tilt > 0 else 'down'}")
    return ", ".join(notes)


def _table(rows: Sequence[Row], y: float, width: float) -> list[Item]:
    scale = (width - 2 * MARGIN_MM) / sum(share for _, _, share in COLUMNS)
    starts = [MARGIN_MM + scale * sum(share for _, _, share in COLUMNS[:k]) for k in range(len(COLUMNS) + 1)]
    items: list[Item] = [rectangle("art", PALE, MARGIN_MM, y, width - 2 * MARGIN_MM, 1.5 * ROW_MM)]
    for (first, second, _), x in zip(COLUMNS, starts, strict=False):
        items.append(_text((x + 1, y + 3.8), first, TEXT_MM, bold=True))
        items.append(_text((x + 1, y + 7.6), second, SMALL_MM, RULE))
    y += 1.5 * ROW_MM
    for row in rows:
        base = y + (ROW_MM * 0.5 if row.note else ROW_MM * 0.66)
        for cell, x in zip(row.cells, starts, strict=False):
            items.append(_text((x + 1, base), cell, TEXT_MM, bold=x == starts[1]))
        if row.note:
            items.append(_text((starts[1] + 1, y + ROW_MM * 0.9), row.note, SMALL_MM, RULE))
        items += _frame(starts[0] + 1.2, y + 1.5, 3.4, 3.4)
        items.append(rectangle("art", RULE, MARGIN_MM, y + ROW_MM, width - 2 * MARGIN_MM, 0.15))
        for k in (-3, -2):
            items.append(rectangle("art", RULE, starts[k], y, 0.15, ROW_MM))
        y += ROW_MM
    return items


def _frame(x: float, y: float, width: float, height: float) -> list[Item]:
    line = 0.25
    return [
        rectangle("art", BLACK, x, y, width, line),
        rectangle("art", BLACK, x, y + height - line, width, line),
        rectangle("art", BLACK, x, y, line, height),
        rectangle("art", BLACK, x + width - line, y, line, height),
    ]


def _with_foot(page: Page, name: str, number: int, count: int) -> Page:
    width, height = page.size_mm
    foot = (
        _text((MARGIN_MM, height - MARGIN_MM), name, SMALL_MM, RULE),
        Text((width - MARGIN_MM, height - MARGIN_MM), f"page {number} of {count}", SMALL_MM, "end", RULE),
    )
    return Page(page.size_mm, (*page.items, *foot), page.title)


def _label(landmark: MappedLandmark, others: Sequence[MappedLandmark]) -> str:
    several = len({other.family for other in others}) > 1
    return str(landmark.id) if several else str(landmark.code)


def _text(
    at: tuple[float, float], content: str, height: float, color: tuple[int, int, int] = BLACK, bold: bool = False
) -> Text:
    printable = content.encode(FONT_LETTERS, "replace").decode(FONT_LETTERS)
    return Text(at, printable, height, "start", color, bold=bold)


def _wrapped(text: str, width: int) -> list[str]:
    return textwrap.wrap(text, width)
