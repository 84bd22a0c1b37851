"""Trajectory files: TUM lines ``time x y z qx qy qz qw``, as evo and most SLAM tools read them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from lmkit.errors import InputError
from lmkit.geometry.pose import Pose
from lmkit.io.documents import read_text
from lmkit.model.trajectory import Trajectory

UNIT = 1e-2
_HINT = "write lines of time x y z qx qy qz qw, separated by spaces; # starts a comment"


def tum_line(time_s: float, pose: Pose) -> str:
    """One line of a TUM file."""
    numbers = [*pose.t, *pose.quaternion_xyzw]
    return f"{time_s:.6f} " + " ".join(f"{v:.9f}" for v in numbers)


def poses_to_tum(poses: Iterable[tuple[float, Pose]]) -> str:
    """The text of a TUM file."""
    return "".join(tum_line(time_s, pose) + "\n" for time_s, pose in poses)


def read_trajectory(path: Path) -> Trajectory:
    """The poses of a TUM file.

    Raises:
        InputError: not readable, or a line is no pose; names the line.
    """
    rows: list[list[float]] = []
    for number, line in enumerate(read_text(path, "trajectory").splitlines(), start=1):
        words = line.split("#", 1)[0].replace(",", " ").split()
        if not words:
            continue
        try:
            row = [float(word) for word in words]
        except ValueError:
            raise InputError("bad_trajectory", f"{path}: line {number} holds what is no number", _HINT) from None
        if len(row) != 8 or not all(map(math.isfinite, row)):
            raise InputError("bad_trajectory", f"{path}: line {number} is no pose of eight finite numbers", _HINT)
        if abs(math.hypot(*row[4:]) - 1) > UNIT:
            raise InputError("bad_trajectory", f"{path}: line {number}: the quaternion is not of length 1", _HINT)
        if rows and row[0] <= rows[-1][0]:
            raise InputError("bad_trajectory", f"{path}: line {number}: time does not increase", "sort it by time")
        rows.append(row)
    if not rows:
        raise InputError("bad_trajectory", f"{path}: holds no poses", _HINT)
    return _trajectory(rows)


def _trajectory(rows: Sequence[Sequence[float]]) -> Trajectory:
    table = np.array(rows)
    return Trajectory(table[:, 0], table[:, 1:4], table[:, 4:] / np.linalg.norm(table[:, 4:], axis=1, keepdims=True))
