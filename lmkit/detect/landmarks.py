"""`detect_landmarks`: the steps in order (docs/landmark.md, section 6)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from lmkit.arrays import ByteArray, FloatArray
from lmkit.detect.accept import AcceptanceRule, Verdict, read_square
from lmkit.detect.candidates import find_candidates
from lmkit.detect.picture import Picture
from lmkit.detect.refine import Reading, Registrar, Registration, take_pixels
from lmkit.detect.screen import align_candidates, linear_pyramid, screen_candidates
from lmkit.errors import InputError
from lmkit.model.camera import CameraModel
from lmkit.model.landmark import LM8, LandmarkFamily
from lmkit.model.observation import LandmarkObservation
from lmkit.model.palette import srgb_to_linear

_LINEAR = srgb_to_linear(np.arange(256) / 255).astype(np.float32)


ALIGN_ROUNDS = 3
READ_ROUNDS = 3
REGISTER_STEPS = 5
COARSE_SIDE_PX = 100.0
COARSE_PX = 0.05
COARSE_PIXELS = 600  # enough to read and to find the place; the last steps take more
BEND_SIDE_PX = 40.0  # smaller landmarks do not show the lens's bend


@dataclass(frozen=True)
class DetectOptions:
    """The few dials of detection.

    Attributes:
        family: which landmarks to look for.
        min_pattern: candidates whose pattern explains less than this share are not aligned.
        max_aligned: at most so many are, best first.
        min_aligned_pattern: those that explain less than this once aligned are not registered.
        max_registered: at most so many are, best first; bounds the time on cluttered pictures.
        rule: what a landmark must show.
        through_lens: the picture comes through a lens, so straight edges may be bent; off for scans and
            rasterised pages.
        camera: the camera that took the picture, if it is calibrated: its own distortion then takes the
            place of a guessed bend.
    """

    family: LandmarkFamily = LM8
    min_pattern: float = 0.04
    max_aligned: int = 100
    min_aligned_pattern: float = 0.2
    max_registered: int = 24
    rule: AcceptanceRule = field(default_factory=AcceptanceRule)
    through_lens: bool = True
    camera: CameraModel | None = None


@dataclass(frozen=True)
class Attempt:
    """One candidate that was registered and read, accepted or not.

    Attributes:
        corners: (4,2) px of the picture, in the landmark's order.
        covariance: (8,8) of the corners, px^2.
        verdict: what it reads as.
        rejected: why it is no landmark; None where it is one.
    """

    corners: FloatArray
    covariance: FloatArray
    verdict: Verdict
    rejected: str | None


def detect_landmarks(image: ByteArray, options: DetectOptions | None = None) -> list[LandmarkObservation]:
    """All landmarks of a picture, largest first.

    Args:
        image: (H,W,3) BGR, 8 bit, as `formats.images.read_image` gives it.
    """
    options = options or DetectOptions()
    accepted = [a for a in attempt_landmarks(image, options) if a.rejected is None]
    accepted.sort(key=lambda a: (-a.verdict.margin, a.verdict.code))
    kept: list[Attempt] = []
    for attempt in accepted:
        middle = attempt.corners.mean(axis=0)
        apart = [np.linalg.norm(middle - k.corners.mean(axis=0)) > 0.5 * _mean_side(k.corners) for k in kept]
        if all(apart):
            kept.append(attempt)
    kept.sort(key=lambda a: -_mean_side(a.corners))
    return [
        LandmarkObservation(
            code=a.verdict.code,
            corners=a.corners,
            confidence=a.verdict.confidence,
            margin=a.verdict.margin,
            family=options.family.name,
            covariance=a.covariance,
        )
        for a in kept
    ]


def attempt_landmarks(image: ByteArray, options: DetectOptions) -> list[Attempt]:
    """Everything that was registered and read, with the reasons of what was rejected."""
    family = options.family
    _check_picture(image, options)
    picture = Picture(_LINEAR[image], estimate_noise(image), options.camera)
    pyramid = linear_pyramid(picture.linear)
    screened = screen_candidates(pyramid, find_candidates(image), family)
    screened = screened.best_first(options.min_pattern, per_place=2, at_most=options.max_aligned)
    aligned = align_candidates(pyramid, screened.quads, family, ALIGN_ROUNDS)
    aligned = aligned.best_first(options.min_aligned_pattern, per_place=2, at_most=options.max_registered)
    aligned = align_candidates(pyramid, aligned.quads, family, ALIGN_ROUNDS)
    aligned = aligned.best_first(options.min_aligned_pattern, per_place=1, at_most=options.max_registered)
    registrar = Registrar(picture, family)
    attempts = (_register_and_read(registrar, quad, options) for quad in aligned.quads)
    return [attempt for attempt in attempts if attempt is not None]


def _settled_coarsely(registrar: Registrar, quad: FloatArray) -> FloatArray:
    """A large quad registered in a smaller picture first: its corners are then good to a pixel or so."""
    shrink = int(_mean_side(quad) // COARSE_SIDE_PX)
    if shrink < 2:
        return quad
    small = Registrar(registrar.picture.shrunk(shrink), registrar.family)
    # Pixel k of the smaller picture covers the span [k, k + 1) * shrink of the larger one.
    start = Registration((quad + 0.5) / shrink - 0.5, np.array([2.0, 0.0, 2.0]))
    pixels = take_pixels(small.picture, start, small.family)
    if pixels is None:
        return quad
    verdict = read_square(small, start, pixels)
    if not verdict.promising:
        return quad
    reading = Reading.of(small.family, verdict.code, verdict.quarter)
    settled = small.register(start, pixels, reading, 2 * REGISTER_STEPS)
    return (settled.corners + 0.5) * shrink - 0.5


def _register_and_read(registrar: Registrar, quad: FloatArray, options: DetectOptions) -> Attempt | None:
    family, picture = registrar.family, registrar.picture
    quad = picture.straightened(_settled_coarsely(registrar, quad))
    side = _mean_side(quad)
    fit_bend = options.through_lens and options.camera is None and side > BEND_SIDE_PX
    # The blur starts generous, so that a wrong corner still feels its edge.
    blur = max(0.8, 0.012 * min(side, COARSE_SIDE_PX)) ** 2
    registration = Registration(quad, np.array([blur, 0.0, blur]))
    pixels = take_pixels(picture, registration, family, COARSE_PIXELS, near_edges=False)
    if pixels is None:
        return None
    verdict = read_square(registrar, registration, pixels)
    if not verdict.promising:
        return None
    # Register what was read, read again, until the reading stands.
    for _ in range(READ_ROUNDS):
        reading = Reading.of(family, verdict.code, verdict.quarter)
        for _ in range(2):
            discounted = registrar.discounted(registration, pixels, reading)
            registration = registrar.register(registration, discounted, reading, REGISTER_STEPS, to_px=COARSE_PX)
        pixels = take_pixels(picture, registration, family, COARSE_PIXELS, near_edges=False)
        if pixels is None:
            return None
        # Read with the plain weights: discounting what does not fit the last reading would make it
        # confirm itself.
        previous, verdict = verdict, read_square(registrar, registration, pixels)
        if (verdict.code, verdict.quarter) == (previous.code, previous.quarter):
            break
    if not verdict.promising:
        return None
    # Now with all pixels that help.
    pixels = take_pixels(picture, registration, family)
    if pixels is None:
        return None
    reading = Reading.of(family, verdict.code, verdict.quarter)
    for _ in range(2):
        discounted = registrar.discounted(registration, pixels, reading)
        registration = registrar.register(registration, discounted, reading, REGISTER_STEPS, fit_bend)
    verdict = read_square(registrar, registration, pixels)
    reading = Reading.of(family, verdict.code, verdict.quarter)
    discounted = registrar.discounted(registration, pixels, reading)
    # A bit that only what hides the landmark speaks for loses its margin under the discount.
    wary = read_square(registrar, registration, discounted)
    if (wary.code, wary.quarter) == (verdict.code, verdict.quarter):
        code_margin = min(verdict.code_margin, wary.code_margin)
        turn_margin = min(verdict.turn_margin, wary.turn_margin)
    else:
        code_margin = turn_margin = 0.0
    verdict = replace(verdict, code_margin=code_margin, turn_margin=turn_margin)
    registration = registrar.with_covariance(registration, discounted, reading, fit_bend)
    corners, covariance = registrar.picture_corners(registration)
    order = (np.arange(4) + verdict.quarter) % 4
    rows = (2 * order[:, None] + np.arange(2)).ravel()
    height, width = picture.linear.shape[:2]
    inside = bool(((corners >= -0.5) & (corners <= np.array([width, height]) - 0.5)).all())
    # A corner that is not in the picture was not seen, and none is made up.
    rejected = verdict.reason_to_reject(options.rule) if inside else "cut"
    return Attempt(corners[order], covariance[np.ix_(rows, rows)], verdict, rejected)


def _check_picture(image: ByteArray, options: DetectOptions) -> None:
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise InputError(
            "bad_picture",
            f"a picture of shape {image.shape} and type {image.dtype} cannot be searched",
            "give (height, width, 3) BGR of 8 bit; lmkit.formats.images.read_image makes that of any file",
        )
    size = (image.shape[1], image.shape[0])
    if options.camera is not None and options.camera.image_size != size:
        raise InputError(
            "camera_size",
            "the picture is {}x{}, the camera {}x{}".format(*size, *options.camera.image_size),
            "use pictures of the size that was calibrated",
        )


def is_colourless(image: ByteArray) -> bool:
    """All three channels the same: a grey picture, in which red and blue cannot be told apart."""
    return bool(np.array_equal(image[:, :, 0], image[:, :, 1]) and np.array_equal(image[:, :, 1], image[:, :, 2]))


def estimate_noise(image: ByteArray) -> float:
    """Standard deviation of the picture's noise over 255, from its smoothest half (Immerkaer 1996)."""
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], dtype=np.float32)
    response = np.abs(cv2.filter2D(grey, cv2.CV_32F, kernel))
    return float(np.median(response)) / 0.6745 / 6 / 255


def _mean_side(quad: FloatArray) -> float:
    return float(np.linalg.norm(np.roll(quad, -1, axis=0) - quad, axis=1).mean())
