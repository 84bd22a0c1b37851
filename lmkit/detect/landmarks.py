"""`detect_landmarks`: the steps in order (docs/landmark.md, section 6)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from lmkit.arrays import ByteArray, FloatArray
from lmkit.detect.accept import Verdict, read_square
from lmkit.detect.candidates import find_candidates
from lmkit.detect.refine import Picture, Reading, Registrar, Registration, rebend, take_pixels
from lmkit.detect.screen import align_candidates, linear_pyramid, screen_candidates
from lmkit.model.landmark import LM8, LandmarkFamily
from lmkit.model.observation import LandmarkObservation
from lmkit.model.palette import srgb_to_linear

_LINEAR = srgb_to_linear(np.arange(256) / 255).astype(np.float32)


ALIGN_ROUNDS = 3


@dataclass(frozen=True)
class DetectOptions:
    """The few dials of detection.

    Attributes:
        family: which landmarks to look for.
        min_pattern: candidates whose pattern explains less than this share are not looked at twice.
        max_registered: at most so many candidates of a picture are registered, best first.
    """

    family: LandmarkFamily = LM8
    min_pattern: float = 0.04
    max_aligned: int = 100
    min_aligned_pattern: float = 0.2
    max_registered: int = 24


@dataclass(frozen=True)
class Attempt:
    """One candidate that was registered and read, accepted or not."""

    registration: Registration
    corners: FloatArray
    verdict: Verdict
    side_px: float


def attempt_landmarks(image: ByteArray, options: DetectOptions) -> list[Attempt]:
    """Find, screen, register and read; nothing is decided yet."""
    family = options.family
    picture = Picture(_LINEAR[image], estimate_noise(image))
    pyramid = linear_pyramid(picture.linear)
    screened = screen_candidates(pyramid, find_candidates(image), family)
    screened = screened.best_first(options.min_pattern, per_place=2, at_most=options.max_aligned)
    aligned = align_candidates(pyramid, screened.quads, family, ALIGN_ROUNDS)
    aligned = aligned.best_first(options.min_aligned_pattern, per_place=1, at_most=options.max_registered)
    registrar = Registrar(picture, family)
    attempts = (_register_and_read(registrar, quad) for quad in aligned.quads)
    return [attempt for attempt in attempts if attempt is not None]


def _register_and_read(registrar: Registrar, quad: FloatArray) -> Attempt | None:
    family, picture = registrar.family, registrar.picture
    side = _mean_side(quad)
    # The blur starts generous, so that a wrong corner still feels its edge.
    blur = max(0.8, 0.012 * side) ** 2
    registration = Registration(quad, np.array([blur, 0.0, blur]))
    # Read, register what was read, and again until the reading stands.
    verdict: Verdict | None = None
    fit_bend = side > 40
    for _ in range(3):
        pixels = take_pixels(picture, registration, family)
        if pixels is None:
            return None
        # Read with the plain weights: discounting what does not fit the last reading would make it
        # confirm itself.
        found = read_square(registrar, registration, pixels)
        if verdict is not None and (found.code, found.quarter) == (verdict.code, verdict.quarter):
            verdict = found
            break
        verdict = found
        reading = Reading.of(family, verdict.code, verdict.quarter)
        pixels = registrar.discounted(registration, pixels, reading)
        registration = registrar.register(registration, pixels, reading, 6, fit_bend)
        pixels = registrar.discounted(registration, pixels, reading)
        registration = registrar.register(registration, pixels, reading, 6, fit_bend)
    assert verdict is not None
    corners = rebend(registration.corners, registration.bend, picture.centre, picture.half_width)
    return Attempt(registration, np.roll(corners, -verdict.quarter, axis=0), verdict, _mean_side(corners))


def estimate_noise(image: ByteArray) -> float:
    """Standard deviation of the picture's noise over 255, from its smoothest half (Immerkaer 1996)."""
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], dtype=np.float32)
    response = np.abs(cv2.filter2D(grey, cv2.CV_32F, kernel))
    return float(np.median(response)) / 0.6745 / 6 / 255


def _mean_side(quad: FloatArray) -> float:
    return float(np.linalg.norm(np.roll(quad, -1, axis=0) - quad, axis=1).mean())
