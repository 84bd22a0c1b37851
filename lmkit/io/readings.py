"""Readings files: range and bearing as CSV with the header ``time_s,code,range_m,bearing_rad``; one may be empty."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from lmkit.errors import InputError
from lmkit.io.field_problems import plain_problem
from lmkit.io.tables import read_rows, to_number, to_seconds
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.observation import RangeBearing

COLUMNS = ("time_s", "code", "range_m", "bearing_rad")
FAMILY = "family"  # a fifth column, where landmarks are of several families
FARTHEST_M, LARGEST_RAD = 500.0, 6.4  # larger values are ranges in millimeters and bearings in degrees


def read_readings(path: Path, families: Sequence[str]) -> dict[float, list[RangeBearing]]:
    """Readings by time, in the order of the file.

    Args:
        families: possible families; without a column ``family`` there must be one.

    Raises:
        InputError: not readable, another header, or a row that is not a reading; names the line.
    """
    rows = read_rows(path, "readings file")
    header = tuple(cell.strip() for cell in rows[0]) if rows else ()
    if header not in (COLUMNS, (*COLUMNS, FAMILY)):
        raise InputError(
            "bad_header", f"{path}: line 1 is {','.join(header)!r}", f"write the header {','.join(COLUMNS)}"
        )
    frames: dict[float, list[RangeBearing]] = {}
    for number, row in enumerate(rows[1:], start=2):
        if not row:
            continue
        try:
            if len(row) != len(header):
                raise ValueError(f"{len(row)} values")
            time = to_seconds(row[0])
            distance, bearing = (to_number(cell) if cell else None for cell in row[2:4])
            if distance is None and bearing is None:
                raise ValueError("neither range nor bearing")
            if distance is not None and distance <= 0:
                raise ValueError("a range that is not positive")
            if distance is not None and distance > FARTHEST_M:
                raise ValueError(f"a range of {distance:g} m: millimeters?")
            if bearing is not None and abs(bearing) > LARGEST_RAD:
                raise ValueError(f"a bearing of {bearing:g} rad: degrees?")
        except ValueError as error:
            raise InputError(
                "bad_reading",
                f"{path}: line {number} is not a reading ({plain_problem(error)})",
                "write time_s,code,range_m,bearing_rad",
            ) from None
        code = row[1].strip()
        try:
            id_ = LandmarkId.parse(f"{row[4].strip()}:{code}" if len(row) > 4 else code, families)
        except InputError as error:
            raise InputError(error.code, f"{path}: line {number}: {error.message}", error.hint) from None
        frames.setdefault(time, []).append(RangeBearing(id_, distance, bearing, time))
    if not frames:
        raise InputError("no_readings", f"{path}: contains no readings", "write one reading a line")
    return frames
