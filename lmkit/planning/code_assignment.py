"""Code assignment: codes that one misread gap or a quarter turn would confuse are placed far apart."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lmkit.arrays import FloatArray, IntArray
from lmkit.errors import InputError
from lmkit.model.codewords import turned_word
from lmkit.model.families import MarkerFamily, family_named
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import MappedLandmark
from lmkit.model.square_marker import SquareMarkerFamily

CONFUSABLE = 1  # gaps
APART_M = 1e6


def assign_codes(
    places: Sequence[FloatArray], existing: Sequence[MappedLandmark], family_name: str
) -> list[LandmarkId]:
    """An id for each of (N) places (3,), none of which is mounted already.

    Each place in turn gets the code whose nearest confusable landmark is farthest away.

    Raises:
        InputError: the family has too few codes.
    """
    family = family_named(family_name)
    used = [(m.code, m.T_map_landmark.t) for m in existing if m.family == family_name]
    if len(used) + len(places) > family.code_count:
        raise InputError(
            "too_few_codes",
            f"{len(used) + len(places)} landmarks, but {family_name} has {family.code_count} codes",
            "relax the requirement, or use larger landmarks (--size)",
        )
    confusable = confusable_codes(family)
    chosen: list[int] = []
    for place in places:
        far = np.full(family.code_count, APART_M)
        for code, there in used:
            rows = np.flatnonzero(confusable[code])
            far[rows] = np.minimum(far[rows], float(np.linalg.norm(place - there)))
            far[code] = -1.0
        code = int(np.argmax(far))
        chosen.append(code)
        used.append((code, place))
    return [LandmarkId(family_name, code) for code in chosen]


def confusable_codes(family: MarkerFamily) -> IntArray:
    """(C,C) True where one wrong gap or cell, or a quarter turn with none, makes one code of the other."""
    if isinstance(family, SquareMarkerFamily):
        return _close_codes(family)
    words = np.array(family.words)
    gap_counts = tuple(ring.gap_count for ring in family.rings)
    apart = np.bitwise_count(words[:, None] ^ words[None]) <= CONFUSABLE
    for quarters in (1, 2, 3):
        turned = np.array([turned_word(int(word), gap_counts, quarters) for word in words])
        apart |= words[:, None] == turned[None]
    np.fill_diagonal(apart, False)
    return np.asarray(apart | apart.T)


def _close_codes(family: SquareMarkerFamily) -> IntArray:
    """(C,C) True where at most ``CONFUSABLE`` cells differ, in any quarter turn."""
    if family.distance > CONFUSABLE:
        return np.zeros((family.code_count, family.code_count), dtype=bool)
    cells = family.bits**2
    signs = [2.0 * np.rot90(family.white, k, axes=(1, 2)).reshape(-1, cells) - 1 for k in range(4)]
    apart = np.max([signs[0] @ turned.T for turned in signs], axis=0) >= cells - 2 * CONFUSABLE
    np.fill_diagonal(apart, False)
    return np.asarray(apart)
