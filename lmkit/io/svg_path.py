"""Path data of SVG (the attribute d) as polylines; curves become short lines."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from lmkit.arrays import FloatArray

ARC_STEP_RAD = math.radians(5.0)
CURVE_STEPS = 16
MOST_POINTS = 200_000
_SPACE = re.compile(r"[\s,]*")
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_COUNTS = {"M": 2, "L": 2, "H": 1, "V": 1, "C": 6, "S": 4, "Q": 4, "T": 2, "A": 7, "Z": 0}
CURVES = "CSQTA"
_FLAGS = (3, 4)  # arguments of A that are a single digit, without a separator


def path_polylines(data: str, curves: bool = True) -> Iterator[tuple[FloatArray, bool]]:
    """(N,2) points of every part of a path, and whether it closes.

    Args:
        curves: False leaves curved parts out.

    Raises:
        ValueError: not path data.
        OverflowError: too many points.

    Examples:
        >>> [(points.tolist(), closed) for points, closed in path_polylines("M0 0h2v1z")]
        [([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0]], True)]
    """
    start = at = handle = (0.0, 0.0)
    points: list[tuple[float, float]] = []
    before, count, broken = "", 0, False
    for letter, values in _commands(data):
        kind = letter.upper()
        if not before and kind != "M":
            raise ValueError(f"a path that begins with {letter}")
        if kind == "Z" and broken:  # the line that closes the path stays
            yield np.array([*(points or [at]), start]), False
            points = []
        if kind in "MZ":
            broken = False
        if kind in "MZ" and points:
            yield np.array(points), kind == "Z"
            points = []
        if kind == "Z":
            at = start
        elif kind == "M":
            start = at = _moved(at, values, letter.islower())
            points = [at]
        else:
            if not points:
                points = [at]
            new, handle = _segment(
                kind, _absolute(kind, values, at) if letter.islower() else values, at, handle, before
            )
            if kind in CURVES and not curves:
                yield np.array(points), False
                points, broken, at = [], True, new[-1]
            else:
                points.extend(new)
                at = points[-1]
        before, count = kind, count + 1
        if len(points) + count > MOST_POINTS:
            raise OverflowError(f"a path of more than {MOST_POINTS} points")
    if points:
        yield np.array(points), False


def ellipse_points(center: tuple[float, float], radii: tuple[float, float]) -> FloatArray:
    """(N,2) points around an ellipse along the axes."""
    angles = np.arange(0.0, 2 * math.pi, ARC_STEP_RAD)
    return np.asarray(np.array(center) + np.column_stack([np.cos(angles), np.sin(angles)]) * np.array(radii))


def _commands(data: str) -> Iterator[tuple[str, list[float]]]:
    """Each command with its arguments; repeated arguments repeat the command."""
    place, letter = _SPACE.match(data).end(), ""  # type: ignore[union-attr]
    while place < len(data):
        if data[place].upper() in _COUNTS:
            letter, place = data[place], place + 1
        elif not letter or letter in "Zz":
            raise ValueError(f"{data[place : place + 10]!r} in a path")
        values: list[float] = []
        for k in range(_COUNTS[letter.upper()]):
            place = _SPACE.match(data, place).end()  # type: ignore[union-attr]
            if letter in "Aa" and k in _FLAGS and data[place : place + 1] in ("0", "1"):
                values.append(float(data[place]))
                place += 1
                continue
            found = _NUMBER.match(data, place)
            if found is None:
                raise ValueError(f"a number is missing after {letter} in a path")
            values.append(float(found.group()))
            place = found.end()
        yield letter, values
        letter = {"M": "L", "m": "l"}.get(letter, letter)
        place = _SPACE.match(data, place).end()  # type: ignore[union-attr]


def _moved(at: tuple[float, float], values: list[float], relative: bool) -> tuple[float, float]:
    return (at[0] + values[0], at[1] + values[1]) if relative else (values[0], values[1])


def _absolute(kind: str, values: list[float], at: tuple[float, float]) -> list[float]:
    if kind == "H":
        return [at[0] + values[0]]
    if kind == "V":
        return [at[1] + values[0]]
    if kind == "A":
        return [*values[:5], at[0] + values[5], at[1] + values[6]]
    return [v + at[k % 2] for k, v in enumerate(values)]


def _segment(
    kind: str, values: list[float], at: tuple[float, float], handle: tuple[float, float], before: str
) -> tuple[list[tuple[float, float]], tuple[float, float]]:
    """Points after ``at``, and the control point that S and T after it mirror."""
    if kind == "H":
        return [(values[0], at[1])], at
    if kind == "V":
        return [(at[0], values[0])], at
    end = (values[-2], values[-1])
    if kind == "L":
        return [end], at
    if kind == "A":
        return _arc(at, values, end), at
    mirrored = (2 * at[0] - handle[0], 2 * at[1] - handle[1])
    if kind in "ST":
        values = [*(mirrored if before in {"S": "CS", "T": "QT"}[kind] else at), *values]
    controls = [at, *((values[k], values[k + 1]) for k in range(0, len(values), 2))]
    return _bezier(controls), controls[-2]


def _bezier(controls: list[tuple[float, float]]) -> list[tuple[float, float]]:
    t = np.linspace(0.0, 1.0, CURVE_STEPS + 1)[1:, None]
    points = [np.array(c) for c in controls]
    while len(points) > 1:  # de Casteljau
        points = [(1 - t) * a + t * b for a, b in pairwise(points)]
    return [*((float(x), float(y)) for x, y in points[0][:-1]), controls[-1]]


def _arc(at: tuple[float, float], values: list[float], end: tuple[float, float]) -> list[tuple[float, float]]:
    """Points of an elliptical arc, by SVG's own rules (SVG 2, B.2.4 and B.2.5)."""
    rx, ry, turn = abs(values[0]), abs(values[1]), math.radians(values[2])
    if rx == 0 or ry == 0 or at == end:
        return [end]
    c, s = math.cos(turn), math.sin(turn)
    dx, dy = (at[0] - end[0]) / 2, (at[1] - end[1]) / 2
    x, y = c * dx + s * dy, -s * dx + c * dy
    grow = math.hypot(x / rx, y / ry)
    rx, ry = rx * max(grow, 1.0), ry * max(grow, 1.0)
    rest = max(0.0, 1 / ((x / rx) ** 2 + (y / ry) ** 2) - 1)
    factor = math.copysign(math.sqrt(rest), 1.0 if values[3] != values[4] else -1.0)
    cx, cy = factor * rx * y / ry, -factor * ry * x / rx
    first, last = math.atan2((y - cy) / ry, (x - cx) / rx), math.atan2((-y - cy) / ry, (-x - cx) / rx)
    sweep = (last - first) % (2 * math.pi)
    sweep = sweep if values[4] else sweep - 2 * math.pi
    steps = max(1, math.ceil(abs(sweep) / ARC_STEP_RAD))
    mx, my = c * cx - s * cy + (at[0] + end[0]) / 2, s * cx + c * cy + (at[1] + end[1]) / 2
    angles = [first + sweep * k / steps for k in range(1, steps)]
    around = [(rx * math.cos(a), ry * math.sin(a)) for a in angles]
    return [*((mx + c * px - s * py, my + s * px + c * py) for px, py in around), end]
