"""Decoding of a registered square, with the measures that decide whether it is a landmark."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.detection.hypotheses import RIDGE, red_over_blue, words_of
from lmkit.detection.pattern_model import INKS, drawing_of
from lmkit.kernels.hypotheses import Decoded, DecodingRules, Words, decode
from lmkit.kernels.occlusion import OcclusionRules
from lmkit.kernels.pattern import Drawing
from lmkit.kernels.plane import View
from lmkit.kernels.registration import Samples
from lmkit.model.landmark import LandmarkFamily

RULES = DecodingRules(
    ridge=RIDGE,
    parts_ridge=1e-4,
    occlusion=OcclusionRules(
        model_share=0.08,  # of the contrast: smallest error of any model of blur and print
        usual_quantile=0.7,
        code_limit=6.0,  # two standard deviations: pixels that fit worse show something else
        foreign_limit=12.0,  # a single bright pixel is not an object
        foreign_pixel=6.0,
        foreign_pixels=3,
        foreign_reach=10 / 9,
    ),
)
PROMISING_TURN_MARGIN, PROMISING_PATTERN = 2.0, 0.02
PROMISING_RED_OVER_BLUE, PROMISING_CONTRAST = 0.1, 1.1
# When the code is stable at the first pixels; 1 in 500 accepted landmarks has less.
SETTLED_CODE_MARGIN, SETTLED_TURN_MARGIN = 1.5, 6.0
# A turn so clear leaves only the code open: few of a large landmark's first pixels lie in its gaps.
SETTLED_CLEAR = 60.0
CORRELATED_PIXELS = 3.0  # demosaicing and JPEG spread a pixel's error over this number of pixels
PART_TOLERANCE = 0.08  # uneven print and light: usual difference of a part from white or blue


@dataclass(frozen=True)
class Decoding:
    """Decoding of a registered square, with its margins.

    Attributes:
        code, quarter: the likeliest reading.
        code_margin: log likelihood ratio against the likeliest other code in the same turn.
        turn_margin: against the likeliest reading in any other quarter turn.
        pattern: share of what a plain framed square leaves unexplained that rings, gaps and
            triangle explain.
        error: mean squared residual over its expected variance.
        inks: (4,3) linear-light BGR of white, red, blue, surroundings.
        parts: (2+G,) brightness of the triangle, of the rings' fixed stretches and of every gap
            position, where 0 is the ground and 1 the white: each fitted on its own.
        parts_sigma: (2+G,) their standard deviations.
        expected_parts: (2+G,) what they are for this code: 1, or 0 for an open gap.
        evidence: least log likelihood ratio to another code, without pixels that fit neither code well.
        foreign: log likelihood ratio of an object in front of the landmark to the landmark alone.
        plain: the code looks the same in every quarter turn.
    """

    code: int
    quarter: int
    code_margin: float
    turn_margin: float
    pattern: float
    error: float
    inks: FloatArray
    parts: FloatArray
    parts_sigma: FloatArray
    expected_parts: FloatArray
    evidence: float
    foreign: float
    plain: bool

    @property
    def margin(self) -> float:
        """The smaller of the two margins."""
        return min(self.code_margin, self.turn_margin)

    @property
    def red_over_blue(self) -> float:
        """How much redder the border is than the ground, as a log ratio relative to the white."""
        return red_over_blue(self.inks)

    @property
    def parts_residual(self) -> float:
        """Mean squared deviation of the parts from those of the code, in standard deviations."""
        terms = [
            (part - expected) ** 2 / (sigma**2 + PART_TOLERANCE**2)
            for part, expected, sigma in zip(
                self.parts.tolist(), self.expected_parts.tolist(), self.parts_sigma.tolist(), strict=True
            )
        ]
        return float(sum(terms)) / len(terms)

    def is_same_code(self, other: Decoding) -> bool:
        """Same code in the same quarter turn."""
        return (self.code, self.quarter) == (other.code, other.quarter)

    @property
    def is_promising(self) -> bool:
        """Whether to continue registration: much looser than the final acceptance.

        No contrast is too large: the blur that a fit starts with is generous, and takes the ground of a sharp image
        for darker than black.
        """
        return (
            self.turn_margin > PROMISING_TURN_MARGIN
            and self.pattern > PROMISING_PATTERN
            and self.red_over_blue > PROMISING_RED_OVER_BLUE
            and self.white_over_ground > PROMISING_CONTRAST
        )

    @property
    def is_settled(self) -> bool:
        """Whether to run the last steps when the code no longer changes: margins near those of accepted landmarks."""
        if self.turn_margin > SETTLED_CLEAR:
            return True
        return self.code_margin > SETTLED_CODE_MARGIN and self.turn_margin > SETTLED_TURN_MARGIN

    @property
    def white_over_ground(self) -> float:
        """How much brighter white is than the ground, as a ratio."""
        white, _, ground, _ = self.inks.tolist()
        return float(sum(white)) / max(float(sum(ground)), 1e-6)


@dataclass(frozen=True, eq=False)
class FamilyTables:
    """Data of a family for decoding, computed once.

    Attributes:
        family: the family.
        drawing: edges of its drawing.
        words: open gaps of its codes.
        plain: for every code, whether the gaps of every ring are all open or all closed.
        expected_parts: (4,codes,2+G) brightness of triangle, rings and gap positions for every turn and code.
    """

    family: LandmarkFamily
    drawing: Drawing
    words: Words
    plain: tuple[bool, ...]
    expected_parts: FloatArray


@lru_cache(maxsize=16)
def tables_of(family: LandmarkFamily) -> FamilyTables:
    """Tables of a family."""
    plain = tuple(is_plain(family, code) for code in range(family.code_count))
    words = words_of(family)
    closed = 1.0 - (words.masks[:, :, None] >> np.arange(words.gaps) & 1)
    expected = np.concatenate([np.ones((*words.masks.shape, 2)), closed], axis=2)
    return FamilyTables(family, drawing_of(family), words, plain, expected)


def decode_square(tables: FamilyTables, view: View, state: FloatArray, samples: Samples) -> Decoding:
    """Score every code in every quarter turn at this state of a registration."""
    return decoding_of(
        tables, decode(tables.drawing, tables.words, view, samples, state, RULES), len(samples.variance)
    )


def decoding_of(tables: FamilyTables, found: Decoded | None, pixels: int) -> Decoding:
    """Decoding with its margins, from the result of a kernel on this number of pixels."""
    return _NOTHING if found is None else _decoding(tables, found, pixels, _margins(found, pixels))


def cautious_decoding_of(
    tables: FamilyTables, plain: Decoded | None, robust: Decoded | None, pixels: int
) -> Decoding:
    """:func:`cautious` of a kernel's decodings with plain and with robust weights."""
    if plain is None:
        return _NOTHING
    is_same = robust is not None and (robust.code, robust.turn) == (plain.code, plain.turn)
    robust_margins = _margins(robust, pixels) if robust is not None and is_same else None
    return _decoding(tables, plain, pixels, _smaller(_margins(plain, pixels), robust_margins))


def cautious(plain: Decoding, robust: Decoding) -> Decoding:
    """The decoding by plain weights with the smaller of plain and robust margins; none where the two codes differ.

    A bit that only an occluding object determines loses its margin with robust weights.
    """
    robust_margins = (robust.code_margin, robust.turn_margin) if robust.is_same_code(plain) else None
    code, turn = _smaller((plain.code_margin, plain.turn_margin), robust_margins)
    return replace(plain, code_margin=code, turn_margin=turn)


def _smaller(plain: tuple[float, float], robust: tuple[float, float] | None) -> tuple[float, float]:
    return (0.0, 0.0) if robust is None else (min(plain[0], robust[0]), min(plain[1], robust[1]))


def _margins(found: Decoded, pixels: int) -> tuple[float, float]:
    evidence, left = 3 * pixels / CORRELATED_PIXELS / 2, max(found.left, 1e-9)
    by_code, by_turn = max(found.left_by_code, left), max(found.left_by_turn, left)
    return evidence * math.log(by_code / left), evidence * math.log(by_turn / left)


def _decoding(tables: FamilyTables, found: Decoded, pixels: int, margins: tuple[float, float]) -> Decoding:
    left = max(found.left, 1e-9)
    return Decoding(
        code=found.code,
        quarter=found.turn,
        code_margin=margins[0],
        turn_margin=margins[1],
        pattern=1 - left / max(found.left_by_frame, 1e-9),
        error=left / (3 * pixels),
        inks=found.inks,
        parts=found.parts,
        parts_sigma=found.parts_sigma * math.sqrt(CORRELATED_PIXELS),
        expected_parts=tables.expected_parts[found.turn, found.code],
        evidence=found.evidence / CORRELATED_PIXELS / 2,
        foreign=found.foreign / CORRELATED_PIXELS / 2,
        plain=tables.plain[found.code],
    )


def is_plain(family: LandmarkFamily, code: int) -> bool:
    """Whether the gaps of every ring are all open or all closed."""
    gaps = iter(family.gaps(code))
    return all(len({next(gaps) for _ in range(ring.gap_count)}) == 1 for ring in family.rings)


# Where the pixels do not even determine the inks.
_NOTHING = Decoding(
    code=0,
    quarter=0,
    code_margin=0.0,
    turn_margin=0.0,
    pattern=0.0,
    error=1.0,
    inks=np.zeros((INKS, 3)),
    parts=np.full(2, 0.5),
    parts_sigma=np.ones(2),
    expected_parts=np.ones(2),
    evidence=0.0,
    foreign=0.0,
    plain=True,
)
