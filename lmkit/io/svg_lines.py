"""Straight lines out of an SVG drawing: lines, polylines, polygons, rectangles, and paths without curves."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.errors import InputError
from lmkit.io.documents import read_text
from lmkit.io.tables import LARGEST

_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_COMMAND = re.compile(r"([A-Za-z])([^A-Za-z]*(?:[eE][-+]?\d[^A-Za-z]*)*)")
_TRANSFORM = re.compile(r"(\w+)\s*\(([^)]*)\)")
_SKIPPED = ("defs", "clipPath", "mask", "pattern", "symbol", "marker")
MAX_LINES, MAX_DEPTH = 200_000, 100
SHORTEST = 1e-9  # user units
_HIDDEN = re.compile(r"display\s*:\s*none|visibility\s*:\s*(?:hidden|collapse)")
_HINT = "draw the walls as straight lines, rectangles or polygons"


def read_svg_lines(path: Path) -> list[tuple[FloatArray, FloatArray]]:
    """(2,) ends of all lines, y up, the lowest and leftmost at 0; in the file's user units.

    Raises:
        InputError: not SVG, no line in it, or a curve.
    """
    text = read_text(path, "floor plan")
    if "<!ENTITY" in text:
        raise InputError("not_svg", f"{path}: holds entities, which are not read", "save it as plain SVG")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError("not_svg", f"{path}: not SVG ({error})", "save the drawing as plain SVG") from None
    lines = list(islice(_lines(path, root, np.eye(3)), MAX_LINES + 1))
    if len(lines) > MAX_LINES:
        raise InputError("svg_too_large", f"{path}: more than {MAX_LINES} lines", _HINT)
    if lines and not np.abs(np.array(lines)).max() < LARGEST:
        raise InputError("svg_too_large", f"{path}: coordinates that are not finite, or beyond {LARGEST:g}", _HINT)
    if not lines:
        raise InputError("no_walls", f"{path}: no line in it", _HINT)
    ends = np.array(lines)
    low, high = ends.reshape(-1, 2).min(axis=0), ends.reshape(-1, 2).max(axis=0)
    ends[..., 0] -= low[0]
    ends[..., 1] = high[1] - ends[..., 1]
    return [(a, b) for a, b in ends]


def _lines(path: Path, element: ElementTree.Element, outer: FloatArray, depth: int = 0) -> Iterator[FloatArray]:
    kind = element.tag.rpartition("}")[2]
    if kind in _SKIPPED or _is_hidden(element):
        return
    if depth > MAX_DEPTH:
        raise InputError("svg_too_large", f"{path}: nested more than {MAX_DEPTH} deep", _HINT)
    transform = outer @ _transform(path, element.get("transform", ""))
    for points, closed in _shapes(path, kind, element):
        with np.errstate(invalid="ignore", over="ignore"):
            placed = points @ transform[:2, :2].T + transform[:2, 2]
        ends = np.stack([placed, np.roll(placed, -1, axis=0)], axis=1)[: None if closed else -1]
        yield from ends[~(np.abs(ends[:, 0] - ends[:, 1]).max(axis=1, initial=0.0) <= SHORTEST)]
    for child in element:
        yield from _lines(path, child, transform, depth + 1)


def _is_hidden(element: ElementTree.Element) -> bool:
    """Whether an element is not drawn: layers that are switched off."""
    hidden = element.get("display") == "none" or element.get("visibility") in ("hidden", "collapse")
    return hidden or _HIDDEN.search(element.get("style", "")) is not None


def _shapes(path: Path, kind: str, element: ElementTree.Element) -> Iterator[tuple[FloatArray, bool]]:
    """(N,2) points of each line of an element, and whether it closes."""

    def number(name: str) -> float:
        found = _NUMBER.match(element.get(name, "0").strip())
        return float(found.group()) if found else 0.0

    if kind == "line":
        yield np.array([[number("x1"), number("y1")], [number("x2"), number("y2")]]), False
    elif kind in ("polyline", "polygon"):
        values = [float(v) for v in _NUMBER.findall(element.get("points", ""))]
        yield np.array(values[: len(values) // 2 * 2]).reshape(-1, 2), kind == "polygon"
    elif kind == "rect" and "%" in element.get("width", "") + element.get("height", ""):
        return  # a background, as large as the page
    elif kind == "rect":
        x, y, w, h = (number(name) for name in ("x", "y", "width", "height"))
        yield np.array([[x, y], [x + w, y], [x + w, y + h], [x, y + h]]), True
    elif kind == "path":
        yield from _path(path, element.get("d", ""))
    elif kind in ("circle", "ellipse", "image"):
        raise InputError("svg_curve", f"{path}: a {kind}, which cannot be a wall", _HINT)


def _path(path: Path, commands: str) -> Iterator[tuple[FloatArray, bool]]:
    x = y = 0.0
    points: list[tuple[float, float]] = []
    for letter, rest in _COMMAND.findall(commands):
        values = [float(v) for v in _NUMBER.findall(rest)]
        kind, relative = letter.upper(), letter.islower()
        if kind not in "MLHVZ":
            raise InputError("svg_curve", f"{path}: a curved path ({letter})", _HINT)
        if kind in "MZ" and points:
            yield np.array(points), kind == "Z"
            (x, y), points = points[0] if kind == "Z" else (x, y), []
        if kind not in "MZ" and not points:
            points = [(x, y)]
        own_x, own_y = (0.0, 0.0) if relative else (x, y)  # of the coordinate that H and V leave out
        steps = [(v, own_y) for v in values] if kind == "H" else [(own_x, v) for v in values]
        for dx, dy in steps if kind in "HV" else zip(values[::2], values[1::2], strict=False):
            if relative:
                x, y = x + dx, y + dy
            else:
                x, y = dx, dy
            points.append((x, y))
    if points:
        yield np.array(points), False


def _transform(path: Path, text: str) -> FloatArray:
    """(3,3) of an element's transform attribute."""
    answer = np.eye(3)
    for name, inside in _TRANSFORM.findall(text):
        v = [float(number) for number in _NUMBER.findall(inside)]
        step = np.eye(3)
        if name == "translate" and len(v) in (1, 2):
            step[:2, 2] = [v[0], v[1] if len(v) > 1 else 0.0]
        elif name == "scale" and len(v) in (1, 2):
            step[0, 0], step[1, 1] = v[0], v[-1]
        elif name == "matrix" and len(v) == 6:
            step[:2] = np.array(v).reshape(3, 2).T
        elif name == "rotate" and len(v) in (1, 3):
            c, s = np.cos(np.deg2rad(v[0])), np.sin(np.deg2rad(v[0]))
            step[:2, :2] = [[c, -s], [s, c]]
            center = np.array(v[1:]) if len(v) == 3 else np.zeros(2)
            step[:2, 2] = center - step[:2, :2] @ center
        else:
            raise InputError("svg_transform", f"{path}: transform {name!r} is not read", "save it as plain SVG")
        answer = answer @ step
    return answer
