"""The steps of a landmark's fit: register and decode alternately until the code is stable; then use all pixels.

Each step is one compiled call (:mod:`lmkit.kernels.landmark_fit`); the numpy definition is here.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from lmkit.detection import decoding
from lmkit.detection.hypotheses import RIDGE
from lmkit.detection.linear_image import LinearImage
from lmkit.detection.pixel_sampling import EDGE_BAND_PX, LEAST_PIXELS, NEAR_SHARE, edges_of, paper_of, reach_of
from lmkit.detection.registration import (
    COLOR_SHIFT_PRIOR,
    DISTORTION_PRIOR,
    LIMITS,
    MIXED_PIXEL_PRIOR,
    SHADING_PRIOR,
    PatternRegistration,
)
from lmkit.detection.shadows import NORMALS
from lmkit.kernels import landmark_fit
from lmkit.kernels.landmark_fit import (
    FINISH,
    READ,
    FitRules,
    FitTask,
    Fitted,
    LandmarkFit,
    Promising,
    Settled,
    Start,
)
from lmkit.kernels.mosaic import MosaicRules
from lmkit.kernels.plane import View
from lmkit.kernels.registration import Priors, Steps
from lmkit.model.landmark import LandmarkFamily

READ_ROUNDS = 3
COARSE = Steps(rounds=1, most=3, to_px=0.1, negligible=10.0)
FINE = Steps(rounds=2, most=3, to_px=0.02, negligible=8.0)  # decision 55
# The initial blur is large, so that a wrong corner still has a gradient toward its edge.
COARSE_SIDE_PX = 100.0
START = Start(least_blur=0.8, blur_share=0.012, blurred_side=COARSE_SIDE_PX)
# Of blue, green and red, in the last steps: what cameras do to color errs most in blue and red (decision 40).  A
# sensor with a mosaic sees these in a quarter of its pixels and green in half, and JPEG files keep color halved.
CHANNEL_WEIGHTS = (0.8, 1.3, 0.9)
# Interpolated values err by color where the image is curved (decision 51).
MOSAIC = MosaicRules(error_share=0.3, evidence=0.15, log_odds=2.0, least_weight=0.04)
COARSE_PIXELS = 400  # enough to decode and to align; the last steps use more


@dataclass
class FitSteps:
    """The steps of a fit.

    Attributes:
        pixels: number of pixels of the landmark in the last steps.
        fit_distortion: also fit the lens's distortion in the end.
    """

    pixels: int
    fit_distortion: bool
    _read: Fitted | None = field(default=None, init=False)

    def read(self, fit: PatternRegistration) -> bool:
        """Register and decode until the code is stable; False if it is not promising."""
        if landmark_fit.is_compiled():
            self._read = self._run(fit, READ)
            return self._read is not None
        coarse = min(COARSE_PIXELS, self.pixels)
        if not fit.sample(coarse, near_edges=False) or not fit.decode().is_promising:
            return False
        for _ in range(READ_ROUNDS):
            before = fit.decoding
            fit.register(COARSE)
            if not fit.sample(coarse, near_edges=False):
                return False
            if fit.decode().is_same_code(before):
                break
        return fit.decoding.is_promising and (fit.image.white is not None or fit.decoding.is_settled)

    def sharpen_shadow(self, fit: PatternRegistration) -> None:
        """Fit the shadow's straight edge, now that the drawing is known, and remove it."""
        if not landmark_fit.is_compiled():
            fit.sharpen_shadow(min(COARSE_PIXELS, self.pixels))
            return
        compiled, reading = compiled_fit(fit.image, fit.family, self.pixels), fit.decoding
        found = compiled.run_shadow_edge(fit.view, fit.state, reading.quarter, reading.code, NORMALS)
        if found is not None:
            fit.remove_shadow(found)

    def finish(self, fit: PatternRegistration) -> bool:
        """Register with all pixels, and decode with plain and with robust weights; False if it left the image."""
        if landmark_fit.is_compiled():
            return self._run(fit, FINISH) is not None
        if not fit.sample(self.pixels, near_edges=True):
            return False
        fit.samples.weigh_channels(CHANNEL_WEIGHTS)
        fit.register(FINE._replace(fit_distortion=self.fit_distortion), MOSAIC)
        fit.decode()
        fit.decode_robust()
        return True

    def _run(self, fit: PatternRegistration, phase: int) -> Fitted | None:
        compiled = compiled_fit(fit.image, fit.family, self.pixels)
        found = compiled.run(fit.view, fit.state, self.fit_distortion, phase, self._read)
        if found is not None:
            fit.take_over(found)
        return found


def compiled_fit(image: LinearImage, family: LandmarkFamily, pixels: int) -> LandmarkFit:
    """The compiled steps for landmarks of a family in this image."""
    known = image.fits.get((family, pixels))
    if known is None:
        view = View(np.zeros(2), image.center, image.half_width, family.half_mm)
        task, source = _task(family, pixels), image.straight_source
        known = LandmarkFit(task, source, view, image.lens, image.skew, image.pixel_error)
        image.fits[family, pixels] = known
    return known


@lru_cache(maxsize=16)
def _task(family: LandmarkFamily, pixels: int) -> FitTask:
    tables = decoding.tables_of(family)
    return FitTask(tables.drawing, tables.words, edges_of(family), _rules(family, pixels))


def _rules(family: LandmarkFamily, pixels: int) -> FitRules:
    promising = Promising(
        decoding.CORRELATED_PIXELS,
        decoding.PROMISING_TURN_MARGIN,
        decoding.PROMISING_PATTERN,
        decoding.PROMISING_RED_OVER_BLUE,
        decoding.PROMISING_CONTRAST,
    )
    priors = Priors(RIDGE, DISTORTION_PRIOR, SHADING_PRIOR, MIXED_PIXEL_PRIOR, 10.0, COLOR_SHIFT_PRIOR)
    return FitRules(
        reach_of(family),
        paper_of(family),
        EDGE_BAND_PX * family.side_mm,
        NEAR_SHARE,
        LEAST_PIXELS,
        min(COARSE_PIXELS, pixels),
        pixels,
        READ_ROUNDS,
        COARSE,
        FINE,
        decoding.RULES,
        priors,
        LIMITS,
        promising,
        Settled(decoding.SETTLED_CODE_MARGIN, decoding.SETTLED_TURN_MARGIN, decoding.SETTLED_CLEAR),
        START,
        PatternRegistration.corner_errors,
        CHANNEL_WEIGHTS,
        MOSAIC,
    )
