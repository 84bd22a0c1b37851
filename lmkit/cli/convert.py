"""`lmkit convert`: rig files of other programs, read and written."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lmkit.cli.common import print_line, warn
from lmkit.errors import InputError


def run(
    rig: Annotated[
        Path, typer.Argument(help="Rig file of lmkit, OpenCV or Kalibr, or a folder with ROS's two files.")
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="File to write; a folder for ros.")],
    to: Annotated[str, typer.Option("--to", help="lmkit, opencv, ros or kalibr.")],
    force: Annotated[bool, typer.Option("--force", help="Overwrite files.")] = False,
) -> None:
    """Convert a stereo calibration from and to OpenCV, ROS and Kalibr files."""
    from lmkit.formats.any_rig import KINDS, read_any_rig
    from lmkit.formats.files import check_writable, write_file
    from lmkit.formats.kalibr import rig_to_camchain
    from lmkit.formats.opencv_rig import rig_to_opencv_yaml
    from lmkit.formats.rig import rig_to_yaml
    from lmkit.formats.ros_camera_info import FILES, rig_to_camera_infos

    if to not in KINDS:
        raise InputError("bad_kind", f"--to {to} is unknown", f"choose {', '.join(KINDS)}")
    read = read_any_rig(rig)
    texts: dict[Path, str]
    if to == "ros":
        texts = dict(zip((output / name for name in FILES), rig_to_camera_infos(read), strict=True))
    elif to == "kalibr":
        text, lens, error_px = rig_to_camchain(read)
        if error_px > 0:
            warn(f"Kalibr's lenses have four coefficients: the nearest, {lens}, differs by up to {error_px:.3f} px")
        texts = {output: text}
    else:
        texts = {output: rig_to_opencv_yaml(read) if to == "opencv" else rig_to_yaml(read)}
    if read.T_base_left is not None and to != "lmkit":
        warn(f"{to} files have no place for T_base_left; it is left out")
    for path in texts:
        check_writable(path, force)
    for path, text in texts.items():
        write_file(path, text, force)
        print_line(f"wrote {path}")
