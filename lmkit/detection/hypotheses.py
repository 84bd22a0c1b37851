"""CodeHypothesis: every code in every quarter turn, each with its own best inks, in one matrix product.

The picture of a landmark is linear in its inks.  Let the columns of C be the coverage by the four
inks without triangle and gaps, by the triangle at four quarter turns, and by the gaps (16 columns
for lm8).  A hypothesis h = (code, quarter turn) only says which of those columns are white and
which are blue, so its design matrix is C M_h with a matrix M_h of zeros and ones, and its residual
sum of squares with the inks at their best follows from C'C and C'Y alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from lmkit.arrays import FloatArray, IntArray
from lmkit.detection.pattern_model import INKS, QUARTERS, LandmarkPattern
from lmkit.kernels.hypotheses import Words
from lmkit.model.landmark import LandmarkFamily

# Keeps inks that are hardly seen (surroundings beyond the grid) from running away.
RIDGE = 1e-5


@dataclass(frozen=True)
class Hypotheses:
    """All readings of a family.

    Attributes:
        codes, quarters: (H,) what each one says.
        selections: (H,C,4) the matrices M_h.
    """

    codes: IntArray
    quarters: IntArray
    selections: FloatArray


@lru_cache(maxsize=8)
def all_hypotheses(family: LandmarkFamily) -> Hypotheses:
    """Every code in every quarter turn, quarter by quarter."""
    turns = LandmarkPattern(family).gap_turns
    count = INKS + QUARTERS + family.gap_count
    selections = np.zeros((QUARTERS * family.code_count, count, INKS))
    codes = np.tile(np.arange(family.code_count), QUARTERS)
    quarters = np.repeat(np.arange(QUARTERS), family.code_count)
    selections[:, np.arange(INKS), np.arange(INKS)] = 1
    for h, (code, quarter) in enumerate(zip(codes, quarters, strict=True)):
        open_columns = [
            INKS + QUARTERS + column
            for column, gap in zip(turns[quarter], family.gaps(int(code)), strict=True)
            if gap
        ]
        selections[h, INKS + quarter, [0, 2]] = 1, -1
        selections[h, open_columns, 0] = -1
        selections[h, open_columns, 2] = 1
    return Hypotheses(codes, quarters, selections)


@lru_cache(maxsize=8)
def pattern_selections(family: LandmarkFamily) -> FloatArray:
    """(H,C+4,4) the matrices M_h for columns to which those of the framed square are appended."""
    selections = all_hypotheses(family).selections
    return np.concatenate([selections, np.zeros((len(selections), INKS, INKS))], axis=1)


@lru_cache(maxsize=8)
def frame_selection(family: LandmarkFamily) -> FloatArray:
    """(1,C+4,4) the matrix that picks the framed square without rings or triangle."""
    count = all_hypotheses(family).selections.shape[1]
    return np.concatenate([np.zeros((1, count, INKS)), np.eye(INKS)[None]], axis=1)


@dataclass(frozen=True)
class InkSolver:
    """Least squares over the inks, prepared for many hypotheses at once.

    Attributes:
        selections: (H,C,4) the matrices M_h.
        normal: (H,4,4) M_h' C'C M_h, with a little ridge.
        to_whitened: (H,4,C) maps C'Y to four numbers whose squares sum to the explained energy.
    """

    selections: FloatArray
    normal: FloatArray
    to_whitened: FloatArray

    @classmethod
    def prepare(cls, gram: FloatArray, selections: FloatArray) -> InkSolver:
        """From (C,C) C'C and (H,C,4) the matrices M_h."""
        transposed = selections.transpose(0, 2, 1)
        normal = transposed @ (gram @ selections)
        trace = np.trace(normal, axis1=1, axis2=2)
        normal = normal + (RIDGE * trace / INKS)[:, None, None] * np.eye(INKS)
        inverse_root = np.linalg.inv(np.linalg.cholesky(normal))
        return cls(selections, normal, inverse_root @ transposed)

    def in_single_precision(self) -> InkSolver:
        """The same in float32."""
        return InkSolver(*(array.astype(np.float32) for array in (self.selections, self.normal, self.to_whitened)))

    def inks(self, hypotheses: IntArray, projections: FloatArray) -> FloatArray:
        """(N,4,3) best inks of N pictures, each under its own hypothesis, from (C,N,3) C'Y."""
        seen = self.selections[hypotheses].transpose(0, 2, 1) @ projections.transpose(1, 0, 2)
        return np.asarray(np.linalg.solve(self.normal[hypotheses], seen))

    def explained_energy(self, projections: FloatArray) -> FloatArray:
        """(H,N) energy that each hypothesis explains, of (C,N,3) projections C'Y of N pictures."""
        h, inks, count = self.to_whitened.shape
        n = projections.shape[1]
        mapped = self.to_whitened.reshape(h * inks, count) @ projections.reshape(count, n * 3)
        # Sums written out: numpy's own reduction over such short axes takes several times longer.
        squared = np.square(mapped).reshape(h, inks, n * 3)
        energy = (squared[:, 0] + squared[:, 1] + squared[:, 2] + squared[:, 3]).reshape(h, n, 3)
        return np.asarray(energy[:, :, 0] + energy[:, :, 1] + energy[:, :, 2])


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
