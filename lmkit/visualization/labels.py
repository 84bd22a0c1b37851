"""Placement of words in a drawing, where they cover no lines, symbols or other words."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from lmkit.arrays import FloatArray

Point = tuple[float, float]
STEP_PX = 3.0  # between the sample points of a line
PER_LETTER = 0.58  # width of a letter, relative to the text's height
PAD_PX = 2.0
WORD_COST = 60.0  # of a covered word or symbol, in sample points of a line
LATER_COST = 0.4  # of a candidate, per preferred candidate before it


def text_width(text: str, size: float) -> float:
    """Width of a line of text, estimated; pixels."""
    return PER_LETTER * size * len(text)


class LabelPlacer:
    """Places for words that avoid drawn lines, symbols and words; pixels."""

    def __init__(self) -> None:
        self._points: list[FloatArray] = []
        self._boxes: list[tuple[float, float, float, float]] = []

    def keep_line(self, points: Sequence[Point]) -> None:
        """Keep a line readable."""
        ends = np.asarray(points, dtype=np.float64).reshape(-1, 2)
        for a, b in pairwise(ends):
            count = max(2, int(np.linalg.norm(b - a) / STEP_PX) + 1)
            self._points.append(a + np.linspace(0.0, 1.0, count)[:, None] * (b - a))

    def keep_box(self, middle: Point, width: float, height: float) -> None:
        """Keep a symbol or word readable."""
        x, y = middle
        self._boxes.append((x - width / 2, y - height / 2, x + width / 2, y + height / 2))

    def place(self, text: str, size: float, candidates: Sequence[Point]) -> tuple[Point, bool]:
        """The best center for a word, and whether it covers nothing there; later words avoid it.

        Args:
            candidates: possible centers, the preferred one first.
        """
        width, height = text_width(text, size) + 2 * PAD_PX, size + 2 * PAD_PX
        points = np.concatenate(self._points) if self._points else np.zeros((0, 2))
        costs = [self._cost(points, at, width, height) for at in candidates]
        best = int(np.argmin([cost + LATER_COST * k for k, cost in enumerate(costs)]))
        self.keep_box(candidates[best], width, height)
        return candidates[best], costs[best] == 0

    def _cost(self, points: FloatArray, at: Point, width: float, height: float) -> float:
        x, y = at
        inside = (np.abs(points[:, 0] - x) < width / 2) & (np.abs(points[:, 1] - y) < height / 2)
        covered = sum(
            left < x + width / 2 and x - width / 2 < right and top < y + height / 2 and y - height / 2 < bottom
            for left, top, right, bottom in self._boxes
        )
        return float(inside.sum()) + WORD_COST * covered


def line_parts_inside(points: Sequence[Point], low: Point, high: Point) -> list[list[Point]]:
    """Parts of a line inside a box."""
    parts: list[list[Point]] = [[]]
    for x, y in points:
        if low[0] <= x <= high[0] and low[1] <= y <= high[1]:
            parts[-1].append((x, y))
        elif parts[-1]:
            parts.append([])
    return [part for part in parts if len(part) > 1]
