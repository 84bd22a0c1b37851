"""Floor and rig as the commands of `lmkit plan` read them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from lmkit.errors import InputError

if TYPE_CHECKING:
    from lmkit.geometry.rig import AnyRig


def read_mounted_rig(path: Path, camera_height: str | None) -> AnyRig:
    """Read a rig that has its pose on the robot.

    Raises:
        InputError: neither the file nor the option says how high the camera is.
    """
    from lmkit.cli.parsing import parse_meters
    from lmkit.geometry.stereo_rig import mounted_ahead
    from lmkit.io.any_rig import read_any_rig

    height_m = None if camera_height is None else parse_meters(camera_height, "--camera-height")
    rig = read_any_rig(path)
    if height_m is not None:
        return replace(rig, T_base_left=mounted_ahead(height_m))
    if rig.T_base_left is None:
        raise InputError("no_base", f"{path} has no T_base_left", "add it, or give --camera-height 0.85m")
    return rig
