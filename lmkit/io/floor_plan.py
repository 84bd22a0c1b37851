"""Floor plans: walls as lines (lmkit's own YAML, SVG), images with a scale, maps of ROS (docs/formats.md)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from lmkit.arrays import BoolArray
from lmkit.errors import InputError
from lmkit.io.documents import Document, first_problem, load_document, read_document, read_text
from lmkit.io.images import read_image
from lmkit.io.svg_lines import read_svg_lines
from lmkit.model.floor_plan import FloorPlan, Wall, wall_name, walls_of

CELL_M = 0.05
LARGEST_CELL_M = 0.25  # a robot has to find its way between cells
MOST_CELLS = 16_000_000
FREE_ABOVE = 0.86  # of white, in plain images: gray furniture and thin walls are not free
UNKNOWN_GRAY = 205.5 / 255  # map savers write unknown as 205, whatever the threshold; unknown is never free
SHORTEST_WALL_M = 0.05
LONGEST_ROOM_M = 200.0
BORDER = 4  # cells around lines
LOOKS_IN = 0.1  # share of a line's side that must be free for it to be a wall

Point = Annotated[list[float], Field(min_length=2, max_length=2)]


class _Wall(Document):
    start: Annotated[Point, Field(alias="from")]
    end: Annotated[Point, Field(alias="to")]
    name: str | None = None
    landmarks: bool = True


class _Place(Document):
    position: Point
    heading_deg: float = 0.0


class _FloorFile(Document):
    format: str = "lmkit-floor/1"
    walls: Annotated[list[_Wall], Field(min_length=1)]
    places: dict[str, _Place] = Field(default_factory=dict)


class _RosMap(BaseModel):
    """Keys of a map of map_server and nav2; others are ignored."""

    model_config = ConfigDict(extra="ignore", allow_inf_nan=False)
    image: str
    resolution: Annotated[float, Field(gt=0)]
    origin: Annotated[list[float], Field(min_length=2, max_length=3)] = [0.0, 0.0, 0.0]
    negate: int = 0
    free_thresh: float = 0.196
    mode: str = "trinary"


def read_floor(path: Path, scale_m: float | None = None) -> FloorPlan:
    """A floor plan from a file of any kind.

    Args:
        scale_m: meters a pixel of an image, or a user unit of an SVG file; needed for those, and only those.

    Raises:
        InputError: not readable, no scale or one too many, nothing free in it.
    """
    suffix = path.suffix.lower()
    has_scale = suffix in (".yaml", ".yml", ".json")
    if has_scale and scale_m is not None:
        raise InputError("two_scales", f"{path} has its own scale", "leave --scale out")
    if not has_scale and scale_m is None:
        raise InputError(
            "no_scale",
            f"{path}: its scale is unknown",
            "give --scale in meters per pixel (SVG: per unit); 10 m over 200 pixels is --scale 0.05",
        )
    if scale_m is not None and not 0 < scale_m < 1e3:
        raise InputError(
            "bad_scale", f"--scale {scale_m:g} is not a valid pixel size", "give meters per pixel, such as 0.05"
        )
    if suffix == ".svg":
        assert scale_m is not None
        drawn = enumerate(read_svg_lines(path))
        return _from_lines(path, [Wall(wall_name(k), a * scale_m, b * scale_m) for k, (a, b) in drawn])
    if has_scale:
        return _read_ours(path) if "lmkit-floor" in read_text(path, "floor plan") else _read_ros(path)
    assert scale_m is not None
    return _from_image(path, path, scale_m, (0.0, 0.0), FREE_ABOVE, False)


def rectangular_room(width_m: float, depth_m: float) -> FloorPlan:
    """A room with its south-west corner at the origin of the map, and walls north, east, south and west.

    Args:
        width_m: along x, from west to east.
        depth_m: along y, from south to north.

    Raises:
        InputError: smaller than a robot or larger than a hall.
    """
    if not 0.5 <= min(width_m, depth_m) <= max(width_m, depth_m) <= LONGEST_ROOM_M:
        raise InputError(
            "bad_room",
            f"a room of {width_m:g} x {depth_m:g} m is not plausible",
            "give its inside, such as 6.00x4.00m",
        )
    corners = np.array([(0.0, 0.0), (0.0, depth_m), (width_m, depth_m), (width_m, 0.0), (0.0, 0.0)])
    names = ("west", "north", "east", "south")
    return _from_lines(Path("room"), [Wall(n, corners[k], corners[k + 1]) for k, n in enumerate(names)])


def _read_ours(path: Path) -> FloorPlan:
    data = read_document(path, _FloorFile, "floor plan")
    lines = [
        Wall(wall.name or wall_name(k), np.array(wall.start), np.array(wall.end), wall.landmarks)
        for k, wall in enumerate(data.walls)
    ]
    for index, line in enumerate(lines):
        if line.length_m < SHORTEST_WALL_M:
            raise InputError(
                "short_wall", f"{path}: walls[{index}]: shorter than {SHORTEST_WALL_M} m", "write meters"
            )
    places = {
        name: (place.position[0], place.position[1], float(np.deg2rad(place.heading_deg)))
        for name, place in data.places.items()
    }
    return replace(_from_lines(path, lines), places=places)


def _from_lines(path: Path, lines: list[Wall]) -> FloorPlan:
    """Each line has two sides; those that look into free space are walls."""
    ends = np.array([end for line in lines for end in (line.left, line.right)])
    # Half a cell more: lines on whole cells, such as those of a room from 0 to 6 m, block as much on either side.
    low, high = ends.min(axis=0) - (BORDER + 0.5) * CELL_M, ends.max(axis=0) + (BORDER + 0.5) * CELL_M
    columns, rows = np.ceil((high - low) / CELL_M).astype(int).tolist()
    _check_size(path, rows, columns)
    drawn = np.zeros((rows, columns), dtype=np.uint8)
    for line in lines:
        start, end = (np.round((p - low) / CELL_M * 16 - 8).astype(int).tolist() for p in (line.left, line.right))
        cv2.line(drawn, start, end, 255, 1, cv2.LINE_8, 4)
    floor = FloorPlan(_inside(path, drawn == 0), CELL_M, (float(low[0]), float(low[1])))
    walls = []
    for line in lines:
        for wall in (line, replace(line, left=line.right, right=line.left)):
            out = np.array([np.cos(wall.facing_rad), np.sin(wall.facing_rad)])
            steps = np.linspace(0.0, 1.0, max(3, int(wall.length_m / CELL_M)))[:, None]
            if floor.is_free(wall.left + steps * (wall.right - wall.left) + 2 * CELL_M * out).mean() > LOOKS_IN:
                walls.append(wall)
    return replace(floor, walls=_split_walls(walls))


def _split_walls(walls: list[Wall]) -> list[Wall]:
    """Both sides of a wall inside a room have names of their own."""
    names = [wall.name for wall in walls]
    seen: dict[str, int] = {}
    answer = []
    for wall in walls:
        seen[wall.name] = seen.get(wall.name, 0) + 1
        answer.append(replace(wall, name=f"{wall.name}{seen[wall.name]}") if names.count(wall.name) > 1 else wall)
    return answer


def _read_ros(path: Path) -> FloorPlan:
    try:
        data = _RosMap.model_validate(load_document(path, read_text(path, "floor plan")))
    except ValidationError as error:
        where, problem = first_problem(error)
        raise InputError(
            "bad_value", f"{path}: {where}: {problem}", "give a map of ROS or an lmkit-floor/1 file"
        ) from None
    if data.mode != "trinary":
        raise InputError("map_mode", f"{path}: mode {data.mode!r} is not read", "save the map with mode: trinary")
    if len(data.origin) > 2 and abs(data.origin[2]) > 1e-6:
        raise InputError("turned_map", f"{path}: origin: rotated maps are not supported", "rotate the image instead")
    origin = (data.origin[0], data.origin[1])
    return _from_image(
        path,
        path.parent / data.image,
        data.resolution,
        origin,
        max(1 - data.free_thresh, UNKNOWN_GRAY),
        bool(data.negate),
    )


def _from_image(
    path: Path, image: Path, scale_m: float, origin: tuple[float, float], free_above: float, negate: bool
) -> FloorPlan:
    gray = read_image(image).min(axis=2) / 255.0
    if negate:
        gray = 1 - gray
    free = (gray > free_above)[::-1]
    if scale_m > LARGEST_CELL_M:
        raise InputError(
            "coarse_plan", f"{path}: a pixel of {scale_m:g} m is too coarse", f"draw it {LARGEST_CELL_M} m fine"
        )
    # Cells that hold any wall are not free.
    times = max(1, round(CELL_M / scale_m))
    if times > 1:
        rows, columns = (-(-n // times) * times for n in free.shape)
        padded = np.zeros((rows, columns), dtype=bool)
        padded[: free.shape[0], : free.shape[1]] = free
        free = padded.reshape(rows // times, times, columns // times, times).all(axis=(1, 3))
    _check_size(path, *free.shape)
    free = _inside(path, free)
    cell_m = scale_m * times
    return FloorPlan(free, cell_m, origin, walls_of(free, cell_m, origin))


def _check_size(path: Path, rows: int, columns: int) -> None:
    if rows * columns > MOST_CELLS:
        raise InputError(
            "floor_too_large",
            f"{path}: {columns} x {rows} cells of {CELL_M} m, more than {MOST_CELLS // 1_000_000} million",
            "check the scale, or cut the plan into parts",
        )


def _inside(path: Path, free: BoolArray) -> BoolArray:
    """Without what is connected with the rim of the image, where anything is left then."""
    padded = np.pad(free, 1, constant_values=True).astype(np.uint8)
    _, parts = cv2.connectedComponents(padded, connectivity=4)
    inside = (free & (parts[1:-1, 1:-1] != parts[0, 0])) if padded[0, 0] else free
    answer = inside if inside.any() else free
    if not answer.any():
        raise InputError("nothing_free", f"{path}: no free floor", "white is free, dark is not; check --scale")
    return np.asarray(answer)
