"""Two cameras with known intrinsics, from one rig file or from one file a camera."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from lmkit.errors import InputError
from lmkit.geometry.rig import MountedCamera, mounted_cameras
from lmkit.io.any_rig import read_any_rig


def read_two_cameras(paths: Sequence[Path]) -> tuple[MountedCamera, MountedCamera]:
    """The left and the right camera; their relative pose in the files is not used.

    Raises:
        InputError: a file cannot be read, or together they do not contain two cameras of one lens model.
    """
    cameras = [camera for path in paths for camera in mounted_cameras(read_any_rig(path))]
    names = ", ".join(str(path) for path in paths)
    if len(cameras) != 2:
        raise InputError(
            "not_two_cameras",
            f"{names}: {len(cameras)} camera(s), two are needed",
            "give the file of a stereo rig, or --intrinsics LEFT --intrinsics RIGHT",
        )
    left, right = cameras
    if left.model.model != right.model.model:
        raise InputError(
            "unlike_models",
            f"{names}: the left lens is {left.model.model}, the right one {right.model.model}",
            "calibrate both cameras with the same --model",
        )
    return left, right
