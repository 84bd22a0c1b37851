"""Floor and rig as the commands of `lmkit plan` read them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from lmkit.errors import InputError
from lmkit.units import parse_size_mm

if TYPE_CHECKING:
    from lmkit.cli.option_groups import DrawnFloorOptions
    from lmkit.geometry.rig import AnyRig
    from lmkit.model.floor_plan import FloorPlan
    from lmkit.model.landmark_map import LandmarkMap

SMALL_FLOOR_M2 = (
    2.0  # smallest plausible floor of a robot; a smaller one has the wrong scale, such as millimeters for meters
)


def read_mounted_rig(path: Path, camera_height: str | None) -> AnyRig:
    """Read a rig that has its pose on the robot.

    Raises:
        InputError: neither the file nor the option has the camera's height.
    """
    from lmkit.cli.parsing import parse_meters
    from lmkit.geometry.stereo_rig import mounted_ahead
    from lmkit.io.any_rig import read_any_rig

    height_m = None if camera_height is None else parse_meters(camera_height, "--camera-height")
    rig = read_any_rig(path)
    if height_m is not None:
        return replace(rig, T_base_left=mounted_ahead(height_m))
    if rig.T_base_left is None:
        raise InputError("no_base", f"{path} has no T_base_left", "add it, or give --camera-height 0.85m")
    return rig


def read_ground(path: Path, options: DrawnFloorOptions) -> FloorPlan:
    """Read a floor plan; warn of islands, and of parts that no opening connects.

    Raises:
        InputError: not readable, or an option is not valid.
    """
    from lmkit.cli.output import warn
    from lmkit.cli.parsing import parse_meters
    from lmkit.io.dxf_lines import parse_layer_rules
    from lmkit.io.floor_islands import DrawingOptions, drawing_warnings, parse_island_rules
    from lmkit.io.floor_plan import read_floor

    thin_m = 0.0 if options.thin_lines is None else parse_meters(options.thin_lines, "--thin-lines")
    islands, layers = parse_island_rules(options.islands), parse_layer_rules(options.layers)
    drawing = DrawingOptions(*islands, thin_m, options.curves, layers)
    floor = read_floor(path, options.scale, drawing)
    for text in drawing_warnings(floor.islands, floor.free, floor.cell_m):
        warn(text)
    free_m2 = float(floor.free.sum()) * floor.cell_m**2
    if options.scale is not None and free_m2 < SMALL_FLOOR_M2:
        warn(f"{path}: the free floor is {free_m2:.2g} m2; check --scale {options.scale:g}")
    return floor


def read_room(room: str | None, floor: Path | None, options: DrawnFloorOptions) -> FloorPlan | None:
    """Read the floor of --room or --floor; None without either.

    Raises:
        InputError: both are given, or one of them is not valid.
    """
    from lmkit.io.floor_plan import rectangular_room

    if room is not None and floor is not None:
        raise InputError("not_together", "--room and --floor cannot be combined", "leave one of them out")
    if room is not None:
        width_mm, depth_mm = parse_size_mm(room, "--room")
        return rectangular_room(width_mm / 1000, depth_mm / 1000)
    return None if floor is None else read_ground(floor, options)


def warn_of_landmarks_off(ground: FloorPlan, landmarks: LandmarkMap, floor: Path, landmark_map: Path) -> None:
    """Warn of landmarks that are not visible from the floor, such as those of another building's map."""
    from lmkit.cli.output import warn
    from lmkit.model.landmark_id import ids_text
    from lmkit.model.map_checks import landmarks_off

    if off := landmarks_off(ground, landmarks):
        share = f"{len(off)} of {len(landmarks)} landmarks"
        where = f"face a wall or are outside of the rooms of {floor}, and count nowhere"
        remedy = "check that map and floor plan have the same origin and scale"
        warn(f"{landmark_map}: {share} {where} ({ids_text(off)}); {remedy}")
