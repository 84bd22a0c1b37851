"""CodeHypothesis a registered square, and deciding whether it is a landmark at all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.detection.acceptance import AcceptanceRule
from lmkit.detection.hypotheses import InkSolver, all_hypotheses, frame_selection, pattern_selections, red_over_blue
from lmkit.detection.pattern_model import INKS, QUARTERS
from lmkit.detection.pixel_sampling import PixelSamples, Registration
from lmkit.detection.registration import CORRELATED_PIXELS, PatternRegistration
from lmkit.model.landmark import LandmarkFamily

# A logistic fit of right and wrong against the margin, on simulated pictures at the edge of what can
# be read; benchmarks/confidence.py checks it on others.
EVEN_MARGIN, MARGIN_SCALE = 9.5, 4.6
GAP_PIXELS = 8  # fewer around a gap say nothing
GAP_SURROUNDINGS_MM = 20.0
MODEL_SHARE = 0.08  # of the contrast, which no model of blur and print gets better
WORST_MISFIT = 40.0  # one bright pixel is no hand
PART_TOLERANCE = 0.08  # uneven print and light: a part may differ so much from white or blue


@dataclass(frozen=True)
class Decoding:
    """What a registered square reads as, and how well.

    Attributes:
        code, quarter: the likeliest reading.
        code_margin: log likelihood ratio (nats) against the likeliest other code in the same turn.
        turn_margin: against the likeliest reading in any other quarter turn.
        pattern: share of what a plain framed square leaves unexplained that rings, gaps and
            triangle explain.
        error: mean squared residual over its expected variance.
        inks: (4,3) linear-light BGR of white, red, blue, surroundings.
        parts: (2+G,) brightness of the triangle, of the rings' fixed stretches and of every gap
            position, where 0 is the ground and 1 the white: each fitted on its own.
        parts_sigma: (2+G,) their standard deviations.
        expected_parts: (2+G,) what they are for this code: 1, or 0 for an open gap.
        gap_misfit: the largest mean squared misfit around a gap position, over the usual one.
        plain: the code looks alike in every quarter turn.
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
    gap_misfit: float
    plain: bool

    @property
    def margin(self) -> float:
        """The smaller of the two margins."""
        return min(self.code_margin, self.turn_margin)

    @property
    def red_over_blue(self) -> float:
        """How much redder the border is than the ground, as a log ratio relative to the white."""
        return float(red_over_blue(self.inks))

    @property
    def parts_misfit(self) -> float:
        """Mean squared distance of the parts from what the code says of them, in standard deviations."""
        off = self.parts - self.expected_parts
        return float(np.mean(off**2 / (self.parts_sigma**2 + PART_TOLERANCE**2)))

    def reason_to_reject(self, rule: AcceptanceRule) -> str | None:
        """Why this is no landmark, in one word; None where it is one."""
        low, high = rule.white_over_ground
        turn_margin = rule.turn_margin * (rule.plain_code_factor if self.plain else 1.0)
        checks = {
            "colour": self.red_over_blue >= rule.red_over_blue,
            "contrast": low <= self.white_over_ground <= high,
            "turn": self.turn_margin >= turn_margin,
            "code": self.code_margin >= rule.code_margin,
            "hidden": self.gap_misfit <= rule.hidden,
            "unsure": float(self.parts_sigma.max()) <= rule.part_sigma,
            "pattern": float(np.abs(self.parts[:2] - 1).max()) <= rule.part_deviation
            and self.parts_misfit <= rule.parts_misfit
            and float(np.abs(self.parts - 0.5).max()) <= 0.5 + rule.part_overshoot,
        }
        return next((name for name, passed in checks.items() if not passed), None)

    def is_promising(self, rule: AcceptanceRule) -> bool:
        """Worth registering: far looser than what is accepted in the end.

        Of the development rooms' landmarks one in sixty fails, of the other squares nineteen in twenty.
        """
        low, high = rule.white_over_ground
        return (
            self.turn_margin > 8.0
            and self.pattern > 0.04
            and self.red_over_blue > 0.3
            and 0.82 * low < self.white_over_ground < 1.5 * high
        )

    @property
    def confidence(self) -> float:
        """Probability that the code is right, 0..1.

        The margin is a log likelihood ratio, but neighbouring pixels repeat each other's errors
        (demosaicing, JPEG) more than it allows for, so it is mapped to what it has been worth.
        """
        return float(1 / (1 + np.exp((EVEN_MARGIN - self.margin) / MARGIN_SCALE)))

    @property
    def white_over_ground(self) -> float:
        """How much brighter white is than the ground, as a ratio."""
        return float(self.inks[0].sum() / max(float(self.inks[2].sum()), 1e-6))


def decode_square(registrar: PatternRegistration, registration: Registration, pixels: PixelSamples) -> Decoding:
    """Score every code in every quarter turn at this registration."""
    family = registrar.family
    points, spread, _ = registrar.points_and_spread(registration, pixels.at)
    columns = registrar.pattern.coverage(points, spread).columns
    columns = columns * registrar.light(registration, points)[:, None]
    root = 1 / np.sqrt(pixels.variance)
    weighted = columns * root[:, None]
    values = pixels.values * root[:, None]
    gram = weighted.T @ weighted
    projections = (weighted.T @ values)[:, None, :]
    hypotheses = all_hypotheses(family)
    solver = InkSolver.prepare(gram, pattern_selections(family))
    energy = float((values**2).sum())
    left = np.maximum(energy - solver.explained_energy(projections)[:, 0], 1e-9)
    best = int(left.argmin())
    same_turn = hypotheses.quarters == hypotheses.quarters[best]
    others = same_turn.copy()
    others[best] = False
    evidence = values.size / CORRELATED_PIXELS / 2
    frame = InkSolver.prepare(gram, frame_selection(family))
    left_by_frame = max(energy - float(frame.explained_energy(projections)[0, 0]), 1e-9)
    (inks,) = solver.inks(np.array([best]), projections)
    parts, parts_sigma = _fit_parts(columns, pixels, inks, int(hypotheses.quarters[best]))
    return Decoding(
        code=int(hypotheses.codes[best]),
        quarter=int(hypotheses.quarters[best]),
        code_margin=evidence * float(np.log(left[others].min() / left[best])),
        turn_margin=evidence * float(np.log(left[~same_turn].min() / left[best])),
        pattern=1 - float(left[best]) / left_by_frame,
        error=float(left[best]) / values.size,
        inks=inks,
        parts=parts,
        parts_sigma=parts_sigma,
        expected_parts=np.concatenate([np.ones(2), 1 - hypotheses.selections[best][-family.gap_count :, 2]]),
        gap_misfit=_gap_misfit(family, points, pixels, columns @ solver.selections[best] @ inks, inks),
        plain=_is_plain(family, int(hypotheses.codes[best])),
    )


def _gap_misfit(
    family: LandmarkFamily, points: FloatArray, pixels: PixelSamples, model: FloatArray, inks: FloatArray
) -> float:
    """The largest mean squared misfit around a gap position, over what is usual.

    What hides a gap reaches over the ring's edges on its way from outside, so the surroundings tell,
    even where it is as dark as the ground or as bright as the ring.  Usual is the median of all
    pixels, or the expected variance, or a share of the contrast, which no model of blur and print
    gets better; whichever is largest.
    """
    squared = np.mean((pixels.values - model) ** 2, axis=1)
    median = float(np.median(squared / pixels.variance))
    usual = np.maximum(pixels.variance * max(median, 1.0), np.mean((MODEL_SHARE * (inks[0] - inks[2])) ** 2))
    misfit = np.minimum(squared / usual, WORST_MISFIT)
    radius = np.maximum(np.hypot(points[:, 0], points[:, 1]), 1.0)
    angle = np.degrees(np.arctan2(points[:, 0], points[:, 1]))
    reach = np.degrees(GAP_SURROUNDINGS_MM / radius)
    worst = 0.0
    for ring in family.rings:
        near = np.abs(radius - (ring.inner_mm + ring.outer_mm) / 2) < (
            GAP_SURROUNDINGS_MM + (ring.outer_mm - ring.inner_mm) / 2
        )
        for centre in ring.gap_centres_deg:
            off = np.abs((angle - centre + 180) % 360 - 180)
            around = near & (off < ring.gap_width_deg / 2 + reach)
            if around.sum() >= GAP_PIXELS:
                worst = max(worst, float(misfit[around].mean()))
    return worst


def _is_plain(family: LandmarkFamily, code: int) -> bool:
    """Are the gaps of every ring all open or all closed?"""
    gaps = iter(family.gaps(code))
    return all(len({next(gaps) for _ in range(ring.gap_count)}) == 1 for ring in family.rings)


def _fit_parts(
    columns: FloatArray, pixels: PixelSamples, inks: FloatArray, quarter: int
) -> tuple[FloatArray, FloatArray]:
    """Brightness of every white part on its own, 0 like the ground and 1 like the white, and sigmas.

    A sign with other shapes in a red frame can be fitted by some code, but its parts then come out
    between blue and white, where a landmark's are one or the other.
    """
    contrast = inks[0] - inks[2]
    values = pixels.values @ contrast / max(float(contrast @ contrast), 1e-9)
    fixed, triangles, gaps, frame = np.split(columns, [INKS, INKS + QUARTERS, columns.shape[1] - INKS], axis=1)
    stretches = fixed[:, 0] - frame[:, 0] - gaps.sum(axis=1)
    design = np.column_stack([triangles[:, quarter], stretches, gaps, frame])
    weighted = design / pixels.variance[:, None]
    normal = weighted.T @ design
    normal += 1e-4 * np.trace(normal) / len(normal) * np.eye(len(normal))
    inverse = np.linalg.inv(normal)
    solution = inverse @ (weighted.T @ values)
    misfit = float(np.mean((values - design @ solution) ** 2 / pixels.variance)) * CORRELATED_PIXELS
    count = design.shape[1] - INKS
    return solution[:count], np.sqrt(np.diag(inverse)[:count] * misfit)
