"""The only reader of CSV tables: rows of common dialects, and finite numbers.

Separators are commas, semicolons (with decimal commas, as spreadsheets write them in half of Europe) or tabs.
"""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path

from lmkit.errors import InputError
from lmkit.io.documents import read_text, with_article
from lmkit.units import NANOSECONDS_FROM

LARGEST = 1e9  # of a length in m, an angle in rad or a pixel; larger values are not measurements
LARGEST_TIME = 1e19


def read_rows(path: Path, what: str) -> list[list[str]]:
    """Rows of cells without the space around them, and without one empty cell behind the last column.

    Raises:
        InputError: not readable, empty, or not a table.
    """
    text = read_text(path, what)
    if not text.strip():
        raise InputError("empty_file", f"{path}: the file is empty", f"give {with_article(what)}, with its header")
    first = text.partition("\n")[0]
    separator = next((sign for sign in (";", "\t") if sign in first and "," not in first), ",")
    try:
        rows = [[cell.strip() for cell in row] for row in csv.reader(io.StringIO(text), delimiter=separator)]
    except csv.Error as error:
        raise InputError("bad_table", f"{path}: not a table ({error})", f"give {with_article(what)} as CSV") from None
    columns = len(rows[0])
    rows = [row[:-1] if len(row) == columns + 1 and not row[-1] else row for row in rows]
    if separator == ";":
        rows = rows[:1] + [[_with_decimal_point(cell) for cell in row] for row in rows[1:]]
    return rows


def to_number(cell: str) -> float:
    """A measurement.

    Raises:
        ValueError: not a number, not finite, or too large for a measurement.
    """
    value = float(cell)
    if not abs(value) <= LARGEST:
        raise ValueError(f"{cell[:30]!r} is not a measurement: not finite, or beyond {LARGEST:g}")
    return value


def to_seconds(cell: str) -> float:
    """A time stamp in seconds; integer nanoseconds since 1970 are recognized by their size.

    Raises:
        ValueError: not a number, not finite, or too large.
    """
    value = float(cell)
    if not math.isfinite(value) or abs(value) > LARGEST_TIME:
        raise ValueError(f"{cell[:30]!r} is not a time stamp")
    if abs(value) < NANOSECONDS_FROM:
        return value
    return int(cell) / 1e9 if cell.strip().lstrip("+-").isdecimal() else value / 1e9


def _with_decimal_point(cell: str) -> str:
    whole, comma, decimals = cell.partition(",")
    return f"{whole}.{decimals}" if comma and "," not in decimals else cell
