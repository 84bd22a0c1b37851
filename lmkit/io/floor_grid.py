"""Floor plans from grids of cells: coarsening, the outside of a building, and maps with a rotated origin."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from scipy.ndimage import distance_transform_edt

from lmkit.arrays import BoolArray, FloatArray
from lmkit.errors import InputError, InputWarning, warn_caller
from lmkit.io.floor_islands import (
    PLAIN_DRAWING,
    DrawingOptions,
    use_behind,
    with_islands,
    without_thin_lines,
)
from lmkit.model.floor_plan import FloorPlan, wall_name, walls_of

CELL_M = 0.05
SMALLEST_M = 0.5  # of a floor
DOOR_M = 1.3  # wider than an open outer door
HIDDEN_RATIO = 2.0  # open doors are treated as closed if the floor grows at least by this factor
LARGEST_CELL_M = 0.25  # larger cells are too coarse for planning
MOST_CELLS = 16_000_000
LEAST_ROTATION_RAD = 1e-6
PROBES = (-0.45, 0.0, 0.45)  # of a cell, per axis: a rotated cell is free only if all these points are


def floor_of_grid(
    path: Path,
    free: BoolArray,
    scale_m: float,
    origin: tuple[float, float] = (0.0, 0.0),
    rotation_rad: float = 0.0,
    solid: BoolArray | None = None,
    drawing: DrawingOptions = PLAIN_DRAWING,
) -> FloorPlan:
    """A floor plan of a grid.

    Args:
        path: named in errors.
        free: (rows, columns), row 0 at the lowest y.
        scale_m: side of a cell.
        origin: lower left corner of the grid in the map, meters.
        rotation_rad: rotation of the grid about that corner, counter-clockwise.
        solid: cells that are certainly walls; None: every cell that is not free.
        drawing: treatment of islands and thin lines.

    Raises:
        InputError: cells too coarse or too many, or nothing is free.
    """
    if scale_m > LARGEST_CELL_M:
        raise InputError(
            "coarse_plan",
            f"{path}: a pixel of {scale_m:g} m is too coarse",
            f"draw it with pixels of {LARGEST_CELL_M} m or less",
        )
    if scale_m * max(free.shape) < SMALLEST_M:
        raise InputError(
            "fine_plan",
            f"{path}: {max(free.shape)} pixels of {scale_m:g} m are no floor",
            "check its scale in meters",
        )
    if drawing.thin_m > 0:
        free = ~without_thin_lines(~free, drawing.thin_m, scale_m)
    # Cells that contain any part of a wall are not free.
    times = max(1, round(CELL_M / scale_m))
    if times > 1:
        free = np.asarray(_blocks(free, times).all(axis=(1, 3)))
        solid = None if solid is None else np.asarray(_blocks(solid, times).any(axis=(1, 3)))
    check_size(path, *free.shape)
    cell_m = scale_m * times
    inside = inside_of(path, free, cell_m)
    # A closed outer door is not a wall.
    solid = ~free if solid is None else solid
    free = inside
    if abs(rotation_rad) < LEAST_ROTATION_RAD:
        return _with_walls(with_islands(FloorPlan(free, cell_m, origin), drawing), solid)
    plain = _with_walls(with_islands(FloorPlan(free, cell_m, (0.0, 0.0)), drawing), solid)
    return _rotated(path, plain, origin, rotation_rad)


def _with_walls(floor: FloorPlan, solid: BoolArray | None) -> FloorPlan:
    """Walls along the outlines, except outlines of islands that are not walls."""
    walls = [
        wall for wall in walls_of(floor.free, floor.cell_m, floor.origin, solid) if use_behind(floor, wall) == "wall"
    ]
    return replace(floor, walls=[replace(wall, name=wall_name(k)) for k, wall in enumerate(walls)])


def check_size(path: Path, rows: int, columns: int) -> None:
    """Refuse grids of too many cells.

    Raises:
        InputError: ``floor_too_large``.
    """
    if rows * columns > MOST_CELLS:
        raise InputError(
            "floor_too_large",
            f"{path}: {columns} x {rows} cells of {CELL_M} m, more than {MOST_CELLS // 1_000_000} million",
            "check the scale, or cut the plan into parts",
        )


def inside_of(path: Path, free: BoolArray, cell_m: float, shut_doors: bool = True) -> BoolArray:
    """Free cells that are not connected with the border of the grid; all free cells if there are none.

    An open outer door would make the rooms behind it outside, and leave only closed areas, such as the
    inside of a drawn table.  If openings up to `DOOR_M` remove most of the floor, they are treated as closed.

    Args:
        shut_doors: False for walls written by hand, where an opening is reported as an error.

    Raises:
        InputError: no cell is free.
    """
    padded = np.pad(free, 1, constant_values=True).astype(np.uint8)
    _, parts = cv2.connectedComponents(padded, connectivity=4)
    inside = free & (parts[1:-1, 1:-1] != parts[0, 0])
    if shut_doors:
        behind_doors = _inside_with_doors_shut(free, cell_m)
        if behind_doors.sum() > HIDDEN_RATIO * inside.sum():
            inside = behind_doors
            sentence = f"{path}: an outer door is open; outer openings up to {DOOR_M} m are treated as closed"
            warn_caller(InputWarning(sentence))
    answer = inside if inside.any() else free
    if not answer.any():
        raise InputError("nothing_free", f"{path}: no free floor", "white is free, dark is not; check --scale")
    return np.asarray(answer)


def _inside_with_doors_shut(free: BoolArray, cell_m: float) -> BoolArray:
    """Free cells that a disc of a door's width does not reach from the border, except narrow niches.

    The disc reaches a little into a door; the line between inside and outside is where the opening is narrowest.
    """
    from skimage.segmentation import watershed

    radius = DOOR_M / 2 / cell_m
    around = int(np.ceil(radius)) + 2
    padded = np.pad(free, around, constant_values=True)
    clearance = distance_transform_edt(padded)
    clear = clearance > radius
    # The disc starts outside the building.
    clear[[0, -1]], clear[:, [0, -1]] = True, True
    _, parts = cv2.connectedComponents(clear.astype(np.uint8), connectivity=4)
    is_outside = parts == parts[0, 0]
    left = padded & (distance_transform_edt(~is_outside) > radius)
    _, rooms = cv2.connectedComponents(left.astype(np.uint8), connectivity=4)
    wide = np.zeros(int(rooms.max()) + 1, dtype=bool)
    wide[rooms[left & clear]] = True
    markers = np.where(is_outside, 1, np.where(left & wide[rooms], 2, 0))
    return np.asarray(watershed(-clearance, markers, mask=padded) == 2)[around:-around, around:-around]


def _blocks(cells: BoolArray, times: int) -> BoolArray:
    """(rows, times, columns, times) of a grid, padded with False."""
    rows, columns = (-(-n // times) * times for n in cells.shape)
    padded = np.zeros((rows, columns), dtype=bool)
    padded[: cells.shape[0], : cells.shape[1]] = cells
    return padded.reshape(rows // times, times, columns // times, times)


def _rotated(path: Path, grid: FloorPlan, origin: tuple[float, float], rotation_rad: float) -> FloorPlan:
    """The floor on a grid along the map's axes; its walls are rotated exactly, extents of islands enclose them."""
    c, s = np.cos(rotation_rad), np.sin(rotation_rad)
    R, start = np.array([[c, -s], [s, c]]), np.array(origin)
    cell_m = grid.cell_m
    rows, columns = grid.free.shape
    corners = np.array([(0, 0), (columns, 0), (columns, rows), (0, rows)]) * cell_m @ R.T
    low = corners.min(axis=0)
    width, height = np.ceil((corners.max(axis=0) - low) / cell_m).astype(int).tolist()
    check_size(path, height, width)
    lower_left = (float(start[0] + low[0]), float(start[1] + low[1]))
    turned = FloorPlan(np.ones((height, width), dtype=bool), cell_m, lower_left)
    all_rows, all_columns = np.indices((height, width))
    middles: FloatArray = turned.middles(all_rows.ravel(), all_columns.ravel()) - start
    still = np.ones(height * width, dtype=bool)
    for dx in PROBES:
        for dy in PROBES:
            still &= grid.is_free((middles + np.array([dx, dy]) * cell_m) @ R)
    walls = [replace(wall, left=R @ wall.left + start, right=R @ wall.right + start) for wall in grid.walls]
    islands = []
    for island in grid.islands:
        (x0, y0), (x1, y1) = island.low, island.high
        ends = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)]) @ R.T + start
        islands.append(replace(island, low=ends.min(axis=0), high=ends.max(axis=0)))
    return replace(turned, free=still.reshape(height, width), walls=walls, islands=islands)
