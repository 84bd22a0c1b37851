"""A floor from above, as the underlay of a plan: walls, and expected pose errors as colors."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.ndimage import distance_transform_edt, label
from scipy.spatial import cKDTree

from lmkit.arrays import BoolArray, ByteArray, FloatArray
from lmkit.geometry.planar import wrap_heading
from lmkit.model.floor_plan import FloorPlan, Wall
from lmkit.visualization.canvas import Rgb
from lmkit.visualization.plan_view import Note, Underlay

FREE, WALL, BLIND, OUTSIDE = (255, 255, 255), (70, 74, 80), (222, 222, 226), (244, 244, 242)
WALL_SHOWN_M = 0.15
HATCH, HATCH_PX, HATCH_LINE_PX = (60, 20, 80), 24, 3  # color of the lines, distance between them, and their width
FINE_PX = 2000  # longer side up to which an underlay is enlarged, so that its hatching is drawn as lines
OBSTACLE, IGNORED = (150, 118, 84), (236, 226, 214)  # islands of drawings
LEAST_ROOM_M2 = 1.0
SHORT_M, CURVE_RAD = 0.25, 0.6  # pieces of a curve are shorter, with smaller angles between them
NOTED_AT, NOTED_OFF_M = (
    (0.5, 0.4, 0.6, 0.3, 0.7),
    0.45,
)  # place of a wall's name: along the wall, and distance from it
# From small to large errors, without the red of landmarks.
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
    """The walls, and the expected errors (N,) at (N,2) places, if given; hatched where (N,) fails is true."""
    rgb = np.where(floor.free[:, :, None], np.array(FREE), np.array(WALL)).astype(np.uint8)
    hatched = np.zeros(floor.free.shape, dtype=bool)
    legend: tuple[tuple[Rgb, str], ...] = ()
    if places is not None and error_m is not None:
        rows, columns = np.nonzero(floor.free)
        middles = floor.middles(rows, columns)
        distance, nearest = cKDTree(places).query(middles)
        step = np.sqrt(floor.free.sum() * floor.cell_m**2 / len(places))
        level = np.searchsorted(LEVELS_M, error_m)
        colors = np.array([*COLORS, BLIND])[np.where(np.isinf(error_m), len(COLORS), level)]
        # Up to the outermost places, without the steps of their grid.
        reached = floor.clearance_at(middles) >= floor.clearance_at(places).min() - floor.cell_m / 2
        near = reached & (distance < 1.6 * step)
        rgb[rows[near], columns[near]] = colors[nearest[near]]
        words = [f"{100 * low:g} to {100 * high:g} cm" for low, high in pairwise(LEVELS_M)]
        names = [f"under {100 * LEVELS_M[0]:g} cm", *words, f"over {100 * LEVELS_M[-1]:g} cm", "blind"]
        legend = tuple(zip((*COLORS, BLIND), names, strict=True))
        if fails is not None:
            failing = near & fails[nearest]
            hatched[rows[failing], columns[failing]] = True
            legend = (*legend, (HATCH, "hatched: requirement not met")) if failing.any() else legend
    legend = (*legend, *_draw_islands(rgb, floor))
    low = floor.origin
    high = (low[0] + floor.size_m[0], low[1] + floor.size_m[1])
    # Nothing is shown far from free space.
    rgb[distance_transform_edt(~floor.free) * floor.cell_m > WALL_SHOWN_M] = OUTSIDE
    drawn = _with_hatching(rgb[::-1], hatched[::-1]) if hatched.any() else np.ascontiguousarray(rgb[::-1])
    return Underlay(drawn, low, high, legend, np.ascontiguousarray(floor.free[::-1]))


def _with_hatching(rgb: ByteArray, hatched: BoolArray) -> ByteArray:
    """The (h,w,3) image, enlarged, with lines across the (h,w) cells to hatch."""
    factor = max(1, FINE_PX // max(hatched.shape))
    fine, where = (values.repeat(factor, axis=0).repeat(factor, axis=1) for values in (rgb, hatched))
    diagonal = np.arange(where.shape[0])[:, None] - np.arange(where.shape[1])
    fine[where & (diagonal % HATCH_PX < HATCH_LINE_PX)] = HATCH
    return np.ascontiguousarray(fine)


def _draw_islands(rgb: ByteArray, floor: FloorPlan) -> list[tuple[Rgb, str]]:
    """Draw islands that are not walls in their own colors; returns their legend entries."""
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
    """The name of every wall of a room, at a free place beside it; short pieces of curves have none."""
    rooms, _ = label(floor.free)
    areas = np.bincount(rooms.ravel()) * floor.cell_m**2
    notes = []
    for wall in floor.walls:
        if _is_piece_of_curve(wall, floor):
            continue
        out = np.array([np.cos(wall.facing_rad), np.sin(wall.facing_rad)])
        before = (wall.left + wall.right) / 2 + 2 * floor.cell_m * out
        # The inside of a pillar is not a room.
        if floor.is_free(before) and areas[rooms[floor.cells(before)]] < LEAST_ROOM_M2:
            continue
        along = np.array(NOTED_AT)[:, None] * (wall.right - wall.left)
        places = wall.left + along + NOTED_OFF_M * out
        at = places[np.argmax(floor.clearance_at(places).round(1))]
        notes.append(Note(wall.name, (float(at[0]), float(at[1]))))
    return notes


def _is_piece_of_curve(wall: Wall, floor: FloorPlan) -> bool:
    """Whether a short wall continues at one of its ends with a wall of slightly different direction."""
    if wall.length_m > SHORT_M:
        return False
    for other in floor.walls:
        rotation = abs(wrap_heading(other.facing_rad - wall.facing_rad))
        if not 0 < rotation < CURVE_RAD:
            continue
        gaps = [np.linalg.norm(wall.left - other.right), np.linalg.norm(wall.right - other.left)]
        if min(gaps) < floor.cell_m:
            return True
    return False
