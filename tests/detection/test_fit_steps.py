"""The compiled fit of a landmark agrees with its definition, step by step."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from simulated import CAMERA, shoot

from lmkit.detection import register_and_decode
from lmkit.detection.acceptance import AcceptanceRule
from lmkit.detection.config import DetectOptions
from lmkit.detection.covering import covering_margin
from lmkit.detection.decoding import Decoding
from lmkit.detection.detector import candidates_of
from lmkit.detection.linear_image import LinearImage
from lmkit.detection.pixel_sampling import sample_pixels
from lmkit.detection.rivals import rival_margin
from lmkit.kernels import landmark_fit, load
from lmkit.kernels.plane import STATE, View
from lmkit.model.families import family_named
from lmkit.simulation.photograph import ImagingChain, Lens

needs_library = pytest.mark.skipif(load.library() is None, reason=load.describe())


@needs_library
@pytest.mark.parametrize("side", [25, 60, 110])
@pytest.mark.parametrize("lens", ["guessed", "known"])
@pytest.mark.parametrize("shade", [1.0, 0.4])
@pytest.mark.parametrize("family", ["lm8", "lm12"])
def test_the_compiled_fit_takes_the_steps_of_the_definition(monkeypatch, side, lens, shade, family):
    family = family_named(family)
    image = shoot(77, side, turn_deg=20, tilt_deg=35, seed=side, family=family)[0]
    rows = image.shape[0] // 2
    image[:rows] = (image[:rows] * shade**0.45).astype(np.uint8)  # a shadow ends on the landmark
    camera = replace(CAMERA, distortion=np.array([-0.2, 0.05, 1e-3, -1e-3, 0.0])) if lens == "known" else None
    options = DetectOptions((family,), camera=camera)
    compiled = candidates_of(image, options)
    monkeypatch.setattr(landmark_fit, "is_compiled", lambda: False)
    defined = candidates_of(image, options)
    assert compiled
    assert len(compiled) == len(defined)
    for ours, theirs in zip(compiled, defined, strict=True):
        assert ours.decoding.code == theirs.decoding.code
        assert ours.rejected == theirs.rejected
        np.testing.assert_allclose(ours.corners, theirs.corners, atol=1e-4)
        np.testing.assert_allclose(ours.covariance, theirs.covariance, rtol=1e-3, atol=1e-9)
        assert ours.log_odds == pytest.approx(theirs.log_odds, abs=1e-3)


@needs_library
def test_a_doubtful_code_is_compared_with_rivals_that_are_fitted_too(monkeypatch):
    """Motion over a third of the side.  The true code wins, and any other loses against it."""
    margins = []

    def every_way(image, family, state, decoding, pixels):
        for reading in (decoding, replace(decoding, code=220)):
            margins.append(rival_margin(image, family, state, reading, pixels))
            with monkeypatch.context() as patch:
                patch.setattr(landmark_fit, "is_compiled", lambda: False)
                margins.append(rival_margin(image, family, state, reading, pixels))
        return margins[0]

    monkeypatch.setattr(register_and_decode, "rival_margin", every_way)
    moving = ImagingChain(Lens(0.6, motion_px=(0.0, 13.5)))
    (found,) = candidates_of(shoot(185, 40.0, turn_deg=-16.0, seed=5, chain=moving)[0], DetectOptions())[:1]
    assert found.decoding.code == 185
    right, right_defined, wrong, wrong_defined = margins
    assert right == found.reading.rival_margin
    assert right == pytest.approx(right_defined, abs=1e-3)
    assert wrong == pytest.approx(wrong_defined, abs=1e-3)
    assert wrong < 0 < right < 60


@needs_library
@pytest.mark.parametrize(("family", "bar_ends_px", "code"), [("lm8", 17, 128), ("lm8", 24, 0), ("lm12", 17, 0)])
def test_a_gap_that_an_object_makes_is_doubted(monkeypatch, family, bar_ends_px, code):
    """A bar in the color of the ground, from outside up to the outer ring or across it, at a closed gap of lm8."""
    margins = []

    def both(*arguments):
        margins.append(covering_margin(*arguments))
        with monkeypatch.context() as patch:
            patch.setattr(landmark_fit, "is_compiled", lambda: False)
            margins.append(covering_margin(*arguments))
        return margins[0]

    monkeypatch.setattr(register_and_decode, "covering_margin", both)
    family = family_named(family)
    image = shoot(0, 60.0, family=family, seed=3, at_m=(0.0, 0.0))[0]
    y, x = np.array(image.shape[:2]) // 2
    image[y - 40 : y - bar_ends_px, x - 7 : x + 7] = image[y - 24, x - 24]
    options = DetectOptions((family,), rule=AcceptanceRule(-5.0))
    found = max(candidates_of(image, options), key=lambda candidate: candidate.reading.decoding.margin)
    assert found.decoding.code == code
    assert found.reading.covering_margin in margins
    assert margins[::2] == pytest.approx(margins[1::2], abs=1e-2)
    assert (found.reading.covering_margin < 8) if code else all(map(math.isinf, margins))


@pytest.mark.parametrize(("spread_px2", "is_margin_seen"), [(0.01, True), (1.0, False)])
def test_pixels_that_show_what_is_behind_the_paper_are_not_taken(spread_px2, is_margin_seen):
    """A margin of 1.1 px is narrower than the point spread of its pixels; the wall would shift the edges."""
    image, family = LinearImage.of(np.full((60, 60, 3), 200, np.uint8)), family_named("lm8")
    corners = np.array([[20.5, 20.5], [40.5, 20.5], [40.5, 40.5], [20.5, 40.5]])
    state = np.zeros(STATE)
    state[:8], state[8], state[10] = corners.ravel(), spread_px2, spread_px2
    at = sample_pixels(image, View(np.zeros(2), image.center, image.half_width, family.half_mm), state, family).at
    assert np.abs(at - 30.5).max() == (10.5 if is_margin_seen else 9.5)


@pytest.mark.parametrize(
    ("turn", "code", "goes_on"), [(100.0, 0.1, True), (10.0, 2.0, True), (10.0, 0.1, False), (3.0, 50.0, False)]
)
def test_a_landmark_that_is_clear_but_for_its_code_goes_on_to_all_pixels(turn, code, goes_on):
    """Few of the first pixels of a large landmark lie in its gaps, so one gap may stay undecided."""
    seen = SimpleNamespace(turn_margin=turn, code_margin=code)
    assert Decoding.is_settled.fget(seen) is goes_on
