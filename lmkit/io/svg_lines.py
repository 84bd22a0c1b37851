"""Lines of an SVG drawing as a browser draws it (docs/decisions/0026-svg.md).

Units, transforms, nested drawings with their view boxes, symbols and <use>, hidden layers and style sheets count;
curves become short lines.  Clip paths and masks are not applied, and text is not a wall.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.errors import InputError
from lmkit.io.documents import read_text
from lmkit.io.svg_path import ellipse_points, path_polylines
from lmkit.io.svg_values import (
    PAINT,
    StyleSheet,
    Viewport,
    fit_view_box,
    is_background,
    is_drawn,
    is_visible,
    numbers,
    transform_of,
    view_box,
)
from lmkit.io.tables import LARGEST

MAX_LINES, MAX_DEPTH, MAX_ELEMENTS = 200_000, 100, 100_000
SHORTEST = 1e-9  # user units
PAGE = 0.99  # a filled shape without outline over this share of the page is its background
PAGE_UNITS = (300.0, 150.0)  # of a drawing that gives no size
_SKIPPED = ("defs", "clipPath", "mask", "pattern", "symbol", "marker", "text", "style", "metadata", "foreignObject")
_HINT = "draw the walls as lines, curves or polygons, and save as plain SVG"
_HREF = ("href", "{http://www.w3.org/1999/xlink}href")


def read_svg_lines(path: Path, curves: bool = True) -> list[tuple[FloatArray, FloatArray]]:
    """(2,) ends of all lines, y up, the lowest and leftmost at 0; in user units of the drawing's viewBox.

    Args:
        curves: False leaves out circles, ellipses and curved parts of paths.

    Raises:
        InputError: not SVG, no line in it, too large, or a part that cannot be drawn: an image, a reference to
            another file, lengths in units of a font.
    """
    text = read_text(path, "floor plan")
    if "<!ENTITY" in text:
        raise InputError("not_svg", f"{path}: contains entities, which are not supported", "save it as plain SVG")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as error:
        raise InputError("not_svg", f"{path}: not SVG ({error})", "save the drawing as plain SVG") from None
    try:
        ends = _Drawing(root, curves).lines()
    except ValueError as error:
        raise InputError("bad_svg", f"{path}: {error} is not read", _HINT) from None
    except OverflowError as error:
        raise InputError("svg_too_large", f"{path}: {error}", _HINT) from None
    if not len(ends):
        raise InputError("no_walls", f"{path}: it contains no line", _HINT)
    if not np.abs(ends).max() < LARGEST:
        raise InputError("svg_too_large", f"{path}: coordinates that are not finite, or beyond {LARGEST:g}", _HINT)
    low, high = ends.reshape(-1, 2).min(axis=0), ends.reshape(-1, 2).max(axis=0)
    ends[..., 0] -= low[0]
    ends[..., 1] = high[1] - ends[..., 1]
    return [(a, b) for a, b in ends]


class _Drawing:
    def __init__(self, root: ElementTree.Element, curves: bool) -> None:
        self.root, self.curves = root, curves
        self.named = {name: element for element in root.iter() if (name := element.get("id")) is not None}
        self.sheet = StyleSheet(element.text or "" for element in root.iter() if _kind(element) == "style")
        self.visited = self.count = 0
        self.found: list[FloatArray] = []
        box = view_box(root)
        width, height = box[2:] if box else PAGE_UNITS
        page = Viewport(width, height)
        self.page = (
            page
            if box
            else Viewport(page.length(root.get("width"), "x", width), page.length(root.get("height"), "y", height))
        )

    def lines(self) -> FloatArray:
        """(N,2,2) ends of every line, in units of the root."""
        self._children(self.root, self.sheet.style(self.root, "svg", {}), np.eye(3), self.page, 0)
        return np.vstack(self.found) if self.found else np.empty((0, 2, 2))

    def _children(
        self, element: ElementTree.Element, style: Mapping[str, str], T: FloatArray, view: Viewport, depth: int
    ) -> None:
        if len(element) and is_drawn(style):
            passed = {key: style[key] for key in PAINT if key in style}
            for child in element:
                self._add(child, passed, T, view, depth + 1)

    def _add(
        self,
        element: ElementTree.Element,
        inherited: Mapping[str, str],
        T: FloatArray,
        view: Viewport,
        depth: int,
    ) -> None:
        kind = _kind(element)
        self.visited += 1
        if depth > MAX_DEPTH or self.visited > MAX_ELEMENTS:
            raise OverflowError(f"nested more than {MAX_DEPTH} deep, or more than {MAX_ELEMENTS} elements")
        if kind in _SKIPPED:
            return
        style = self.sheet.style(element, kind, inherited)
        if not is_drawn(style):
            return
        if "transform" in element.attrib:
            T = T @ transform_of(element.attrib["transform"])
        if kind == "use":
            self._use(element, style, T, view, depth)
        elif kind == "svg":
            self._nest(element, element, style, _shifted(T, element, view), view, depth)
        elif kind == "image":
            raise ValueError("an image, which has no lines,")
        else:
            if is_visible(style):
                self._draw(kind, element, style, T, view)
            self._children(element, style, T, view, depth)

    def _draw(
        self, kind: str, element: ElementTree.Element, style: Mapping[str, str], T: FloatArray, view: Viewport
    ) -> None:
        for points, closed in _shape(kind, element, view, self.curves):
            if closed and (is_background(style) or self._is_page(points, T, style)):
                continue
            ends = _placed(points, closed, T)
            self.found.append(ends)
            self.count += len(ends)
            if self.count > MAX_LINES:
                raise OverflowError(f"more than {MAX_LINES} lines")

    def _use(
        self, use: ElementTree.Element, style: Mapping[str, str], T: FloatArray, view: Viewport, depth: int
    ) -> None:
        reference = next((use.attrib[name] for name in _HREF if name in use.attrib), "")
        target = self.named.get(reference.removeprefix("#"))
        if target is None or not reference.startswith("#"):
            raise ValueError(f"a reference to {reference[:40]!r}, which this file does not contain,")
        passed = {key: style[key] for key in PAINT if key in style}
        moved = _shifted(T, use, view)
        if _kind(target) in ("symbol", "svg"):
            self._nest(target, use, self.sheet.style(target, _kind(target), passed), moved, view, depth + 1)
        else:
            self._add(target, passed, moved, view, depth + 1)

    def _nest(
        self,
        drawing: ElementTree.Element,
        sized: ElementTree.Element,
        style: Mapping[str, str],
        T: FloatArray,
        view: Viewport,
        depth: int,
    ) -> None:
        """Add a nested drawing or a symbol; ``sized`` gives its size."""

        def size(key: str, axis: str, whole: float) -> float:
            return view.length(sized.get(key), axis, view.length(drawing.get(key), axis, whole))

        width, height = size("width", "x", view.width), size("height", "y", view.height)
        if min(width, height) <= 0:
            return
        box = view_box(drawing)
        if box is not None:
            T = T @ fit_view_box(box, width, height, drawing.get("preserveAspectRatio"))
            width, height = box[2:]
        self._children(drawing, style, T, Viewport(width, height), depth)

    def _is_page(self, points: FloatArray, T: FloatArray, style: Mapping[str, str]) -> bool:
        """Whether a filled shape without outline covers the page."""
        if style.get("stroke", "none") != "none" or style.get("fill") == "none":
            return False
        ends = points @ T[:2, :2].T + T[:2, 2]
        return bool((np.ptp(ends, axis=0) >= PAGE * np.array([self.page.width, self.page.height])).all())


def _shifted(T: FloatArray, element: ElementTree.Element, view: Viewport) -> FloatArray:
    """T after the x and y of a nested drawing or of a <use>."""
    answer = T.copy()
    answer[:2, 2] += T[:2, :2] @ [view.length(element.get("x"), "x"), view.length(element.get("y"), "y")]
    return answer


def _kind(element: ElementTree.Element) -> str:
    return str(element.tag).rpartition("}")[2]


def _placed(points: FloatArray, closed: bool, T: FloatArray) -> FloatArray:
    """(N,2,2) ends of the lines between points, without lines of zero length."""
    with np.errstate(invalid="ignore", over="ignore"):
        at = points @ T[:2, :2].T + T[:2, 2]
        ends = np.stack([at, np.roll(at, -1, axis=0)], axis=1)[: None if closed else -1]
        return np.asarray(ends[~(np.abs(ends[:, 0] - ends[:, 1]).max(axis=1, initial=0.0) <= SHORTEST)])


def _shape(
    kind: str, element: ElementTree.Element, view: Viewport, curves: bool
) -> Iterator[tuple[FloatArray, bool]]:
    """(N,2) points of each line of an element, and whether it closes."""

    def along(axis: str, *names: str) -> list[float]:
        return [view.length(element.get(name), axis) for name in names]

    if kind == "line":
        yield np.column_stack([along("x", "x1", "x2"), along("y", "y1", "y2")]), False
    elif kind in ("polyline", "polygon"):
        values = numbers(element.get("points"))
        yield np.array(values[: len(values) // 2 * 2]).reshape(-1, 2), kind == "polygon"
    elif kind == "rect":
        (x, w), (y, h) = along("x", "x", "width"), along("y", "y", "height")
        if min(w, h) > 0:
            yield np.array([[x, y], [x + w, y], [x + w, y + h], [x, y + h]]), True
    elif kind in ("circle", "ellipse") and not curves:
        return
    elif kind in ("circle", "ellipse"):
        rx, ry = along("r", "r", "r") if kind == "circle" else (*along("x", "rx"), *along("y", "ry"))
        if min(rx, ry) > 0:
            (cx,), (cy,) = along("x", "cx"), along("y", "cy")
            yield ellipse_points((cx, cy), (rx, ry)), True
    elif kind == "path":
        yield from path_polylines(element.get("d", ""), curves)
