"""Files with something wrong: texts, tables, documents and bytes, changed at random."""

from __future__ import annotations

import json
import random
import re
from typing import Any

import yaml

PIECES = (
    ".nan", ".inf", "1e308", "-1e308", "nan", "9" * 400, "-1", "0", "''", "[]", "{}", "null", "~", "!!int x",
    "&a", "*a", "<<: *a", "---\n", "\0", "\ufeff", "\t", ";", ",", ":", "\"", "'", "\ud7ff", "é", "2020-01-01",
    "1:2:3", "{", "}", "[", "]", "\n", "#", "%YAML:1.0", "- ", "? ", "!!python/name:os.system", "lmkit-map/1",
)  # fmt: skip
NUMBERS = (
    0,
    -1,
    1,
    0.97,
    1.03,
    2,
    1e-9,
    1e-3,
    1e3,
    1e6,
    -1e6,
    1e9,
    1e18,
    1e308,
    -1e308,
    57.3,
    -57.3,
    360,
    2**31,
    2**63,
)
VALUES = (None, "", "a", [], {}, True, [0], [[]], "nan", "é" * 300)


def harm_text(text: str, rng: random.Random) -> str:
    """One to three pieces replaced, removed or repeated."""
    for _ in range(rng.randint(1, 3)):
        at, until = sorted(rng.randrange(len(text) + 1) for _ in range(2))
        until = min(until, at + rng.choice((0, 1, 4, 20, 400)))
        text = text[:at] + rng.choice((rng.choice(PIECES), "", text[at:until] * 2)) + text[until:]
    return text


def harm_table(text: str, rng: random.Random) -> str:
    """Rows or a column of a CSV or TUM table changed: few rows, other order, other units, hostile numbers."""
    separator = "," if "," in text else " "
    head, *rows = [line.split(separator) for line in text.splitlines()]
    kind = rng.randrange(8)
    column = rng.randrange(len(head))
    if kind == 0:
        rows = rows[: rng.choice((0, 1, 2, 3, 5))]
    elif kind == 1:
        rng.shuffle(rows)
    elif kind == 2:
        rows = rows[::-1]
    elif kind == 3:
        rows = rows + rows[: rng.choice((1, len(rows)))]
    elif kind == 4:
        factor = rng.choice(NUMBERS)
        rows = [[_scaled(cell, factor) if k == column else cell for k, cell in enumerate(row)] for row in rows]
    elif kind == 5:
        value = str(rng.choice((*NUMBERS, "", "nan", "inf", "x")))
        rows = [[value if k == column else cell for k, cell in enumerate(row)] for row in rows]
    elif kind == 6:
        rows = [[cell for k, cell in enumerate(row) if k != column] for row in rows]
        head = [cell for k, cell in enumerate(head) if k != column] if rng.random() < 0.5 else head
    elif rows:
        row = rng.choice(rows)
        row[rng.randrange(len(row))] = str(rng.choice((*NUMBERS, "", "nan", "x", "1e-320")))
    return "\n".join(separator.join(row) for row in [head, *rows]) + "\n"


def _scaled(cell: str, factor: float) -> str:
    try:
        return repr(float(cell) * factor)
    except ValueError:
        return cell


def harm_document(text: str, rng: random.Random) -> str:
    """One or two values of a YAML or JSON document replaced, removed, repeated or scaled."""
    if "!!opencv-matrix" in text:
        return harm_number(text, rng)
    data = (
        json.loads(text) if text.startswith("{") else yaml.load(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    )
    for _ in range(rng.randint(1, 2)):
        places = list(_places(data))
        if not places:
            break
        holder, key = rng.choice(places)
        _harm_value(holder, key, rng)
    return json.dumps(data) if text.startswith("{") or rng.random() < 0.2 else yaml.safe_dump(data)


def harm_number(text: str, rng: random.Random) -> str:
    """One number of a text replaced."""
    found = rng.choice(list(re.finditer(r"-?\d[\d.e+-]*", text)))
    return text[: found.start()] + str(rng.choice(NUMBERS)) + text[found.end() :]


def _places(data: Any) -> Any:
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in items:
        yield data, key
        yield from _places(value)


def _harm_value(holder: Any, key: Any, rng: random.Random) -> None:
    value = holder[key]
    kind = rng.randrange(5)
    if kind == 0:
        del holder[key]
    elif kind == 1:
        holder[key] = rng.choice((*NUMBERS, *VALUES))
    elif kind == 2 and isinstance(value, list):
        holder[key] = rng.choice((value * 2, value[:1], value[::-1], [], [value]))
    elif kind == 3 and isinstance(value, list):
        holder[key] = _all_numbers(value, rng.choice(NUMBERS))
    elif isinstance(value, int | float) and not isinstance(value, bool):
        holder[key] = value * rng.choice(NUMBERS)
    else:
        holder[rng.choice(("x", key)) if isinstance(holder, dict) else key] = rng.choice(VALUES)


def _all_numbers(value: Any, factor: float) -> Any:
    if isinstance(value, list):
        return [_all_numbers(item, factor) for item in value]
    return value * factor if isinstance(value, int | float) and not isinstance(value, bool) else value


def harm_bytes(data: bytes, rng: random.Random) -> bytes:
    """Cut off, with some bytes changed, or with a run of bytes removed or repeated."""
    kind = rng.randrange(4)
    if kind == 0 or not data:
        return data[: rng.randrange(len(data) + 1)]
    if kind == 1:
        changed = bytearray(data)
        for _ in range(rng.choice((1, 5, 50))):
            changed[rng.randrange(len(changed))] = rng.randrange(256)
        return bytes(changed)
    at, until = sorted(rng.randrange(len(data) + 1) for _ in range(2))
    return data[:at] + (data[at:until] * 2 if kind == 2 else b"") + data[until:]
