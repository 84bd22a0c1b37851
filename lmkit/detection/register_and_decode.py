"""One candidate: registered and decoded alternately until its code is stable; then accepted or rejected."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lmkit.arrays import ByteArray, FloatArray
from lmkit.detection.acceptance import AcceptanceRule, ScoredReading
from lmkit.detection.config import DetectOptions
from lmkit.detection.covering import covering_margin
from lmkit.detection.decoding import Decoding, cautious, cautious_decoding_of, tables_of
from lmkit.detection.fit_steps import COARSE_PIXELS, COARSE_SIDE_PX, START, FitSteps, compiled_fit
from lmkit.detection.linear_image import LinearImage
from lmkit.detection.pixel_sampling import mean_side
from lmkit.detection.registration import PatternRegistration, blur_of
from lmkit.detection.rivals import rival_margin
from lmkit.kernels import landmark_fit
from lmkit.kernels.landmark_fit import Fitted
from lmkit.kernels.registration import Steps
from lmkit.model.landmark import LandmarkFamily
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.observation import Detection

SHARP = Steps(rounds=0, most=5, to_px=0.01)  # nothing hides a rasterized page
FROM_FAR = Steps(rounds=0, most=10, to_px=0.05)
HOPELESS = 2.5  # log odds below the rule's from which modeling the shadow's edge no longer helps
DISTORTION_SIDE_PX = 25.0  # smaller landmarks do not determine the lens's distortion
# For every quarter turn, the corners in the landmark's own order, and rows and columns of their covariance.
_ORDER = tuple((np.arange(4) + quarter) % 4 for quarter in range(4))
_ROWS = tuple(np.ix_(rows, rows) for rows in ((2 * order[:, None] + np.arange(2)).ravel() for order in _ORDER))


@dataclass(frozen=True)
class Candidate:
    """One candidate that was registered and decoded, accepted or rejected.

    Attributes:
        family: the family as which it was read.
        corners: (4,2) px of the image, in the landmark's order.
        covariance: (8,8) of the corners, px^2.
        reading: its decoding and score.
        rejected: reason of the rejection; None if it is accepted.
    """

    family: LandmarkFamily
    corners: FloatArray
    covariance: FloatArray
    reading: ScoredReading
    rejected: str | None

    @property
    def decoding(self) -> Decoding:
        """Decoding of the square."""
        return self.reading.decoding

    @property
    def log_odds(self) -> float:
        """Score of being a landmark with this code."""
        return self.reading.log_odds

    @property
    def confidence(self) -> float:
        """Probability that a landmark is here and the code right, 0..1."""
        return 1 / (1 + math.exp(-min(max(self.log_odds, -30.0), 30.0)))

    @cached_property
    def side_px(self) -> float:
        """Mean length of its sides."""
        return mean_side(self.corners)

    @property
    def observation(self) -> Detection:
        """The candidate as a detection."""
        return Detection(
            id=LandmarkId(self.family.name, self.decoding.code),
            corners=self.corners,
            confidence=self.confidence,
            margin=self.decoding.margin,
            covariance=self.covariance,
        )


def register_all(
    image: LinearImage, quads: FloatArray, family: LandmarkFamily, options: DetectOptions
) -> list[Candidate]:
    """Candidates of (N,4,2) squares, as :func:`register_and_decode` of each, without None."""
    if image.white is not None or not landmark_fit.is_compiled():
        found = (register_and_decode(image, quad, family, options) for quad in quads)
        return [candidate for candidate in found if candidate is not None]
    if len(quads) == 0:
        return []
    coarse = np.array([_coarse_corners(image, quad, family, options) for quad in quads])
    quads = image.straightened(coarse.reshape(-1, 2)).reshape(-1, 4, 2)
    fits_distortion = options.through_lens and options.camera is None
    fit = compiled_fit(image, family, options.config.pixels)
    fitted = fit.run_all(quads, DISTORTION_SIDE_PX if fits_distortion else math.inf)
    return [_candidate_of(image, one, family, options) for one in fitted]


def register_and_decode(
    image: LinearImage, quad: FloatArray, family: LandmarkFamily, options: DetectOptions
) -> Candidate | None:
    """Register and decode a candidate alternately until its code is stable; None if it is not promising."""
    quad = image.straightened(_coarse_corners(image, quad, family, options))
    side = mean_side(quad)
    fit_distortion = options.through_lens and options.camera is None and side > DISTORTION_SIDE_PX
    blur = max(START.least_blur, START.blur_share * min(side, START.blurred_side))
    fit = PatternRegistration(image, family, quad, blur**2)
    steps = FitSteps(options.config.pixels, fit_distortion)
    if not steps.read(fit):
        return None
    if image.white is not None:
        if _reading(fit, fit.decoding, fit.corners).log_odds < options.rule.least_log_odds - HOPELESS:
            return None
        steps.sharpen_shadow(fit)
    if not steps.finish(fit):
        return None
    return _candidate(fit, cautious(fit.decoding, fit.robust_decoding), options, fit_distortion)


def read_landmark_at(image: ByteArray, corners: FloatArray, family: LandmarkFamily) -> Candidate | None:
    """Read the landmark at known corners of a sharp image, such as a rasterized page.

    Args:
        image: (H,W,3) BGR, 8 bit.
        corners: (4,2) px, clockwise as seen, good to a few hundredths of the side.

    Returns:
        None if too little of it is inside the image.
    """
    fit = PatternRegistration(LinearImage.of(image), family, corners, 0.3)
    if not fit.sample(COARSE_PIXELS, near_edges=True):
        return None
    fit.decode()
    fit.register(SHARP)
    return _candidate(fit, fit.decode(), DetectOptions(), fit_distortion=False)


def _coarse_corners(
    image: LinearImage, quad: FloatArray, family: LandmarkFamily, options: DetectOptions
) -> FloatArray:
    """Corners of a large quad, first registered in a smaller image, accurate to about a pixel."""
    times = int(math.log2(max(mean_side(quad) / COARSE_SIDE_PX, 1.0)))
    if times < 1:
        return quad
    scale = 2.0**times
    # Pixel k of the smaller image covers the span [k, k + 1) * scale of the larger one.
    fit = PatternRegistration(image.halved(times), family, (quad + 0.5) / scale - 0.5, 2.0)
    if not fit.sample(COARSE_PIXELS, near_edges=True) or not fit.decode().is_promising:
        return quad
    fit.register(FROM_FAR)
    return (fit.corners + 0.5) * scale - 0.5


def _candidate(
    fit: PatternRegistration, decoding: Decoding, options: DetectOptions, fit_distortion: bool
) -> Candidate:
    corners, covariance = fit.image_corners(fit_distortion)
    reading = _against_other_codes(_reading(fit, decoding, corners), fit.image, fit.family, fit.state, options)
    return _in_own_order(fit.image, fit.family, corners, covariance, reading, options.rule)


def _candidate_of(image: LinearImage, found: Fitted, family: LandmarkFamily, options: DetectOptions) -> Candidate:
    decoding = cautious_decoding_of(tables_of(family), found.plain, found.robust, found.pixels)
    reading = ScoredReading(decoding, mean_side(found.corners), blur_of(found.state), is_shaded=False)
    reading = _against_other_codes(reading, image, family, found.state, options)
    return _in_own_order(image, family, found.corners, found.covariance, reading, options.rule)


def _against_other_codes(
    reading: ScoredReading, image: LinearImage, family: LandmarkFamily, state: FloatArray, options: DetectOptions
) -> ScoredReading:
    """An acceptable reading with its margins over other codes.

    Rivals are fitted if the reading is doubtful; codes behind an object are tested if an object is seen.
    """
    least, pixels = options.rule.least_log_odds, options.config.pixels
    if reading.log_odds >= least and reading.is_doubtful:
        reading = reading.compared(rival_margin=rival_margin(image, family, state, reading.decoding, pixels))
    if reading.log_odds >= least and reading.shows_object:
        reading = reading.compared(covering_margin=covering_margin(image, family, state, reading.decoding, pixels))
    return reading


def _in_own_order(
    image: LinearImage,
    family: LandmarkFamily,
    corners: FloatArray,
    covariance: FloatArray,
    reading: ScoredReading,
    rule: AcceptanceRule,
) -> Candidate:
    """The candidate, its corners in the landmark's own order."""
    quarter, (width, height) = reading.decoding.quarter, image.size
    inside = all(-0.5 <= x <= width - 0.5 and -0.5 <= y <= height - 0.5 for x, y in corners.tolist())
    # Corners outside the image are not observed, and are not extrapolated.
    rejected = reading.reason_to_reject(rule) if inside else "cut"
    return Candidate(family, corners[_ORDER[quarter]], covariance[_ROWS[quarter]], reading, rejected)


def _reading(fit: PatternRegistration, decoding: Decoding, corners: FloatArray) -> ScoredReading:
    return ScoredReading(decoding, mean_side(corners), fit.blur_px, is_shaded=fit.image.white is not None)
