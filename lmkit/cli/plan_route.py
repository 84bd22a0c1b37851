"""`lmkit plan route`: the shortest safe route on which the pose stays known."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lmkit.cli import map_options, options
from lmkit.cli.map_options import read_map_file
from lmkit.cli.option_groups import PLAIN, DrawnFloorOptions
from lmkit.cli.output import check_outputs, image_kind, print_json, print_line, warn, write_outputs


def run(
    start: Annotated[
        str, typer.Argument(help="Start: x,y in meters, a place of the floor plan, or a landmark's code.")
    ],
    goal: Annotated[
        str, typer.Argument(help="Goal: written as the start, or x,y,heading with the heading in degrees.")
    ],
    floor: options.FloorFile,
    landmark_map: options.MapFile,
    rig: options.MountedRigFile,
    drawing: DrawnFloorOptions = PLAIN,
    camera_height: options.CameraHeight = None,
    marker_family: map_options.MarkerFamily = None,
    marker_size: map_options.MarkerSize = None,
    radius: options.Radius = "0.25m",
    error: options.PositionError = "5cm",
    plan: options.PlanOutput = None,
    csv: Annotated[
        Path | None, typer.Option("--csv", help="CSV file to write: poses along the route with expected errors.")
    ] = None,
    tum: Annotated[
        Path | None,
        typer.Option("--tum", help="TUM file to write: poses with their number as time, for lmkit convert --to bag."),
    ] = None,
    as_json: options.Json = False,
    force: options.Force = False,
) -> None:
    """Plan the shortest safe route on which the pose stays known."""
    from lmkit.cli.parsing import parse_demand, parse_meters
    from lmkit.cli.plan_inputs import read_ground, read_mounted_rig, warn_of_landmarks_off
    from lmkit.io.trajectory import poses_to_tum
    from lmkit.planning.route import (
        find_goal,
        plan_route,
        route_csv,
        route_lines,
        route_poses,
        route_warning,
    )
    from lmkit.reports.planning import draw_route

    demand, radius_m = parse_demand(error, 2.0, 1, 25.0, 100.0), parse_meters(radius, "--radius")
    check_outputs((csv, tum, plan), force)
    cameras = read_mounted_rig(rig, camera_height)
    landmarks = read_map_file(landmark_map, marker_family, marker_size)
    ground = read_ground(floor, drawing)
    warn_of_landmarks_off(ground, landmarks, floor, landmark_map)
    ends = [find_goal(text, ground, landmarks, radius_m) for text in (start, goal)]
    found = plan_route(ground, landmarks, cameras, radius_m, ends[0], ends[1], demand)
    write_outputs({csv: route_csv(found), tum: poses_to_tum(route_poses(found))}, force)
    if plan is not None:
        write_outputs({plan: draw_route(ground, landmarks, found, image_kind(plan))}, force)
    if as_json:
        print_json(found.to_dict())
    else:
        for line in route_lines(found):
            print_line(line)
    if text := route_warning(found, demand):
        warn(text)
