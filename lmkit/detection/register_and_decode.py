"""One candidate: registered, read, registered again, until the reading stands; then accepted or not."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lmkit.arrays import ByteArray, FloatArray
from lmkit.detection.acceptance import AcceptanceRule
from lmkit.detection.config import DetectOptions
from lmkit.detection.decoding import Decoding, decode_square
from lmkit.detection.linear_image import LinearImage
from lmkit.detection.pixel_sampling import PixelSamples, Registration, mean_side, sample_pixels
from lmkit.detection.registration import CodeHypothesis, PatternRegistration
from lmkit.detection.shadows import ShadowEdge
from lmkit.model.landmark import LandmarkFamily
from lmkit.model.observation import Detection

READ_ROUNDS = 3
REGISTER_STEPS = 5
COARSE_SIDE_PX = 100.0
COARSE_PX = 0.05
COARSE_PIXELS = 600  # enough to read and to find the place; the last steps take more
BEND_SIDE_PX = 40.0  # smaller landmarks do not show the lens's bend


@dataclass(frozen=True)
class Candidate:
    """One candidate that was registered and read, accepted or not.

    Attributes:
        family: what it was read as.
        corners: (4,2) px of the picture, in the landmark's order.
        covariance: (8,8) of the corners, px^2.
        verdict: what it reads as.
        rejected: why it is no landmark; None where it is one.
    """

    family: LandmarkFamily
    corners: FloatArray
    covariance: FloatArray
    verdict: Decoding
    rejected: str | None

    @property
    def side_px(self) -> float:
        """Mean length of its sides."""
        return mean_side(self.corners)

    @property
    def observation(self) -> Detection:
        """What is told of it."""
        return Detection(
            code=self.verdict.code,
            corners=self.corners,
            confidence=self.verdict.confidence,
            margin=self.verdict.margin,
            family=self.family.name,
            covariance=self.covariance,
        )


def register_and_decode(
    picture: LinearImage, quad: FloatArray, family: LandmarkFamily, options: DetectOptions
) -> Candidate | None:
    """Register what a candidate reads as, read again, until the reading stands; None where nothing does."""
    registrar = PatternRegistration(picture, family)
    coarse = min(COARSE_PIXELS, options.effort.pixels)
    quad = picture.straightened(_settled_coarsely(registrar, quad, options))
    side = mean_side(quad)
    fit_bend = options.through_lens and options.camera is None and side > BEND_SIDE_PX
    # The blur starts generous, so that a wrong corner still feels its edge.
    blur = max(0.8, 0.012 * min(side, COARSE_SIDE_PX)) ** 2
    registration = Registration(quad, np.array([blur, 0.0, blur]))
    pixels = sample_pixels(picture, registration, family, coarse, near_edges=False)
    if pixels is None:
        return None
    verdict = decode_square(registrar, registration, pixels)
    if not verdict.is_promising(options.rule):
        return None
    # Register what was read, read again, until the reading stands.
    for _ in range(READ_ROUNDS):
        reading = CodeHypothesis.of(family, verdict.code, verdict.quarter)
        for _ in range(2):
            robust_weights = registrar.robust_weights(registration, pixels, reading)
            registration = registrar.register(registration, robust_weights, reading, REGISTER_STEPS, to_px=COARSE_PX)
        pixels = sample_pixels(picture, registration, family, coarse, near_edges=False)
        if pixels is None:
            return None
        # Read with the plain weights: discounting what does not fit the last reading would make it
        # confirm itself.
        previous, verdict = verdict, decode_square(registrar, registration, pixels)
        if (verdict.code, verdict.quarter) == (previous.code, previous.quarter):
            break
    if not verdict.is_promising(options.rule):
        return None
    if picture.white is not None:
        picture = _with_sharp_shadow(registrar, registration, pixels, verdict)
        registrar = PatternRegistration(picture, family)
    # Now with all pixels that help.
    pixels = sample_pixels(picture, registration, family, options.effort.pixels)
    if pixels is None:
        return None
    reading = CodeHypothesis.of(family, verdict.code, verdict.quarter)
    for _ in range(2):
        robust_weights = registrar.robust_weights(registration, pixels, reading)
        registration = registrar.register(registration, robust_weights, reading, REGISTER_STEPS, fit_bend)
    verdict = decode_square(registrar, registration, pixels)
    reading = CodeHypothesis.of(family, verdict.code, verdict.quarter)
    robust_weights = registrar.robust_weights(registration, pixels, reading)
    # A bit that only what hides the landmark speaks for loses its margin under the discount.
    wary = decode_square(registrar, registration, robust_weights)
    if (wary.code, wary.quarter) == (verdict.code, verdict.quarter):
        code_margin = min(verdict.code_margin, wary.code_margin)
        turn_margin = min(verdict.turn_margin, wary.turn_margin)
    else:
        code_margin = turn_margin = 0.0
    verdict = replace(verdict, code_margin=code_margin, turn_margin=turn_margin)
    registration = registrar.with_covariance(registration, robust_weights, reading, fit_bend)
    return _attempt(registrar, registration, verdict, options.rule)


def read_landmark_at(image: ByteArray, corners: FloatArray, family: LandmarkFamily) -> Candidate | None:
    """Read what stands at known corners of a sharp picture, such as a rasterised page.

    Args:
        image: (H,W,3) BGR, 8 bit.
        corners: (4,2) px, clockwise as seen, good to a few hundredths of the side.

    Returns:
        None where too little of it lies in the picture.
    """
    registrar = PatternRegistration(LinearImage.of(image), family)
    registration = Registration(corners, np.array([0.3, 0.0, 0.3]))
    pixels = sample_pixels(registrar.picture, registration, family, COARSE_PIXELS)
    if pixels is None:
        return None
    verdict = decode_square(registrar, registration, pixels)
    reading = CodeHypothesis.of(family, verdict.code, verdict.quarter)
    registration = registrar.register(registration, pixels, reading, REGISTER_STEPS)
    verdict = decode_square(registrar, registration, pixels)
    registration = registrar.with_covariance(registration, pixels, reading, fit_bend=False)
    return _attempt(registrar, registration, verdict, AcceptanceRule())


def _settled_coarsely(registrar: PatternRegistration, quad: FloatArray, options: DetectOptions) -> FloatArray:
    """A large quad registered in a smaller picture first: its corners are then good to a pixel or so."""
    shrink = int(mean_side(quad) // COARSE_SIDE_PX)
    if shrink < 2:
        return quad
    small = PatternRegistration(registrar.picture.shrunk(shrink), registrar.family)
    # Pixel k of the smaller picture covers the span [k, k + 1) * shrink of the larger one.
    start = Registration((quad + 0.5) / shrink - 0.5, np.array([2.0, 0.0, 2.0]))
    pixels = sample_pixels(small.picture, start, small.family)
    if pixels is None:
        return quad
    verdict = decode_square(small, start, pixels)
    if not verdict.is_promising(options.rule):
        return quad
    reading = CodeHypothesis.of(small.family, verdict.code, verdict.quarter)
    settled = small.register(start, pixels, reading, 2 * REGISTER_STEPS)
    return (settled.corners + 0.5) * shrink - 0.5


def _attempt(
    registrar: PatternRegistration, registration: Registration, verdict: Decoding, rule: AcceptanceRule
) -> Candidate:
    """What was read, its corners in the landmark's own order."""
    corners, covariance = registrar.picture_corners(registration)
    order = (np.arange(4) + verdict.quarter) % 4
    rows = (2 * order[:, None] + np.arange(2)).ravel()
    height, width = registrar.picture.linear.shape[:2]
    inside = bool(((corners >= -0.5) & (corners <= np.array([width, height]) - 0.5)).all())
    # A corner that is not in the picture was not seen, and none is made up.
    rejected = verdict.reason_to_reject(rule) if inside else "cut"
    return Candidate(registrar.family, corners[order], covariance[np.ix_(rows, rows)], verdict, rejected)


def _with_sharp_shadow(
    registrar: PatternRegistration, registration: Registration, pixels: PixelSamples, verdict: Decoding
) -> LinearImage:
    """The picture with the shadow taken out by one straight edge, now that the drawing is known."""
    drawn = registrar.drawn(registration, pixels, CodeHypothesis.of(registrar.family, verdict.code, verdict.quarter))
    bright = np.maximum(drawn.mean(axis=1), 1e-3)
    light = np.maximum(pixels.values.mean(axis=1), 1e-3) / bright * pixels.light
    edge = ShadowEdge.fit(registrar.picture.distorted(pixels.at), light, bright**2)
    shape = registrar.picture.linear.shape
    return registrar.picture.renormalized(edge.light((shape[0], shape[1])))
