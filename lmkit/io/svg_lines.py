"""Straight lines out of an SVG drawing: lines, polylines, polygons, rectangles, and paths without curves."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.errors import InputError
from lmkit.io.documents import read_text

_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_COMMAND = re.compile(r"([A-Za-z])([^A-Za-z]*(?:[eE][-+]?\d[^A-Za-z]*)*)")
_TRANSFORM = re.compile(r"(\w+)\s*\(([^)]*)\)")
_SKIPPED = ("defs", "clipPath", "mask", "pattern", "symbol", "marker")
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
    lines = list(_lines(path, root, np.eye(3)))
    if not lines:
        raise InputError("no_walls", f"{path}: no line in it", _HINT)
    ends = np.array(lines)
    low, high = ends.reshape(-1, 2).min(axis=0), ends.reshape(-1, 2).max(axis=0)
    ends[..., 0] -= low[0]
    ends[..., 1] = high[1] - ends[..., 1]
    return [(a, b) for a, b in ends]


def _lines(path: Path, element: ElementTree.Element, outer: FloatArray) -> Iterator[FloatArray]:
    kind = element.tag.rpartition("}")[2]
    if kind in _SKIPPED:
        return
    transform = outer @ _transform(path, element.get("transform", ""))
    for points, closed in _shapes(path, kind, element):
        placed = points @ transform[:2, :2].T + transform[:2, 2]
        following = np.roll(placed, -1, axis=0)
        for a, b in list(zip(placed, following, strict=True))[: None if closed else -1]:
            if not np.allclose(a, b):
                yield np.array([a, b])
    for child in element:
        yield from _lines(path, child, transform)


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
    elif kind == "rect":
        x, y, w, h = (number(name) for name in ("x", "y", "width", "height"))
        yield np.array([[x, y], [x + w, y], [x + w, y + h], [x, y + h]]), True
    elif kind == "path":
        yield from _path(path, element.get("d", ""))
    elif kind in ("circle", "ellipse", "image"):
        raise InputError("svg_curve", f"{path}: a {kind}, which cannot be a wall", _HINT)


def _path(path: Path, commands: str) -> Iterator[tuple[FloatArray, bool]]:
    at: FloatArray = np.zeros(2)
    points: list[FloatArray] = []
    for letter, rest in _COMMAND.findall(commands):
        values = [float(v) for v in _NUMBER.findall(rest)]
        kind, relative = letter.upper(), letter.islower()
        if kind not in "MLHVZ":
            raise InputError("svg_curve", f"{path}: a curved path ({letter})", _HINT)
        if kind in "MZ" and points:
            yield np.array(points), kind == "Z"
            at, points = points[0] if kind == "Z" else at, []
        if kind in "HV":
            steps = [(v, np.nan) if kind == "H" else (np.nan, v) for v in values]
        else:
            steps = list(zip(values[::2], values[1::2], strict=False))
        if kind != "M" and kind != "Z" and not points:
            points = [at]
        for step in steps:
            given = np.array(step)
            to = at + np.nan_to_num(given) if relative else np.where(np.isnan(given), at, given)
            points.append(to)
            at = to
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
            centre = np.array(v[1:]) if len(v) == 3 else np.zeros(2)
            step[:2, 2] = centre - step[:2, :2] @ centre
        else:
            raise InputError("svg_transform", f"{path}: transform {name!r} is not read", "save it as plain SVG")
        answer = answer @ step
    return answer
