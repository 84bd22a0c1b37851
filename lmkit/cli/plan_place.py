"""`lmkit plan place`: where to mount as few landmarks as possible."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lmkit.cli import options
from lmkit.cli.map_options import read_mounted_map
from lmkit.cli.option_groups import PLAIN, DrawnFloorOptions
from lmkit.cli.output import ProgressBars, check_outputs, print_json, print_line, warn, write_outputs
from lmkit.errors import InputError

MOST_PATIENCE_S = 3600.0


def run(
    floor: options.FloorFile,
    rig: options.MountedRigFile,
    output: options.OutputFolder = Path("lmkit-plan"),
    landmark_map: Annotated[
        Path | None, typer.Option("--map", help="Map of landmarks that are already mounted and stay where they are.")
    ] = None,
    drawing: DrawnFloorOptions = PLAIN,
    camera_height: options.CameraHeight = None,
    radius: options.Radius = "0.25m",
    error: options.PositionError = "5cm",
    heading: options.HeadingError = 2.0,
    in_view: options.InView = 2,
    headings: options.Headings = 25.0,
    share: Annotated[
        float, typer.Option("--share", help="Percentage of the floor that must meet the requirement.")
    ] = 90.0,
    family: options.OneFamily = "lm8",
    size: Annotated[
        list[str] | None, typer.Option("--size", help="Allowed landmark size; repeatable. Default: 180mm.")
    ] = None,
    height: Annotated[
        list[str] | None,
        typer.Option("--height", help="Allowed height of landmark centers; repeatable. Default: above the camera."),
    ] = None,
    not_on: Annotated[
        str, typer.Option("--not-on", metavar="WALLS", help="Walls without landmarks, such as A,C.")
    ] = "",
    patience: Annotated[
        float,
        typer.Option("--patience", help="Time limit, seconds, of the step that replaces two landmarks by one."),
    ] = 2.5,
    prints: Annotated[
        bool, typer.Option("--prints/--no-prints", help="Write the landmarks as files to print.")
    ] = True,
    paper: Annotated[
        str,
        typer.Option("--paper", help="Paper of prints and mounting sheets: a4, letter, a3, a2, a1, a0 or tabloid."),
    ] = "a4",
    jobs: options.Jobs = None,
    as_json: options.Json = False,
    force: options.Force = False,
) -> None:
    """Place as few landmarks as possible. Writes map, prints, mounting list and drawings."""
    from lmkit.cli.parsing import parse_demand, parse_meters
    from lmkit.cli.plan_inputs import read_ground, read_mounted_rig, warn_of_landmarks_off
    from lmkit.model.families import family_named
    from lmkit.model.landmark_map import LandmarkMap
    from lmkit.pipelines.prints import PAPERS
    from lmkit.planning.mounting_plan import placement_lines
    from lmkit.planning.mounting_sites import MountingOptions
    from lmkit.planning.placement import place_landmarks
    from lmkit.reports.planning import PLACEMENT_FILES, placement_files

    demand, radius_m = parse_demand(error, heading, in_view, headings, share), parse_meters(radius, "--radius")
    if not 0 <= patience <= MOST_PATIENCE_S:
        raise InputError(
            "out_of_range", f"--patience {patience:g} is outside 0 to {MOST_PATIENCE_S:g} s", "2.5 is usual"
        )
    if paper not in PAPERS:
        raise InputError("bad_paper", f"--paper {paper} is unknown", f"choose {', '.join(PAPERS)}")
    check_outputs([output / name for name in PLACEMENT_FILES], force)
    choices = MountingOptions(
        family=family_named(family).name,
        sizes_m=tuple(parse_meters(text, "--size") for text in size or ["180mm"]),
        heights_m=tuple(parse_meters(text, "--height") for text in height or []),
        not_on=tuple(name.strip() for name in not_on.split(",") if name.strip()),
        swap_s=patience,
    )
    cameras = read_mounted_rig(rig, camera_height)
    mounted = LandmarkMap([]) if landmark_map is None else read_mounted_map(landmark_map)
    ground = read_ground(floor, drawing)
    if landmark_map is not None:
        warn_of_landmarks_off(ground, mounted, floor, landmark_map)
    with ProgressBars() as bars:

        def on_step(_: int, covered: float) -> None:
            bars.update("placing landmarks", min(100, int(100 * covered / demand.share)), 100)

        placement = place_landmarks(ground, list(mounted), cameras, radius_m, demand, choices, on_step)
    files = placement_files(ground, placement, demand, prints, paper)
    written = write_outputs({output / name: data for name, data in files.items()}, force)
    if as_json:
        print_json(placement.to_dict())
    else:
        for line in placement_lines(placement, ground, demand, output / "mounting.csv"):
            print_line(line)
        print_line(f"wrote {', '.join(map(str, written))}")
    if placement.share < demand.share:
        warn(f"checked on a finer grid, the requirement holds on only {placement.share:.1%} of the floor")
