"""Reading other families: each by its own name, two in one image, and none as a member of another family."""

from __future__ import annotations

import numpy as np
import pytest
from simulated import shoot

from lmkit.detection.config import DetectOptions
from lmkit.detection.detector import detect_landmarks
from lmkit.errors import InputError
from lmkit.model.landmark import FAMILIES, LM4, LM8, LM8P, LM12


@pytest.mark.parametrize("family", FAMILIES.values(), ids=lambda f: f.name)
def test_every_family_is_read(family):
    rng = np.random.default_rng(3)
    options = DetectOptions((family,))
    for side_px in (28, 40, 90):
        code = int(rng.integers(family.code_count))
        image, corners = shoot(code, side_px, float(rng.uniform(0, 360)), 25.0, seed=side_px, family=family)
        (found,) = detect_landmarks(image, options)
        assert (found.code, found.family) == (code, family.name)
        assert np.abs(found.corners - corners).max() < 0.25


@pytest.mark.parametrize("drawn", [LM4, LM8, LM12], ids=lambda f: f.name)
def test_no_family_is_read_as_one_of_other_rings(drawn):
    others = tuple(family for family in (LM4, LM8, LM12) if family != drawn)
    for seed, side_px in enumerate((30, 60, 100)):
        image, _ = shoot(5 + 3 * seed, side_px, 10.0 * seed, 15.0, seed=seed, family=drawn)
        assert detect_landmarks(image, DetectOptions(others)) == []


def test_two_families_in_one_image():
    images = [shoot(9, 60, family=family, seed=k)[0] for k, family in enumerate((LM8, LM4))]
    found = detect_landmarks(np.hstack(images), DetectOptions((LM4, LM8)))
    assert sorted((d.family, d.code) for d in found) == [("lm4", 9), ("lm8", 9)]


def test_a_word_that_is_no_code_is_refused():
    """An lm8 of odd parity shows eight gaps that no lm8p has; the nearest code is not good enough."""
    for seed, word in enumerate((1, 64, 137, 254)):
        image, _ = shoot(word, 60, seed=seed)
        assert [d.code for d in detect_landmarks(image)] == [word]
        assert detect_landmarks(image, DetectOptions((LM8P,))) == []


def test_families_of_one_drawing_are_not_looked_for_together():
    with pytest.raises(InputError, match="cannot be distinguished"):
        detect_landmarks(np.zeros((80, 80, 3), np.uint8), DetectOptions((LM8, LM8P)))
