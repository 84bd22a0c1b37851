"""One square marker: registered and decoded alternately until its code is stable; then accepted or rejected."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from lmkit.arrays import ByteArray, FloatArray
from lmkit.detection.config import DetectOptions
from lmkit.detection.linear_image import LinearImage
from lmkit.detection.pixel_sampling import mean_side
from lmkit.detection.registration import DrawingFit
from lmkit.detection.tag_decoding import TagDecoding, border_error_of, decode_tag, drawing_of_cells, tag_tables_of
from lmkit.kernels.landmark_fit import CornerErrors
from lmkit.kernels.registration import Steps
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.observation import Detection
from lmkit.model.square_marker import SquareMarkerFamily

READ_ROUNDS = 3
SOFT = Steps(rounds=1, most=3, to_px=0.1)
COARSE = Steps(rounds=1, most=3, to_px=0.1)
FINE = Steps(rounds=2, most=3, to_px=0.02)
SHARP = Steps(rounds=0, most=5, to_px=0.01)  # nothing hides a rasterized page
FROM_FAR = Steps(rounds=0, most=10, to_px=0.05)
COARSE_SIDE_PX = 100.0
COARSE_PIXELS = 400
DISTORTION_SIDE_PX = 40.0
MIXED_PIXEL_PRIOR = 0.1  # black and white have no color to be smoothed; what rejects open borders counts on it
# As `registration.CORNER_ERRORS`, fitted to square markers.
CORNER_ERRORS = CornerErrors(least=0.0071, few_edges=30.0, mosaic=2.0, growth=1.88, full=0.025, stretch=0.77)
LEAST_CONTRAST = 1.25  # white over black of what is worth registering


class Promise(NamedTuple):
    """Least decoding with which registration continues, much looser than the final acceptance.

    Attributes:
        pattern: least share explained by the cells; noise lowers it, so that it shows little in dim light.
        cell_error: most root mean square distance of the cells from the code's.
        margin: least log likelihood ratio against any other reading.
    """

    pattern: float
    cell_error: float
    margin: float


# Chosen on simulated scenes (benchmarks/tags.py, another seed than is reported): of squares that are read in the end,
# one in a hundred has less as it is found, none once it was moved.
FOUND, MOVED = Promise(0.05, 0.8, 4.0), Promise(0.12, 0.56, 6.0)
ANY = Promise(0.0, 1.5, 0.0)


class Clearness(NamedTuple):
    """How clear the cells of a marker must be.

    Attributes:
        cell_error: most root mean square distance of the cells from the code's.
        border_error: the same of the border's cells from black.
        squares: number of squares per photograph that are this clear, with any content.
    """

    cell_error: float
    border_error: float
    squares: float


# Counted on every second photograph, as it is, dim, enlarged, enlarged and sharpened, and cropped, whatever the cells
# show.  `benchmarks/tag_false_positives.py --calibrate` counts more kinds of the same photographs.
CLEARNESSES = (
    Clearness(0.36, 0.25, 0.35),
    Clearness(0.33, 0.25, 0.28),
    Clearness(0.33, 0.20, 0.084),
    Clearness(0.28, 0.25, 0.14),
    Clearness(0.28, 0.20, 0.044),
    Clearness(0.249, 0.25, 0.068),
    Clearness(0.249, 0.20, 0.016),
    Clearness(0.20, 0.20, 0.004),
)
MOST_FALSE = 1e-3  # markers in a photograph without markers


@dataclass(frozen=True)
class TagRule:
    """Thresholds of acceptance for a decoded square marker.

    Attributes:
        clearness: of its cells.
        false_rate: expected false positives of a photograph, see `CLEARNESSES`.
        margin: least log likelihood ratio against any other reading.
        white_over_black: least ratio of brightness.

    A share of squares with random content resembles a code by chance: the larger this share for a family,
    the clearer its cells must be.
    """

    clearness: Clearness
    false_rate: float
    margin: float = 20.0
    white_over_black: float = 1.3

    @classmethod
    def of(cls, family: SquareMarkerFamily) -> TagRule:
        """The loosest rule of a family with few enough false positives; the strictest if none has."""
        return _rule_of(family)


@lru_cache(maxsize=32)
def _rule_of(family: SquareMarkerFamily) -> TagRule:
    rules = []
    for clearness in CLEARNESSES:
        # So many cells may be all wrong if the others are perfect.
        wrong = int(family.bits**2 * clearness.cell_error**2)
        rules.append(TagRule(clearness, clearness.squares * family.chance(wrong)))
    return next((rule for rule in rules if rule.false_rate <= MOST_FALSE), rules[-1])


@dataclass(frozen=True)
class TagCandidate:
    """One square that was registered and decoded, accepted or not.

    Attributes:
        family: the family as which it was read.
        corners: (4,2) px of the image, in the marker's order.
        covariance: (8,8) of the corners, px^2.
        decoding: its decoding.
        border_error: root mean square distance of the border's cells from black.
        rejected: reason of the rejection; None if it is accepted.
    """

    family: SquareMarkerFamily
    corners: FloatArray
    covariance: FloatArray
    decoding: TagDecoding
    border_error: float
    rejected: str | None

    @cached_property
    def side_px(self) -> float:
        """Mean length of its sides."""
        return mean_side(self.corners)

    @property
    def log_odds(self) -> float:
        """Log odds that the code is right."""
        return (self.decoding.margin - 9.5) / 4.6

    @property
    def observation(self) -> Detection:
        """The candidate as a detection."""
        confidence = 1 / (1 + math.exp(min(-self.log_odds, 50.0)))
        code = LandmarkId(self.family.name, self.decoding.code)
        return Detection(code, self.corners, confidence, self.decoding.margin, self.covariance)


class TagFit(DrawingFit):
    """The fit of one square marker."""

    decoding: TagDecoding
    mixed_pixel_prior = MIXED_PIXEL_PRIOR
    corner_errors = CORNER_ERRORS

    def __init__(
        self, image: LinearImage, family: SquareMarkerFamily, corners: FloatArray, spread_px2: float, gray: bool
    ) -> None:
        self.family = family
        super().__init__(image, family, tag_tables_of(family).empty, corners, spread_px2)
        self.channel_repeats = 3 if gray else 1

    def decode(self, least: Promise) -> bool:
        """Score every code, and use the likeliest one as the drawing; False if it is not promising."""
        found = decode_tag(self.family, self.view, self.state, self.samples.plain, self.channel_repeats)
        if found is not None and self.image.is_inverted:
            found = replace(found, white=1 - found.black, black=1 - found.white)
        if found is None or found.white < LEAST_CONTRAST * found.black or found.pattern < least.pattern:
            return False
        if found.margin < least.margin or found.cell_error > least.cell_error:
            return False
        self.decoding = found
        self._draw(self.decoding.expected.astype(np.float64))
        return True

    @property
    def border_error(self) -> float:
        """Root mean square distance of the border's cells from black."""
        return border_error_of(self.family, self.view, self.state, self.samples.plain, self.decoding)

    def image_corners(self, fit_distortion: bool) -> tuple[FloatArray, FloatArray]:
        """(4,2) corners in the image as delivered, and their (8,8) covariance.

        Black and white are the same in all channels, and errors of the camera's processing at edges are equal in all
        of them. The correlation of the channels is estimated from the residuals.
        """
        left = (self.samples.values - self.discount()) / np.sqrt(self.samples.variance)
        self.channel_repeats = float(np.mean(left.sum(axis=0) ** 2) / np.mean((left**2).sum(axis=0)))
        return super().image_corners(fit_distortion)

    def draw_cells(self) -> None:
        """Draw every cell with its fitted brightness: the pose must not depend on a code that may be wrong."""
        self._draw(np.clip(self.decoding.cells, 0.0, 1.0))

    def _draw(self, white: FloatArray) -> None:
        self.drawing = drawing_of_cells(self.family, white, self.decoding.has_own_ground)


def register_and_decode_tag(
    image: LinearImage,
    quad: FloatArray,
    families: Sequence[SquareMarkerFamily],
    options: DetectOptions,
    gray: bool,
) -> TagCandidate | None:
    """The likeliest reading of a square among families; None where nothing is promising."""
    found = [_read(image, quad, family, options, gray) for family in families]
    read = [candidate for candidate in found if candidate is not None]
    return max(read, key=lambda c: (c.rejected is None, c.decoding.margin), default=None)


def read_tag_at(image: ByteArray, corners: FloatArray, family: SquareMarkerFamily) -> TagCandidate | None:
    """Read the marker at known corners of a sharp image, such as a rasterized page.

    Args:
        image: (H,W,3) BGR, 8 bit.
        corners: (4,2) px, clockwise as seen, good to a few hundredths of the side.

    Returns:
        None if too little of it is inside the image, or its content does not resemble cells.
    """
    fit = TagFit(LinearImage.of(image), family, corners, 0.3, gray=True)
    if not fit.sample(COARSE_PIXELS, near_edges=True) or not fit.decode(FOUND):
        return None
    fit.register(SHARP)
    return _candidate(fit, fit.decoding, TagRule.of(family), fit_distortion=False) if fit.decode(ANY) else None


def _read(
    image: LinearImage,
    quad: FloatArray,
    family: SquareMarkerFamily,
    options: DetectOptions,
    gray: bool,
) -> TagCandidate | None:
    quad = image.straightened(_coarse_corners(image, quad, family, gray))
    side = mean_side(quad)
    is_large = side > COARSE_SIDE_PX
    fit_distortion = options.through_lens and options.camera is None and side > DISTORTION_SIDE_PX
    fit = TagFit(image, family, quad, max(0.8, 0.012 * min(side, COARSE_SIDE_PX)) ** 2, gray)
    if not fit.sample(COARSE_PIXELS, near_edges=False) or not fit.decode(FOUND):
        return None
    fit.draw_cells()
    if is_large and not fit.sample(COARSE_PIXELS, near_edges=True):
        return None
    fit.register(SOFT)
    for _ in range(READ_ROUNDS):
        before = fit.decoding
        if not fit.sample(COARSE_PIXELS, near_edges=False) or not fit.decode(MOVED):
            return None
        if fit.decoding.is_same_code(before) and fit.decoding.cell_error < 0.2:
            break
        if fit.decoding.cell_error > 0.3:
            fit.draw_cells()
        if is_large and not fit.sample(COARSE_PIXELS, near_edges=True):
            return None
        fit.register(COARSE)
    if image.white is not None:
        fit.sharpen_shadow(COARSE_PIXELS)
    if not fit.sample(options.config.pixels, near_edges=True):
        return None
    fit.register(FINE._replace(fit_distortion=fit_distortion))
    # Pixels near the border determine the pose of a large marker; pixels all over it determine its code.
    if is_large and not fit.sample(COARSE_PIXELS, near_edges=False):
        return None
    if not fit.decode(MOVED):
        return None
    return _candidate(fit, fit.decoding, TagRule.of(family), fit_distortion)


def _coarse_corners(image: LinearImage, quad: FloatArray, family: SquareMarkerFamily, gray: bool) -> FloatArray:
    """Corners of a large quad, registered in smaller images first, from the smallest on."""
    times = int(np.log2(max(mean_side(quad) / COARSE_SIDE_PX, 1.0)))
    for halvings in range(times, 0, -1):
        small = image.halved(halvings)
        scale = np.array(image.size) / np.array(small.size)  # a last row alone is shared among the others
        fit = TagFit(small, family, (quad + 0.5) / scale - 0.5, 2.0, gray)
        if not fit.sample(COARSE_PIXELS, near_edges=False) or not fit.decode(FOUND):
            return quad
        fit.draw_cells()
        if not fit.sample(COARSE_PIXELS, near_edges=True):
            return quad
        fit.register(FROM_FAR)
        quad = np.asarray((fit.corners + 0.5) * scale - 0.5)
    return quad


def _candidate(fit: TagFit, decoding: TagDecoding, rule: TagRule, fit_distortion: bool) -> TagCandidate:
    corners, covariance = fit.image_corners(fit_distortion)
    order = (np.arange(4) + decoding.quarter) % 4
    rows = (2 * order[:, None] + np.arange(2)).ravel()
    inside = bool(((corners >= -0.5) & (corners <= np.array(fit.image.size) - 0.5)).all())
    border_error = fit.border_error
    rejected = _reason_to_reject(decoding, border_error, rule) if inside else "cut"
    return TagCandidate(fit.family, corners[order], covariance[np.ix_(rows, rows)], decoding, border_error, rejected)


def _reason_to_reject(decoding: TagDecoding, border_error: float, rule: TagRule) -> str | None:
    checks = {
        "contrast": decoding.white > rule.white_over_black * max(decoding.black, 1e-6),
        "code": decoding.margin >= rule.margin,
        "cells": decoding.cell_error <= rule.clearness.cell_error,
        "border": border_error <= rule.clearness.border_error,
    }
    return next((name for name, passed in checks.items() if not passed), None)
