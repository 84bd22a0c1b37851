"""Maps measured by hand: a CSV form that a person with a tape measure fills in (docs/formats.md).

Each row has a code and either a wall with ``left_m`` or ``right_m``, or ``x_m``, ``y_m`` and ``facing_deg``; and the
height of the center above the floor.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.errors import InputError, InputWarning, warn_caller
from lmkit.io.field_problems import plain_problem
from lmkit.io.landmark_map import FOREIGN_FAMILY
from lmkit.io.map_plausibility import require_in_sight
from lmkit.io.tables import read_rows, to_number
from lmkit.model.families import family_named
from lmkit.model.floor_plan import Wall
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark, wall_pose

COLUMNS = ("code", "wall", "left_m", "right_m", "height_m", "x_m", "y_m", "facing_deg", "size_mm", "family", "name")
BLANK_COLUMNS = ("code", "wall", "left_m", "height_m")
ALIASES = {"from_left_end_m": "left_m", "z_m": "height_m", "id": "code"}
NEAR_QUARTER = 0.01
AGREE_M = 0.05  # largest difference of two measurements of one position


@dataclass(frozen=True)
class FormDefaults:
    """Values for cells and columns that a form leaves empty.

    Attributes:
        family: landmark family.
        size_m: outer edge to outer edge of the border.
        sigma: standard deviations of a position (m, each axis) and an orientation (rad, each axis), if known.
    """

    family: str
    size_m: float = 0.18
    sigma: tuple[float, float] | None = None


def blank_form(codes: Sequence[int]) -> str:
    """An empty form, a row for each code."""
    return "\n".join([",".join(BLANK_COLUMNS), *(f"{code},,," for code in codes)]) + "\n"


def read_measured_map(path: Path, walls: Sequence[Wall], defaults: FormDefaults) -> LandmarkMap:
    """The map that a filled-in form describes; rows without any measurement are left out.

    Args:
        walls: walls that the form may name; case is ignored.

    Raises:
        InputError: not readable, an unknown column or wall, a value that is missing or contradicts another; names the
            line.

    Warns:
        InputWarning: directions that look like radians.
    """
    rows = read_rows(path, "form")
    header = [ALIASES.get(cell.lower(), cell.lower()) for cell in rows[0]] if rows else []
    if "code" not in header or len(set(header)) != len(header) or not set(header) <= set(COLUMNS):
        unknown = [cell for cell in header if cell not in COLUMNS]
        what = f"unknown column {unknown[0]!r}" if unknown else "no column 'code', or a column twice"
        raise InputError("bad_header", f"{path}: line 1: {what}", f"columns are {', '.join(COLUMNS)}")
    by_name = {wall.name.lower(): wall for wall in walls}
    landmarks = []
    facing_deg: list[float] = []
    for number, row in enumerate(rows[1:], start=2):
        cells = {name: cell for name, cell in zip(header, row, strict=False) if cell}
        if not set(cells) - {"code", "wall", "size_mm", "family", "name"}:
            continue
        try:
            if len(row) > len(header):
                raise ValueError(f"{len(row)} cells under {len(header)} columns; write decimals with a point")
            landmarks.append(_landmark(cells, by_name, defaults))
            facing_deg += [_number(cells, "facing_deg")] if "facing_deg" in cells else []
        except ValueError as error:
            raise InputError(
                "bad_row",
                f"{path}: line {number}: {plain_problem(error)}",
                "measure in meters; columns are in docs/formats.md",
            ) from None
    if not landmarks:
        raise InputError("no_landmarks", f"{path}: no row has a measurement", "fill in wall, left_m and height_m")
    require_in_sight(path, landmarks)
    if _are_radians(facing_deg):
        some = ", ".join(f"{angle:g}" for angle in facing_deg[:3])
        warn_caller(InputWarning(f"{path}: facing_deg of {some}: are these radians? Write degrees"))
    try:
        return LandmarkMap(landmarks)
    except InputError as error:
        raise InputError(error.code, f"{path}: {error.message}", error.hint) from None


def _are_radians(angles: Sequence[float]) -> bool:
    """Whether angles are at most 2 pi, and half of them near quarter turns in radians (1.571, 3.142)."""
    quarters = [angle / (math.pi / 2) for angle in angles]
    near = [quarter for quarter in quarters if round(quarter) and abs(quarter - round(quarter)) < NEAR_QUARTER]
    return bool(near) and 2 * len(near) >= len(angles) and max(map(abs, angles)) < 2 * math.pi + NEAR_QUARTER


def _landmark(cells: Mapping[str, str], walls: Mapping[str, Wall], defaults: FormDefaults) -> MappedLandmark:
    try:
        id_ = LandmarkId.parse(cells.get("code", ""), [cells.get("family", defaults.family)])
        if id_.family != FOREIGN_FAMILY:
            family_named(id_.family)
    except InputError as error:
        raise ValueError(error.message) from None
    size_m = _number(cells, "size_mm", 1000 * defaults.size_m) / 1000
    height_m = _number(cells, "height_m")
    if size_m <= 0:
        raise ValueError(f"size_mm {cells['size_mm']} is not positive")
    (x, y), facing_rad = _place(cells, walls, size_m)
    covariance = None
    if defaults.sigma is not None:
        covariance = np.diag(np.repeat(np.square(defaults.sigma), 3))
    pose = wall_pose([float(x), float(y), height_m], facing_rad)
    return MappedLandmark(id_, size_m, pose, covariance, cells.get("name"))


def _place(cells: Mapping[str, str], walls: Mapping[str, Wall], size_m: float) -> tuple[FloatArray, float]:
    """Position (2,) in the map, and the direction of the face (rad)."""
    has_position = "x_m" in cells or "y_m" in cells
    if "wall" not in cells or not walls:
        if "left_m" in cells or "right_m" in cells:
            what = (
                "left_m needs a wall" if "wall" not in cells else f"wall {cells['wall']!r} is unknown without a room"
            )
            if "wall" not in cells or not has_position:
                raise ValueError(f"{what}; give --room 6.00x4.00m or --floor, and the column wall")
        position = np.array([_number(cells, "x_m"), _number(cells, "y_m")])
        return position, math.radians(_number(cells, "facing_deg"))
    wall = walls.get(cells["wall"].lower())
    if wall is None:
        raise ValueError(f"wall {cells['wall']!r} is unknown; walls are {', '.join(w.name for w in walls.values())}")
    if "left_m" not in cells and "right_m" not in cells:
        raise ValueError("left_m is empty; measure from the left end of the wall, as you face it, to the center")
    left_m = _number(cells, "left_m") if "left_m" in cells else wall.length_m - _number(cells, "right_m")
    if "right_m" in cells and abs(left_m + _number(cells, "right_m") - wall.length_m) > AGREE_M:
        total = left_m + _number(cells, "right_m")
        raise ValueError(f"left_m and right_m add up to {total:.2f} m, but wall {wall.name} is {wall.length_m:.2f} m")
    if not size_m / 2 - AGREE_M <= left_m <= wall.length_m - size_m / 2 + AGREE_M:
        raise ValueError(
            f"left_m {left_m:g} is beyond wall {wall.name}, which is {wall.length_m:.2f} m long (centimeters?)"
        )
    position = np.asarray(wall.left + left_m * wall.along)
    if has_position:
        _require_equal(position, np.array([_number(cells, "x_m"), _number(cells, "y_m")]), wall)
    if "facing_deg" in cells and math.cos(math.radians(_number(cells, "facing_deg")) - wall.facing_rad) < 0:
        facing_deg = math.degrees(wall.facing_rad) % 360
        raise ValueError(f"facing_deg looks into wall {wall.name}, which faces {facing_deg:.0f} degrees")
    return position, wall.facing_rad


def _require_equal(on_wall: FloatArray, written: FloatArray, wall: Wall) -> None:
    if np.linalg.norm(on_wall - written) > AGREE_M:
        x, y = on_wall
        raise ValueError(
            f"x_m, y_m and the place on wall {wall.name} ({x:.2f}, {y:.2f}) differ; leave one of the two empty"
        )


def _number(cells: Mapping[str, str], name: str, default: float | None = None) -> float:
    if name not in cells:
        if default is None:
            raise ValueError(f"{name} is empty")
        return default
    try:
        return to_number(cells[name])
    except ValueError:
        raise ValueError(f"{name} {cells[name][:30]!r} is not a number") from None
