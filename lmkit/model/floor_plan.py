"""A floor from above: where a robot can be, and the walls that landmarks can be mounted on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import cv2
import numpy as np

from lmkit.arrays import BoolArray, FloatArray, IntArray
from lmkit.kernels.line_of_sight import clear_lines

NEAR_CELLS = 1.5  # so far off a wall a line of sight to it ends
STRAIGHT_CELLS = 1.2  # largest deviation of an outline from a straight wall
SHORTEST_M = 0.3
BEHIND_CELLS = (0.5, 1.5, 2.5)  # distances behind an outline at which a certain wall is searched


@dataclass(frozen=True, eq=False)
class Wall:
    """A straight wall as seen from the free side of it.

    Attributes:
        name: ``A``, ``B``, ...
        left, right: (2,) its ends, meters in the map, as seen by a person who faces it.
        usable: landmarks may be mounted here.
    """

    name: str
    left: FloatArray
    right: FloatArray
    usable: bool = True

    @property
    def length_m(self) -> float:
        """From end to end."""
        return float(np.linalg.norm(self.right - self.left))

    @property
    def along(self) -> FloatArray:
        """(2,) unit vector from its left end to its right one."""
        return np.asarray((self.right - self.left) / self.length_m)

    @property
    def facing_rad(self) -> float:
        """Direction of its normal, into the free space."""
        return float(np.arctan2(-self.along[0], self.along[1]))


@dataclass(frozen=True, eq=False)
class Island:
    """A drawn object that nothing connects with the outer walls: a pillar, furniture, text.

    Attributes:
        number: from top to bottom of the plan.
        low, high: (2,) its extent in the map, meters.
        use: ``obstacle`` (blocks the robot, carries no landmarks), ``wall``, or ``ignore`` (counts as free floor).
    """

    number: int
    low: FloatArray
    high: FloatArray
    use: str

    def __str__(self) -> str:
        (width, depth), (x, y) = self.high - self.low, (self.low + self.high) / 2
        return f"({self.number}) {width:.1f} x {depth:.1f} m at {x:.2f}, {y:.2f}"


@dataclass(frozen=True, eq=False)
class FloorPlan:
    """An occupancy grid with its walls.

    Attributes:
        free: (rows, columns), row 0 at the lowest y.
        cell_m: side of a cell.
        origin: (x, y) of the lower left corner of the first cell, meters in the map.
        walls: walls visible from free space.
        places: named poses (x, y, heading; meters and rad).
        islands: drawn objects inside the rooms, where the plan comes from a drawing.
        island_cells: (rows, columns) number of the island at each cell, 0 elsewhere; None without islands.
    """

    free: BoolArray
    cell_m: float
    origin: tuple[float, float]
    walls: Sequence[Wall] = ()
    places: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    islands: Sequence[Island] = ()
    island_cells: IntArray | None = None

    @property
    def size_m(self) -> tuple[float, float]:
        """Extent in x and y."""
        rows, columns = self.free.shape
        return columns * self.cell_m, rows * self.cell_m

    @cached_property
    def clearance_m(self) -> FloatArray:
        """(rows, columns) meters from the center of each cell to the nearest cell that is not free."""
        padded = np.pad(self.free, 1).astype(np.uint8)
        far = cv2.distanceTransform(padded, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
        return np.asarray(np.maximum(far - 0.5, 0.0) * self.cell_m, dtype=np.float64)

    def cells(self, points: FloatArray) -> tuple[IntArray, IntArray]:
        """Rows and columns of (...,2) points; may lie outside."""
        at = np.floor((points - np.array(self.origin)) / self.cell_m).astype(np.int64)
        return at[..., 1], at[..., 0]

    def middles(self, rows: IntArray, columns: IntArray) -> FloatArray:
        """(N,2) middles of cells, meters."""
        return np.asarray(np.column_stack([columns, rows]) * self.cell_m + self.cell_m / 2 + np.array(self.origin))

    def is_free(self, points: FloatArray) -> BoolArray:
        """(...) of (...,2) points; False outside the grid."""
        rows, columns = self.cells(points)
        inside = (rows >= 0) & (columns >= 0) & (rows < self.free.shape[0]) & (columns < self.free.shape[1])
        return np.asarray(inside & self.free[np.where(inside, rows, 0), np.where(inside, columns, 0)])

    def clearance_at(self, points: FloatArray) -> FloatArray:
        """(...) meters to the nearest cell that is not free; 0 outside."""
        rows, columns = self.cells(points)
        far = self.clearance_m[rows.clip(0, self.free.shape[0] - 1), columns.clip(0, self.free.shape[1] - 1)]
        return np.asarray(np.where(self.is_free(points), far, 0.0))

    def sees(self, origins: FloatArray, points: FloatArray) -> BoolArray:
        """(N,) True where the straight line from (N,2) cameras to (N,2) points on walls runs through free cells."""
        near_m = NEAR_CELLS * self.cell_m  # just before the wall
        return clear_lines(self.free, self.cell_m, self.origin, near_m, origins, points)

    def blocked(self, points: FloatArray, radius_m: float) -> FloorPlan:
        """A copy of the floor with discs around (N,2) points blocked."""
        free = self.free.copy()
        rows, columns = np.indices(free.shape)
        middles = self.middles(rows.ravel(), columns.ravel())
        for point in points:
            free &= ~(np.linalg.norm(middles - point, axis=1) < radius_m).reshape(free.shape)
        return replace(self, free=free)


def walls_of(
    free: BoolArray, cell_m: float, origin: tuple[float, float], solid: BoolArray | None = None
) -> list[Wall]:
    """Straight walls around the free cells of a grid, along its outlines; the longest first.

    Args:
        solid: cells that are walls for certain; parts of outlines with none behind them are left out.
    """
    # Outlines through the corners of cells, so that straight walls are straight.
    large = np.kron(np.pad(free, 1), np.ones((2, 2), dtype=bool)).astype(np.uint8)
    outlines, _ = cv2.findContours(large, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    found: list[tuple[float, FloatArray, FloatArray]] = []
    for outline in outlines:
        for a, b in _straight_parts(np.asarray(outline, dtype=np.int64).reshape(-1, 2)):
            if np.linalg.norm(b - a) * cell_m < SHORTEST_M:
                continue
            along = (b - a) / np.linalg.norm(b - a)
            normal = np.array([along[1], -along[0]])
            inside = [_free_at(free, (a + b) / 2 + side * normal) for side in (1.0, -1.0)]
            if inside[0] == inside[1]:
                continue
            # Left and right as seen by a viewer who faces the wall, which is a quarter cell outside the outline.
            left, right, normal = (a, b, normal) if inside[0] else (b, a, -normal)
            for start, end in [(left, right)] if solid is None else _solid_parts(solid, left, right, -normal):
                ends = [np.array(origin) + (point - 0.25 * normal) * cell_m for point in (start, end)]
                if np.linalg.norm(end - start) * cell_m >= SHORTEST_M:
                    found.append((float(np.linalg.norm(end - start)), ends[0], ends[1]))
    found.sort(key=lambda wall: (-round(wall[0], 6), *wall[1].tolist()))
    return [Wall(wall_name(k), left, right) for k, (_, left, right) in enumerate(found)]


def _straight_parts(outline: IntArray) -> list[tuple[FloatArray, FloatArray]]:
    """Ends of the straight parts of an outline on half cells, each fitted to all its points; in cells."""
    corners = cv2.approxPolyDP(outline.astype(np.int32).reshape(-1, 1, 2), 2 * STRAIGHT_CELLS, True).reshape(-1, 2)
    places = sorted(int(np.argmin(np.abs(outline - corner).sum(axis=1))) for corner in corners)
    parts = []
    for start, end in zip(places, [*places[1:], places[0] + len(outline)], strict=True):
        points = outline[np.arange(start, end + 1) % len(outline)] / 2 - 1 + 0.25
        inner = points[2:-2] if len(points) > 8 else points
        middle = inner.mean(axis=0)
        along = np.linalg.svd(inner - middle, full_matrices=False)[2][0]
        a, b = (middle + along * ((end - middle) @ along) for end in (points[0], points[-1]))
        parts.append((a, b))
    return parts


def _solid_parts(
    solid: BoolArray, start: FloatArray, end: FloatArray, outward: FloatArray
) -> list[tuple[FloatArray, FloatArray]]:
    """Parts of a line (in cells) that have solid cells just behind them."""
    steps = np.linspace(0.0, 1.0, 1 + int(np.ceil(2 * np.linalg.norm(end - start))))
    points = start + steps[:, None] * (end - start)
    behind = np.zeros(len(points), dtype=bool)
    for depth in BEHIND_CELLS:
        at = np.floor(points + depth * outward).astype(np.int64)
        inside = (at >= 0).all(axis=1) & (at[:, 0] < solid.shape[1]) & (at[:, 1] < solid.shape[0])
        behind |= inside & solid[np.where(inside, at[:, 1], 0), np.where(inside, at[:, 0], 0)]
    changes = np.flatnonzero(np.diff(np.concatenate([[False], behind, [False]]).astype(np.int8)))
    return [(points[first], points[after - 1]) for first, after in changes.reshape(-1, 2).tolist()]


def wall_name(index: int) -> str:
    """A, B, ... Z, AA, AB, ..."""
    name = ""
    index += 1
    while index:
        index, letter = divmod(index - 1, 26)
        name = chr(ord("A") + letter) + name
    return name


def _free_at(free: BoolArray, at: FloatArray) -> bool:
    column, row = int(np.floor(at[0])), int(np.floor(at[1]))
    return bool(0 <= row < free.shape[0] and 0 <= column < free.shape[1] and free[row, column])
