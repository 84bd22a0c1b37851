"""Comparison of a doubtful reading with rivals: other codes that are fitted too."""

from __future__ import annotations

import math

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.detection.decoding import CORRELATED_PIXELS, RULES, Decoding, decode_square
from lmkit.detection.fit_steps import CHANNEL_WEIGHTS, COARSE_PIXELS, compiled_fit
from lmkit.detection.linear_image import LinearImage
from lmkit.detection.registration import PatternRegistration, registration_at
from lmkit.kernels import landmark_fit
from lmkit.kernels.hypotheses import Words, decode
from lmkit.kernels.landmark_fit import RivalRules, Rivals
from lmkit.kernels.registration import Hypothesis, Steps
from lmkit.model.landmark import LandmarkFamily

# Most of what a rival gains, it gains in two steps.  One whose margin is 25 before that does not come close, unless
# the reading leaves much unexplained: then its place or its blur is wrong, as under long motion blur.
RIVAL_RULES = RivalRules(rivals=3, most=2, to_px=0.02, negligible=1.0, hopeless=25.0, by_error=1.5)


def rival_margin(
    image: LinearImage, family: LandmarkFamily, state: FloatArray, decoding: Decoding, pixels: int
) -> float:
    """Log likelihood ratio of a reading to the likeliest other codes, each with its own corners and blur.

    The margins of a decoding compare all codes at the state fitted for one of them, which favors this one: another
    code, with slightly different corners of a small landmark, often fits as well.

    Args:
        state: (15,) final state of the reading's fit.
        pixels: number of pixels of the landmark in the last steps.

    Returns:
        Less than 0 if a rival fits better; infinite if none comes close.
    """
    if landmark_fit.is_compiled():
        fit = compiled_fit(image, family, pixels)
        found = fit.run_rivals(state, decoding.quarter, decoding.code, RIVAL_RULES)
    else:
        found = rivals_of(registration_at(image, family, state), decoding, min(COARSE_PIXELS, pixels))
    if found is None or found.rivals_error is None:
        return math.inf
    return _ratio(found.pixels, found.rivals_error, found.error)


def rivals_of(fit: PatternRegistration, decoding: Decoding, pixels: int) -> Rivals | None:
    """Definition of :meth:`lmkit.kernels.landmark_fit.LandmarkFit.run_rivals`; the fit's state moves."""
    if not fit.sample(pixels, near_edges=True):
        return None
    fit.samples.weigh_channels(CHANNEL_WEIGHTS)
    words, turn, code = fit.tables.words, decoding.quarter, decoding.code
    count, least = len(fit.samples.variance), math.inf
    before = decode_square(fit.tables, fit.view, fit.state, fit.samples.plain)
    far = max(RIVAL_RULES.hopeless, RIVAL_RULES.by_error * before.error)
    if before.is_same_code(decoding) and before.margin > far:
        return Rivals(count, 1.0, None)
    error = _error_of(fit, Hypothesis(int(words.masks[turn, code]), turn))
    start, others = fit.state, np.delete(words.masks, code, axis=1)
    for _ in range(min(RIVAL_RULES.rivals, others.shape[1])):
        rival = decode(fit.tables.drawing, Words.of(others, words.gaps), fit.view, fit.samples.plain, start, RULES)
        if rival is None or _ratio(count, rival.left / (3 * count), error) > far:
            break
        fit.state = start
        least = min(least, _error_of(fit, Hypothesis(int(others[rival.turn, rival.code]), rival.turn)))
        if least < error:
            break
        others = np.delete(others, rival.code, axis=1)
    return Rivals(count, error, least if math.isfinite(least) else None)


def _error_of(fit: PatternRegistration, hypothesis: Hypothesis) -> float:
    fit.hypothesis = hypothesis
    rules = RIVAL_RULES
    fit.register(Steps(rounds=0, most=rules.most, to_px=rules.to_px, negligible=rules.negligible))
    return fit.last_error


def _ratio(pixels: int, error: float, least: float) -> float:
    """Log likelihood ratio of two mean squared residuals; neighboring pixels share their errors."""
    return 3 * pixels / CORRELATED_PIXELS / 2 * math.log(max(error, 1e-9) / max(least, 1e-9))
