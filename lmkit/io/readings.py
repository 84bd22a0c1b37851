"""Readings files: CSV with the columns ``time_s,code,range_m,bearing_rad``; a range or a bearing may be empty."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from lmkit.errors import InputError
from lmkit.io.field_problems import plain_problem
from lmkit.io.tables import read_rows, to_number, to_seconds
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.observation import RangeBearing

COLUMNS = ("time_s", "code", "range_m", "bearing_rad")
FAMILY = "family"  # a further column, where landmarks are of several families
ALIASES = {
    "t": "time_s", "time": "time_s", "timestamp": "time_s",
    "id": "code", "tag_id": "code", "range": "range_m", "bearing": "bearing_rad",
}  # fmt: skip
FARTHEST_M, LARGEST_RAD = 500.0, 6.4  # larger values are ranges in millimeters and bearings in degrees


def read_readings(path: Path, families: Sequence[str]) -> dict[float, list[RangeBearing]]:
    """Readings by time, in the order of the file.

    Args:
        families: possible families; without a column ``family`` there must be one.

    Raises:
        InputError: not readable, another header, or a row that is not a reading; names the line.
    """
    rows = read_rows(path, "readings file")
    header = tuple(ALIASES.get(cell.lower(), cell) for cell in rows[0]) if rows else ()
    if sorted(set(header) - {FAMILY}) != sorted(COLUMNS) or len(set(header)) < len(header):
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
            cells = dict(zip(header, row, strict=True))
            time = to_seconds(cells["time_s"])
            distance, bearing = (to_number(cells[name]) if cells[name] else None for name in COLUMNS[2:])
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
        code = cells["code"]
        try:
            id_ = LandmarkId.parse(f"{cells[FAMILY]}:{code}" if FAMILY in cells else code, families)
        except InputError as error:
            raise InputError(error.code, f"{path}: line {number}: {error.message}", error.hint) from None
        frames.setdefault(time, []).append(RangeBearing(id_, distance, bearing, time))
    if not frames:
        raise InputError("no_readings", f"{path}: contains no readings", "write one reading a line")
    return frames
