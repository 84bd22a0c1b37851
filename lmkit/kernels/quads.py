"""Squares darker than their surroundings, from a local threshold, and the cells of an image to search.

The steps: local threshold, outlines of dark regions with sub-pixel crossings, four corners, a line through every
side; and squares from the longest straight segments if a part may be hidden, of the outline of the dark region or of
the bright strip that is its margin.
"""

from __future__ import annotations

import ctypes
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.load import address, addresses, contiguous, function
from lmkit.kernels.quad_rules import QuadRules
from lmkit.kernels.quads_numpy import dark_quads_numpy, where_to_look_numpy
from lmkit.kernels.workspace import Workspace

FloatArray = NDArray[np.floating[Any]]
ByteArray = NDArray[np.uint8]

CELL = 4
PAD = 16  # the lengths of outlines are padded to a multiple of this


_WORKSPACE = Workspace()


class Contrast(NamedTuple):
    """Least range, over 3 x 3 cells, of log red over blue and of log brightness; then both for the second level."""

    ratio: float
    luma: float
    more_ratio: float
    more_luma: float


def where_to_look(image: ByteArray, offset: float, least: Contrast, dilate: bool) -> ByteArray:
    """(h,w) 1 for cells of 4 x 4 pixels with contrast around them, both in color and in brightness, 2 with more.

    Args:
        image: (H,W,3) BGR.
        offset: added to code values before their logarithm, against noise.
        dilate: include neighboring cells.
    """
    image = contiguous(image, (-1, -1, 3), np.uint8)
    kernel = _where_kernel()
    if kernel is None:
        return where_to_look_numpy(image, offset, least, dilate)
    height, width = image.shape[:2]
    shape = ((height + CELL - 1) // CELL, (width + CELL - 1) // CELL)
    where = np.empty(shape, np.uint8)
    rows, cells = _WORKSPACE.floats("rows", 4 * width), _WORKSPACE.floats("cells", 8 * shape[0] * shape[1])
    numbers = np.array(least)
    kernel(height, width, address(image), offset, address(numbers), dilate, rows, cells, address(where))
    return where


def dark_quads(
    plane: ByteArray, where: ByteArray | None, window: int, rules: QuadRules, halvings: int = 0, level: int = 0
) -> FloatArray:
    """(N,4,2) quadrilaterals around dark regions, clockwise; many are not landmarks.

    Args:
        plane: (H,W) one channel.
        where: cells in which the outlines begin, from :func:`where_to_look`; None for all.
        window: side of the window for the local mean, odd, at most 15.
        halvings: number of halvings of the plane relative to the image of ``where``; -1: one fewer.
        level: total number of halvings; corners are px of the original image.
    """
    plane = contiguous(plane, (-1, -1), np.uint8)
    height, width = plane.shape
    if not (0 < window <= 15 and window % 2):
        raise ValueError(f"a window of {window} pixels")
    if where is not None:
        where = contiguous(where, (-1, -1), np.uint8)
    kernel = _quads_kernel()
    if kernel is None:
        return dark_quads_numpy(plane, where, window, rules, halvings, level)
    pixels = (height + 2) * (width + 2)
    numbers, count = np.array(rules, dtype=np.float64), np.zeros(1, np.int64)
    image = (height, width, address(plane), *addresses(where), *((0, 0) if where is None else where.shape))
    scratch = (
        _WORKSPACE.floats("field", pixels // 2 + 1),
        _WORKSPACE.floats("flags", pixels // 4 + 1),
        _WORKSPACE.floats("sums", width // 2 + 1),
        _WORKSPACE.floats("wide", width // 2 + 1),
        _WORKSPACE.floats("points", 3 * (rules.longest + 2 * PAD)),
        _WORKSPACE.floats("runs", width // CELL + 2),
    )
    capacity = 512
    while True:
        quads, corners = _WORKSPACE.floats("quads", 8 * capacity), np.empty((capacity, 4, 2))
        room = (capacity, quads, *addresses(corners, count))
        status = kernel(*image, halvings, level, window, address(numbers), *scratch, *room)
        if status == 0:
            return corners[: int(count[0])]
        capacity *= 4


@lru_cache(maxsize=1)
def _where_kernel() -> Any:
    p, n, d = ctypes.c_void_p, ctypes.c_int64, ctypes.c_double
    return function("lmkit_where_to_look", n, n, p, d, p, n, p, p, p)


@lru_cache(maxsize=1)
def _quads_kernel() -> Any:
    p, n = ctypes.c_void_p, ctypes.c_int64
    return function("lmkit_dark_quads", n, n, p, p, *[n] * 5, *[p] * 7, n, p, p, p)
