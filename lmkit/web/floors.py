"""Page 5, the walls of the project: shown, edited, and imported from a floor plan."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from starlette.requests import Request
from starlette.responses import Response

from lmkit.errors import InputError
from lmkit.io.files import write_file
from lmkit.io.floor_plan import SHORTEST_WALL_M, floor_to_yaml, read_drawn_lines, read_floor
from lmkit.model.floor_plan import FloorPlan, Wall
from lmkit.web.answers import MAX_UPLOAD, Body, answer, read_body, read_bytes
from lmkit.web.project import Project
from lmkit.web.state import state_of
from lmkit.web.versions import keep_versions

FLOOR = "floor.yaml"
MOST_WALLS = 2000
DRAWINGS = frozenset({".yaml", ".yml", ".svg", ".dxf", ".png", ".pgm", ".jpg", ".jpeg"})
Meters = Annotated[float, Field(ge=-10_000, le=10_000)]


class WallBody(Body):
    """A wall as a line in the map, meters."""

    start: tuple[Meters, Meters]
    end: tuple[Meters, Meters]
    name: Annotated[str, Field(max_length=40)] = ""
    landmarks: bool = True


class FloorBody(Body):
    """All walls, which replace those of the version in the browser (empty: no file)."""

    version: Annotated[str, Field(max_length=64)]
    walls: Annotated[list[WallBody], Field(max_length=MOST_WALLS)]


async def show(request: Request) -> Response:
    """Walls of the project; none where it has no floor plan."""
    state = state_of(request)
    return answer(await state.workers.run(describe_floor, state.project))


async def edit(request: Request) -> Response:
    """Replace the walls; the previous floor plan is kept for undo."""
    state, body = state_of(request), await read_body(request, FloorBody)
    if body.version != _version(state.project.path(FLOOR)):
        raise InputError("changed", "floor.yaml has changed meanwhile", "look at the new walls, then edit again")
    text = await state.workers.run(edited_floor, str(state.project.path(FLOOR)), body)
    return await _written(request, text)


async def load(request: Request) -> Response:
    """Import the walls of a floor plan in the body; ``scale`` in meters per pixel or unit, for drawings."""
    state, data = state_of(request), await read_bytes(request, MAX_UPLOAD)
    try:
        scale = float(request.query_params["scale"]) if request.query_params.get("scale") else None
    except ValueError:
        raise InputError("bad_value", "scale: not a number", "give meters per pixel, such as 0.05") from None
    text = await state.workers.run(floor_of_file, data, request.path_params["name"], scale)
    return await _written(request, text)


async def _written(request: Request, text: str) -> Response:
    project = state_of(request).project
    keep_versions(project, FLOOR)
    if text:
        write_file(project.path(FLOOR), text.encode(), force=True)
    else:
        project.path(FLOOR).unlink(missing_ok=True)
    return await show(request)


def edited_floor(path: str, body: FloorBody) -> str:
    """Text of the floor plan with these walls and the places of the file; empty without walls.

    Raises:
        InputError: the file is of another format, or a wall is too short.
    """
    places = read_drawn_lines(Path(path))[1] if Path(path).is_file() else {}
    lines = [Wall(w.name.strip(), np.array(w.start), np.array(w.end), w.landmarks) for w in body.walls]
    for line in lines:
        if line.length_m < SHORTEST_WALL_M:
            raise InputError("short_wall", f"a wall is shorter than {SHORTEST_WALL_M} m", "give it two other ends")
    return floor_to_yaml(lines, places) if lines else ""


def floor_of_file(data: bytes, name: str, scale_m: float | None) -> str:
    """Text of a lmkit-floor/1 file with the walls of a floor plan of any format.

    Raises:
        InputError: not a floor plan, or too many walls; uses the sender's name of the file.
    """
    suffix = PurePosixPath(name).suffix.lower()
    if suffix not in DRAWINGS:
        raise InputError(
            "no_floor", f"{name[:80]}: not a floor plan by its name", "give YAML, SVG, DXF, PNG, JPEG or PGM"
        )
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"floor{suffix}"
        path.write_bytes(data)
        try:
            if suffix in (".yaml", ".yml"):
                return floor_to_yaml(*read_drawn_lines(path))
            floor = read_floor(path, scale_m)
        except InputError as error:
            raise InputError(error.code, error.message.replace(str(path), "this file"), error.hint) from None
    # A line has two sides, which are two walls in a drawing.
    lines = {tuple(sorted((tuple(w.left.round(3)), tuple(w.right.round(3))))): w for w in floor.walls}
    if len(lines) > MOST_WALLS:
        raise InputError("too_many", f"{len(lines)} walls", f"draw at most {MOST_WALLS}, without text and furniture")
    return floor_to_yaml([replace(w, left=w.left.round(3), right=w.right.round(3)) for w in lines.values()], {})


def describe_floor(project: Project) -> dict[str, Any]:
    """Walls of ``floor.yaml`` as the page draws them, their gap if any, or the reason why they cannot be read."""
    path = project.path(FLOOR)
    facts: dict[str, Any] = {"version": _version(path), "problem": None, "hint": "", "gap": None}
    if not path.is_file():
        return facts | {"walls": []}
    walls: list[dict[str, Any]] = []
    try:
        walls = describe_walls(path)
        facts["gap"] = None if encloses_a_room(read_floor(path)) else gap_of(read_drawn_lines(path)[0])
    except InputError as error:
        facts |= {"problem": error.message.replace(f"{path}: ", "").replace(str(path), FLOOR), "hint": error.hint}
    return facts | {"walls": walls}


def encloses_a_room(floor: FloorPlan) -> bool:
    """Whether walls enclose the free space: no cell at the border of the grid is free."""
    return not any(rim.any() for rim in (floor.free[0], floor.free[-1], floor.free[:, 0], floor.free[:, -1]))


def gap_of(walls: list[Wall]) -> list[float]:
    """(x, y) of the wall's end that is farthest from all other walls: the likely gap of an open room."""
    left, along = np.array([w.left for w in walls]), np.array([w.right - w.left for w in walls])
    ends = np.stack([left, left + along], axis=1)
    apart = np.zeros((len(walls), 2))
    for k, n in np.ndindex(apart.shape):
        share = np.clip(((ends[k, n] - left) * along).sum(axis=1) / (along**2).sum(axis=1), 0.0, 1.0)
        distances = np.linalg.norm(left + share[:, None] * along - ends[k, n], axis=1)
        distances[k] = np.inf
        apart[k, n] = distances.min()
    return [float(v) for v in ends[np.unravel_index(np.argmax(apart), apart.shape)]]


def describe_walls(path: Path) -> list[dict[str, Any]]:
    """Walls of a floor plan of lmkit's own format, as the page draws them."""
    return [
        {"start": w.left.tolist(), "end": w.right.tolist(), "name": w.name, "landmarks": w.usable}
        for w in read_drawn_lines(path)[0]
    ]


def walls_beside(path: Path) -> list[dict[str, Any]]:
    """Walls of the floor plan beside a map; none where there is no such file, or it cannot be read."""
    try:
        return describe_walls(path.with_name(FLOOR))
    except InputError:
        return []


def _version(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16] if path.is_file() else ""
