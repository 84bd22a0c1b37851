"""Trajectory files: TUM lines ``time x y z qx qy qz qw``, as evo and most SLAM tools read them."""

from __future__ import annotations

import io
import math
import re
import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.errors import InputError
from lmkit.geometry.pose import Pose
from lmkit.geometry.rotations import orthonormal
from lmkit.io.documents import read_text
from lmkit.io.field_problems import plain_problem
from lmkit.io.tables import LARGEST, to_number, to_seconds
from lmkit.model.trajectory import Trajectory
from lmkit.units import NANOSECONDS_FROM

UNIT = 1e-2
KITTI_COUNT = 12  # numbers a row: R and t, without a time
_TUM = (0, 1, 2, 3, 4, 5, 6, 7)
LONGEST_HEADER = 10_000  # characters
# Names of columns: x, tx, p_RS_R_x, pose.position.x; qw, q_RS_w, pose.orientation.w.
_POSITION = re.compile(
    r"(?:(?:p|t|pos|position|trans|translation)(?:_[a-z]{1,9}){0,3}_?)?([xyz])(?:_m)?"
    r"|.*[./](?:pos|position|translation)[./]([xyz])"
)
_QUATERNION = re.compile(
    r"(?:q|o|quat|quaternion|rot|orientation)(?:_[a-z]{1,9}){0,3}_?([wxyz])"
    r"|.*[./](?:quaternion|orientation|rotation)[./]([wxyz])"
)
_HINT = "write lines of time x y z qx qy qz qw, separated by spaces; # starts a comment"


def tum_line(time_s: float, pose: Pose) -> str:
    """One line of a TUM file."""
    numbers = [*pose.t, *pose.quaternion_xyzw]
    return f"{time_s:.6f} " + " ".join(f"{v:.9f}" for v in numbers)


def poses_to_tum(poses: Iterable[tuple[float, Pose]]) -> str:
    """The text of a TUM file."""
    return "".join(tum_line(time_s, pose) + "\n" for time_s, pose in poses)


def read_trajectory(path: Path) -> Trajectory:
    """The poses of a TUM file, or of a table whose header names its columns (EuRoC's CSV); seconds or nanoseconds.

    Raises:
        InputError: not readable, or a line is not a pose; names the line.
    """
    text = _with_decimal_points(read_text(path, "trajectory"))
    table = _plain_table(text)
    return _trajectory(_checked_rows(path, text) if table is None else table)


def _with_decimal_points(text: str) -> str:
    """A table separated by semicolons, with decimal commas, as one separated by spaces."""
    first = re.search(r"^[^#\n]*\d[^#\n]*$", text, re.MULTILINE)
    return text.replace(",", ".").replace(";", " ") if first is not None and ";" in first[0] else text


def _plain_table(text: str) -> FloatArray | None:
    """(N,8) rows of a TUM file at once; None for another kind of file, or if a row is wrong."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of an empty file
            table = np.loadtxt(io.StringIO(text.replace(",", " ")), comments="#", ndmin=2)
    except ValueError:
        return None
    head = re.match(r"(?:[^\S\n]*(?:#.*)?\n)*", text)  # a title may precede the names of the columns
    if any(_named_order(line) not in (None, _TUM) for line in (head[0].splitlines() if head else ())):
        return None
    if table.shape[1] != len(_TUM) or len(table) < 2:
        return None
    times, poses = table[:, 0], table[:, 1:]
    if np.abs(times).max() >= NANOSECONDS_FROM or not np.abs(poses).max() <= LARGEST:
        return None
    units = np.abs(np.linalg.norm(poses[:, 3:], axis=1) - 1) <= UNIT
    return table if units.all() and (np.diff(times) > 0).all() else None


def _checked_rows(path: Path, text: str) -> list[list[float]]:
    """Rows of a trajectory, line by line.

    Raises:
        InputError: names the line.
    """
    rows: list[list[float]] = []
    order: tuple[int, ...] = _TUM
    has_more = False
    for number, line in enumerate(text.splitlines(), start=1):
        if not rows and (named := _named_order(line)) is not None:
            order, has_more = named, True
            continue
        words = _words(line.split("#", 1)[0])
        words = words if has_more else [word for cell in words for word in cell.split()]
        if not rows and order is _TUM and len(words) == KITTI_COUNT:
            hint = "give times as TUM lines; lmkit evaluate compares two such files row by row"
            raise InputError("no_times", f"{path}: KITTI poses, which have no times", hint)
        if not any(words) or (not rows and words[0].lower().startswith("time")):
            continue
        if len(words) <= max(order) or (len(words) > 8 and not has_more):
            expected = max(order) + 1 if has_more else 8
            raise InputError(
                "bad_trajectory", f"{path}: line {number} holds {len(words)} numbers, not {expected}", _HINT
            )
        words = [words[k] for k in order]
        if has_more and not any(words[1:]):
            continue  # a time without a pose
        try:
            row = [to_seconds(words[0]), *(to_number(word) for word in words[1:])]
        except ValueError as error:
            raise InputError("bad_trajectory", f"{path}: line {number}: {plain_problem(error)}", _HINT) from None
        if abs(math.hypot(*row[4:]) - 1) > UNIT:
            raise InputError("bad_trajectory", f"{path}: line {number}: the quaternion is not of length 1", _HINT)
        if rows and row[0] == rows[-1][0]:
            raise InputError(
                "bad_trajectory", f"{path}: line {number} has the time of the line before it", "remove one of the two"
            )
        if rows and row[0] < rows[-1][0]:
            raise InputError("bad_trajectory", f"{path}: line {number}: time does not increase", "sort it by time")
        rows.append(row)
    if not rows:
        raise InputError("bad_trajectory", f"{path}: contains no poses", _HINT)
    return rows


def read_two_trajectories(truth: Path, estimate: Path) -> tuple[Trajectory, Trajectory]:
    """Two trajectories to compare: with times, or both as KITTI poses, which are compared row by row.

    Raises:
        InputError: as for :func:`read_trajectory`; KITTI poses of different number, or beside a file with times.
    """
    tables = [_kitti_rows(path) for path in (truth, estimate)]
    if tables[0] is None or tables[1] is None:
        return read_trajectory(truth), read_trajectory(estimate)
    if len(tables[0]) != len(tables[1]):
        raise InputError(
            "unlike_trajectories",
            f"{truth} holds {len(tables[0])} KITTI poses, {estimate} {len(tables[1])}",
            "give files with the same number of rows: KITTI poses have no times",
        )
    return _of_kitti(truth, tables[0]), _of_kitti(estimate, tables[1])


def _kitti_rows(path: Path) -> list[str] | None:
    """Lines of a file of KITTI poses, or None."""
    text = read_text(path, "trajectory")
    first = re.search(r"^[^\S\n]*[^#\s].*$", text, re.MULTILINE)
    if first is None or len(first[0].split("#", 1)[0].split()) != KITTI_COUNT:
        return None
    return [line for line in text.splitlines() if line.split("#", 1)[0].strip()]


def _of_kitti(path: Path, lines: Sequence[str]) -> Trajectory:
    """Trajectory with row numbers as times."""
    at_once = _plain_kitti(lines)
    if at_once is not None:
        return at_once
    rows = []
    for number, line in enumerate(lines):
        try:
            T = np.array([to_number(word) for word in line.split("#", 1)[0].split()]).reshape(3, 4)
            if np.abs(T[:, :3] @ T[:, :3].T - np.eye(3)).max() > UNIT or np.linalg.det(T[:, :3]) < 0:
                raise ValueError("its rotation matrix is not a rotation")
        except ValueError as error:
            raise InputError(
                "bad_trajectory",
                f"{path}: pose {number + 1}: {plain_problem(error)}",
                "write rows r11 r12 r13 tx r21 ... tz",
            ) from None
        pose = Pose("map", "base", orthonormal(T[:, :3]), T[:, 3])
        rows.append([float(number), *pose.t, *pose.quaternion_xyzw])
    return _trajectory(rows)


def _plain_kitti(lines: Sequence[str]) -> Trajectory | None:
    """All poses at once; None if a row is wrong."""
    try:
        T = np.loadtxt(lines, comments="#", ndmin=2).reshape(-1, 3, 4)
    except ValueError:
        return None
    if not np.abs(T).max() <= LARGEST or len(T) != len(lines):
        return None
    R = T[:, :, :3]
    if np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max() > UNIT or np.linalg.det(R).min() < 0:
        return None
    from scipy.spatial.transform import Rotation  # takes a quarter of a second to load

    U, _, Vt = np.linalg.svd(R)
    return Trajectory(np.arange(len(T), dtype=np.float64), T[:, :, 3], Rotation.from_matrix(U @ Vt).as_quat())


def _named_order(line: str) -> tuple[int, ...] | None:
    """Columns of time x y z qx qy qz qw, by the names of a header; None if it does not name all of them.

    Other columns, such as covariances, are not read.

    Examples:
        >>> _named_order("#timestamp [ns],qw,qx,qy,qz,p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m]")
        (0, 5, 6, 7, 2, 3, 4, 1)
    """
    if len(line) > LONGEST_HEADER:
        return None
    plain = re.sub(r"\[[^\]]*\]|\([^)]*\)", "", line).strip("#% ").lower()
    columns: dict[str, int] = {}
    for number, word in enumerate(_words(plain)):
        name = word.strip("#% ")
        if name in ("t", "sec", "seconds") or "time" in name or "stamp" in name:
            columns.setdefault("t", number)
        for kind, pattern in (("p", _POSITION), ("q", _QUATERNION)):
            if found := pattern.fullmatch(name):
                columns.setdefault(kind + (found[1] or found[2]), number)
    order = [columns.get(name) for name in ("t", "px", "py", "pz", "qx", "qy", "qz", "qw")]
    return None if None in order else tuple(number for number in order if number is not None)


def _words(line: str) -> list[str]:
    """Cells of a row separated by commas or by spaces, without quotation marks."""
    words = line.split(",") if "," in line else line.split()
    return [word.strip(" \t\"'") for word in words]


def _trajectory(rows: Sequence[Sequence[float]] | FloatArray) -> Trajectory:
    table = np.asarray(rows)
    return Trajectory(table[:, 0], table[:, 1:4], table[:, 4:] / np.linalg.norm(table[:, 4:], axis=1, keepdims=True))
