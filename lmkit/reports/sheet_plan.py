"""Plan of a room on a printed page: walls, their names, landmarks on their own side, a scale bar."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.generation.artwork import FilledPath, polygon_commands
from lmkit.generation.page import Box, Item, Text
from lmkit.model.floor_plan import FloorPlan, Island, Wall
from lmkit.model.landmark_map import MappedLandmark
from lmkit.model.palette import BLACK, BLUE, RED, Rgb
from lmkit.model.rooms import Room, split_rooms
from lmkit.visualization.labels import LabelPlacer, text_width

RULE: Rgb = (96, 100, 106)
PALE: Rgb = (232, 236, 240)
SCALES = (10, 20, 25, 50, 75, 100, 150, 200, 250, 300, 400, 500, 750, 1000, 2000, 5000)
UNITS_PER_MM = 5.0  # of the label placer, whose distances are in pixels
WALL_MM, MARK_MM, LEAST_MARK_MM = 0.7, 1.3, 3.0
CODE_MM, NAME_MM = 2.8, 3.2
AROUND_M, BEYOND_M = 0.2, 0.15
OBJECTS = "; (1), (2), ...: objects of the floor plan"


def plan_items(
    landmarks: Sequence[MappedLandmark],
    floor: FloorPlan | None,
    room: Room | None,
    box: Box,
    titles: Sequence[tuple[str, FloatArray]] = (),
) -> tuple[list[Item], float]:
    """Items of a page, and their lower end, mm from its top.

    Args:
        room: room to draw; None: the whole floor, or without a floor the extent of the landmarks.
        box: box on the page, mm.
        titles: words at places of the map, meters.
    """
    walls, islands = _walls_of(floor, room), _islands_of(floor, room)
    corners = [landmark.T_map_landmark.t[:2] for landmark in landmarks] + [
        end for w in walls for end in (w.left, w.right)
    ]
    if room is not None:
        corners += [room.low, room.high]
    low, high = np.min(corners, axis=0) - AROUND_M, np.max(corners, axis=0) + AROUND_M
    room_mm = np.array([box[2] - box[0], box[3] - box[1] - 6])
    scale = next((s for s in SCALES if (1000 * (high - low) / s <= room_mm).all()), SCALES[-1])
    per_m = 1000 / scale
    drawing = _Drawing(low, high, per_m, box)
    for island in islands:
        drawing.object(island)
    for wall in walls:
        drawing.line(wall.left, wall.right, WALL_MM, BLACK)
    for landmark in landmarks:
        drawing.mark(landmark)
    several = len({landmark.family for landmark in landmarks}) > 1
    for landmark in landmarks:
        drawing.code(landmark, str(landmark.id) if several else str(landmark.code))
    for island in islands:
        drawing.word(f"({island.number})", NAME_MM, [drawing.at((island.low + island.high) / 2)], RULE)
    for text, place in titles:
        drawing.word(text, 9.0, [drawing.at(place)], RULE)
    for wall in walls:
        drawing.wall_name(wall)
    bottom = drawing.bottom + 5
    return [*drawing.items, *_scale_bar(box[0], bottom, per_m, scale, bool(islands))], bottom + 1


def _islands_of(floor: FloorPlan | None, room: Room | None) -> list[Island]:
    """Drawn objects of the floor plan, such as tables, whose center is in the room."""
    if floor is None:
        return []
    islands = [island for island in floor.islands if island.use == "obstacle"]
    if room is None:
        return islands
    middles = [(island.low + island.high) / 2 for island in islands]
    return [i for i, at in zip(islands, middles, strict=True) if ((room.low <= at) & (at <= room.high)).all()]


def _walls_of(floor: FloorPlan | None, room: Room | None) -> list[Wall]:
    if floor is None:
        return []
    if room is None:
        return list(floor.walls)
    _, numbers = split_rooms(floor)
    chosen = []
    for wall in floor.walls:
        out = np.array([np.cos(wall.facing_rad), np.sin(wall.facing_rad)])
        places = (
            wall.left + np.linspace(0.05, 0.95, 19)[:, None] * (wall.right - wall.left) + 2.5 * floor.cell_m * out
        )
        if (numbers[floor.cells(places[floor.is_free(places)])] == room.number).any():
            chosen.append(_cut(wall, room.low - BEYOND_M, room.high + BEYOND_M))
    return chosen


def _cut(wall: Wall, low: FloatArray, high: FloatArray) -> Wall:
    """The part of a wall inside a box; the wall must cross the box."""
    shares = np.linspace(0.0, 1.0, 1001)
    points = wall.left + shares[:, None] * (wall.right - wall.left)
    inside = shares[((points >= low) & (points <= high)).all(axis=1)]
    if not len(inside):
        return wall
    left, right = (wall.left + share * (wall.right - wall.left) for share in (inside[0], inside[-1]))
    return replace(wall, left=left, right=right)


class _Drawing:
    """Meters of the map to millimeters of the page: x to the right, y up."""

    def __init__(self, low: FloatArray, high: FloatArray, per_m: float, box: Box) -> None:
        self.items: list[Item] = []
        self.low, self.per_m = low, per_m
        self.left = (box[0] + box[2] - per_m * (high[0] - low[0])) / 2
        self.bottom = box[1] + per_m * (high[1] - low[1])
        self.labels = LabelPlacer()

    def at(self, xy: FloatArray) -> tuple[float, float]:
        """Millimeters on the page."""
        x, y = (float(v) for v in (xy - self.low) * self.per_m)
        return self.left + x, self.bottom - y

    def line(self, start: FloatArray, end: FloatArray, width_mm: float, color: Rgb) -> None:
        """A line that words must not cover."""
        a, b = np.array(self.at(start)), np.array(self.at(end))
        along = (b - a) / max(float(np.linalg.norm(b - a)), 1e-9)
        side = width_mm / 2 * np.array([-along[1], along[0]])
        a, b = a - along * width_mm / 2, b + along * width_mm / 2
        points = [(float(p[0]), float(p[1])) for p in (a + side, b + side, b - side, a - side)]
        self.items.append(FilledPath("art", color, polygon_commands(points)))
        self.labels.keep_line([(UNITS_PER_MM * p[0], UNITS_PER_MM * p[1]) for p in (a.tolist(), b.tolist())])

    def object(self, island: Island) -> None:
        """The extent of a drawn object."""
        (left, bottom), (right, top) = self.at(island.low), self.at(island.high)
        corners = [(left, top), (right, top), (right, bottom), (left, bottom)]
        self.items.append(FilledPath("art", PALE, polygon_commands(corners)))

    def mark(self, landmark: MappedLandmark) -> None:
        """A bar on the landmark's own side of its wall."""
        T = landmark.T_map_landmark
        across = np.array([-T.R[1, 2], T.R[0, 2]])
        flat = float(np.linalg.norm(across)) < 0.3
        along = T.R[:2, 0] if flat else across
        along = along / max(float(np.linalg.norm(along)), 1e-9)
        half = max(landmark.size_m, LEAST_MARK_MM / self.per_m) / 2
        middle = T.t[:2] + (WALL_MM / 2 + MARK_MM / 2 + 0.1) / self.per_m * (T.R[:2, 2] if not flat else 0 * along)
        self.line(middle - half * along, middle + half * along, MARK_MM, RED)
        self.line(middle - 0.6 * half * along, middle + 0.6 * half * along, MARK_MM / 2, BLUE)

    def code(self, landmark: MappedLandmark, label: str) -> None:
        """The code beside the landmark, on the side from which it is seen."""
        T = landmark.T_map_landmark
        x, y = self.at(T.t[:2])
        out = np.array([T.R[0, 2], -T.R[1, 2]])
        out = out / np.linalg.norm(out) if np.linalg.norm(out) > 0.3 else np.array([0.0, -1.0])
        half = abs(out[0]) * text_width(label, CODE_MM) / 2 + abs(out[1]) * CODE_MM / 2
        across = np.array([-out[1], out[0]])
        places = [
            np.array([x, y]) + (2.6 + half + far) * out + aside * across
            for far in (0.0, 2.0, 4.5, 7.5)
            for aside in (0.0, 2.5, -2.5, 5.0, -5.0)
        ]
        self.word(label, CODE_MM, [(float(p[0]), float(p[1])) for p in places], BLACK)

    def wall_name(self, wall: Wall) -> None:
        """The name of a wall, on the side of the room."""
        out = np.array([np.cos(wall.facing_rad), np.sin(wall.facing_rad)])
        places = [
            self.at(wall.left + share * (wall.right - wall.left) + off / self.per_m * out)
            for off in (4.0, 7.0, 10.0)
            for share in (0.5, 0.4, 0.6, 0.3, 0.7, 0.2, 0.8)
        ]
        self.word(wall.name, NAME_MM, places, RULE)

    def word(self, text: str, height: float, candidates: Sequence[tuple[float, float]], color: Rgb) -> None:
        """A word centered at the best of several places."""
        scaled = [(UNITS_PER_MM * x, UNITS_PER_MM * y) for x, y in candidates]
        (x, y), _ = self.labels.place(text, UNITS_PER_MM * height, scaled)
        at = (x / UNITS_PER_MM, y / UNITS_PER_MM + 0.36 * height)
        printable = text.encode("cp1252", "replace").decode("cp1252")
        self.items.append(Text(at, printable, height, "middle", color, bold=color == BLACK))


def _scale_bar(x: float, y: float, per_m: float, scale: int, objects: bool) -> list[Item]:
    length = next(m for m in (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0) if m * per_m >= 8 or m == 100.0)
    ends = [(x, y - 0.3), (x + length * per_m, y - 0.3), (x + length * per_m, y + 0.3), (x, y + 0.3)]
    return [
        FilledPath("art", BLACK, polygon_commands(ends)),
        Text(
            (x + length * per_m + 2, y + 0.9),
            f"{length:g} m; scale 1 : {scale}; x to the right, y up{OBJECTS if objects else ''}",
            2.4,
            color=RULE,
        ),
    ]
