"""The codes of a family as hypotheses about gaps and triangle; :mod:`lmkit.kernels.hypotheses` scores them."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.detection.pattern_model import QUARTERS, LandmarkPattern
from lmkit.kernels.hypotheses import Words
from lmkit.model.landmark import LandmarkFamily

# Prior that bounds inks with few pixels (surroundings beyond the grid).
RIDGE = 1e-5


def red_over_blue(inks: FloatArray) -> float:
    """How much redder the border is than the ground: a log ratio, relative to the white.

    Args:
        inks: (4,3) linear-light BGR of white, red, blue, surroundings.
    """
    white, red, blue, _ = inks.tolist()

    def share(ink: list[float], channel: int) -> float:
        return float(min(max(ink[channel] / max(white[channel], 1e-3), 0.0), 1.5)) + 0.03

    return math.log(share(red, 2) / share(red, 0)) - math.log(share(blue, 2) / share(blue, 0))


@lru_cache(maxsize=16)
def words_of(family: LandmarkFamily) -> Words:
    """Open gaps of every code in every quarter turn, and where the gaps are."""
    masks = np.zeros((QUARTERS, family.code_count), dtype=np.int32)
    turns = LandmarkPattern(family).gap_turns
    for code in range(family.code_count):
        gaps = family.gaps(code)
        for quarter, columns in enumerate(turns):
            masks[quarter, code] = sum(1 << column for column, gap in zip(columns, gaps, strict=True) if gap)
    return Words.of(masks, family.gap_count)
