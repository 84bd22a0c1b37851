"""`lmkit plan coverage`: the expected pose error at every place of a floor."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lmkit.cli import map_options, options
from lmkit.cli.map_options import read_map_file
from lmkit.cli.option_groups import PLAIN, DrawnFloorOptions
from lmkit.cli.output import check_outputs, image_kind, print_json, print_line, write_outputs


def run(
    floor: options.FloorFile,
    landmark_map: options.MapFile,
    rig: options.MountedRigFile,
    drawing: DrawnFloorOptions = PLAIN,
    camera_height: options.CameraHeight = None,
    marker_family: map_options.MarkerFamily = None,
    marker_size: map_options.MarkerSize = None,
    radius: options.Radius = "0.25m",
    error: options.PositionError = "5cm",
    heading: options.HeadingError = 2.0,
    in_view: options.InView = 2,
    headings: options.Headings = 25.0,
    plan: Annotated[Path, typer.Option("--plan", "-o", help="Heat map to write (.png or .svg).")] = Path(
        "coverage.png"
    ),
    as_json: options.Json = False,
    force: options.Force = False,
) -> None:
    """Predict the pose error at every place. Places that fail the requirement are listed."""
    from lmkit.cli.parsing import parse_demand, parse_meters
    from lmkit.cli.plan_inputs import read_ground, read_mounted_rig, warn_of_landmarks_off
    from lmkit.planning.coverage import coverage_dict, coverage_lines, failing_places, predict_coverage
    from lmkit.reports.planning import draw_coverage

    demand, radius_m = parse_demand(error, heading, in_view, headings, 100.0), parse_meters(radius, "--radius")
    check_outputs([plan], force)
    cameras = read_mounted_rig(rig, camera_height)
    landmarks = read_map_file(landmark_map, marker_family, marker_size)
    ground = read_ground(floor, drawing)
    warn_of_landmarks_off(ground, landmarks, floor, landmark_map)
    answer = predict_coverage(ground, list(landmarks), cameras, radius_m)
    failing = failing_places(answer, demand)
    write_outputs({plan: draw_coverage(ground, landmarks, answer, demand, image_kind(plan))}, force)
    if as_json:
        print_json(coverage_dict(answer, demand, failing, plan))
        return
    for line in coverage_lines(answer, demand, failing):
        print_line(line)
    print_line(f"wrote {plan}")
