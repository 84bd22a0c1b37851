"""A floor from above, as the underlay of a plan: walls, and how well a pose is known, as colors."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.ndimage import distance_transform_edt, label
from scipy.spatial import cKDTree

from lmkit.arrays import BoolArray, ByteArray, FloatArray
from lmkit.model.floor_plan import FloorPlan
from lmkit.visualization.canvas import Rgb
from lmkit.visualization.plan_view import Note, Underlay

FREE, WALL, BLIND, OUTSIDE = (255, 255, 255), (70, 74, 80), (222, 222, 226), (244, 244, 242)
WALL_SHOWN_M = 0.15
HATCH, HATCH_CELLS = (60, 20, 80), 5  # color of the lines, and distance between them
OBSTACLE, IGNORED = (150, 118, 84), (236, 226, 214)  # islands of drawings
LEAST_ROOM_M2 = 1.0
NOTED_AT, NOTED_OFF_M = (0.5, 0.4, 0.6, 0.3, 0.7), 0.45  # the name of a wall: along it, and off it
# From well known to badly known, none of them the red of landmarks.
COLORS: tuple[Rgb, ...] = (
    (26, 122, 73),
    (120, 190, 90),
    (205, 222, 110),
    (250, 220, 120),
    (240, 150, 70),
    (150, 80, 150),
)
LEVELS_M = (0.01, 0.02, 0.05, 0.1, 0.3)


def floor_underlay(
    floor: FloorPlan,
    places: FloatArray | None = None,
    error_m: FloatArray | None = None,
    fails: BoolArray | None = None,
) -> Underlay:
    """The walls; for (N,2) places, where given, the (N,) errors to be expected, hatched where (N,) fails is true."""
    rgb = np.where(floor.free[:, :, None], np.array(FREE), np.array(WALL)).astype(np.uint8)
    legend: tuple[tuple[Rgb, str], ...] = ()
    if places is not None and error_m is not None:
        rows, columns = np.nonzero(floor.free)
        middles = floor.middles(rows, columns)
        distance, nearest = cKDTree(places).query(middles)
        step = np.sqrt(floor.free.sum() * floor.cell_m**2 / len(places))
        level = np.searchsorted(LEVELS_M, error_m)
        colors = np.array([*COLORS, BLIND])[np.where(np.isinf(error_m), len(COLORS), level)]
        # As far as the places reach, without the steps of their grid.
        reached = floor.clearance_at(middles) >= floor.clearance_at(places).min() - floor.cell_m / 2
        near = reached & (distance < 1.6 * step)
        rgb[rows[near], columns[near]] = colors[nearest[near]]
        words = [f"{100 * low:g} to {100 * high:g} cm" for low, high in pairwise(LEVELS_M)]
        names = [f"under {100 * LEVELS_M[0]:g} cm", *words, f"over {100 * LEVELS_M[-1]:g} cm", "blind"]
        legend = tuple(zip((*COLORS, BLIND), names, strict=True))
        if fails is not None and fails.any():
            hatched = near & fails[nearest] & ((rows + columns) % HATCH_CELLS == 0)
            rgb[rows[hatched], columns[hatched]] = HATCH
            legend = (*legend, (HATCH, "hatched: requirement not met"))
    legend = (*legend, *_draw_islands(rgb, floor))
    low = floor.origin
    high = (low[0] + floor.size_m[0], low[1] + floor.size_m[1])
    # Far from free space there is nothing to show.
    rgb[distance_transform_edt(~floor.free) * floor.cell_m > WALL_SHOWN_M] = OUTSIDE
    return Underlay(np.ascontiguousarray(rgb[::-1]), low, high, legend, np.ascontiguousarray(floor.free[::-1]))


def _draw_islands(rgb: ByteArray, floor: FloorPlan) -> list[tuple[Rgb, str]]:
    """Islands that are not walls in colors of their own; their entries of the legend."""
    legend: list[tuple[Rgb, str]] = []
    words = {"obstacle": (OBSTACLE, "island: obstacle, no landmarks"), "ignore": (IGNORED, "island: left out")}
    for use, (color, text) in words.items():
        numbers = [island.number for island in floor.islands if island.use == use]
        if numbers and floor.island_cells is not None:
            rgb[np.isin(floor.island_cells, numbers)] = color
            legend.append((color, text))
    return legend


def island_notes(floor: FloorPlan) -> list[Note]:
    """The numbers of islands, in brackets, beside them."""
    notes = []
    for island in floor.islands:
        x, y = (island.low + island.high) / 2
        notes.append(Note(f"({island.number})", (float(x), float(y))))
    return notes


def wall_notes(floor: FloorPlan) -> list[Note]:
    """The name of every wall of a room, beside it where nothing else stands."""
    rooms, _ = label(floor.free)
    areas = np.bincount(rooms.ravel()) * floor.cell_m**2
    notes = []
    for wall in floor.walls:
        out = np.array([np.cos(wall.facing_rad), np.sin(wall.facing_rad)])
        before = (wall.left + wall.right) / 2 + 2 * floor.cell_m * out
        # The inside of a pillar is no room.
        if floor.is_free(before) and areas[rooms[floor.cells(before)]] < LEAST_ROOM_M2:
            continue
        along = np.array(NOTED_AT)[:, None] * (wall.right - wall.left)
        places = wall.left + along + NOTED_OFF_M * out
        at = places[np.argmax(floor.clearance_at(places).round(1))]
        notes.append(Note(wall.name, (float(at[0]), float(at[1]))))
    return notes
