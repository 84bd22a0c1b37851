"""`lmkit plan`: where landmarks should hang, how well a robot then knows where it is, and ways to drive."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lmkit.cli.options import CameraHeight, ErrorOption, Floor, Force, Heading, Headings, InView, Radius, Rig, Scale
from lmkit.cli.output import check_outputs, picture_kind, print_json, print_line, warn
from lmkit.errors import InputError

if TYPE_CHECKING:
    from lmkit.geometry.stereo_rig import StereoRig
    from lmkit.model.floor_plan import FloorPlan
    from lmkit.planning.coverage import Demand

app = typer.Typer(help="Where to hang landmarks, what a robot then knows, and ways to drive.")

MOST_NAMED = 8
MOST_PATIENCE_S = 3600.0

Json = Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")]


@app.callback(invoke_without_command=True)
def _without_command(context: typer.Context) -> None:
    """Where to hang landmarks, what a robot then knows, and ways to drive."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
        raise typer.Exit(2)


@app.command("coverage")
def coverage(
    floor: Floor,
    landmark_map: Annotated[Path, typer.Option("--map", help="Map of the landmarks that hang.")],
    rig: Rig,
    scale: Scale = None,
    camera_height: CameraHeight = None,
    radius: Radius = "0.25m",
    error: ErrorOption = "5cm",
    heading: Heading = 2.0,
    in_view: InView = 2,
    headings: Headings = 25.0,
    plan: Annotated[Path, typer.Option("--plan", "-o", help="Heat map to write, .png or .svg.")] = Path(
        "coverage.png"
    ),
    as_json: Json = False,
    force: Force = False,
) -> None:
    """The error to expect at every place, and the weak places by name."""
    from lmkit.cli.parsing import parse_demand, parse_metres
    from lmkit.io.external_maps import read_any_map
    from lmkit.io.files import write_file
    from lmkit.planning.coverage import predict_coverage, weak_places
    from lmkit.reports.planning import draw_coverage

    demand = parse_demand(error, heading, in_view, headings, 100.0)
    check_outputs((), plan, force)
    ground, landmarks, eyes = _floor(floor, scale), read_any_map(landmark_map), _rig(rig, camera_height)
    answer = predict_coverage(ground, list(landmarks), eyes, parse_metres(radius, "--radius"))
    share = float(answer.covered(demand).mean())
    weak = weak_places(answer, demand)
    write_file(plan, draw_coverage(ground, landmarks, answer, demand, picture_kind(plan)), force)
    if as_json:
        places = [
            {
                "position": list(w.middle),
                "area_m2": w.area_m2,
                "in_view": w.in_view,
                "error_m": None if math.isinf(w.error_m) else w.error_m,
            }
            for w in weak
        ]
        print_json({"share": share, "places": len(answer.places), "weak": places, "plan": str(plan)})
        return
    print_line(f"{share:.0%} of {len(answer.places)} places hold {_asked(demand)}")
    for place in weak[:MOST_NAMED]:
        print_line(f"weak: {place}")
    if len(weak) > MOST_NAMED:
        print_line(f"and {len(weak) - MOST_NAMED} smaller ones")
    print_line(f"see {plan}")


@app.command("place")
def place(
    floor: Floor,
    rig: Rig,
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for map, prints, list and plan.")] = Path(
        "lmkit-plan"
    ),
    landmark_map: Annotated[Path | None, typer.Option("--map", help="Landmarks that hang already and stay.")] = None,
    scale: Scale = None,
    camera_height: CameraHeight = None,
    radius: Radius = "0.25m",
    error: ErrorOption = "5cm",
    heading: Heading = 2.0,
    in_view: InView = 2,
    headings: Headings = 25.0,
    share: Annotated[float, typer.Option("--share", help="Percent of the floor at which this must hold.")] = 90.0,
    size: Annotated[
        list[str] | None, typer.Option("--size", help="Of the landmarks; repeatable, to choose from. Default: 180mm.")
    ] = None,
    height: Annotated[
        list[str] | None,
        typer.Option("--height", help="Of their middles; repeatable, to choose from. Default: above the camera."),
    ] = None,
    not_on: Annotated[str, typer.Option("--not-on", help="Walls that stay bare, as in A,C.")] = "",
    patience: Annotated[
        float, typer.Option("--patience", help="Seconds to look for two landmarks that one can do for.")
    ] = 2.5,
    prints: Annotated[bool, typer.Option("--prints/--no-prints", help="Write the landmarks to print.")] = True,
    as_json: Json = False,
    force: Force = False,
) -> None:
    """The fewest landmarks found that hold an error over a share of the floor: map, prints, list, plan."""
    from lmkit.cli.output import progress_counter
    from lmkit.cli.parsing import parse_demand, parse_metres
    from lmkit.io.external_maps import read_any_map
    from lmkit.io.files import write_file
    from lmkit.io.landmark_map import map_to_yaml
    from lmkit.model.landmark_map import LandmarkMap
    from lmkit.planning.mounting_plan import mounting_csv, sheets_to_print
    from lmkit.planning.mounting_sites import HangOptions
    from lmkit.planning.placement import place_landmarks
    from lmkit.reports.planning import draw_coverage, draw_placement

    demand = parse_demand(error, heading, in_view, headings, share)
    if not 0 <= patience <= MOST_PATIENCE_S:
        raise InputError(
            "out_of_range", f"--patience {patience:g} is outside 0 to {MOST_PATIENCE_S:g} s", "2.5 is usual"
        )
    names = ["map.yaml", "mounting.csv", "plan.png", "coverage.png", "landmarks.pdf"]
    check_outputs([output / name for name in names], None, force)
    ground, eyes = _floor(floor, scale), _rig(rig, camera_height)
    hung = LandmarkMap([]) if landmark_map is None else read_any_map(landmark_map)
    options = HangOptions(
        sizes_m=tuple(parse_metres(text, "--size") for text in size or ["180mm"]),
        heights_m=tuple(parse_metres(text, "--height") for text in height or []),
        not_on=tuple(name.strip() for name in not_on.split(",") if name.strip()),
        exchange_s=patience,
    )
    tick = progress_counter(100, "placing")
    shown = [0]

    def on_step(_: int, covered: float) -> None:
        while shown[0] < min(100, int(100 * covered / demand.share)):
            shown[0] += 1
            tick(shown[0], 100)

    placement = place_landmarks(ground, list(hung), eyes, parse_metres(radius, "--radius"), demand, options, on_step)
    files: dict[str, bytes | str] = {
        "map.yaml": map_to_yaml(placement.landmarks),
        "mounting.csv": mounting_csv(placement),
        "plan.png": draw_placement(ground, placement),
        "coverage.png": draw_coverage(ground, placement.landmarks, placement.coverage, demand),
    }
    if prints and placement.mounts:
        files["landmarks.pdf"] = sheets_to_print(placement)
    for name, data in files.items():
        write_file(output / name, data, force)
    if as_json:
        mounts = [
            {
                "code": m.landmark.code,
                "wall": m.wall.name,
                "along_m": m.along_m,
                "height_m": float(m.landmark.T_map_landmark.t[2]),
                "size_m": m.landmark.size_m,
            }
            for m in placement.mounts
        ]
        print_json({"share": placement.share, "error_m": placement.error_m, "landmarks": mounts})
    else:
        more = " more" if len(hung) else ""
        print_line(f"{len(placement.mounts)}{more} landmarks: {_asked(demand)}")
        print_line(
            f"holds at {placement.share:.1%} of {len(placement.coverage.places)} places, with an error of "
            f"{1000 * placement.error_m:.0f} mm where it holds"
        )
        for mount in placement.mounts[:MOST_NAMED]:
            print_line(f"  {mount.landmark.code:3d}: {mount}")
        if len(placement.mounts) > MOST_NAMED:
            print_line(f"  and {len(placement.mounts) - MOST_NAMED} more in {output / 'mounting.csv'}")
        print_line(f"see {', '.join(str(output / name) for name in files)}")
    if placement.share < demand.share:
        warn(f"between the places that were searched, the demand holds at {placement.share:.1%} only")


@app.command("route")
def route(
    start: Annotated[str, typer.Argument(help="Where from: x,y in metres, a name, or a landmark's code.")],
    goal: Annotated[str, typer.Argument(help="Where to: the same, or x,y,heading in deg.")],
    floor: Floor,
    landmark_map: Annotated[Path, typer.Option("--map", help="Map of the landmarks that hang.")],
    rig: Rig,
    scale: Scale = None,
    camera_height: CameraHeight = None,
    radius: Radius = "0.25m",
    error: ErrorOption = "5cm",
    plan: Annotated[Path | None, typer.Option("--plan", help="Picture to write, .png or .svg.")] = None,
    csv: Annotated[Path | None, typer.Option("--csv", help="Poses along the way with expected errors.")] = None,
    tum: Annotated[Path | None, typer.Option("--tum", help="The same as TUM lines; lmkit convert --to bag.")] = None,
    as_json: Json = False,
    force: Force = False,
) -> None:
    """The shortest safe way on which the pose stays known, with the error to expect along it."""
    from lmkit.cli.parsing import parse_demand, parse_metres
    from lmkit.geometry.planar import planar_pose
    from lmkit.io.external_maps import read_any_map
    from lmkit.io.files import write_file
    from lmkit.io.trajectory import poses_to_tum
    from lmkit.planning.route import find_goal, plan_route
    from lmkit.reports.planning import draw_route

    check_outputs((csv, tum), plan, force)
    demand = parse_demand(error, 2.0, 1, 25.0, 100.0)
    ground, landmarks, eyes = _floor(floor, scale), read_any_map(landmark_map), _rig(rig, camera_height)
    radius_m = parse_metres(radius, "--radius")
    ends = [find_goal(text, ground, landmarks, radius_m) for text in (start, goal)]
    found = plan_route(ground, landmarks, eyes, radius_m, ends[0], ends[1], demand)
    if plan is not None:
        write_file(plan, draw_route(ground, landmarks, found, picture_kind(plan)), force)
    if csv is not None:
        rows = zip(found.states.tolist(), found.error_m.tolist(), found.heading_sigma_rad.tolist(), strict=True)
        lines = [f"{x:.4f},{y:.4f},{math.degrees(h):.2f},{e:.4f},{math.degrees(s):.3f}\n" for (x, y, h), e, s in rows]
        write_file(csv, "x_m,y_m,heading_deg,error_m,heading_error_deg\n" + "".join(lines), force)
    if tum is not None:
        poses = [(float(k), planar_pose(state)) for k, state in enumerate(found.states)]
        write_file(tum, poses_to_tum(poses), force)
    worst = int(found.error_m.argmax())
    if as_json:
        print_json(
            {
                "length_m": found.length_m,
                "waypoints": found.waypoints.tolist(),
                "heading_deg": None if found.heading_rad is None else math.degrees(found.heading_rad),
                "worst_error_m": float(found.error_m[worst]),
                "worst_at": found.states[worst, :2].tolist(),
                "error_at_goal_m": float(found.error_m[-1]),
            }
        )
    else:
        print_line(f"{found.length_m:.2f} m in {len(found.waypoints) - 1} straight parts")
        for x, y in found.waypoints:
            print_line(f"  {x:.2f},{y:.2f}")
        print_line(f"expected error at the goal {100 * found.error_m[-1]:.1f} cm")
    if found.error_m[worst] > demand.error_m:
        x, y = found.states[worst, :2]
        warn(f"around ({x:.1f}, {y:.1f}) m the error grows to {100 * found.error_m[worst]:.0f} cm: a landmark helps")


def _floor(path: Path, scale_m: float | None) -> FloorPlan:
    from lmkit.io.floor_plan import read_floor

    return read_floor(path, scale_m)


def _rig(path: Path, height: str | None) -> StereoRig:
    """With its place on the robot.

    Raises:
        InputError: neither the file nor the option says how high the camera is.
    """
    from lmkit.cli.parsing import parse_metres
    from lmkit.geometry.stereo_rig import mounted_ahead
    from lmkit.io.any_rig import read_any_rig

    rig = read_any_rig(path)
    if height is not None:
        return replace(rig, T_base_left=mounted_ahead(parse_metres(height, "--camera-height")))
    if rig.T_base_left is None:
        raise InputError(
            "no_base", f"{path} has no T_base_left", "add it, or say how high the camera is: --camera-height 0.85m"
        )
    return rig


def _asked(demand: Demand) -> str:
    return (
        f"{100 * demand.error_m:g} cm and {math.degrees(demand.heading_rad):g} deg with {demand.in_view} landmarks "
        f"in view in {demand.headings:.0%} of the directions"
    )
