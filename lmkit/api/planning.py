"""`lmkit.print_landmarks`, `lmkit.place_landmarks` and `lmkit.plan_route`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING

from lmkit.api.arguments import (
    PathLike,
    as_codes,
    as_demand,
    as_families,
    as_map,
    as_meters,
    as_path,
    as_point,
    as_rig,
    require_type,
)
from lmkit.errors import InputError

if TYPE_CHECKING:
    from lmkit.geometry.rig import AnyRig
    from lmkit.model.families import MarkerFamily
    from lmkit.model.floor_plan import FloorPlan
    from lmkit.model.landmark_id import LandmarkId
    from lmkit.model.landmark_map import LandmarkMap
    from lmkit.pipelines.prints import Prints
    from lmkit.planning.coverage import Demand
    from lmkit.planning.mounting_sites import MountingOptions
    from lmkit.planning.placement import Placement
    from lmkit.planning.route import Route


def print_landmarks(
    codes: int | str | LandmarkId | Iterable[int | LandmarkId],
    *,
    family: str | MarkerFamily = "lm8",
    size: float | str | None = None,
    paper: str | None = None,
    template: str | None = None,
) -> Prints:
    """Lay landmarks out on paper, and check that each can be read from the rendered page.

    Args:
        codes: one code or id, several, or text such as ``"0-15,42"``.
        family: the landmark family, or its name.
        size: side of the landmarks, meters or text with a unit; the template's own size if None.
        paper: ``"a4"``, ``"letter"`` or ``"a3"``; None for the template's own, or A4.
        template: name of a shipped template, or a TOML file.

    Returns:
        The pages; ``.save("landmarks.pdf")`` writes them with their manifest.

    Raises:
        InputError: an unknown code, paper or template, or a size that does not fit.

    Examples:
        >>> import lmkit
        >>> prints = lmkit.print_landmarks(range(3), size="120mm")
        >>> prints.save("landmarks.pdf")
        [PosixPath('landmarks.pdf')]
    """
    from lmkit.pipelines.prints import check_landmark_size, make_prints

    of = as_families(family)[0]
    if template is not None:
        as_path(template, "template")
    size_mm = None if size is None else 1000 * as_meters(size, "size")
    if size_mm is not None:
        check_landmark_size(size_mm)
    return make_prints(of, as_codes(codes, of), size_mm=size_mm, paper=paper, template=template)


def place_landmarks(
    floor: FloorPlan | PathLike,
    rig: AnyRig | PathLike,
    *,
    demand: Demand | None = None,
    options: MountingOptions | None = None,
    existing: LandmarkMap | PathLike | None = None,
    radius: float | str = 0.25,
    camera_height: float | str | None = None,
) -> Placement:
    """Place as few landmarks as possible for a required accuracy on a share of the floor.

    Args:
        floor: the floor plan, or its file (YAML, SVG, image, ROS map).
        rig: the rig, or its file; it needs T_base_left or ``camera_height``.
        demand: required accuracy of position and heading, and the share of headings and places that must reach it.
        options: family, sizes, heights and walls to choose from; None: ``lm8`` of 180 mm on any wall.
        existing: landmarks that are already mounted, and are kept.
        radius: radius of the robot, meters or text with a unit.
        camera_height: height of the left camera above the floor, where the rig has no T_base_left.

    Raises:
        InputError: no wall fits a landmark, or the robot fits nowhere.
        NegativeAnswer: no number of landmarks meets the requirement.

    Examples:
        >>> import lmkit
        >>> demand = lmkit.Demand(in_view=1, headings=0.2, share=0.5)
        >>> placement = lmkit.place_landmarks("floor.yaml", "rig.yaml", demand=demand, camera_height=0.9)
        >>> placement
        Placement(... new landmarks, ...% of the places, error ... mm)
        >>> placement.share >= 0.5
        True
    """
    from lmkit.model.landmark import LM8
    from lmkit.planning.coverage import Demand
    from lmkit.planning.mounting_sites import MountingOptions
    from lmkit.planning.placement import place_landmarks

    ground, cameras = _floor(floor), _mounted(rig, camera_height)
    mounted = [] if existing is None else list(as_map(existing))
    choices = MountingOptions(LM8.name) if options is None else options
    require_type(choices, MountingOptions, "options", 'give MountingOptions("lm8", sizes_m=(0.18,))')
    needed = as_demand(demand, Demand())
    return place_landmarks(ground, mounted, cameras, as_meters(radius, "radius"), needed, choices)


def plan_route(
    floor: FloorPlan | PathLike,
    rig: AnyRig | PathLike,
    landmarks: LandmarkMap | PathLike,
    start: str | tuple[float, float],
    goal: str | tuple[float, float],
    *,
    radius: float | str = 0.25,
    camera_height: float | str | None = None,
    demand: Demand | None = None,
) -> Route:
    """Plan the shortest safe route on which the pose stays known.

    Args:
        floor: the floor plan, or its file (YAML, SVG, image, ROS map).
        rig: the rig, or its file; it needs T_base_left or ``camera_height``.
        landmarks: the landmark map, or its file.
        start, goal: (x, y) in meters, or text such as ``"2.5,1,90"`` (heading in degrees) or a place's name.
        radius: radius of the robot, meters or text with a unit.
        camera_height: height of the left camera above the floor.
        demand: required accuracy; routes avoid places that do not reach it.

    Raises:
        InputError: the robot cannot stand at the start or the goal.
        NegativeAnswer: no route leads there.

    Examples:
        >>> import lmkit
        >>> route = lmkit.plan_route("floor.yaml", "rig.yaml", "map.yaml", (1, 1), (3, 2), camera_height=0.9)
        >>> route
        Route(2.24 m, 2 waypoints, error up to ... mm)
    """
    from lmkit.planning.coverage import Demand
    from lmkit.planning.route import Goal, find_goal, plan_route

    ground, mapped, meters = _floor(floor), as_map(landmarks), as_meters(radius, "radius")
    ends = [
        find_goal(end, ground, mapped, meters) if isinstance(end, str) else Goal(*as_point(end, name))
        for name, end in (("start", start), ("goal", goal))
    ]
    needed = as_demand(demand, Demand(in_view=1, share=1.0))
    return plan_route(ground, mapped, _mounted(rig, camera_height), meters, ends[0], ends[1], needed)


def _floor(floor: FloorPlan | PathLike) -> FloorPlan:
    from lmkit.io.floor_plan import read_floor
    from lmkit.model.floor_plan import FloorPlan

    return floor if isinstance(floor, FloorPlan) else read_floor(as_path(floor))


def _mounted(rig: AnyRig | PathLike, height: float | str | None) -> AnyRig:
    """The rig with the pose of its first camera on the robot.

    Raises:
        InputError: neither the rig nor ``height`` gives the height of the camera.
    """
    from lmkit.geometry.stereo_rig import mounted_ahead

    cameras = as_rig(rig)
    if height is not None:
        return replace(cameras, T_base_left=mounted_ahead(as_meters(height, "camera_height")))
    if cameras.T_base_left is None:
        raise InputError("no_base", "the rig has no T_base_left", "add it, or give camera_height=0.85")
    return cameras
