"""`detect_landmarks`: the steps in order (docs/landmark.md, section 6)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from lmkit.arrays import ByteArray, FloatArray
from lmkit.detection.candidates import find_candidates
from lmkit.detection.config import DetectOptions
from lmkit.detection.linear_image import LinearImage
from lmkit.detection.overlaps import AnyCandidate, without_covered
from lmkit.detection.pixel_sampling import mean_side, middle_of
from lmkit.detection.register_and_decode import Candidate, register_all, register_and_decode
from lmkit.detection.screening import LikelyRule, likely_squares
from lmkit.detection.shadows import window_for
from lmkit.detection.veil import without_veil
from lmkit.detection.windows import LEAST_WINDOW_PX, clockwise, window_around
from lmkit.errors import InputError
from lmkit.kernels.screening import Pyramid, Shares
from lmkit.model.landmark import LandmarkFamily
from lmkit.model.observation import Detection

if TYPE_CHECKING:
    from lmkit.detection.tag_registration import TagCandidate

# The strict limit: landmarks below it may be in a shadow.  Small landmarks are rarely above it; of 37
# on simulated images that were tried as shadows, none was accepted as another code there.
SURE_LOG_ODDS, SMALL_PX = 3.0, 30.0


def detect_landmarks(
    image: ByteArray, options: DetectOptions | None = None, near: FloatArray | None = None
) -> list[Detection]:
    """All landmarks of an image, largest first.

    Args:
        image: (H,W,3) BGR, 8 bit, as `io.images.read_image` gives it; gray ones do for square markers.
        near: (N,4,2) where landmarks are expected, px, from any corner on; only windows around them are searched.

    Raises:
        InputError: not such an image, not of the camera's size, or families that share their drawing.
    """
    options = options or DetectOptions()
    _check_image(image, options)
    found: list[Candidate | TagCandidate] = []
    if options.ring_families:
        found += candidates_of(image, options) if near is None else candidates_near(image, near, options)
    if options.square_families:
        from lmkit.detection.tag_detector import find_tags

        found += find_tags(image, options, near)
    places = best_of_each_place([c for c in found if c.rejected is None])
    return [c.observation for c in without_covered(places)]


def best_of_each_place(candidates: Sequence[AnyCandidate]) -> list[AnyCandidate]:
    """The reading with the highest score at every place, largest first; a landmark within another is kept."""
    kept: list[tuple[AnyCandidate, Sequence[float], float]] = []
    for candidate in sorted(candidates, key=lambda a: (-a.log_odds, a.family.name, a.decoding.code)):
        middle, side = middle_of(candidate.corners), candidate.side_px
        if all(math.dist(middle, place) > 0.5 * min(size, side) for _, place, size in kept):
            kept.append((candidate, middle, side))
    return sorted((candidate for candidate, _, _ in kept), key=lambda a: -a.side_px)


def candidates_of(image: ByteArray, options: DetectOptions) -> list[Candidate]:
    """All candidates that were registered and decoded, with the reasons of rejections."""
    _check_image(image, options)
    linear = LinearImage.of(image, options.camera)
    clear = without_veil(linear)
    quads = find_candidates(clear.pyramid.levels, options.config.sources, options.config.where, clear.noise)
    return _candidates_among(quads, linear, clear.pyramid, np.zeros(2), options)


def candidates_near(image: ByteArray, near: FloatArray, options: DetectOptions) -> list[Candidate]:
    """Landmarks in windows around (N,4,2) squares; where a square itself fits, its window is not searched."""
    near = np.asarray(near, dtype=np.float64).reshape(-1, 4, 2)
    found: list[Candidate] = []
    for quad in near[np.isfinite(near).all(axis=(1, 2))]:
        low, high = window_around(quad, image)
        if (high - low < LEAST_WINDOW_PX).any():
            continue
        window = LinearImage.of(np.ascontiguousarray(image[low[1] : high[1], low[0] : high[0]]))
        # The lens and its distortion belong to the whole image.
        whole = LinearImage.of(image, options.camera, window.noise)
        expected, clear = clockwise(quad)[None] - low, without_veil(window)
        here = _candidates_among(expected, whole, clear.pyramid, low.astype(np.float64), options)
        if not any(candidate.rejected is None for candidate in here):
            levels, config = clear.pyramid.levels, options.config
            quads = find_candidates(levels, config.sources, config.where, clear.noise)
            here = _candidates_among(quads, whole, clear.pyramid, low.astype(np.float64), options)
        found += here
    return found


def _candidates_among(
    quads: FloatArray, linear: LinearImage, pyramid: Pyramid, corner: FloatArray, options: DetectOptions
) -> list[Candidate]:
    """Candidates among squares of a window of the image, whose pyramid it is and which begins at ``corner``."""
    config = options.config
    clear, possible = [], np.zeros(len(quads), dtype=bool)
    rule = LikelyRule(Shares(config.min_pattern, config.min_aligned_pattern), config.align_rounds, config.aligned)
    for family in options.ring_families:
        likely = likely_squares(pyramid, quads, family, rule)
        possible |= likely.pattern >= 0
        clear += register_all(linear, likely.quads + corner, family, options)
    if not config.in_shadow:
        return clear
    read = [candidate.corners - corner for candidate in clear if _is_clear(candidate)]
    shaded = _candidates_in_shadow(_elsewhere(quads[possible], read), linear, pyramid, corner, options)
    return clear + [_unless_contradicted(candidate, clear) for candidate in shaded]


def _registered(
    squares: Iterable[tuple[LinearImage, FloatArray]], family: LandmarkFamily, options: DetectOptions
) -> list[Candidate]:
    found = (register_and_decode(image, quad, family, options) for image, quad in squares)
    return [candidate for candidate in found if candidate is not None]


def _is_clear(candidate: Candidate) -> bool:
    """Whether a landmark was read without shadow normalization, and clearly enough to skip it."""
    is_small = candidate.rejected is None and candidate.side_px < SMALL_PX
    return is_small or candidate.log_odds >= SURE_LOG_ODDS


def _unless_contradicted(shaded: Candidate, clear: list[Candidate]) -> Candidate:
    """Reject a reading with a shadow if one without a shadow has a higher score for another code there."""
    for other in clear:
        apart = math.dist(middle_of(shaded.corners), middle_of(other.corners))
        same = (other.family, other.decoding.code) == (shaded.family, shaded.decoding.code)
        surer = other.log_odds > shaded.log_odds and not same
        if surer and apart < 0.5 * shaded.side_px:
            return replace(shaded, rejected=shaded.rejected or "contradicted")
    return shaded


def _candidates_in_shadow(
    quads: FloatArray, image: LinearImage, pyramid: Pyramid, corner: FloatArray, options: DetectOptions
) -> list[Candidate]:
    """The candidates on which a shadow may end, in the shadow-normalized image."""
    shaded: list[Candidate] = []
    if len(quads) == 0:
        return shaded
    config = options.config
    shares = Shares(config.shaded_pattern, config.shaded_aligned_pattern)
    rule = LikelyRule(shares, config.align_rounds, config.aligned, in_shadow=True)
    for family in options.ring_families:
        likely = likely_squares(pyramid, quads, family, rule).quads + corner
        squares = ((_shadow_normalized(image, quad), quad) for quad in likely)
        shaded += _registered(squares, family, options)
    return shaded


def _shadow_normalized(image: LinearImage, quad: FloatArray) -> LinearImage:
    """The image, shadow-normalized around a square."""
    window = window_for(mean_side(quad))
    xs, ys = quad.T.tolist()
    low = (math.floor(min(along)) - window for along in (xs, ys))
    high = (math.ceil(max(along)) + window for along in (xs, ys))
    return image.shadow_normalized((*low, *high), window)


def _elsewhere(candidates: FloatArray, read: Sequence[FloatArray]) -> FloatArray:
    """(N,4,2) the candidates whose center is in none of the squares that were read."""
    if not read or len(candidates) == 0:
        return candidates
    known = [(middle_of(corners), 0.5 * mean_side(corners)) for corners in read]
    middles = (candidates.sum(axis=1) / 4).tolist()
    outside = [all(math.dist(middle, at) > reach for at, reach in known) for middle in middles]
    return np.asarray(candidates[np.array(outside)])


def _check_image(image: ByteArray, options: DetectOptions) -> None:
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise InputError(
            "bad_image",
            f"an image of shape {image.shape} and type {image.dtype} cannot be searched",
            "give (height, width, 3) BGR, 8 bit; read files with lmkit.read_image",
        )
    for one, other in combinations(options.families, 2):
        if one.is_drawn_like(other):
            raise InputError(
                "like_families",
                f"families {one.name} and {other.name} share their drawing and cannot be distinguished",
                "look for one of them; mix families of different drawings",
            )
    size = (image.shape[1], image.shape[0])
    if options.camera is not None and options.camera.image_size != size:
        raise InputError(
            "camera_size",
            "the image is {}x{}, the camera {}x{}".format(*size, *options.camera.image_size),
            "use images of the calibrated size",
        )
