"""Arguments and options that several commands share, declared once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

# Images and recordings.
Images = Annotated[
    list[str] | None,
    typer.Argument(
        help="Images of each camera of the rig: folder, glob or video (split:VIDEO of both side by side); or a "
        "recording folder."
    ),
]
DetectionsFile = Annotated[
    Path | None, typer.Option("--detections", help="CSV file of saved detections, instead of images.")
]
ReadingsFile = Annotated[
    Path | None, typer.Option("--readings", help="CSV file of range and bearing readings, instead of images.")
]
OdometryFile = Annotated[
    Path | None,
    typer.Option("--odometry", help="CSV file of wheel odometry, or TUM file (.tum, .txt) of visual odometry."),
]
GyroFile = Annotated[Path | None, typer.Option("--gyro", help="CSV file of the gyro's yaw rate.")]
WheelTrack = Annotated[str | None, typer.Option("--wheel-track", help="Distance between the wheels, such as 0.4m.")]
Hz = Annotated[float | None, typer.Option("--hz", help="Frames per second, if file names contain no times.")]

# Rigs, maps, floors, robots.
_RIG = typer.Option(
    "--rig",
    help="Rig file of lmkit, OpenCV, Kalibr or ROS (a folder with left.yaml and right.yaml).",
)
RigFile = Annotated[Path, _RIG]
OptionalRigFile = Annotated[Path | None, _RIG]
_MAP = typer.Option("--map", help="Landmark map file.")
MapFile = Annotated[Path, _MAP]
OptionalMapFile = Annotated[Path | None, _MAP]
MountedRigFile = Annotated[
    Path, typer.Option("--rig", help="Rig file with T_base_left. Without T_base_left, give --camera-height.")
]
CameraHeight = Annotated[
    str | None,
    typer.Option(
        "--camera-height", help="Height of a level, forward-looking camera; replaces the rig's T_base_left."
    ),
]
FloorFile = Annotated[
    Path,
    typer.Option("--floor", help="Floor plan: lmkit-floor/1 or ROS map YAML, DXF, or PNG, PGM or SVG with --scale."),
]
Scale = Annotated[
    float | None,
    typer.Option("--scale", help="Scale of the floor plan: meters per pixel, or per unit of SVG or DXF."),
]
Islands = Annotated[
    str,
    typer.Option(
        "--islands",
        help="Treat small closed shapes as obstacles, ignore or walls. By number: ignore:1-4,walls:5.",
    ),
]
ThinLines = Annotated[
    str | None,
    typer.Option(
        "--thin-lines",
        metavar="WIDTH",
        help="Ignore lines in images that are thinner than this, such as 6cm (door arcs, text).",
    ),
]
Curves = Annotated[
    bool,
    typer.Option(
        "--curves/--no-curves",
        help="Treat curves of SVG and DXF files as walls. --no-curves ignores them (door arcs).",
    ),
]
Layers = Annotated[
    str,
    typer.Option("--layers", help="Layers of a DXF file that are walls, such as 'A-WALL*,A-GLAZ' or 'not:A-FURN'."),
]
Radius = Annotated[str, typer.Option("--radius", help="Robot radius.")]

# Landmarks.
Family = Annotated[str, typer.Option("--family", help="Landmark families to look for, such as lm8,lm12.")]
OneFamily = Annotated[str, typer.Option("--family", help="Landmark family, such as lm8, tag36h11 or aruco4x4_50.")]
_SIZE = typer.Option("--size", help="Landmark size, outer edge to outer edge of the border, such as 180mm.")
Size = Annotated[str, _SIZE]
OptionalSize = Annotated[str | None, _SIZE]

# Required accuracy.
PositionError = Annotated[str, typer.Option("--error", help="Required position error (root mean square).")]
HeadingError = Annotated[float, typer.Option("--heading", help="Required heading error (root mean square), degrees.")]
InView = Annotated[int, typer.Option("--in-view", help="Number of landmarks that must be in view at once.")]
Headings = Annotated[
    float, typer.Option("--headings", help="Percentage of headings at a place that must meet the requirement.")
]

# Results.
TumOutput = Annotated[Path | None, typer.Option("--tum", help="TUM trajectory file to write (poses with status ok).")]
CsvOutput = Annotated[Path | None, typer.Option("--csv", help="CSV file to write: poses with standard deviations.")]
PlanOutput = Annotated[
    Path | None, typer.Option("--plan", help="Plan view of map and poses to write (.png or .svg).")
]
ReportOutput = Annotated[Path | None, typer.Option("--report", help="HTML report to write.")]
RerunOutput = Annotated[
    Path | None,
    typer.Option("--rerun", help="Recording for the Rerun viewer to write (.rrd). Needs the extra viewer."),
]
OutputFolder = Annotated[Path, typer.Option("--output", "-o", help="Folder to write.")]
Dpi = Annotated[float, typer.Option("--dpi", help="Resolution of PNG files, dots per inch.")]
Seed = Annotated[int, typer.Option("--seed", help="Random seed; each seed gives another room.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON to stdout, one object per line.")]
Force = Annotated[bool, typer.Option("--force", help="Overwrite existing files.")]


def _bound_processes(jobs: int | None) -> int | None:
    from lmkit.parallel import set_jobs

    set_jobs(jobs)
    return jobs


Jobs = Annotated[
    int | None,
    typer.Option(
        "--jobs",
        min=1,
        metavar="N",
        callback=_bound_processes,
        envvar="LMKIT_JOBS",
        help="Largest number of workers. Default: one per CPU core.",
    ),
]
MeasuredPattern = Annotated[
    str | None,
    typer.Option("--measured", help="Measured size of the printed pattern, outer edges, such as 249.1x174.4mm."),
]
Intrinsics = Annotated[
    list[Path] | None,
    typer.Option(
        "--intrinsics",
        help="Rig file with known intrinsics, which stay unchanged. Repeat it for a left and a right file.",
    ),
]
IntrinsicsSigma = Annotated[
    str | None,
    typer.Option(
        "--intrinsics-sigma",
        help="Standard deviation of --intrinsics, which are then fitted too: stated (in the file) or such as 2px.",
    ),
]
