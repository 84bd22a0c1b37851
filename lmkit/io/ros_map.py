"""Maps of ROS as floor plans: map_server's and nav2's YAML with an image, in modes trinary, scale and raw.

A pixel's occupancy is its darkness (with ``negate`` its lightness); below ``free_thresh`` it is free, above
``occupied_thresh`` a wall, else neither.  In mode raw the pixel's value is the occupancy in percent, above 100
unknown.  Unknown cells are never free and never walls: in particular 205, which savers write for them independent of
the threshold, and transparent pixels, which nav2 writes for them in mode scale.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from lmkit.arrays import BoolArray
from lmkit.errors import InputError, InputWarning, warn_caller
from lmkit.io.documents import load_document
from lmkit.io.field_problems import first_problem
from lmkit.io.floor_grid import floor_of_grid
from lmkit.io.floor_islands import PLAIN_DRAWING, DrawingOptions
from lmkit.io.images import read_gray
from lmkit.model.floor_plan import FloorPlan

MOST_WALLS = 1.5  # of walls to free cells; walls of maps are thin
UNKNOWN_GRAY = 205.5 / 255
Share = Annotated[float, Field(ge=0, le=1)]
Coordinate = Annotated[float, Field(ge=-1e8, le=1e8)]  # m or rad; coordinates of a country's grid reach 1e7


class _RosMap(BaseModel):
    """Keys of a map of map_server and nav2; others are ignored."""

    model_config = ConfigDict(extra="ignore", allow_inf_nan=False)
    image: str
    resolution: Annotated[float, Field(gt=0)]
    origin: Annotated[list[Coordinate], Field(min_length=2, max_length=3)] = [0.0, 0.0, 0.0]
    negate: int = 0
    free_thresh: Share = 0.196
    occupied_thresh: Share = 0.65
    mode: Literal["trinary", "scale", "raw"] = "trinary"


def read_ros_map(path: Path, text: str, drawing: DrawingOptions = PLAIN_DRAWING) -> FloorPlan:
    """A floor plan of a map's YAML and its image.

    Raises:
        InputError: a key or the image is missing or not valid, nothing is free, or a combination of keys that
            map_server and nav2 read differently.
    """
    try:
        data = _RosMap.model_validate(load_document(path, text))
    except ValidationError as error:
        where, problem = first_problem(error)
        raise InputError(
            "bad_value", f"{path}: {where}: {problem}", "give a map of ROS or an lmkit-floor/1 file"
        ) from None
    if data.free_thresh > data.occupied_thresh:
        raise InputError(
            "bad_value",
            f"{path}: free_thresh is above occupied_thresh",
            "give 0 <= free_thresh <= occupied_thresh <= 1",
        )
    if data.mode == "raw" and data.negate:
        raise InputError(
            "map_mode", f"{path}: negate has no meaning in mode raw (nav2)", "save the map without negate"
        )
    free, solid = _cells(path.parent / data.image, data)
    if solid.sum() > MOST_WALLS * max(free.sum(), 1):
        share = 100 * solid.sum() / (solid.sum() + free.sum())
        sentence = f"{path}: {share:.0f} % of the known cells are walls: is negate wrong, or the mode?"
        warn_caller(InputWarning(sentence))
    rotation = data.origin[2] if len(data.origin) > 2 else 0.0
    if abs(rotation) > 2 * np.pi:
        raise InputError(
            "bad_value", f"{path}: origin: a yaw of {rotation:g} rad: degrees?", "write the yaw in radians"
        )
    origin = (data.origin[0], data.origin[1])
    return floor_of_grid(path, free[::-1], data.resolution, origin, rotation, solid[::-1], drawing)


def _cells(image: Path, data: _RosMap) -> tuple[BoolArray, BoolArray]:
    """(rows, columns) free, and wall for certain; rows as in the image."""
    gray, known = read_gray(image)
    if data.mode == "raw":
        percent = np.round(gray * 255)
        known = known & (percent <= 100)
        return known & (percent < 100 * data.free_thresh), known & (percent >= 100 * data.occupied_thresh)
    occupancy = np.asarray(gray if data.negate else 1 - gray)
    free = known & (occupancy < min(data.free_thresh, 1 - UNKNOWN_GRAY))
    return free, known & (occupancy >= data.occupied_thresh)
