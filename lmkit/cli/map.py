"""`lmkit map`: a landmark map from tape measurements; checks and drawings of maps."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lmkit.cli import options
from lmkit.cli.map_options import read_map_file
from lmkit.cli.option_groups import PLAIN, DrawnFloorOptions
from lmkit.cli.output import check_outputs, image_kind, print_line, warn, write_outputs
from lmkit.errors import InputError
from lmkit.units import parse_length_mm, parse_sigma

if TYPE_CHECKING:
    from lmkit.model.floor_plan import FloorPlan
    from lmkit.model.landmark_map import LandmarkMap


def run(
    source: Annotated[
        Path,
        typer.Argument(help="CSV form with measurements, or a map to check (lmkit, WPILib, TagSLAM and others)."),
    ],
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Map file to write.")] = None,
    room: Annotated[
        str | None,
        typer.Option(
            "--room", help="Rectangular room, x by y, such as 6.00x4.00m. Its walls are north, east, south and west."
        ),
    ] = None,
    floor: Annotated[
        Path | None,
        typer.Option("--floor", help="Floor plan with named walls (lmkit-floor/1), or DXF, PNG, PGM, SVG."),
    ] = None,
    drawing: DrawnFloorOptions = PLAIN,
    size: Annotated[
        str | None,
        typer.Option("--size", help="Size of landmarks for which the file gives none. Default for forms: 180mm."),
    ] = None,
    family: Annotated[
        str | None,
        typer.Option("--family", help="Family of landmarks for which the file gives none. Default for forms: lm8."),
    ] = None,
    sigma: Annotated[
        str | None,
        typer.Option(
            "--sigma",
            help="Standard deviation of the measurements, such as 10mm,1deg, for the covariances in the map.",
        ),
    ] = None,
    plan: options.PlanOutput = None,
    blank: Annotated[
        str | None,
        typer.Option("--blank", metavar="CODES", help="Write an empty form for these codes, such as 0-7, to SOURCE."),
    ] = None,
    force: options.Force = False,
) -> None:
    """Make a map from tape measurements; check and draw it."""
    from lmkit.cli.plan_inputs import read_room
    from lmkit.io.measured_map import blank_form
    from lmkit.model.codewords import parse_codes
    from lmkit.model.families import family_named
    from lmkit.model.map_checks import check_map
    from lmkit.reports.planning import draw_map

    if blank is not None:
        check_outputs([source], force)
        write_outputs({source: blank_form(parse_codes(blank, family_named(family or "lm8").code_count))}, force)
        print_line(f"wrote {source}")
        return
    check_outputs([output, plan], force)
    ground = read_room(room, floor, drawing)
    landmarks = _read(source, ground, size, family, sigma)
    for text in check_map(landmarks, ground):
        warn(text)
    for landmark in landmarks:
        x, y, z = landmark.T_map_landmark.t
        print_line(f"{landmark.id}: x {x:.3f} y {y:.3f} z {z:.3f} m, {landmark.size_m * 1000:.0f} mm")
    contents: dict[Path | None, bytes | str] = {}
    if output is not None:
        from lmkit.io.landmark_map import map_to_yaml

        contents[output] = map_to_yaml(landmarks)
    if plan is not None:
        contents[plan] = draw_map(landmarks, ground, source.name, image_kind(plan))
    for path in write_outputs(contents, force):
        print_line(f"wrote {path}")


def _read(
    source: Path, ground: FloorPlan | None, size: str | None, family: str | None, sigma: str | None
) -> LandmarkMap:
    from lmkit.io.measured_map import FormDefaults, read_measured_map

    size_m = None if size is None else parse_length_mm(size, "--size") / 1000
    if source.suffix.lower() not in (".csv", ".tsv"):
        if sigma is not None:
            raise InputError("not_together", f"--sigma is for forms, and {source} is a map", "leave --sigma out")
        return read_map_file(source, family, size)
    spread = None if sigma is None else parse_sigma(sigma, "--sigma", "give a length and an angle, such as 10mm,1deg")
    defaults = FormDefaults(family or "lm8", size_m or 0.18, spread)
    return read_measured_map(source, () if ground is None else ground.walls, defaults)
