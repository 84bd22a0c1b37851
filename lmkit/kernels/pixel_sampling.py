"""Thinned pixels of a landmark, in linear light, with their variance from noise through the tone curve."""

from __future__ import annotations

import ctypes
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.load import address, addresses, contiguous, function
from lmkit.kernels.plane import STATE, View, plane_numpy

Float32Array = NDArray[np.float32]
FloatArray = NDArray[np.floating[Any]]

# 2^32 over the plastic number and its square: multiples of both fill the plane evenly (Roberts 2018).
ALONG, DOWN = 3242174889, 2447445414
VISITED = 20  # examined pixels for each requested one
# Steps between examined pixels of a row for which the chosen pixels cover a square of 10 x 10
# cells evenly: with other steps, such as 13 or 24, they form stripes that miss whole cells of a marker.
EVEN_STEPS = (
    1, 2, 3, 5, 8, 11, 12, 15, 18, 21, 23, 29, 34, 39, 50, 59, 76, 98, 127, 143, 161, 209, 227, 275, 322, 390,
    490, 595,
)  # fmt: skip


class Source(NamedTuple):
    """The sampled image.

    Attributes:
        image: (H,W,3) BGR, 8 bit.
        linear: (256,) linear light of the code values.
        white: (H,W) that values are divided by where it is positive, or None.
        shift: (H,W,2) from a pixel to where it lies without the lens's distortion, px, or None.
    """

    image: NDArray[np.uint8]
    linear: Float32Array
    white: Float32Array | None
    shift: Float32Array | None

    @classmethod
    def of(cls, image: Any, linear: Any, white: Any = None, shift: Any = None) -> Source:
        """Contiguous arrays of consistent shapes.

        Raises:
            ValueError: a shape differs.
        """
        image = contiguous(image, (-1, -1, 3), np.uint8)
        height, width = image.shape[:2]
        return cls(
            image,
            contiguous(linear, (256,), np.float32),
            None if white is None else contiguous(white, (height, width), np.float32),
            None if shift is None else contiguous(shift, (height, width, 2), np.float32),
        )


class Edges(NamedTuple):
    """Half sides of the drawing's squares and radii of its circles, mm."""

    squares: tuple[float, ...]
    circles: tuple[float, ...]


class SamplingRules(NamedTuple):
    """Limits of the sampling.

    Attributes:
        reach: half side of the sampled square, mm.
        band: distance from an edge within which a pixel is near it, mm.
        at_most: approximate number of pixels.
        near_share: share of them near edges; 0 thins evenly.
        noise: standard deviation of the code values over 255.
        floor: least variance.
        paper: half side of the square that is certainly paper, mm; around the face, pixels are not used if a standard
            deviation of the point spread extends beyond it.
    """

    reach: float
    band: float
    at_most: int
    near_share: float
    noise: float
    floor: float = 1e-8
    paper: float = 1e6


class Taken(NamedTuple):
    """The chosen pixels.

    Attributes:
        at: (2,N) positions relative to the view's origin.
        values: (3,N).
        light: (N,) what they were divided by.
        variance: (N,).
        cells: (N,) place in a cell of 2 x 2 pixels: row modulo 2 times 2, plus column modulo 2.
    """

    at: Float32Array
    values: Float32Array
    light: Float32Array
    variance: Float32Array
    cells: Float32Array


def sample(
    source: Source, view: View, state: FloatArray, box: tuple[int, int, int, int], edges: Edges, rules: SamplingRules
) -> Taken:
    """Pixels of a box x0, y0, x1, y1 (exclusive) inside the landmark.

    Raises:
        ValueError: the box reaches beyond the image.
    """
    height, width = source.image.shape[:2]
    x0, y0, x1, y1 = box
    if not (0 <= x0 <= x1 <= width and 0 <= y0 <= y1 <= height):
        raise ValueError(f"box {box} in an image of {width}x{height}")
    kernel = _kernel()
    if kernel is None:
        return sample_numpy(source, view, state, box, edges, rules)
    step = _step(box, rules.at_most)
    capacity = int(1.2 * rules.at_most) + 64
    planes = np.empty((9, capacity), np.float32)
    kinds = np.empty(((x1 - x0) // step + 2) * (y1 - y0) + 1, np.uint8)
    count = np.zeros(1, np.int64)
    state, flat = contiguous(state, (STATE,)), view.flat
    corners, known = np.array([x0, y0, x1, y1, step]), np.array([*edges.squares, *edges.circles], np.float32)
    numbers = np.array(rules, np.float64)
    arrays = addresses(*source, flat, state, corners, known)
    planes_at = [address(planes) + 4 * capacity * k for k in (0, 2, 5, 6, 7, 8)]
    shapes = (len(edges.squares), len(edges.circles))
    kernel(height, width, *arrays, *shapes, *addresses(numbers, kinds), capacity, *planes_at, address(count))
    n = int(count[0])
    kept = np.ascontiguousarray(planes[:8, :n])
    return Taken(kept[:2], kept[2:5], *kept[5:])


def sample_numpy(
    source: Source, view: View, state: FloatArray, box: tuple[int, int, int, int], edges: Edges, rules: SamplingRules
) -> Taken:
    """Definition of :func:`sample`."""
    x0, y0, x1, y1 = box
    step = _step(box, rules.at_most)
    along = (step * 618 + 500) // 1000
    rows, columns = np.mgrid[y0:y1, x0:x1]
    visited = (columns - rows * along) % step == 0
    x, y = columns[visited], rows[visited]
    at = np.column_stack([x, y]) - view.origin
    if source.shift is not None:
        at = at + source.shift[y, x]
    plane, spread = plane_numpy(view, state, at)[:2] if len(at) else (np.zeros((0, 2)), np.zeros((0, 3)))
    square, radius = np.abs(plane).max(axis=1), np.hypot(plane[:, 0], plane[:, 1])
    gaps = [np.abs(square - half) for half in edges.squares] + [np.abs(radius - r) for r in edges.circles]
    spread_to = (np.abs(plane) + np.sqrt(spread[:, [0, 2]])).max(axis=1)
    inside = square < np.where(spread_to < rules.paper, rules.reach, view.half_mm)
    kind = np.where(inside, 1 + (np.min(gaps, axis=0) < rules.band), 0)
    total = int(inside.sum())
    chosen = np.zeros(len(at), dtype=bool)
    if total > rules.at_most and rules.near_share > 0:
        for which, share in ((1, 1 - rules.near_share), (2, rules.near_share)):
            of_kind = kind == which
            chosen |= of_kind & _evenly(x, y, rules.at_most * share / max(int(of_kind.sum()), 1))
    else:
        chosen = inside & _evenly(x, y, rules.at_most / max(total, 1))
    x, y, at = x[chosen], y[chosen], at[chosen]
    light = np.zeros(len(x)) if source.white is None else source.white[y, x].astype(np.float64)
    light[light <= 0] = 1.0
    values = source.linear[source.image[y, x]] / light[:, None]
    variance, cells = value_variance(values, light, rules), y % 2 * 2 + x % 2
    return Taken(*(np.ascontiguousarray(a, np.float32) for a in (at.T, values.T, light, variance, cells)))


def value_variance(values: FloatArray, light: FloatArray, rules: SamplingRules) -> FloatArray:
    """(N,) expected variance of (N,3) linear-light values over ``light``: noise through the tone curve.

    A floor of 1.5 % of the brightest values covers errors of the models of tone and print.
    """
    if len(values) == 0:
        return np.zeros(0)
    bright = values.mean(axis=1)
    # d linear / d code of a 2.2 gamma.
    slope = 2.2 * np.maximum(bright * light, 1e-3) ** (1 - 1 / 2.2) / light
    return np.asarray((slope * rules.noise) ** 2 + (0.015 * np.percentile(bright, 95)) ** 2 + rules.floor)


def _evenly(x: NDArray[np.int64], y: NDArray[np.int64], share: float) -> NDArray[np.bool_]:
    """(N,) True for about this share of the pixels, without the pattern of a regular stride."""
    limit = int(share * 4294967295.0) if share < 1 else 4294967295
    return np.asarray((x * ALONG + y * DOWN) % 2**32 <= limit)


def _step(box: tuple[int, int, int, int], at_most: int) -> int:
    """Step between examined pixels of a row: large landmarks have more pixels than needed."""
    x0, y0, x1, y1 = box
    step = (x1 - x0) * (y1 - y0) // (VISITED * max(at_most, 1))
    return next((even for even in EVEN_STEPS if even >= step), step)


@lru_cache(maxsize=1)
def _kernel() -> Any:
    p, n = ctypes.c_void_p, ctypes.c_int64
    return function("lmkit_sample_pixels", n, n, *[p] * 8, n, n, p, p, n, *[p] * 7)
