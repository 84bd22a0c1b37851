"""PixelSamples of an image that tell about a landmark: which ones, and their values."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.detection.linear_image import LinearImage, rebend, unbend
from lmkit.geometry.homography import homography_from_points, transform_points
from lmkit.model.landmark import LandmarkFamily

MAX_PIXELS = 1500


EDGE_BAND_PX = 3.0


@dataclass(frozen=True)
class Registration:
    """Where the pattern lies and how it is blurred.

    Attributes:
        corners: (4,2) px of the picture freed of distortion and bend.
        spread: (3,) covariance of the point spread, xx xy yy, px^2.
        bend: radial bend, see :func:`unbend`.
        shading: (2,) relative change of the light from the middle to the right and the upper edge.
        bleed: how much brighter blends of inks are than linear light would make them, see :func:`blending`.
        weighted_error: sum of squared residuals over their expected variance, per value.
        covariance: (9,9) of corners and bend, or None before the last step.
    """

    corners: FloatArray
    spread: FloatArray
    bend: float = 0.0
    shading: FloatArray = field(default_factory=lambda: np.zeros(2))
    bleed: float = 0.0
    weighted_error: float = np.inf
    covariance: FloatArray | None = None


@dataclass(frozen=True)
class PixelSamples:
    """The pixels that a registration looks at.

    Attributes:
        at: (N,2) positions, px, freed of the lens's distortion where that is known.
        values: (N,3) BGR in linear light.
        light: (N,) what the values were divided by to take shadows out.
        variance: (N,) expected variance of a value, up to a common factor.
        prior_weight: that factor, so that priors weigh as they should against the values.
    """

    at: FloatArray
    values: FloatArray
    light: FloatArray
    variance: FloatArray
    prior_weight: float = 10.0


def sample_pixels(
    picture: LinearImage,
    registration: Registration,
    family: LandmarkFamily,
    at_most: int = MAX_PIXELS,
    near_edges: bool = True,
) -> PixelSamples | None:
    """The pixels of the face and the inner part of its margin, thinned to about ``at_most``.

    Those ``near_edges`` of the drawing show the place best; evenly thinned ones stand a bad start better.

    None when too little of the landmark lies inside the picture.
    """
    H = homography_from_points(family.corners_mm, registration.corners)
    reach = family.half_mm + 0.7 * family.margin_mm
    outline = transform_points(H, family.corners_mm * (reach / family.half_mm))
    height, width = picture.linear.shape[:2]
    if not (np.abs(outline) < 10 * max(height, width)).all():
        return None
    outline = picture.distorted(rebend(outline, registration.bend, picture.centre, picture.half_width))
    x0, y0 = np.maximum(np.floor(outline.min(axis=0)).astype(int), 0)
    x1, y1 = np.minimum(np.ceil(outline.max(axis=0)).astype(int) + 1, [width, height])
    if x1 - x0 < 6 or y1 - y0 < 6:
        return None
    y, x = np.mgrid[y0:y1, x0:x1]
    whole = np.column_stack([x.ravel(), y.ravel()])
    at = picture.straightened(whole.astype(np.float64))
    plane = transform_points(np.linalg.inv(H), unbend(at, registration.bend, picture.centre, picture.half_width))
    inside = (np.abs(plane) < reach).all(axis=1)
    at, whole = at[inside], whole[inside]
    if len(at) < 40:
        return None
    if len(at) > at_most:
        px_per_mm = mean_side(registration.corners) / family.side_mm
        chosen = _informative(plane[inside], px_per_mm, family, at_most) if near_edges else _evenly(len(at), at_most)
        at, whole = at[chosen], whole[chosen]
    values = picture.linear[whole[:, 1], whole[:, 0]].astype(np.float64)
    light = picture.light_at(whole)
    return PixelSamples(at, values, light, value_variance(values, light, picture.noise))


def _informative(plane: FloatArray, px_per_mm: float, family: LandmarkFamily, at_most: int) -> FloatArray:
    """Indices of so many of the points: four of five near an edge of the drawing, where the position shows."""
    square = np.abs(plane).max(axis=1)
    radius = np.hypot(plane[:, 0], plane[:, 1])
    edges = [np.abs(square - half) for half in (family.half_mm, family.ground_half_mm)]
    edges += [np.abs(radius - r) for ring in family.rings for r in (ring.inner_mm, ring.outer_mm)]
    near = np.min(edges, axis=0) * px_per_mm < EDGE_BAND_PX
    chosen = []
    for indices, count in ((np.flatnonzero(near), 4 * at_most // 5), (np.flatnonzero(~near), at_most // 5)):
        chosen.append(indices[_evenly(len(indices), count)])
    return np.sort(np.concatenate(chosen))


def _evenly(n: int, count: int) -> FloatArray:
    """(n,) True for about ``count``: a fixed low-discrepancy choice, without the comb of a regular stride."""
    golden = np.modf(np.arange(n) * 0.6180339887498949)[0]
    return np.asarray(golden < count / max(n, 1))


def value_variance(values: FloatArray, light: FloatArray, noise: float) -> FloatArray:
    """(N,) expected variance of linear-light values over ``light``: the code values' noise through the tone curve.

    A floor stands for what no model of tone and print explains, 1 % of the brightest value.
    """
    bright = values.mean(axis=1)
    # d linear / d code of a 2.2 gamma.
    slope = 2.2 * np.maximum(bright * light, 1e-3) ** (1 - 1 / 2.2) / light
    return np.asarray((slope * noise) ** 2 + (0.015 * np.percentile(bright, 95)) ** 2 + 1e-8)


def mean_side(corners: FloatArray) -> float:
    """Mean length of the sides of (4,2) corners."""
    return float(np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).mean())
