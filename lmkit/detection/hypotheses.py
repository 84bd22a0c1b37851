"""The codes of a family as hypotheses about gaps and triangle; :mod:`lmkit.kernels.hypotheses` scores them."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.detection.pattern_model import QUARTERS, LandmarkPattern
from lmkit.kernels.hypotheses import Words
from lmkit.model.landmark import LandmarkFamily

# Keeps inks that are hardly seen (surroundings beyond the grid) from running away.
RIDGE = 1e-5


def red_over_blue(inks: FloatArray) -> FloatArray:
    """(...,) how much redder the border is than the ground: a log ratio, relative to the white.

    Args:
        inks: (...,4,3) linear-light BGR of white, red, blue, surroundings.
    """
    white = np.maximum(inks[..., 0, :], 1e-3)
    red = np.clip(inks[..., 1, :] / white, 0.0, 1.5) + 0.03
    blue = np.clip(inks[..., 2, :] / white, 0.0, 1.5) + 0.03
    return np.asarray(np.log(red[..., 2] / red[..., 0]) - np.log(blue[..., 2] / blue[..., 0]))


@lru_cache(maxsize=16)
def words_of(family: LandmarkFamily) -> Words:
    """Open gaps of every code in every quarter turn, and where the gaps are."""
    masks = np.zeros((QUARTERS, family.code_count), dtype=np.int32)
    for quarter, columns in enumerate(LandmarkPattern(family).gap_turns):
        for code in range(family.code_count):
            gaps = family.gaps(code)
            masks[quarter, code] = sum(1 << column for column, gap in zip(columns, gaps, strict=True) if gap)
    sectors = [
        (
            (ring.inner_mm + ring.outer_mm) / 2,
            (ring.outer_mm - ring.inner_mm) / 2,
            math.sin(math.radians(centre)),
            math.cos(math.radians(centre)),
            math.radians(ring.gap_width_deg / 2),
        )
        for ring in family.rings
        for centre in ring.gap_centres_deg
    ]
    return Words.of(masks, np.array(sectors))
