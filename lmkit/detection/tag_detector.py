"""Square markers of an image: candidates from brightness alone, so gray images suffice."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lmkit.arrays import ByteArray, FloatArray
from lmkit.detection.candidates import Source, WhereToLook, find_candidates
from lmkit.detection.config import COARSE, FINE, DetectOptions
from lmkit.detection.linear_image import LinearImage
from lmkit.detection.pixel_sampling import mean_side
from lmkit.detection.tag_registration import TagCandidate, register_and_decode_tag
from lmkit.detection.tag_screening import LEAST_STEP, look_at, shadow_on
from lmkit.detection.windows import LEAST_WINDOW_PX, clockwise, is_colorless, window_around
from lmkit.model.square_marker import SquareMarkerFamily

ANYWHERE_IN_COLOR = -1.0  # black and white have no color to look for
LEAST_LUMA = 0.3
# Borders are a sixth to a ninth of the side wide, twice to three times as wide as a ring landmark's: a wider window
# finds in one pass what takes those two.
DETAILED = Source("gray", 0, 11, 0.05)
TAGS_WHERE = WhereToLook(ANYWHERE_IN_COLOR, LEAST_LUMA, True)
NOISY = 3.0  # standard deviation of the code values
SAME = 0.08  # of the side: two squares are one
ROOM = 0.5  # of the side, around a square: the light there is known
CLEAR = 0.06  # cell error of markers on which no shadow ends that moves corners by a tenth of a pixel


def find_tags(image: ByteArray, options: DetectOptions, near: FloatArray | None) -> list[TagCandidate]:
    """Square markers of (H,W,3) BGR, 8 bit, including rejected ones.

    Args:
        near: (N,4,2) where they are expected, px; only windows around them are searched.
    """
    polarities = (False, True) if options.inverted_tags else (False,)
    return [found for is_inverted in polarities for found in _find(image, options, near, is_inverted)]


def _find(image: ByteArray, options: DetectOptions, near: FloatArray | None, is_inverted: bool) -> list[TagCandidate]:
    gray, families = is_colorless(image), options.square_families

    def seen(linear: LinearImage) -> LinearImage:
        return linear.inverted if is_inverted else linear

    if near is None:
        return tag_candidates_of(seen(LinearImage.of(image, options.camera)), families, options, gray)
    found: list[TagCandidate] = []
    near = np.asarray(near, dtype=np.float64).reshape(-1, 4, 2)
    for quad in near[np.isfinite(near).all(axis=(1, 2))]:
        low, high = window_around(quad, image)
        if (high - low < LEAST_WINDOW_PX).any():
            continue
        window = seen(LinearImage.of(np.ascontiguousarray(image[low[1] : high[1], low[0] : high[0]])))
        # The lens and its distortion belong to the whole image.
        whole = seen(LinearImage.of(image, options.camera, window.noise))
        here = _read_quads(whole, clockwise(quad)[None], families, options, gray)
        if not any(candidate.rejected is None for candidate in here):
            here = _read_quads(whole, _quads_of(window, options) + low, families, options, gray)
        found += here
    return found


def tag_candidates_of(
    image: LinearImage, families: Sequence[SquareMarkerFamily], options: DetectOptions, gray: bool
) -> list[TagCandidate]:
    """All squares that were registered and decoded, with the reasons of rejections."""
    return _read_quads(image, _quads_of(image, options), families, options, gray)


def read_tags(image: LinearImage, quads: FloatArray, options: DetectOptions, gray: bool) -> list[TagCandidate]:
    """Accepted square markers among (N,4,2) quads, px, that were found by other methods."""
    found = _read_quads(image, quads, options.square_families, options, gray)
    return [candidate for candidate in found if candidate.rejected is None]


def _quads_of(image: LinearImage, options: DetectOptions) -> FloatArray:
    config = options.config
    where = WhereToLook(ANYWHERE_IN_COLOR, min(config.where.luma, LEAST_LUMA), config.where.dilated)
    # Halved twice, noise no longer frays outlines.
    left_out = (FINE,) if 255 * image.noise > NOISY else (COARSE, FINE)
    sources = (*(source for source in config.sources if source not in left_out), DETAILED)
    return find_candidates(image.pyramid.levels, sources, where, image.noise)


def _read_quads(
    image: LinearImage,
    quads: FloatArray,
    families: Sequence[SquareMarkerFamily],
    options: DetectOptions,
    gray: bool,
) -> list[TagCandidate]:
    found: list[TagCandidate] = []
    looks = [look_at(image.pyramid.levels, quads, family) for family in families]
    clear = np.array([look.promising for look in looks])
    may_be_shaded = np.max([look.step for look in looks], axis=0) >= LEAST_STEP
    some = np.flatnonzero(clear.any(axis=0))
    for row in some[distinct(quads[some])].tolist():
        quad = quads[row]
        if any(_is_in(quad, other) for other in found if other.rejected is None):
            continue
        chosen = [family for family, is_likely in zip(families, clear[:, row], strict=True) if is_likely]
        candidate = register_and_decode_tag(image, quad, chosen, options, gray)
        # A shadow across a marker moves its corners by half a pixel, even where it reads with one light.
        unclear = 1.0 if candidate is None or candidate.rejected is not None else candidate.decoding.cell_error
        if options.config.in_shadow and may_be_shaded[row] and unclear > CLEAR:
            shaded = _read_in_shadow(image, quad, chosen, options, gray)
            candidate = shaded if shaded is not None and shaded.decoding.cell_error < unclear else candidate
        if candidate is not None:
            found.append(candidate)
    return found


def _read_in_shadow(
    image: LinearImage, quad: FloatArray, families: Sequence[SquareMarkerFamily], options: DetectOptions, gray: bool
) -> TagCandidate | None:
    """A marker that is read after removing the shadow across it; None without a shadow or a reading."""
    edge = shadow_on(image.pyramid.levels, quad, families[0])
    if edge is None:
        return None
    room = ROOM * mean_side(quad)
    low, high = np.floor(quad.min(axis=0) - room).astype(int), np.ceil(quad.max(axis=0) + room).astype(int)
    low, high = np.maximum(low, 0), np.minimum(high, image.size)
    box = (*low.tolist(), *high.tolist())
    found = register_and_decode_tag(image.renormalized(box, edge.light(box)), quad, families, options, gray)
    return found if found is not None and found.rejected is None else None


def _is_in(quad: FloatArray, read: TagCandidate) -> bool:
    """Whether the center of a square is in a marker that was read, and the square is not larger than it."""
    apart = float(np.linalg.norm(quad.mean(axis=0) - read.corners.mean(axis=0)))
    return apart < 0.5 * read.side_px and mean_side(quad) < 1.5 * read.side_px


def distinct(quads: FloatArray) -> list[int]:
    """Rows of (N,4,2) quads that have not nearly the corners of an earlier one, from whichever corner on."""
    kept: list[int] = []
    middles, places = quads.mean(axis=1), np.empty((len(quads), 2))
    for row, quad in enumerate(quads):
        least = SAME * mean_side(quad)
        near = np.flatnonzero(np.abs(places[: len(kept)] - middles[row]).max(axis=1) < least).tolist()
        turns = [np.roll(quads[kept[k]], turn, axis=0) for k in near for turn in range(4)]
        if all(np.abs(turned - quad).max() >= least for turned in turns):
            places[len(kept)] = middles[row]
            kept.append(row)
    return kept
