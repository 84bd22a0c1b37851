"""`detect_landmarks`: the steps in order (docs/landmark.md, section 6)."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from lmkit.arrays import ByteArray, Float32Array, FloatArray
from lmkit.detection.candidates import find_candidates
from lmkit.detection.config import DetectOptions, Effort
from lmkit.detection.linear_image import LinearImage
from lmkit.detection.pixel_sampling import mean_side
from lmkit.detection.register_and_decode import Candidate, register_and_decode
from lmkit.detection.screening import (
    FULL_DETAIL_SIDE_PX,
    align_candidates,
    areas,
    linear_pyramid,
    pyramid_level,
    screen_candidates,
)
from lmkit.detection.shadows import crossed_by_shadow, local_white, window_for
from lmkit.errors import InputError
from lmkit.model.landmark import LandmarkFamily
from lmkit.model.observation import Detection

ALIGN_ROUNDS = 3
SHADED_FACTOR = 1.5  # a shadow's edge has freedoms that fit other things too: margins must be so much larger


def detect_landmarks(image: ByteArray, options: DetectOptions | None = None) -> list[Detection]:
    """All landmarks of a picture, largest first.

    Args:
        image: (H,W,3) BGR, 8 bit, as `formats.images.read_image` gives it.
    """
    attempts = candidates_of(image, options or DetectOptions())
    return [a.observation for a in best_of_each_place([a for a in attempts if a.rejected is None])]


def best_of_each_place(attempts: list[Candidate]) -> list[Candidate]:
    """The surest reading of every place, largest first."""
    kept: list[Candidate] = []
    for attempt in sorted(attempts, key=lambda a: (-a.decoding.margin, a.family.name, a.decoding.code)):
        middle = attempt.corners.mean(axis=0)
        apart = [np.linalg.norm(middle - k.corners.mean(axis=0)) > 0.5 * k.side_px for k in kept]
        if all(apart):
            kept.append(attempt)
    return sorted(kept, key=lambda a: -a.side_px)


def candidates_of(image: ByteArray, options: DetectOptions) -> list[Candidate]:
    """Everything that was registered and read, with the reasons of what was rejected."""
    _check_picture(image, options)
    picture = LinearImage.of(image, options.camera)
    pyramid = linear_pyramid(picture.linear)
    candidates = find_candidates(image, options.effort.sources)
    clear = [
        attempt
        for family in options.families
        for quad in _likely_squares(pyramid, candidates, family, options.effort)
        if (attempt := register_and_decode(picture, quad, family, options)) is not None
    ]
    if not options.effort.in_shadow:
        return clear
    elsewhere = _elsewhere(candidates, [attempt.corners for attempt in clear if attempt.rejected is None])
    shaded = _attempts_in_shadow(picture, pyramid, elsewhere, options)
    return clear + [_unless_contradicted(attempt, clear) for attempt in shaded]


def _unless_contradicted(shaded: Candidate, clear: list[Candidate]) -> Candidate:
    """A reading that needs a shadow does not stand where one without it is surer of something else."""
    for other in clear:
        apart = np.linalg.norm(shaded.corners.mean(axis=0) - other.corners.mean(axis=0))
        same = (other.family, other.decoding.code) == (shaded.family, shaded.decoding.code)
        surer = other.decoding.margin > shaded.decoding.margin and not same
        if surer and apart < 0.5 * shaded.side_px:
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
    picture: LinearImage, pyramid: list[Float32Array], candidates: FloatArray, options: DetectOptions
) -> list[Candidate]:
    """The candidates on which a shadow may end, with the light taken out."""
    window = window_for(0.75 * FULL_DETAIL_SIDE_PX)
    white = [local_white(level, window) for level in pyramid]
    even = [level / light[:, :, None] for level, light in zip(pyramid, white, strict=True)]
    level = pyramid_level(np.sqrt(np.abs(areas(candidates))), len(pyramid))
    crossed = np.zeros(len(candidates), dtype=bool)
    for k, light in enumerate(white):
        crossed[level == k] = crossed_by_shadow(light, candidates[level == k] / 2.0**k)
    rule = options.rule
    strict = replace(rule, turn_margin=SHADED_FACTOR * rule.turn_margin, code_margin=SHADED_FACTOR * rule.code_margin)
    options = replace(options, rule=strict)
    return [
        attempt
        for family in options.families
        for quad in _likely_squares(even, candidates[crossed], family, options.effort)
        if (
            attempt := register_and_decode(
                picture.shadow_normalized(window_for(mean_side(quad))), quad, family, options
            )
        )
        is not None
    ]


def _elsewhere(candidates: FloatArray, read: list[FloatArray]) -> FloatArray:
    """(N,4,2) the candidates whose middle is in none of the squares that are read already."""
    middles = candidates.mean(axis=1)
    for corners in read:
        apart = np.linalg.norm(middles - corners.mean(axis=0), axis=1) > 0.5 * mean_side(corners)
        candidates, middles = candidates[apart], middles[apart]
    return candidates


def _check_picture(image: ByteArray, options: DetectOptions) -> None:
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise InputError(
            "bad_picture",
            f"a picture of shape {image.shape} and type {image.dtype} cannot be searched",
            "give (height, width, 3) BGR of 8 bit; lmkit.io.images.read_image makes that of any file",
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
