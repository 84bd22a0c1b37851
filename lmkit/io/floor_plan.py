"""Floor plans: walls as lines (lmkit's own YAML, SVG, DXF), images with a scale, maps of ROS (docs/formats.md)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
from pydantic import Field

from lmkit.errors import InputError
from lmkit.io.document_head import head_of
from lmkit.io.document_models import Document, read_document
from lmkit.io.documents import dump_yaml, read_text, require_regular
from lmkit.io.dxf_lines import ALL_LAYERS, read_dxf_lines
from lmkit.io.floor_grid import CELL_M, check_size, floor_of_grid, inside_of
from lmkit.io.floor_islands import PLAIN_DRAWING, DrawingOptions, island_use, with_islands
from lmkit.io.images import read_image
from lmkit.io.ros_map import read_ros_map
from lmkit.io.svg_lines import read_svg_lines
from lmkit.model.floor_plan import FloorPlan, Wall, wall_name

FREE_ABOVE = 0.86  # of white, in plain images: gray furniture and thin walls are not free
SHORTEST_WALL_M = 0.05
LONGEST_ROOM_M = 200.0
BORDER = 4  # cells around lines
LOOKS_IN = 0.1  # least share of free cells along one side of a line that makes this side a wall

Meters = Annotated[float, Field(ge=-1e8, le=1e8)]  # coordinates of a country's grid reach 1e7
Point = Annotated[list[Meters], Field(min_length=2, max_length=2)]
Places = Mapping[str, tuple[float, float, float]]


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


def read_floor(path: Path, scale_m: float | None = None, drawing: DrawingOptions = PLAIN_DRAWING) -> FloorPlan:
    """A floor plan from a file of any kind.

    Args:
        scale_m: meters per pixel of an image or per user unit of an SVG file, required for both. For DXF, meters per
            unit, instead of the file's own. Not allowed for other files.
        drawing: treatment of islands, thin lines, curves and layers of images and drawings.

    Raises:
        InputError: not readable, a missing or superfluous scale, or no free cells.
    """
    require_regular(path, "floor plan")
    suffix = path.suffix.lower()
    has_scale = suffix in (".yaml", ".yml", ".json")
    if has_scale and scale_m is not None:
        raise InputError("two_scales", f"{path} has its own scale", "leave --scale out")
    if suffix == ".dwg":
        raise InputError("not_dxf", f"{path}: DWG is not read", "save the drawing as DXF")
    if drawing.layers != ALL_LAYERS and suffix != ".dxf":
        raise InputError("no_layers", f"{path}: --layers is for DXF drawings", "leave it out, or hide the layers")
    if not has_scale and suffix != ".dxf" and scale_m is None:
        raise InputError(
            "no_scale",
            f"{path}: its scale is unknown",
            "give --scale in meters per pixel (SVG: per unit); 10 m over 200 pixels is --scale 0.05",
        )
    if scale_m is not None and not 0 < scale_m < 1e3:
        raise InputError(
            "bad_scale", f"--scale {scale_m:g} is not a valid pixel size", "give meters per pixel, such as 0.05"
        )
    if suffix == ".dxf":
        ends = read_dxf_lines(path, scale_m, drawing.curves, drawing.layers)
        return _from_lines(path, [Wall(wall_name(k), a, b) for k, (a, b) in enumerate(ends)], drawing)
    if suffix == ".svg":
        assert scale_m is not None
        drawn = enumerate(read_svg_lines(path, drawing.curves))
        return _from_lines(path, [Wall(wall_name(k), a * scale_m, b * scale_m) for k, (a, b) in drawn], drawing)
    if has_scale:
        text = read_text(path, "floor plan")
        return _read_ours(path) if head_of(text).format.startswith("lmkit-") else read_ros_map(path, text, drawing)
    assert scale_m is not None
    return _from_image(path, scale_m, drawing)


def read_drawn_lines(path: Path) -> tuple[list[Wall], Places]:
    """Lines and places of a lmkit-floor/1 file, unchanged; a line without a name has an empty name.

    Raises:
        InputError: not readable, or of another format.
    """
    data = read_document(path, _FloorFile, "floor plan")
    lines = [Wall(w.name or "", np.array(w.start), np.array(w.end), w.landmarks) for w in data.walls]
    for index, line in enumerate(lines):
        if line.length_m < SHORTEST_WALL_M:
            raise InputError(
                "short_wall", f"{path}: walls[{index}]: shorter than {SHORTEST_WALL_M} m", "write meters"
            )
    places = {
        name: (place.position[0], place.position[1], float(np.deg2rad(place.heading_deg)))
        for name, place in data.places.items()
    }
    return lines, places


def floor_to_yaml(lines: Sequence[Wall], places: Places) -> str:
    """The text of a lmkit-floor/1 file.

    Args:
        lines: in meters in the map; `Wall.usable` says whether landmarks may be mounted.
        places: named poses (x, y, heading; meters and rad).
    """
    walls: list[dict[str, Any]] = []
    for line in lines:
        walls.append(
            {"from": line.left.tolist(), "to": line.right.tolist(), **({"name": line.name} if line.name else {})}
        )
        walls[-1] |= {} if line.usable else {"landmarks": False}
    data: dict[str, Any] = {"format": "lmkit-floor/1", "walls": walls}
    if places:
        data["places"] = {
            name: {"position": [x, y], "heading_deg": float(np.rad2deg(heading))}
            for name, (x, y, heading) in places.items()
        }
    return dump_yaml(data)


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
    lines, places = read_drawn_lines(path)
    named = [replace(line, name=line.name or wall_name(k)) for k, line in enumerate(lines)]
    return replace(_from_lines(path, named), places=places)


def _from_lines(path: Path, lines: list[Wall], drawing: DrawingOptions | None = None) -> FloorPlan:
    """A floor from lines; each side of a line that faces free space is a wall.

    Args:
        drawing: for drawings, whose islands may be text or furniture.
    """
    ends = np.array([end for line in lines for end in (line.left, line.right)])
    # Shifted by half a cell: lines between cells, as in a room from 0 to 6 m, block equally on both sides.
    low, high = ends.min(axis=0) - (BORDER + 0.5) * CELL_M, ends.max(axis=0) + (BORDER + 0.5) * CELL_M
    columns, rows = np.ceil((high - low) / CELL_M).astype(int).tolist()
    check_size(path, rows, columns)
    drawn = np.zeros((rows, columns), dtype=np.uint8)
    for line in lines:
        start, end = (np.round((p - low) / CELL_M * 16 - 8).astype(int).tolist() for p in (line.left, line.right))
        cv2.line(drawn, start, end, 255, 1, cv2.LINE_8, 4)
    inside = inside_of(path, drawn == 0, CELL_M, shut_doors=drawing is not None)
    floor = FloorPlan(inside, CELL_M, (float(low[0]), float(low[1])))
    if drawing is not None:
        floor = with_islands(floor, drawing)
        lines = [line for line in lines if island_use(floor, (line.left + line.right) / 2) == "wall"]
    walls = []
    for line in lines:
        for wall in (line, replace(line, left=line.right, right=line.left)):
            out = np.array([np.cos(wall.facing_rad), np.sin(wall.facing_rad)])
            steps = np.linspace(0.0, 1.0, max(3, int(wall.length_m / CELL_M)))[:, None]
            if floor.is_free(wall.left + steps * (wall.right - wall.left) + 2 * CELL_M * out).mean() > LOOKS_IN:
                walls.append(wall)
    return replace(floor, walls=_split_walls(walls))


def _split_walls(walls: list[Wall]) -> list[Wall]:
    """Walls with different names for the two sides of an inner wall."""
    names = [wall.name for wall in walls]
    seen: dict[str, int] = {}
    answer = []
    for wall in walls:
        seen[wall.name] = seen.get(wall.name, 0) + 1
        answer.append(replace(wall, name=f"{wall.name}{seen[wall.name]}") if names.count(wall.name) > 1 else wall)
    return answer


def _from_image(path: Path, scale_m: float, drawing: DrawingOptions) -> FloorPlan:
    free = read_image(path).min(axis=2) / 255.0 > FREE_ABOVE
    return floor_of_grid(path, free[::-1], scale_m, drawing=drawing)
