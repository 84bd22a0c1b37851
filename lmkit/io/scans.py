"""Laser scans from files: CSV, and LaserScan messages in ROS bags and MCAP (docs/formats.md).

CSV has two forms: one row per scan (``time_s,angle_min_rad,angle_step_rad`` and then the ranges, in columns of
any name), or one row per beam (``time_s,angle_rad,range_m`` and, if known, ``intensity``).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import groupby, pairwise
from pathlib import Path

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.errors import InputError
from lmkit.io.bags import read_laser_messages
from lmkit.io.field_problems import plain_problem
from lmkit.io.tables import read_rows, to_number, to_seconds
from lmkit.model.scan import LaserScan

BEAMS = ("time_s", "angle_rad", "range_m")
SCANS = ("time_s", "angle_min_rad", "angle_step_rad")
FARTHEST_M = 500.0  # larger ranges are in millimeters
EVEN = 0.05  # largest deviation from even spacing of beams, as a share of a step
HINT = f"write {','.join(BEAMS)} a beam, or {','.join(SCANS)} and ranges a scan"


def read_scans(path: Path, topic: str | None = None) -> list[LaserScan]:
    """Scans in the order of time.

    Args:
        topic: of a bag with several scanners.

    Raises:
        InputError: not readable, not scans, or two scans of one time; names the line.
    """
    if path.is_dir() or path.suffix.lower() in (".bag", ".mcap", ".db3"):
        scans = read_laser_messages(path, topic)
    else:
        scans = _from_csv(path)
    if not scans:
        raise InputError("no_scans", f"{path}: contains no scans", HINT)
    scans.sort(key=lambda scan: scan.time_s)
    for before, after in pairwise(scans):
        if before.time_s == after.time_s:
            raise InputError(
                "same_time", f"{path}: two scans at {after.time_s:g} s", "give each scan a time of its own"
            )
    return scans


def _from_csv(path: Path) -> list[LaserScan]:
    rows = read_rows(path, "scan file")
    header = tuple(cell.strip() for cell in rows[0]) if rows else ()
    if header[:3] == SCANS:
        return list(_scan_rows(path, rows[1:]))
    if header in (BEAMS, (*BEAMS, "intensity")):
        return list(_beam_rows(path, rows[1:], len(header)))
    raise InputError("bad_header", f"{path}: line 1 is {','.join(header)[:80]!r}", HINT)


def _scan_rows(path: Path, rows: Sequence[Sequence[str]]) -> Iterator[LaserScan]:
    for number, row in enumerate(rows, start=2):
        if not row:
            continue
        try:
            time_s, start, step = to_seconds(row[0]), to_number(row[1]), to_number(row[2])
            ranges = np.array([_to_range(cell) for cell in row[3:]])
            if len(ranges) < 3:
                raise ValueError(f"{len(ranges)} ranges")
            _require_angles(start, step)
        except (ValueError, IndexError) as error:
            raise InputError(
                "bad_scan", f"{path}: line {number} is not a scan ({plain_problem(error)})", HINT
            ) from None
        yield LaserScan(time_s, start, step, ranges)


def _beam_rows(path: Path, rows: Sequence[Sequence[str]], columns: int) -> Iterator[LaserScan]:
    beams = []
    for number, row in enumerate(rows, start=2):
        if not row:
            continue
        try:
            if len(row) != columns:
                raise ValueError(f"{len(row)} values")
            angle = to_number(row[1])
            beams.append(
                (to_seconds(row[0]), number, angle, _to_range(row[2]), to_number(row[3]) if columns > 3 else 0.0)
            )
        except ValueError as error:
            raise InputError(
                "bad_scan", f"{path}: line {number} is not a beam ({plain_problem(error)})", HINT
            ) from None
    for time_s, group in groupby(beams, key=lambda beam: beam[0]):
        table = np.array([beam[1:] for beam in group])
        try:
            start, step = _even(table[:, 1])
            _require_angles(start, step)
        except ValueError as error:
            line = int(table[0, 0])
            raise InputError("bad_scan", f"{path}: line {line}: not a scan ({plain_problem(error)})", HINT) from None
        yield LaserScan(time_s, start, step, table[:, 2], table[:, 3] if columns > 3 else None)


def _even(angles: FloatArray) -> tuple[float, float]:
    """First angle and step of evenly spaced ones."""
    if len(angles) < 3:
        raise ValueError(f"{len(angles)} beams at one time")
    step = float(angles[-1] - angles[0]) / (len(angles) - 1)
    off = np.abs(angles - angles[0] - step * np.arange(len(angles)))
    if off.max() > EVEN * abs(step):
        raise ValueError("the beams are not evenly spaced")
    return float(angles[0]), step


def _require_angles(start: float, step: float) -> None:
    if not abs(start) <= 2 * math.pi:
        raise ValueError(f"a first angle of {start:g} rad: degrees?")
    if not 1e-4 < abs(step) < 0.2:
        raise ValueError(f"a step of {step:g} rad: degrees?")


def _to_range(cell: str) -> float:
    """A range; NaN for an empty cell, inf, nan, and 0, which scanners write without an echo."""
    text = cell.strip().lower()
    if text in ("", "inf", "+inf", "-inf", "nan"):
        return math.nan
    value = to_number(text)
    if value < 0 or value > FARTHEST_M:
        raise ValueError(f"a range of {value:g} m{': millimeters?' if value > 0 else ''}")
    return value if value > 0 else math.nan


def scans_to_csv(scans: Sequence[LaserScan]) -> str:
    """The text of a scan file, a row for each scan; intensities are omitted."""
    lines = [",".join(SCANS)]
    for scan in scans:
        ranges = ("" if math.isnan(r) else f"{r:.4f}" for r in scan.ranges_m.tolist())
        lines.append(f"{scan.time_s:.6f},{scan.start_rad:.9f},{scan.step_rad:.9f},{','.join(ranges)}")
    return "\n".join(lines) + "\n"
