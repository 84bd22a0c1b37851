"""Comparison of a reading with other codes whose gaps an object hides."""

from __future__ import annotations

import math

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.detection.decoding import CORRELATED_PIXELS, RULES, Decoding
from lmkit.detection.fit_steps import CHANNEL_WEIGHTS, compiled_fit
from lmkit.detection.linear_image import LinearImage
from lmkit.detection.registration import PatternRegistration, registration_at
from lmkit.kernels import landmark_fit
from lmkit.kernels.covering import Covering, CoveringRules, covering_numpy
from lmkit.kernels.hypotheses import decode, selection_matrices
from lmkit.kernels.occlusion import usual_variance_numpy
from lmkit.kernels.pattern import GAP, coverage_columns_numpy
from lmkit.kernels.plane import light_numpy, plane_numpy
from lmkit.model.landmark import LandmarkFamily

# Chosen on landmarks that something hides, with what a reading needs of it (decision 49).
COVERING_RULES = CoveringRules(reach=7 / 6, price=14 * 2 * CORRELATED_PIXELS)
TAKEN_AWAY = 0.5


def covering_margin(
    image: LinearImage, family: LandmarkFamily, state: FloatArray, decoding: Decoding, pixels: int
) -> float:
    """Log likelihood ratio of a reading, with or without an object in front, to another code behind an object.

    It is used only if the object takes away more than half of the evidence for the code: an evidence that is small
    without an object has other causes.

    Args:
        state: (15,) final state of the reading's fit.
        pixels: number of pixels of the landmark in the last steps.

    Returns:
        Near 0 if the best object also hides the decisive gap; infinite if no object takes so much away, or if too
        few pixels are available.
    """
    if landmark_fit.is_compiled():
        fit = compiled_fit(image, family, pixels)
        found = fit.run_covering(state, decoding.quarter, decoding.code, COVERING_RULES)
    else:
        found = covering_of(registration_at(image, family, state), decoding, pixels)
    if found is None or found.behind_object > TAKEN_AWAY * found.alone:
        return math.inf
    return found.behind_object / CORRELATED_PIXELS / 2


def covering_of(fit: PatternRegistration, decoding: Decoding, pixels: int) -> Covering | None:
    """Definition of :meth:`lmkit.kernels.landmark_fit.LandmarkFit.run_covering`."""
    if not fit.sample(pixels, near_edges=True):
        return None
    fit.samples.weigh_channels(CHANNEL_WEIGHTS)
    samples, tables, turn, code = fit.samples.plain, fit.tables, decoding.quarter, decoding.code
    found = decode(tables.drawing, tables.words, fit.view, samples, fit.state, RULES)
    if found is None or (found.turn, found.code) != (turn, code):
        return Covering(0.0, 0.0)
    values, variance = samples.values.T.astype(np.float64), samples.variance.astype(np.float64)
    points, spread, _, _ = plane_numpy(fit.view, fit.state, samples.at.T.astype(np.float64))
    light = light_numpy(fit.view, fit.state, points)[:, None]
    columns = coverage_columns_numpy(tables.drawing, points, spread).T * light
    codes = tables.words.masks.shape[1]
    M = selection_matrices(tables.words, tables.drawing.column_count)[turn * codes + code]
    off, contrast = values - columns @ M @ found.inks, found.inks[0] - found.inks[2]
    is_open = tables.words.masks[turn, :, None] >> np.arange(tables.words.gaps) & 1
    return covering_numpy(
        points,
        values,
        off,
        usual_variance_numpy(off, variance, contrast, RULES.occlusion),
        columns[:, GAP:],
        contrast,
        is_open[code],
        np.delete(is_open ^ is_open[code], code, axis=0),
        fit.view.half_mm,
        RULES.occlusion,
        COVERING_RULES,
    )
