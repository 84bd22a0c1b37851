"""Tables of a recording as CSV with a header: odometry, gyro, and detected landmarks (docs/formats.md)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.errors import InputError, InputWarning, warn_caller
from lmkit.io.field_problems import plain_problem
from lmkit.io.tables import read_rows, to_number, to_seconds
from lmkit.model.corner_order import require_clockwise
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.observation import Detection
from lmkit.model.recording import Gyro, Odometry, RigFrame

# Other names of columns.
ALIASES = {
    "t": "time_s", "time": "time_s", "timestamp": "time_s", "%time": "time_s", "#timestamp [ns]": "time_s",
    "__time": "time_s",
    "v": "forward_mps", "w": "turn_radps", "wz": "rate_radps", "gyro_z": "rate_radps",
    "d_left_m": "left_m", "d_right_m": "right_m", "x": "x_m", "y": "y_m",
    "yaw": "heading_rad", "theta": "heading_rad", "side": "camera", "tag_id": "code",
}  # fmt: skip
# Suffixes of the names of message fields in rostopic and PlotJuggler.
_IN_MESSAGES = {
    "twist.linear.x": "forward_mps",
    "twist.angular.z": "turn_radps",
    "angular_velocity.z": "rate_radps",
}
_UNITS = frozenset({"s", "sec", "m", "rad", "m/s", "rad/s"})
SIDEWAYS = 0.5  # of the way forward, over a second
LEAST_WAY_M = 0.5
PAIR = ("left", "right")  # cameras of a stereo rig
CORNERS = ("x0", "y0", "x1", "y1", "x2", "y2", "x3", "y3")
CORNER_SIGMA_PX = 0.3  # of corners without a standard deviation: typical of marker detectors
DETECTION_COLUMNS = ("time_s", "camera", "code", *CORNERS)
_NUMBERS = frozenset({
    "time_s", "x_m", "y_m", "heading_rad", "left_m", "right_m", "forward_mps", "turn_radps", "rate_radps",
})  # fmt: skip
_KINDS = (("x_m", "y_m", "heading_rad"), ("left_m", "right_m"), ("forward_mps", "turn_radps"))


def read_odometry(path: Path, track_m: float | None = None) -> Odometry:
    """Odometry of a file with time_s and poses (x_m, y_m, heading_rad), wheels (left_m, right_m) or velocities.

    Args:
        track_m: distance between the wheels, needed for columns left_m and right_m.

    Raises:
        InputError: not readable, no such columns, no numbers, or times that do not increase.
    """
    columns = _read_numbers(path, "odometry file")
    kind = next((kind for kind in _KINDS if all(name in columns for name in kind)), None)
    if kind is None:
        hint = "give time_s with x_m,y_m,heading_rad, with forward_mps,turn_radps, or with left_m,right_m"
        if "rate_radps" in columns:
            hint = "it looks like a gyro's file: give it as the gyro (--gyro), beside wheel odometry"
        raise InputError("bad_header", f"{path}: no columns of odometry in {', '.join(columns)}", hint)
    times, values = columns["time_s"], [columns[name] for name in kind]
    if kind == _KINDS[0]:
        _warn_of_sideways_motion(path, times, *values)
        return Odometry.from_poses(times, *values)
    if kind == _KINDS[1]:
        if track_m is None:
            raise InputError(
                "no_track",
                f"{path} contains wheel distances",
                'give the distance between the wheels, such as wheel_track="0.4m" (--wheel-track 0.4m)',
            )
        return Odometry.from_wheels(times, values[0], values[1], track_m)
    return Odometry.from_velocities(times, *values)


def _warn_of_sideways_motion(
    path: Path, times: FloatArray, x: FloatArray, y: FloatArray, heading: FloatArray
) -> None:
    """Warn of positions and headings that contradict each other; the way sideways is not used."""
    later = np.searchsorted(times, times + 1.0)
    rows = np.column_stack([np.arange(len(times)), later])[later < len(times)]
    dx, dy = (np.diff(column[rows], axis=1)[:, 0] for column in (x, y))
    middle = np.unwrap(heading)[rows].mean(axis=1)
    forward, sideways = dx * np.cos(middle) + dy * np.sin(middle), dy * np.cos(middle) - dx * np.sin(middle)
    count = max(float(np.mean(later - np.arange(len(times)))), 1.0)  # rows of a second, which overlap
    forward_m, sideways_m = (float(np.linalg.norm(part)) / count**0.5 for part in (forward, sideways))
    if max(forward_m, sideways_m) > LEAST_WAY_M and sideways_m > SIDEWAYS * forward_m:
        sentence = (
            f"{path}: the positions move {sideways_m / max(forward_m, 1e-9):.2g} times as far sideways as along the "
            "heading, and only the way along it is used: are x and y swapped, or is the heading of another frame? "
            "Odometry of a robot that drives sideways can be given as a TUM file"
        )
        warn_caller(InputWarning(sentence))


def read_gyro(path: Path) -> Gyro:
    """Yaw rates from a file with time_s and rate_radps (wz).

    Raises:
        InputError: as for odometry.
    """
    columns = _read_numbers(path, "gyro file")
    if "rate_radps" not in columns:
        raise InputError("bad_header", f"{path}: no column rate_radps or wz", "give time_s,rate_radps")
    return Gyro(columns["time_s"], columns["rate_radps"])


def read_detections(path: Path, families: Sequence[str], cameras: Sequence[str] = PAIR) -> list[RigFrame]:
    """Detections of all cameras: time_s, camera (its name in the rig), code, x0 y0 ... x3 y3 (px); family, sigma_px.

    Args:
        families: possible families; without a family column there must be one (with ``tag_id`` it is tag36h11).
        cameras: names of the rig's cameras; for a single camera the column may be missing.

    Raises:
        InputError: not readable, or a row is not a detection; names the line; no family column and several families.
    """
    rows = read_rows(path, "detections file")
    header = _header(rows)
    if len(cameras) == 1 and "camera" not in header:
        header = [*header, "camera"]
        rows = [rows[0], *([*row, cameras[0]] if row else row for row in rows[1:])]
    if not set(DETECTION_COLUMNS) <= set(header):
        raise InputError(
            "bad_header", f"{path}: line 1 is {','.join(header)}", f"write the columns {','.join(DETECTION_COLUMNS)}"
        )
    known = ("tag36h11",) if "tag_id" in [cell.strip() for cell in rows[0]] else tuple(families)
    frames: dict[float, dict[str, list[Detection]]] = {}
    lines: dict[tuple[str, ...], int] = {}
    for number, row in enumerate(rows[1:], start=2):
        if not row:
            continue
        try:
            if len(row) != len(header):
                raise ValueError(f"{len(row)} values for {len(header)} columns")
            if lines.setdefault(tuple(row), number) != number:
                raise ValueError(f"it repeats line {lines[tuple(row)]}")
            cells = dict(zip(header, row, strict=True))
            side, code = cells["camera"].strip(), cells["code"].strip()
            if side not in cameras:
                raise ValueError(f"camera {side!r} is not in the rig: {', '.join(cameras)}")
            corners = np.array([to_number(cells[name]) for name in CORNERS]).reshape(4, 2)
            id_ = LandmarkId.parse(f"{cells['family'].strip()}:{code}" if "family" in cells else code, known)
            sigma_px = to_number(cells["sigma_px"]) if "sigma_px" in cells else CORNER_SIGMA_PX
            if sigma_px <= 0:
                raise ValueError("sigma_px is not positive")
            C = sigma_px**2 * np.eye(8)
            observation = Detection(id_, corners, 1.0, 0.0, C)
            time = to_seconds(cells["time_s"])
        except InputError as error:
            raise InputError(error.code, f"{path}: line {number}: {error.message}", error.hint) from None
        except ValueError as error:
            raise InputError(
                "bad_detection",
                f"{path}: line {number} is not a detection ({plain_problem(error)})",
                "see docs/formats.md",
            ) from None
        frames.setdefault(time, {name: [] for name in cameras})[side].append(observation)
    if not frames:
        raise InputError("no_detections", f"{path}: contains no detections", "write one detection a line")
    require_clockwise((o for seen in frames.values() for some in seen.values() for o in some), str(path))
    return [
        RigFrame(time, tuple(tuple(seen[name]) for name in cameras), f"{time:.6f}")
        for time, seen in sorted(frames.items())
    ]


def detections_to_csv(frames: Sequence[RigFrame], cameras: Sequence[str] = PAIR) -> str:
    """The text of a detections file; frames without detections are omitted.

    Args:
        cameras: names of the rig's cameras.
    """
    lines = [",".join(("time_s", "camera", "family", "code", *CORNERS, "sigma_px"))]
    for frame in frames:
        for side, seen in zip(cameras, frame.seen, strict=True):
            for o in seen:
                numbers = ",".join(f"{v:.4f}" for v in o.corners.ravel())
                C = o.covariance
                sigma_px = CORNER_SIGMA_PX if C is None else math.sqrt(float(np.trace(C)) / 8)
                lines.append(f"{frame.time_s:.6f},{side},{o.family},{o.code},{numbers},{sigma_px:.4f}")
    return "\n".join(lines) + "\n"


def odometry_to_csv(odometry: Odometry) -> str:
    """Velocities of wheel odometry for :func:`read_odometry`; each is valid until the next row."""
    times = odometry.times_s
    seconds = np.diff(times, append=2 * times[-1] - times[-2])
    # The distance of a row was traveled before it, at the velocity of the previous row.
    forward, turn = (np.append(values[1:], 0.0) / seconds for values in (odometry.forward_m, odometry.turn_rad))
    rows = zip(times, forward, turn, strict=True)
    return "time_s,forward_mps,turn_radps\n" + "".join(f"{t:.6f},{v:.6f},{w:.6f}\n" for t, v, w in rows)


def gyro_to_csv(gyro: Gyro) -> str:
    """Yaw rates, for :func:`read_gyro`."""
    rows = zip(gyro.times_s, gyro.rate_radps, strict=True)
    return "time_s,rate_radps\n" + "".join(f"{t:.6f},{rate:.6f}\n" for t, rate in rows)


def _header(rows: Sequence[Sequence[str]]) -> list[str]:
    return [_column(cell.strip()) for cell in rows[0]] if rows else []


def _column(name: str) -> str:
    """lmkit's name of a column; a unit in brackets must be lmkit's."""
    plain, _, unit = name.replace("(", "[").replace(")", "]").partition("[")
    plain = plain.rstrip() if unit.removesuffix("]") in _UNITS else name
    dotted = "." + plain.replace("/", ".")
    in_message = next((ours for end, ours in _IN_MESSAGES.items() if dotted.endswith("." + end)), plain)
    return ALIASES.get(name.lower()) or ALIASES.get(plain.lower()) or in_message


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _read_numbers(path: Path, what: str) -> dict[str, FloatArray]:
    """The columns by name; time_s is among them, and increases."""
    rows = read_rows(path, what)
    header = _header(rows)
    if sum(_is_number(cell) for cell in header) > len(header) / 2:
        raise InputError(
            "bad_header", f"{path}: line 1 contains numbers", "write a header such as time_s,... above them"
        )
    if len(set(header)) < len(header):
        raise InputError("bad_header", f"{path}: line 1 has a column twice", "keep one of them")
    if "time_s" not in header:
        raise InputError("bad_header", f"{path}: line 1 has no column time_s", "write a header such as time_s,...")
    # Columns of text or other values (rostopic's header.frame_id) are ignored.
    wanted = [k for k, name in enumerate(header) if name in _NUMBERS]
    table = []
    for number, row in enumerate(rows[1:], start=2):
        if not row:
            continue
        try:
            if len(row) != len(header):
                raise ValueError(f"{len(row)} values, but {len(header)} columns")
            table.append([(to_seconds if header[k] == "time_s" else to_number)(row[k]) for k in wanted])
        except ValueError as error:
            raise InputError(
                "bad_row", f"{path}: line {number}: {plain_problem(error)}", f"see {what} in docs/formats.md"
            ) from None
    if len(table) < 2:
        raise InputError("too_short", f"{path}: fewer than two rows", "record for longer")
    columns = dict(zip([header[k] for k in wanted], np.array(table).T, strict=True))
    late = np.flatnonzero(np.diff(columns["time_s"]) <= 0)
    if len(late):
        raise InputError(
            "time_not_increasing",
            f"{path}: line {late[0] + 3}: time does not increase",
            "sort by time; where a clock was set back, cut the file in two",
        )
    return columns
