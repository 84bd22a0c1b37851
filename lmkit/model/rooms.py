"""Rooms of a floor plan, and distances along walls that a tape measure can reach."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.ndimage import distance_transform_edt, label

from lmkit.arrays import BoolArray, FloatArray, IntArray
from lmkit.model.floor_plan import FloorPlan, Wall

HALF_DOOR_M = 0.7  # openings narrower than twice this separate rooms
LEAST_ROOM_M2 = 2.0  # narrow parts, such as corridors, that are rooms of their own
TAPE_M = 0.08  # a tape measure runs this far in front of its wall
NEAR_WALL_M = 0.15  # a landmark this close to a wall is mounted on it
ALIGNED = 0.9  # cosine between a landmark's normal and that of its wall
CORNER_M = 0.12  # a wall that ends this close to another one meets it
CROSSING = 0.3  # sine of the least angle at which two walls make a corner


@dataclass(frozen=True, eq=False)
class Room:
    """A part of the free floor.

    Attributes:
        number: 1, 2, ... from the top left of the plan.
        low, high: (2,) its extent in the map, meters.
        middle: (2,) the point in it that is farthest from walls.
        places: names of the floor plan's places inside it.
    """

    number: int
    low: FloatArray
    high: FloatArray
    middle: FloatArray
    places: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        """Number and places."""
        return f"Room {self.number}" + (f" ({', '.join(self.places)})" if self.places else "")


@dataclass(frozen=True)
class TapeEnd:
    """Start of a tape measure along a wall.

    Attributes:
        distance_m: from there to the landmark's center.
        wall: name of the wall that makes the corner; None: the wall ends without a corner, as at a door.
    """

    distance_m: float
    wall: str | None

    def __str__(self) -> str:
        return f"{self.distance_m:.3f} m from {self.wall or 'the end'}"


def split_rooms(floor: FloorPlan) -> tuple[list[Room], IntArray]:
    """Rooms, and for each cell the number of its room, 0 where it is not free.

    Openings up to 1.4 m wide separate rooms.  A part that is narrower everywhere, such as a corridor, is a room of
    its own.  Furniture and text do not separate rooms.
    """
    cell = floor.cell_m
    walled = _without_furniture(floor)
    core = walled.clearance_m > HALF_DOOR_M
    cores, count = label(core)
    parts: IntArray = np.zeros(core.shape, dtype=np.int64)
    if count:
        # Each core reaches as far as the clearance that made it; openings between two are shared.
        far, (rows, columns) = distance_transform_edt(~core, return_indices=True)
        wide = walled.free & (far * cell <= HALF_DOOR_M + 1.5 * cell)
        parts[wide] = cores[rows[wide], columns[wide]]
    narrow, narrow_count = label(walled.free & (parts == 0))
    areas = np.bincount(narrow.ravel(), minlength=narrow_count + 1) * cell**2
    for k in range(1, narrow_count + 1):
        if areas[k] >= LEAST_ROOM_M2 or not parts.any():
            count += 1
            parts[narrow == k] = count
    parts = np.where(floor.free, _grown(walled.free, parts), 0)
    return _numbered(floor, parts)


def _without_furniture(floor: FloorPlan) -> FloorPlan:
    """The floor with its small islands, which block the robot, as free cells."""
    if floor.island_cells is None:
        return floor
    small = [island.number for island in floor.islands if island.use == "obstacle"]
    return replace(floor, free=floor.free | np.isin(floor.island_cells, small))


def _grown(free: BoolArray, parts: IntArray) -> IntArray:
    """Rooms that reach over all free cells that are connected with them; others are left out."""
    kernel = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], dtype=np.uint8)
    while True:
        grown = cv2.dilate(parts.astype(np.float32), kernel).astype(np.int64)
        new = free & (parts == 0) & (grown > 0)
        if not new.any():
            return parts
        parts[new] = grown[new]


def _numbered(floor: FloorPlan, parts: IntArray) -> tuple[list[Room], IntArray]:
    numbers = [int(k) for k in np.unique(parts) if k]
    middles = {k: floor.middles(*np.nonzero(parts == k)) for k in numbers}
    tops = sorted(numbers, key=lambda k: (-round(middles[k][:, 1].max(), 1), middles[k][:, 0].min()))
    rooms, renamed = [], np.zeros_like(parts)
    for number, k in enumerate(tops, start=1):
        renamed[parts == k] = number
        names = tuple(
            name
            for name, (x, y, _) in floor.places.items()
            if floor.is_free(np.array([x, y])) and parts[floor.cells(np.array([x, y]))] == k
        )
        low, high = middles[k].min(axis=0) - floor.cell_m / 2, middles[k].max(axis=0) + floor.cell_m / 2
        widest = middles[k][np.argmax(floor.clearance_m[parts == k])]
        rooms.append(Room(number, low, high, widest, names))
    return rooms, renamed


def wall_of(floor: FloorPlan, position: FloatArray, normal: FloatArray) -> Wall | None:
    """The wall on which a landmark is mounted, by its (3,) position and (3,) normal; None: on no wall."""
    best: tuple[float, Wall] | None = None
    for wall in floor.walls:
        facing = np.array([np.cos(wall.facing_rad), np.sin(wall.facing_rad)])
        from_left = position[:2] - wall.left
        off, along = abs(float(from_left @ facing)), float(from_left @ wall.along)
        fits = normal[:2] @ facing > ALIGNED and -NEAR_WALL_M < along < wall.length_m + NEAR_WALL_M
        if fits and off < NEAR_WALL_M and (best is None or off < best[0]):
            best = (off, wall)
    return None if best is None else best[1]


def tape_ends(floor: FloorPlan, wall: Wall, along_m: float) -> tuple[TapeEnd, TapeEnd]:
    """Nearest corners on the left and on the right of a place of a wall, or where the wall ends.

    Args:
        along_m: of the place, from the wall's left end.
    """
    out = np.array([np.cos(wall.facing_rad), np.sin(wall.facing_rad)])
    left: tuple[float, str | None] = (0.0, None)
    right: tuple[float, str | None] = (wall.length_m, None)
    for other in floor.walls:
        at = _corner(wall, other, out)
        if at is None:
            continue
        # Only the side of the other wall that looks at the place can be measured from.
        looks = float(np.array([np.cos(other.facing_rad), np.sin(other.facing_rad)]) @ wall.along)
        if looks > 0 and at < along_m and at >= left[0] - CORNER_M and (left[1] is None or at > left[0]):
            left = (at, other.name)
        if looks < 0 and at > along_m and at <= right[0] + CORNER_M and (right[1] is None or at < right[0]):
            right = (at, other.name)
    return TapeEnd(along_m - left[0], left[1]), TapeEnd(right[0] - along_m, right[1])


def _corner(wall: Wall, other: Wall, out: FloatArray) -> float | None:
    """Distance from the wall's left end at which another wall blocks a tape along it, if any."""
    crossing = float(other.along @ out)
    if other is wall or abs(crossing) < CROSSING:
        return None
    # Where the other wall, a little longer at its ends, crosses the line of the tape.
    reach = (TAPE_M - float((other.left - wall.left) @ out)) / crossing
    if not -CORNER_M < reach < other.length_m + CORNER_M:
        return None
    on_wall = other.left + (reach - TAPE_M / crossing) * other.along
    return float((on_wall - wall.left) @ wall.along)
