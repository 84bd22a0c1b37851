"""Options that several commands share, declared once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Floor = Annotated[
    Path, typer.Option("--floor", help="Floor plan: lmkit-floor/1 or ROS map YAML, or PNG, PGM, SVG with --scale.")
]


Scale = Annotated[float | None, typer.Option("--scale", help="Metres a pixel, or an SVG unit.")]


Rig = Annotated[Path, typer.Option("--rig", help="Rig file; with T_base_left, or give --camera-height.")]


CameraHeight = Annotated[
    str | None, typer.Option("--camera-height", help="Of a camera that looks ahead over the robot's middle.")
]


Radius = Annotated[str, typer.Option("--radius", help="Of the robot.")]


ErrorOption = Annotated[str, typer.Option("--error", help="Position error asked for, root mean square.")]


Heading = Annotated[float, typer.Option("--heading", help="Heading error asked for, deg.")]


InView = Annotated[int, typer.Option("--in-view", help="Landmarks that must be in view at once.")]


Headings = Annotated[
    float, typer.Option("--headings", help="Percent of the directions in which this must hold for a place to count.")
]


Force = Annotated[bool, typer.Option("--force", help="Overwrite files.")]
