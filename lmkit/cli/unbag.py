"""`lmkit unbag`: a recording from a ROS bag, as files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lmkit.cli import options
from lmkit.cli.output import print_line, progress
from lmkit.errors import InputError


def run(
    bag: Annotated[Path, typer.Argument(help="ROS 1 bag, ROS 2 bag or MCAP file.")],
    output: options.OutputFolder,
    left: Annotated[str | None, typer.Option("--left", help="Topic of the left images.")] = None,
    right: Annotated[str | None, typer.Option("--right", help="Topic of the right images.")] = None,
    left_info: Annotated[str | None, typer.Option("--left-info", help="Topic of the left camera_info.")] = None,
    right_info: Annotated[str | None, typer.Option("--right-info", help="Topic of the right camera_info.")] = None,
    odometry: Annotated[str | None, typer.Option("--odometry", help="Topic of the odometry.")] = None,
    imu: Annotated[str | None, typer.Option("--imu", help="Topic of the gyro.")] = None,
    force: options.Force = False,
) -> None:
    """Extract stereo images, rig, odometry and gyro from a ROS bag."""
    from lmkit.io.bags import unpack_bag
    from lmkit.io.files import write_file

    if not bag.exists():
        raise InputError("file_missing", f"{bag} does not exist", "check the path")
    if output.is_dir() and any(output.iterdir()) and not force:
        raise InputError("file_exists", f"folder {output} is not empty", "add --force, or choose another with -o")
    wanted = {
        "left": left, "right": right, "left_info": left_info, "right_info": right_info,
        "odometry": odometry, "imu": imu,
    }  # fmt: skip
    names = []
    for file in progress(unpack_bag(bag, wanted), None, "unpacking"):
        write_file(output / file.name, file.content, force)
        names.append(file.name)
    pairs = sum(name.startswith("left/") for name in names)
    others = ", ".join(name for name in names if not name.startswith(("left/", "right/")))
    print_line(f"{pairs} pairs{', ' + others if others else ''} -> {output}")
