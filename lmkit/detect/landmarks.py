"""`detect_landmarks`: the steps in order (docs/landmark.md, section 6)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import combinations

import cv2
import numpy as np

from lmkit.arrays import ByteArray, Float32Array, FloatArray
from lmkit.detect.accept import AcceptanceRule, Verdict, read_square
from lmkit.detect.candidates import FAST_SOURCES, SOURCES, Source, find_candidates
from lmkit.detect.light import ShadowEdge, crossed_by_shadow, local_white, window_for
from lmkit.detect.picture import Picture
from lmkit.detect.refine import MAX_PIXELS, Pixels, Reading, Registrar, Registration, take_pixels
from lmkit.detect.screen import (
    FULL_DETAIL_SIDE_PX,
    SECOND_LOOK,
    Look,
    align_candidates,
    areas,
    linear_pyramid,
    pyramid_level,
    screen_candidates,
)
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
SHADED_FACTOR = 1.5  # a shadow's edge has freedoms that fit other things too: margins must be so much larger
BEND_SIDE_PX = 40.0  # smaller landmarks do not show the lens's bend


@dataclass(frozen=True)
class Effort:
    """How hard to look.

    Attributes:
        sources: where squares come from.
        min_pattern: candidates whose pattern explains less than this share are not aligned.
        max_aligned: at most so many are, best first.
        look: what a candidate must show once aligned.
        min_aligned_pattern: those that explain less than this once aligned are not registered.
        max_registered: at most so many are, best first; bounds the time on cluttered pictures.
        pixels: of one landmark that are registered; more bring better corners.
        in_shadow: look again, with the light taken out, where a shadow may end on a landmark.
    """

    sources: tuple[Source, ...] = SOURCES
    min_pattern: float = 0.04
    max_aligned: int = 100
    look: Look = SECOND_LOOK
    min_aligned_pattern: float = 0.2
    max_registered: int = 24
    pixels: int = MAX_PIXELS
    in_shadow: bool = True


FAR = Effort()
FAST = Effort(sources=FAST_SOURCES, max_aligned=40, max_registered=12, pixels=500, in_shadow=False)


@dataclass(frozen=True)
class DetectOptions:
    """The few dials of detection.

    Attributes:
        families: which landmarks to look for; no two may share a drawing.
        effort: ``FAR`` reads what can be read, ``FAST`` gives up small and shaded landmarks for speed.
        rule: what a landmark must show.
        through_lens: the picture comes through a lens, so straight edges may be bent; off for scans and
            rasterised pages.
        camera: the camera that took the picture, if it is calibrated: its own distortion then takes the
            place of a guessed bend.
    """

    families: tuple[LandmarkFamily, ...] = (LM8,)
    effort: Effort = FAR
    rule: AcceptanceRule = field(default_factory=AcceptanceRule)
    through_lens: bool = True
    camera: CameraModel | None = None


@dataclass(frozen=True)
class Attempt:
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
    verdict: Verdict
    rejected: str | None

    @property
    def observation(self) -> LandmarkObservation:
        """What is told of it."""
        return LandmarkObservation(
            code=self.verdict.code,
            corners=self.corners,
            confidence=self.verdict.confidence,
            margin=self.verdict.margin,
            family=self.family.name,
            covariance=self.covariance,
        )


def detect_landmarks(image: ByteArray, options: DetectOptions | None = None) -> list[LandmarkObservation]:
    """All landmarks of a picture, largest first.

    Args:
        image: (H,W,3) BGR, 8 bit, as `formats.images.read_image` gives it.
    """
    attempts = attempt_landmarks(image, options or DetectOptions())
    return [a.observation for a in best_of_each_place([a for a in attempts if a.rejected is None])]


def best_of_each_place(attempts: list[Attempt]) -> list[Attempt]:
    """The surest reading of every place, largest first."""
    kept: list[Attempt] = []
    for attempt in sorted(attempts, key=lambda a: (-a.verdict.margin, a.family.name, a.verdict.code)):
        middle = attempt.corners.mean(axis=0)
        apart = [np.linalg.norm(middle - k.corners.mean(axis=0)) > 0.5 * _mean_side(k.corners) for k in kept]
        if all(apart):
            kept.append(attempt)
    return sorted(kept, key=lambda a: -_mean_side(a.corners))


def attempt_landmarks(image: ByteArray, options: DetectOptions) -> list[Attempt]:
    """Everything that was registered and read, with the reasons of what was rejected."""
    _check_picture(image, options)
    picture = Picture(_LINEAR[image], estimate_noise(image), options.camera)
    pyramid = linear_pyramid(picture.linear)
    candidates = find_candidates(image, options.effort.sources)
    attempts: list[Attempt] = []
    for family in options.families:
        attempts += _attempts_in_clear(picture, pyramid, candidates, family, options)
    if not options.effort.in_shadow:
        return attempts
    read = [attempt.corners for attempt in attempts if attempt.rejected is None]
    elsewhere = _elsewhere(candidates, read)
    shaded: list[Attempt] = []
    for family in options.families:
        shaded += _attempts_in_shadow(picture, pyramid, elsewhere, family, options)
    return attempts + [_unless_contradicted(attempt, attempts) for attempt in shaded]


def read_landmark_at(image: ByteArray, corners: FloatArray, family: LandmarkFamily) -> Attempt | None:
    """Read what stands at known corners of a sharp picture, such as a rasterised page.

    Args:
        image: (H,W,3) BGR, 8 bit.
        corners: (4,2) px, clockwise as seen, good to a few hundredths of the side.

    Returns:
        None where too little of it lies in the picture.
    """
    registrar = Registrar(Picture(_LINEAR[image], estimate_noise(image)), family)
    registration = Registration(corners, np.array([0.3, 0.0, 0.3]))
    pixels = take_pixels(registrar.picture, registration, family, COARSE_PIXELS)
    if pixels is None:
        return None
    verdict = read_square(registrar, registration, pixels)
    reading = Reading.of(family, verdict.code, verdict.quarter)
    registration = registrar.register(registration, pixels, reading, REGISTER_STEPS)
    verdict = read_square(registrar, registration, pixels)
    registration = registrar.with_covariance(registration, pixels, reading, fit_bend=False)
    order = (np.arange(4) + verdict.quarter) % 4
    rows = (2 * order[:, None] + np.arange(2)).ravel()
    seen, covariance = registrar.picture_corners(registration)
    rejected = verdict.reason_to_reject(AcceptanceRule())
    return Attempt(family, seen[order], covariance[np.ix_(rows, rows)], verdict, rejected)


def _attempts_in_clear(
    picture: Picture,
    pyramid: list[Float32Array],
    candidates: FloatArray,
    family: LandmarkFamily,
    options: DetectOptions,
) -> list[Attempt]:
    quads = _likely_squares(pyramid, candidates, family, options.effort)
    attempts = (_register_and_read(picture, quad, family, options) for quad in quads)
    return [attempt for attempt in attempts if attempt is not None]


def _unless_contradicted(shaded: Attempt, clear: list[Attempt]) -> Attempt:
    """A reading that needs a shadow does not stand where one without it is surer of something else."""
    for other in clear:
        apart = np.linalg.norm(shaded.corners.mean(axis=0) - other.corners.mean(axis=0))
        same = (other.family, other.verdict.code) == (shaded.family, shaded.verdict.code)
        surer = other.verdict.margin > shaded.verdict.margin and not same
        if surer and apart < 0.5 * _mean_side(shaded.corners):
            return replace(shaded, rejected=shaded.rejected or "contradicted")
    return shaded


def _likely_squares(
    pyramid: list[Float32Array], candidates: FloatArray, family: LandmarkFamily, effort: Effort
) -> FloatArray:
    """(N,4,2) the candidates that look like landmarks, their corners moved to where they fit."""
    screened = screen_candidates(pyramid, candidates, family)
    screened = screened.best_first(effort.min_pattern, per_place=2, at_most=effort.max_aligned)
    aligned = align_candidates(pyramid, screened.quads, family, ALIGN_ROUNDS, effort.look)
    aligned = aligned.best_first(effort.min_aligned_pattern, per_place=2, at_most=effort.max_registered)
    aligned = align_candidates(pyramid, aligned.quads, family, ALIGN_ROUNDS, effort.look)
    return aligned.best_first(effort.min_aligned_pattern, per_place=1, at_most=effort.max_registered).quads


def _attempts_in_shadow(
    picture: Picture,
    pyramid: list[Float32Array],
    candidates: FloatArray,
    family: LandmarkFamily,
    options: DetectOptions,
) -> list[Attempt]:
    """The candidates on which a shadow may end, with the light taken out."""
    window = window_for(0.75 * FULL_DETAIL_SIDE_PX)
    white = [local_white(level, window) for level in pyramid]
    even = [level / light[:, :, None] for level, light in zip(pyramid, white, strict=True)]
    level = pyramid_level(np.sqrt(np.abs(areas(candidates))), len(pyramid))
    crossed = np.zeros(len(candidates), dtype=bool)
    for k, light in enumerate(white):
        crossed[level == k] = crossed_by_shadow(light, candidates[level == k] / 2.0**k)
    quads = _likely_squares(even, candidates[crossed], family, options.effort)
    rule = options.rule
    strict = replace(rule, turn_margin=SHADED_FACTOR * rule.turn_margin, code_margin=SHADED_FACTOR * rule.code_margin)
    options = replace(options, rule=strict)
    attempts = (_register_and_read(picture.evened(window_for(_mean_side(q))), q, family, options) for q in quads)
    return [attempt for attempt in attempts if attempt is not None]


def _elsewhere(candidates: FloatArray, read: list[FloatArray]) -> FloatArray:
    """(N,4,2) the candidates whose middle is in none of the squares that are read already."""
    middles = candidates.mean(axis=1)
    for corners in read:
        apart = np.linalg.norm(middles - corners.mean(axis=0), axis=1) > 0.5 * _mean_side(corners)
        candidates, middles = candidates[apart], middles[apart]
    return candidates


def _settled_coarsely(registrar: Registrar, quad: FloatArray, options: DetectOptions) -> FloatArray:
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
    if not verdict.is_promising(options.rule):
        return quad
    reading = Reading.of(small.family, verdict.code, verdict.quarter)
    settled = small.register(start, pixels, reading, 2 * REGISTER_STEPS)
    return (settled.corners + 0.5) * shrink - 0.5


def _register_and_read(
    picture: Picture, quad: FloatArray, family: LandmarkFamily, options: DetectOptions
) -> Attempt | None:
    registrar = Registrar(picture, family)
    coarse = min(COARSE_PIXELS, options.effort.pixels)
    quad = picture.straightened(_settled_coarsely(registrar, quad, options))
    side = _mean_side(quad)
    fit_bend = options.through_lens and options.camera is None and side > BEND_SIDE_PX
    # The blur starts generous, so that a wrong corner still feels its edge.
    blur = max(0.8, 0.012 * min(side, COARSE_SIDE_PX)) ** 2
    registration = Registration(quad, np.array([blur, 0.0, blur]))
    pixels = take_pixels(picture, registration, family, coarse, near_edges=False)
    if pixels is None:
        return None
    verdict = read_square(registrar, registration, pixels)
    if not verdict.is_promising(options.rule):
        return None
    # Register what was read, read again, until the reading stands.
    for _ in range(READ_ROUNDS):
        reading = Reading.of(family, verdict.code, verdict.quarter)
        for _ in range(2):
            discounted = registrar.discounted(registration, pixels, reading)
            registration = registrar.register(registration, discounted, reading, REGISTER_STEPS, to_px=COARSE_PX)
        pixels = take_pixels(picture, registration, family, coarse, near_edges=False)
        if pixels is None:
            return None
        # Read with the plain weights: discounting what does not fit the last reading would make it
        # confirm itself.
        previous, verdict = verdict, read_square(registrar, registration, pixels)
        if (verdict.code, verdict.quarter) == (previous.code, previous.quarter):
            break
    if not verdict.is_promising(options.rule):
        return None
    if picture.white is not None:
        picture = _with_sharp_shadow(registrar, registration, pixels, verdict)
        registrar = Registrar(picture, family)
    # Now with all pixels that help.
    pixels = take_pixels(picture, registration, family, options.effort.pixels)
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
    return Attempt(family, corners[order], covariance[np.ix_(rows, rows)], verdict, rejected)


def _with_sharp_shadow(registrar: Registrar, registration: Registration, pixels: Pixels, verdict: Verdict) -> Picture:
    """The picture with the shadow taken out by one straight edge, now that the drawing is known."""
    drawn = registrar.drawn(registration, pixels, Reading.of(registrar.family, verdict.code, verdict.quarter))
    bright = np.maximum(drawn.mean(axis=1), 1e-3)
    light = np.maximum(pixels.values.mean(axis=1), 1e-3) / bright * pixels.light
    edge = ShadowEdge.fit(registrar.picture.distorted(pixels.at), light, bright**2)
    shape = registrar.picture.linear.shape
    return registrar.picture.lit_by(edge.light((shape[0], shape[1])))


def _check_picture(image: ByteArray, options: DetectOptions) -> None:
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise InputError(
            "bad_picture",
            f"a picture of shape {image.shape} and type {image.dtype} cannot be searched",
            "give (height, width, 3) BGR of 8 bit; lmkit.formats.images.read_image makes that of any file",
        )
    for one, other in combinations(options.families, 2):
        if one.is_drawn_like(other):
            raise InputError(
                "like_families",
                f"families {one.name} and {other.name} share their drawing and cannot be told apart",
                "look for one of them; mix families of different rings",
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
