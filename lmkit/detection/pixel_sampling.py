"""The pixels that a registration uses."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lmkit.arrays import Float32Array, FloatArray
from lmkit.detection.linear_image import LinearImage
from lmkit.kernels.pixel_sampling import Edges, SamplingRules, sample
from lmkit.kernels.plane import View, distorted_numpy, homography_numpy
from lmkit.kernels.registration import Samples
from lmkit.model.families import MarkerFamily
from lmkit.model.square_marker import SquareMarkerFamily

MAX_PIXELS = 1500
EDGE_BAND_PX = 3.0
NEAR_SHARE = 0.8  # share of pixels near edges, if these are preferred
LEAST_PIXELS = 40
DISTORTION = 11  # its place in the state


@dataclass
class PixelSamples:
    """The pixels that a registration uses, with their weights.

    Attributes:
        at: (2,N) positions relative to the view's origin, px, undistorted if the lens is known.
        values: (3,N) BGR in linear light.
        light: (N,) divisor of the values in a shadow-normalized image.
        noise_variance: (N,) expected variance of a value by the image's noise, up to a common factor.
        cells: (N,) place in a cell of 2 x 2 pixels; see :mod:`lmkit.kernels.mosaic`.
        variance: (N,) that of the noise, enlarged where the model does not fit.
        prior_weight: the common factor, to weight priors consistently with the values.
    """

    at: Float32Array
    values: Float32Array
    light: Float32Array
    noise_variance: Float32Array
    cells: Float32Array
    variance: Float32Array
    prior_weight: float = 10.0

    def weigh_channels(self, weights: tuple[float, float, float]) -> None:
        """Multiply the values of blue, green and red by these."""
        self.values = np.array(weights, dtype=np.float32)[:, None] * self.values

    @property
    def plain(self) -> Samples:
        """Weighted by the image's noise alone."""
        return Samples(self.at, self.values, self.noise_variance)

    @property
    def weighted(self) -> Samples:
        """With down-weighted outliers."""
        return Samples(self.at, self.values, self.variance)


def sample_pixels(
    image: LinearImage,
    view: View,
    state: FloatArray,
    family: MarkerFamily,
    at_most: int = MAX_PIXELS,
    near_edges: bool = True,
) -> PixelSamples | None:
    """The pixels of the face and the inner part of its margin, thinned to about ``at_most``.

    Pixels ``near_edges`` of the drawing determine the position best; uniform samples tolerate a worse start.

    None when too little of the landmark lies inside the image.
    """
    reach = reach_of(family)
    box = _bounding_box(image, view, state, reach / family.half_mm)
    if box is None:
        return None
    band = EDGE_BAND_PX * family.side_mm / mean_side(state[:8].reshape(4, 2))
    near_share, paper = NEAR_SHARE if near_edges else 0.0, paper_of(family)
    rules = SamplingRules(reach, band, at_most, near_share, image.pixel_error, paper=paper)
    taken = sample(image.straight_source, view, state, box, edges_of(family), rules)
    if taken.at.shape[1] < LEAST_PIXELS:
        return None
    return PixelSamples(*taken, variance=taken.variance)


def mean_side(corners: FloatArray) -> float:
    """Mean length of the sides of (4,2) corners."""
    a, b, c, d = corners.tolist()
    return (math.dist(a, b) + math.dist(b, c) + math.dist(c, d) + math.dist(d, a)) / 4


def middle_of(corners: FloatArray) -> tuple[float, float]:
    """Mean of (4,2) corners; plain numbers take a quarter of the time of arrays."""
    (ax, ay), (bx, by), (cx, cy), (dx, dy) = corners.tolist()
    return (ax + bx + cx + dx) / 4, (ay + by + cy + dy) / 4


def _bounding_box(
    image: LinearImage, view: View, state: FloatArray, scale: float
) -> tuple[int, int, int, int] | None:
    """x0, y0, x1, y1 of the landmark, ``scale`` times its face, within the image."""
    (a, b, c), (d, e, f), (g, h, i) = homography_numpy(state[:8].reshape(4, 2), view.half_mm).tolist()
    far = view.half_mm * scale
    width, height = image.size
    outline = []
    for x, y in ((-far, far), (far, far), (far, -far), (-far, -far)):
        w = g * x + h * y + i
        if w <= 0:
            return None
        outline.append(((a * x + b * y + c) / w, (d * x + e * y + f) / w))
    if not all(abs(v) < 10 * max(height, width) for point in outline for v in point):
        return None
    if image.camera is not None or state[DISTORTION] != 0.0:
        flat = distorted_numpy(view, float(state[DISTORTION]), np.array(outline))
        outline = image.distorted(flat).tolist()
    xs, ys = zip(*outline, strict=True)
    x0, y0 = max(math.floor(min(xs)), 0), max(math.floor(min(ys)), 0)
    x1, y1 = min(math.ceil(max(xs)) + 1, width), min(math.ceil(max(ys)) + 1, height)
    return (x0, y0, x1, y1) if x1 - x0 >= 6 and y1 - y0 >= 6 else None


def reach_of(family: MarkerFamily) -> float:
    """Half side of the square that pixels are taken from, mm."""
    return family.half_mm + 0.7 * family.margin_mm


def paper_of(family: MarkerFamily) -> float:
    """Half side of the square that is certainly paper, mm; square markers have no such requirement (decision 47)."""
    return math.inf if isinstance(family, SquareMarkerFamily) else family.half_mm + family.margin_mm


@lru_cache(maxsize=16)
def edges_of(family: MarkerFamily) -> Edges:
    """Edges of a family's drawing."""
    if isinstance(family, SquareMarkerFamily):
        return Edges((family.half_mm,), ())
    radii = tuple(radius for ring in family.rings for radius in (ring.inner_mm, ring.outer_mm))
    return Edges((family.half_mm, family.ground_half_mm), radii)
