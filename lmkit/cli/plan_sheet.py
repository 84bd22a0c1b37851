"""`lmkit plan sheet`: printable sheets for mounting, one per room."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lmkit.cli import map_options, options
from lmkit.cli.map_options import read_map_file
from lmkit.cli.option_groups import PLAIN, DrawnFloorOptions
from lmkit.cli.output import check_outputs, print_line, write_outputs
from lmkit.errors import InputError


def run(
    landmark_map: options.MapFile,
    marker_family: map_options.MarkerFamily = None,
    marker_size: map_options.MarkerSize = None,
    floor: Annotated[
        Path | None,
        typer.Option(
            "--floor",
            help="Floor plan, as for lmkit plan place. Without it, the sheet gives the positions in the map.",
        ),
    ] = None,
    drawing: DrawnFloorOptions = PLAIN,
    room: Annotated[
        str | None, typer.Option("--room", help="Rectangular room, such as 6.00x4.00m, instead of a floor plan.")
    ] = None,
    output: Annotated[Path, typer.Option("--output", "-o", help="PDF file to write.")] = Path("mounting.pdf"),
    paper: Annotated[str, typer.Option("--paper", help="Paper: a4, letter, a3, a2, a1, a0 or tabloid.")] = "a4",
    force: options.Force = False,
) -> None:
    """Write mounting sheets: each room with distances from corners that a tape measure reaches."""
    from lmkit.cli.plan_inputs import read_room
    from lmkit.pipelines.prints import PAPERS
    from lmkit.reports.mounting_sheet import mounting_sheets

    if paper not in PAPERS:
        raise InputError("bad_paper", f"--paper {paper} is unknown", f"choose {', '.join(PAPERS)}")
    if output.suffix.lower() != ".pdf":
        raise InputError("bad_output", f"{output} is not a PDF file", "name it with .pdf")
    check_outputs([output], force)
    landmarks = read_map_file(landmark_map, marker_family, marker_size)
    ground = read_room(room, floor, drawing)
    write_outputs({output: mounting_sheets(landmarks, ground, landmark_map.name, paper)}, force)
    print_line(f"wrote {output}")
