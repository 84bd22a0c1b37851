"""Shadows that end on a landmark: the image divided by its local white.

A landmark that is half in the sun and half in the shade looks like two landmarks to every threshold and every
model of one light.  The white nearby determines the light: a gray closing (the smallest of the
largest values around) preserves the shadow's edge, which a mean would blur, and bridges
the dark parts, if its window is wider than these parts.  Once the landmark is read, the drawing
predicts the brightness of every pixel, and one straight edge between two lights is fitted.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from lmkit.arrays import ByteArray, Float32Array, FloatArray
from lmkit.kernels.shadow_edge import Split, shadow_edge
from lmkit.model.palette import SRGB_TO_LINEAR

# The window over the side of a landmark: wider than the ground between margin and rings, which is a
# quarter of the side at the corners, and not so wide that it bridges the shade's own white.
WINDOW_OVER_SIDE = 0.42
LEAST_RATIO = 1.5  # between the brightest and the darkest white of a square, for a shadow's edge on it
LARGEST_WINDOW_PX = 31  # larger ones take as much time as all else
DARKEST = 1e-3
EDGE_DIRECTIONS = 36
_ANGLES = np.arange(EDGE_DIRECTIONS) * (np.pi / EDGE_DIRECTIONS)
NORMALS = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])


def window_for(side_px: float) -> int:
    """Side of the closing's window, odd, px, for landmarks of this side."""
    return max(2 * round(WINDOW_OVER_SIDE * side_px / 2) + 1, 5)


def white_within(levels: Sequence[ByteArray], box: tuple[int, int, int, int], window: int) -> Float32Array:
    """(y1 - y0, x1 - x0) brightness of the white around pixels of a box x0, y0, x1, y1 of an image.

    Args:
        levels: (H,W,3) BGR, 8 bit: the image and its halvings, in which large windows are taken.
        window: its side, odd, px.
    """
    x0, y0, x1, y1 = box
    times = min(max(0, math.ceil(math.log2(window / LARGEST_WINDOW_PX))), len(levels) - 1)
    level, scale = levels[times], 2**times
    left, top = x0 // scale, y0 // scale
    right, bottom = min(-(-x1 // scale), level.shape[1]), min(-(-y1 // scale), level.shape[0])
    linear = np.asarray(cv2.LUT(level[top:bottom, left:right], SRGB_TO_LINEAR), dtype=np.float32)
    if times == 0:
        return local_white(linear, window)
    white = local_white(linear, 2 * round(window / scale / 2) + 1)
    # Pixel k of a halved image covers the span [k, k + 1) * scale of the image.
    first = scale * (np.array([left, top]) + 0.5) - 0.5 - (x0, y0)
    move = np.column_stack([scale * np.eye(2), first])
    enlarged = cv2.warpAffine(white, move, (x1 - x0, y1 - y0), borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(enlarged, dtype=np.float32)


def local_white(linear: Float32Array, window: int) -> Float32Array:
    """(H,W) brightness of the white around every pixel of a image in linear light."""
    # A little smoothing, or the closing would return the noise's upper end.
    gray = cv2.blur(cv2.cvtColor(linear, cv2.COLOR_BGR2GRAY), (3, 3))
    closed = cv2.morphologyEx(gray, cv2.MORPH_CLOSE, np.ones((window, window), dtype=np.uint8))
    return np.asarray(np.maximum(closed, DARKEST), dtype=np.float32)


@dataclass(frozen=True)
class ShadowEdge:
    """A straight edge between two lights.

    Attributes:
        normal: (2,) unit vector across it, toward the second light.
        offset: px along the normal.
        lights: light before and behind the edge.
    """

    normal: FloatArray
    offset: float
    lights: tuple[float, float]

    @classmethod
    def fit(cls, at: FloatArray, light: FloatArray, weights: FloatArray) -> ShadowEdge:
        """The edge that leaves the least weighted variance of the logarithm on its two sides.

        Args:
            at: (N,2) px.
            light: (N,) observed over predicted brightness, positive.
            weights: (N,).
        """
        return cls.of(shadow_edge(at, np.log(light), weights, NORMALS))

    @classmethod
    def of(cls, split: Split) -> ShadowEdge:
        """The edge along one of the `NORMALS` that splits the logarithms of the light."""
        return cls(NORMALS[split.direction], split.offset, (math.exp(split.before), math.exp(split.behind)))

    def light(self, box: tuple[int, int, int, int]) -> Float32Array:
        """(y1 - y0, x1 - x0) light of an image's pixels in a box x0, y0, x1, y1; its edge is as soft as a pixel."""
        x0, y0, x1, y1 = box
        x = (np.arange(x0, x1) * self.normal[0] - self.offset + 0.5).astype(np.float32)
        y = (np.arange(y0, y1) * self.normal[1]).astype(np.float32)
        behind = np.clip(y[:, None] + x, 0, 1)
        return np.asarray(self.lights[0] + behind * (self.lights[1] - self.lights[0]), dtype=np.float32)
