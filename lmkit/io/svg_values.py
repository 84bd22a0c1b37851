"""Lengths, transforms, view boxes and style of SVG elements."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from lmkit.arrays import FloatArray

PX_PER_UNIT = {
    "": 1.0, "px": 1.0, "mm": 96 / 25.4, "cm": 96 / 2.54, "in": 96.0, "pt": 4 / 3, "pc": 16.0, "q": 96 / 101.6,
}  # fmt: skip
PAINT = ("visibility", "fill", "stroke")  # what children inherit
_STYLED = ("display", "opacity", *PAINT)
_LENGTH = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)\s*([a-z%]*)", re.IGNORECASE)
_NUMBERS = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_TRANSFORM = re.compile(r"(\w+)\s*\(([^)]*)\)")
_RULE = re.compile(r"([^{}]{1,1000})\{([^{}]{0,10000})\}")
_WHITE = re.compile(r"#fff(?:fff)?|white|rgb\(255,255,255\)|rgb\(100%,100%,100%\)", re.IGNORECASE)


@dataclass(frozen=True)
class Viewport:
    """Reference width and height of percentages, in user units."""

    width: float
    height: float

    def length(self, text: str | None, axis: str, otherwise: float = 0.0) -> float:
        """User units of a length along ``x`` or ``y``, or of a radius ``r``.

        Raises:
            ValueError: no length, or one in units of a font.
        """
        if text is None or text.strip() in ("", "auto"):
            return otherwise
        found = _LENGTH.fullmatch(text.strip())
        unit = found[2].lower() if found else "?"
        if found is None or (unit != "%" and unit not in PX_PER_UNIT):
            raise ValueError(f"a length of {text[:30]!r}")
        if unit != "%":
            return float(found[1]) * PX_PER_UNIT[unit]
        diagonal = math.hypot(self.width, self.height) / math.sqrt(2)
        return float(found[1]) / 100 * {"x": self.width, "y": self.height, "r": diagonal}[axis]


def numbers(text: str | None) -> list[float]:
    """All numbers of an attribute."""
    return [float(number) for number in _NUMBERS.findall(text or "")]


def transform_of(text: str | None) -> FloatArray:
    """(3,3) of a transform attribute.

    Raises:
        ValueError: a transform of another name, or with other numbers.
    """
    answer = np.eye(3)
    for name, inside in _TRANSFORM.findall(text or ""):
        v = numbers(inside)
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
        elif name in ("skewX", "skewY") and len(v) == 1:
            step[(0, 1) if name == "skewX" else (1, 0)] = np.tan(np.deg2rad(v[0]))
        else:
            raise ValueError(f"transform {name!r}")
        answer = answer @ step
    return answer


def view_box(element: ElementTree.Element) -> tuple[float, float, float, float] | None:
    """x, y, width and height of an element's viewBox, or None without a valid one."""
    box = numbers(element.get("viewBox"))
    return (box[0], box[1], box[2], box[3]) if len(box) == 4 and min(box[2:]) > 0 else None


def fit_view_box(
    box: tuple[float, float, float, float], width: float, height: float, ratio: str | None
) -> FloatArray:
    """(3,3) from a viewBox to a viewport of this size at the origin, by preserveAspectRatio."""
    scale = np.array([width / box[2], height / box[3]])
    words = (ratio or "xMidYMid").split()
    align = words[0] if words else "xMidYMid"
    if align != "none":
        scale[:] = scale.max() if "slice" in words else scale.min()
    share = [
        {"Min": 0.0, "Mid": 0.5, "Max": 1.0}.get(align[k : k + 3], 0.5) if align != "none" else 0 for k in (1, 5)
    ]
    room = np.array([width, height]) - scale * np.array(box[2:])
    answer = np.diag([*scale, 1.0])
    answer[:2, 2] = np.array(share) * room - scale * np.array(box[:2])
    return answer


class StyleSheet:
    """Rules of <style> elements with simple selectors: ``rect``, ``.wall``, ``rect.wall`` or ``#id``."""

    def __init__(self, texts: Iterable[str]) -> None:
        self.rules: dict[str, dict[str, str]] = {}
        for text in texts:
            plain = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
            for selectors, body in _RULE.findall(plain):
                for selector in selectors.split(","):
                    self.rules.setdefault(selector.strip(), {}).update(_declarations(body))

    def style(self, element: ElementTree.Element, kind: str, inherited: Mapping[str, str]) -> dict[str, str]:
        """Display, opacity, visibility, fill and stroke of an element; the last three are inherited."""
        style = dict(inherited) | {key: element.attrib[key] for key in _STYLED if key in element.attrib}
        if not self.rules:
            return style | _declarations(element.get("style", ""))
        classes = [f".{name}" for name in element.get("class", "").split()]
        for selector in ("*", kind, *classes, *(kind + name for name in classes), f"#{element.get('id')}"):
            style |= self.rules.get(selector, {})
        return style | _declarations(element.get("style", ""))


def is_drawn(style: Mapping[str, str]) -> bool:
    """Whether an element and its children can be seen."""
    opacity = numbers(style.get("opacity", "1"))
    return style.get("display") != "none" and (not opacity or opacity[0] > 0)


def is_visible(style: Mapping[str, str]) -> bool:
    """Whether the element itself can be seen; its children may differ."""
    return style.get("visibility", "visible") not in ("hidden", "collapse")


def is_background(style: Mapping[str, str]) -> bool:
    """Whether a shape is paper: white, and without an outline."""
    return (
        style.get("stroke", "none") == "none" and _WHITE.fullmatch(style.get("fill", "").replace(" ", "")) is not None
    )


def _declarations(text: str) -> dict[str, str]:
    if not text:
        return {}
    pairs = (part.partition(":") for part in text.split(";"))
    found = {key.strip().lower(): value.replace("!important", "").strip() for key, _, value in pairs}
    return {key: value for key, value in found.items() if key in _STYLED}
