"""Prints in an image, including poor ones: readable landmarks, else mirrored or inverted, else the likeliest ones.

Mirrored ring landmarks are recognized by their code; a mirrored square marker has no valid code in most families.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import cv2
import numpy as np

from lmkit.arrays import ByteArray, FloatArray
from lmkit.detection.config import ACCURATE, DetectOptions
from lmkit.detection.detector import best_of_each_place, candidates_of
from lmkit.detection.register_and_decode import Candidate, read_landmark_at
from lmkit.detection.screening import ScreeningThresholds
from lmkit.detection.tag_detector import find_tags
from lmkit.detection.tag_registration import TagCandidate, read_tag_at
from lmkit.model.palette import SRGB_TO_LINEAR, linear_to_srgb
from lmkit.verification.flat_print import FINE_SIDE_PX, corners_of_border

Reading = TypeVar("Reading", Candidate, TagCandidate)
SHRINKS = (2, 4, 8)
LEAST_PX = 150  # of an image's shorter side
OPENING_PX = 7
# Poor prints must also be found and graded.
LOOK_AT_ANY = replace(
    ACCURATE, aligned=ScreeningThresholds(white_over_ground=1.2, red_over_blue=0.2, contrast=0.1, turn=0.02)
)
ROOM = 0.4  # margin in sides around a marker that is read again
LIKELY = 0.3  # least share of the pattern in a rejected square that counts as a landmark
LIKELY_CELLS = 0.4  # largest error of the cells of a rejected square that counts as a marker; noise has 0.5
BLACK_FOR_WHITE = np.round(255 * linear_to_srgb(1 - SRGB_TO_LINEAR.astype(np.float64))).astype(np.uint8)


@dataclass(frozen=True, eq=False)
class FoundPrint:
    """One landmark of an image.

    Attributes:
        candidate: its reading, in pixels of ``image``.
        image: (H,W,3) BGR in which it reads: the image, mirrored or inverted if necessary.
        is_mirrored, is_inverted: whether the image was mirrored or inverted.
    """

    candidate: Candidate | TagCandidate
    image: ByteArray
    is_mirrored: bool = False
    is_inverted: bool = False

    @property
    def corners(self) -> FloatArray:
        """(4,2) px in the original image, in the landmark's order."""
        corners = self.candidate.corners
        if not self.is_mirrored:
            return corners
        return np.column_stack([self.image.shape[1] - 1 - corners[:, 0], corners[:, 1]])


def find_prints(image: ByteArray, options: DetectOptions) -> list[FoundPrint]:
    """All landmarks that are read in an image, at full or reduced size; if there are none, the likeliest candidates.

    Streaks and blur that break the border at full size are less visible at reduced size.

    Args:
        image: (H,W,3) BGR, 8 bit.
        options: families, and whether the image was taken through a lens.
    """
    options = replace(options, config=LOOK_AT_ANY)
    good: list[Candidate | TagCandidate] = []
    likely: list[Candidate | TagCandidate] = []
    for shrink in (1, *SHRINKS):
        size = (image.shape[1] // shrink, image.shape[0] // shrink)
        if min(size) < LEAST_PX:
            break
        small = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
        rings, tags = _candidates(small, shrink, options)
        found: list[Candidate | TagCandidate] = [*rings, *tags]
        good += best_of_each_place([a for a in found if a.rejected is None and _is_elsewhere(a, good)])
        if good:
            continue
        if options.square_families and (other := _otherwise(image, small, shrink, options)):
            return other
        likely += [a for a in found if _is_likely(a)]
        if shrink > 1:
            likely += [a for a in _of_opened(image, small, shrink, options) if _is_likely(a)]
    if good:
        return [FoundPrint(_settled(image, candidate), image) for candidate in good]
    return [FoundPrint(candidate, image) for candidate in best_of_each_place(likely)[:1]]


def _is_elsewhere(candidate: Candidate | TagCandidate, found: Sequence[Candidate | TagCandidate]) -> bool:
    """Whether no found landmark overlaps the candidate."""
    return len(best_of_each_place([*found, candidate])) > len(found)


def _candidates(small: ByteArray, shrink: int, options: DetectOptions) -> tuple[list[Candidate], list[TagCandidate]]:
    rings = candidates_of(small, options) if options.ring_families else []
    tags = find_tags(small, options, None) if options.square_families else []
    return [_enlarged(a, shrink) for a in rings], [_enlarged(a, shrink) for a in tags]


def _otherwise(image: ByteArray, small: ByteArray, shrink: int, options: DetectOptions) -> list[FoundPrint]:
    """Square markers that are read in the mirrored image, the inverted image, or both."""
    for is_mirrored, is_inverted in ((True, False), (False, True), (True, True)):
        seen = _seen(small, is_mirrored, is_inverted)
        tags = [a for a in find_tags(seen, options, None) if a.rejected is None]
        if tags:
            large = _seen(image, is_mirrored, is_inverted)
            found = best_of_each_place([_enlarged(a, shrink) for a in tags])
            return [FoundPrint(_settled(large, candidate), large, is_mirrored, is_inverted) for candidate in found]
    return []


def _settled(image: ByteArray, candidate: Candidate | TagCandidate) -> Candidate | TagCandidate:
    """A large square marker with corners from lines along its border and cells read at reduced size.

    Edges that are sharper than from a lens keep a fit of the whole drawing from moving away from its start.
    """
    if isinstance(candidate, Candidate) or candidate.side_px < FINE_SIDE_PX:
        return candidate
    corners = corners_of_border(image, candidate.corners, candidate.family.half_mm)
    low = np.maximum(np.floor(corners.min(axis=0) - ROOM * candidate.side_px), 0).astype(int)
    high = np.ceil(corners.max(axis=0) + ROOM * candidate.side_px).astype(int)
    part = SRGB_TO_LINEAR[image[low[1] : high[1], low[0] : high[0]]]
    whole = np.array(part.shape[1::-1])
    size = np.round(whole * FINE_SIDE_PX / candidate.side_px).astype(int)
    light = cv2.resize(part, size.tolist(), interpolation=cv2.INTER_AREA).astype(np.float64)
    small = np.round(255 * linear_to_srgb(light)).astype(np.uint8)
    again = read_tag_at(small, (corners - low + 0.5) * size / whole - 0.5, candidate.family)
    clearer = again is not None and again.rejected is None and again.decoding.code == candidate.decoding.code
    return replace(again if again is not None and clearer else candidate, corners=corners)


def _seen(image: ByteArray, is_mirrored: bool, is_inverted: bool) -> ByteArray:
    image = BLACK_FOR_WHITE[image] if is_inverted else image
    return np.ascontiguousarray(image[:, ::-1]) if is_mirrored else image


def _of_opened(
    image: ByteArray, small: ByteArray, shrink: int, options: DetectOptions
) -> list[Candidate | TagCandidate]:
    """Landmarks after a morphological opening, which removes thin bright lines."""
    opened = cv2.morphologyEx(small, cv2.MORPH_OPEN, np.ones((OPENING_PX, OPENING_PX), np.uint8))
    rings, tags = _candidates(np.asarray(opened, dtype=np.uint8), shrink, options)
    again: list[Candidate | TagCandidate | None] = [read_landmark_at(image, a.corners, a.family) for a in rings]
    for tag in tags:
        # The inside of a large marker is fitted in a smaller image, where the lines are thin.
        seen = read_tag_at(small, (tag.corners + 0.5) / shrink - 0.5, tag.family)
        again.append(None if seen is None else _settled(image, _enlarged(seen, shrink)))
    return [candidate for candidate in again if candidate is not None]


def _is_likely(candidate: Candidate | TagCandidate) -> bool:
    if candidate.rejected == "cut" or candidate.decoding.pattern <= LIKELY:
        return False
    return isinstance(candidate, Candidate) or candidate.decoding.cell_error < LIKELY_CELLS


def _enlarged(candidate: Reading, shrink: int) -> Reading:
    """The candidate in pixels of the image before shrinking."""
    corners = (candidate.corners + 0.5) * shrink - 0.5
    return replace(candidate, corners=corners, covariance=candidate.covariance * shrink**2)
