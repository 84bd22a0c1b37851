"""Acceptance of a decoded square as a landmark with the right code, by one logistic score.

The score is a sum of terms, each a figure of the decoding times a weight: the log odds that a landmark is
there and that its code is right.  `benchmarks/train_acceptance.py` fits the weights on simulated cameras and on
photographs and prints the table below; docs/landmark.md, section 6, explains the terms.

AprilTag and ArUco markers have another rule: `TagRule` in `tag_registration`.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType

from lmkit.detection.decoding import Decoding


@dataclass(frozen=True)
class Term:
    """One term of the score.

    Attributes:
        weight: what one unit of the figure adds to the log odds.
        usual: median of the figure over landmarks that are read right.
        reason: the reason of a rejection for which this term is the worst.
    """

    weight: float
    usual: float
    reason: str


TURN_PER_CODE = (
    0.6  # a quarter turn changes more of the drawing than a code, so the same margin is less evidence by this factor
)
FOREIGN = 3.0  # usual gain of the best of many rectangles without an object
# A reading with log odds and a margin below these is compared with its rivals, which are fitted too (`rivals`).  It
# is then no surer than this share of its margin over them.
DOUBTFUL, CLEAR_MARGIN, SHARE_OF_RIVAL_MARGIN = 3.8, 80.0, 0.25
# Where an object explains so much, a reading is compared with other codes behind it (`covering`).  It is then no
# surer than this share of its margin over them.
SEEN_OBJECT, SHARE_OF_COVERING_MARGIN = 6.0, 0.3
BIAS = -1.76
TERMS: MappingProxyType[str, Term] = MappingProxyType(
    {
        "margin": Term(0.07, 3.34, "code"),
        "parts residual": Term(-0.68, -0.84, "pattern"),
        "parts residual, large": Term(-0.44, -0.09, "pattern"),
        "evidence": Term(1.16, 1.80, "hidden"),
        "foreign": Term(-0.78, 0.00, "hidden"),
        "contradicting part": Term(-5.70, 0.00, "pattern"),
        "uncertain parts": Term(-0.68, -2.53, "unsure"),
        "too uncertain parts": Term(-0.62, 0.00, "unsure"),
        "little red": Term(-0.81, 0.00, "color"),
        "too red": Term(-0.12, 0.00, "color"),
        "too much contrast": Term(-0.11, 0.00, "contrast"),
        "plain code": Term(-1.48, 0.00, "pattern"),
        "blur": Term(-0.92, -3.46, "blur"),
        "shadow": Term(-0.45, 0.00, "pattern"),
    }
)


@dataclass(frozen=True)
class AcceptanceRule:
    """Least score of a landmark.

    Attributes:
        least_log_odds: of being a landmark with the right code.
    """

    least_log_odds: float


STRICT, DEFAULT, EAGER = AcceptanceRule(3.0), AcceptanceRule(1.7), AcceptanceRule(0.5)
STRICTNESSES = MappingProxyType({"strict": STRICT, "default": DEFAULT, "eager": EAGER})


@dataclass(frozen=True, eq=False)
class ScoredReading:
    """Decoding of a square, with its size and blur in the image.

    Attributes:
        decoding: the decoding.
        side_px: mean side.
        blur_px: standard deviation of the point spread, geometric mean of its axes.
        is_shaded: read after a shadow was removed.
        rival_margin: log likelihood ratio to other codes that are fitted too; infinite if none was.
        covering_margin: log likelihood ratio to other codes behind an object; infinite without an object.
    """

    decoding: Decoding
    side_px: float
    blur_px: float
    is_shaded: bool
    rival_margin: float = math.inf
    covering_margin: float = math.inf

    @cached_property
    def figures(self) -> dict[str, float]:
        """The values of the terms, by name; each is finite for any image."""
        d = self.decoding
        white, red, sigma = max(d.white_over_ground, 0.1), d.red_over_blue, max(*d.parts_sigma.tolist(), 0.01)
        margin = max(min(d.code_margin, TURN_PER_CODE * d.turn_margin), 0.0)
        residual = math.log(max(d.parts_residual + 0.1, 0.22))
        off = max(abs(a - b) for a, b in zip(d.parts.tolist(), d.expected_parts.tolist(), strict=True))
        return {
            "margin": math.log1p(margin / 4),
            "parts residual": residual,
            "parts residual, large": residual * max(0.0, math.log(self.side_px / 20)),
            "evidence": math.log1p(max(d.evidence, 0.0) / 2),
            "foreign": math.log1p(max(d.foreign - FOREIGN, 0.0)),
            "contradicting part": min(max(off - 0.3, 0.0), 1.0),
            "uncertain parts": math.log(min(sigma, 3.0)),
            "too uncertain parts": max(0.0, math.log(sigma / 0.2)),
            "little red": max(0.0, 0.9 - red),
            "too red": max(0.0, red - 4.5),
            "too much contrast": max(0.0, math.log(white / 20)),
            "plain code": float(d.plain),
            "blur": math.log(max(self.blur_px / self.side_px, 1e-3)),
            "shadow": float(self.is_shaded),
        }

    @cached_property
    def _sum_of_terms(self) -> float:
        figures = self.figures
        return BIAS + sum(term.weight * figures[name] for name, term in TERMS.items())

    @property
    def log_odds(self) -> float:
        """Score: log odds of being a landmark with the right code.

        At most the margin over the likeliest rival, and over another code behind an object.
        """
        return min(self._sum_of_terms, self._margin, self._behind_object)

    def compared(self, **margins: float) -> ScoredReading:
        """The reading with a ``rival_margin`` or a ``covering_margin``; its figures stay."""
        compared = copy.copy(self)
        vars(compared).update(margins)
        return compared

    @property
    def is_doubtful(self) -> bool:
        """Whether rivals must be fitted: another code may fit as well with its own corners and blur."""
        return self.log_odds < DOUBTFUL and self.decoding.margin < CLEAR_MARGIN

    @property
    def shows_object(self) -> bool:
        """Whether an object in front of the landmark explains some of its pixels, and may hide a gap."""
        return self.decoding.foreign > SEEN_OBJECT

    @property
    def _behind_object(self) -> float:
        return SHARE_OF_COVERING_MARGIN * self.covering_margin

    @property
    def _margin(self) -> float:
        return min(self.decoding.margin, SHARE_OF_RIVAL_MARGIN * self.rival_margin)

    def reason_to_reject(self, rule: AcceptanceRule) -> str | None:
        """The reason in one word if the score is too low; None if it is high enough."""
        if self.log_odds >= rule.least_log_odds:
            return None
        if self._margin < rule.least_log_odds:
            return "code"
        if self._behind_object < rule.least_log_odds:
            return "hidden"
        figures = self.figures
        # The term that lowers the score most, compared with a usual landmark.
        worst = min(TERMS, key=lambda name: TERMS[name].weight * (figures[name] - TERMS[name].usual))
        return TERMS[worst].reason
