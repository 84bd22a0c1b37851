"""Simulated cameras: mosaics, demosaicers, tone, noise reduction, and the kinds of cameras drawn from them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lmkit.errors import InputError
from lmkit.simulation.cameras import HELD_OUT_KINDS, TRAINING_KINDS, draw_chain
from lmkit.simulation.mosaic import DEMOSAICERS, PATTERNS, demosaic, mosaic_of
from lmkit.simulation.photograph import TONES, Development, Lens, Sensor, apply_tone, develop, focus
from lmkit.simulation.render import OVERSAMPLE

INSIDE = (slice(4, -4), slice(4, -4))


@pytest.mark.parametrize("how", DEMOSAICERS)
@pytest.mark.parametrize("pattern", PATTERNS)
def test_demosaicing_restores_what_is_even_or_a_ramp(pattern, how):
    x, y = np.meshgrid(np.linspace(0, 1, 24), np.linspace(0, 1, 20))
    image = np.stack([0.2 + 0.5 * x, 0.6 - 0.3 * y, 0.1 + 0.2 * x + 0.3 * y], axis=-1)
    found = demosaic(mosaic_of(image, pattern), pattern, how)
    assert np.abs(found - image)[INSIDE].max() < 2e-3


@pytest.mark.parametrize("how", DEMOSAICERS)
def test_a_shifted_scene_seen_by_the_shifted_pattern_is_the_shifted_image(how):
    image = np.random.default_rng(2).uniform(0, 1, (20, 24, 3))
    whole = demosaic(mosaic_of(image, "RGGB"), "RGGB", how)
    shifted = demosaic(mosaic_of(image[:, 1:], "GRBG"), "GRBG", how)
    assert np.abs(whole[:, 1:] - shifted)[INSIDE].max() < 1e-9


def test_malvar_leaves_less_error_on_gray_detail_than_bilinear():
    stripes = 0.5 + 0.3 * np.sin(np.arange(40) * 2 * np.pi / 7)
    image = np.broadcast_to(stripes[None, :, None], (20, 40, 3)).copy()
    off = {how: np.abs(demosaic(mosaic_of(image, "RGGB"), "RGGB", how) - image)[INSIDE].mean() for how in DEMOSAICERS}
    assert off["malvar"] < 0.5 * off["bilinear"]


def test_unknown_mosaics_are_refused_by_name():
    with pytest.raises(InputError, match="XTRANS"):
        Sensor(bayer=True, pattern="XTRANS")
    with pytest.raises(InputError, match="nearest"):
        Sensor(bayer=True, demosaic="nearest")


@pytest.mark.parametrize("tone", TONES)
def test_tone_curves_rise_from_0_to_1(tone):
    values = apply_tone(np.linspace(0, 1, 200), tone)
    assert (np.diff(values) > 0).all()
    assert np.allclose(values[[0, -1]], [0, 1], atol=1e-3)


def test_contrast_keeps_black_middle_gray_and_white():
    gray = np.array([0.0, 0.5, 1.0])[None, :, None].repeat(3, axis=2)
    image = develop(gray, Development(tone="linear", contrast=1.4))
    assert image[0, :, 0].tolist() == [0, 128, 255]


def test_saturation_zero_is_gray_and_keeps_brightness():
    color = np.array([[[0.8, 0.3, 0.1]]])
    image = develop(color, Development(tone="linear", saturation=0.0))
    assert image[0, 0].tolist() == [round(255 * (0.8 * 0.299 + 0.3 * 0.587 + 0.1 * 0.114))] * 3


def test_noise_reduction_takes_noise_and_leaves_edges():
    rng = np.random.default_rng(3)
    clean = np.full((40, 40, 3), 0.2)
    clean[:, 20:] = 0.8
    noisy = np.clip(clean + rng.normal(0, 0.02, clean.shape), 0, 1)
    how = Development(tone="linear", denoise=0.5)
    image = develop(noisy, how) / 255
    assert image[:, :16].std() < 0.6 * noisy[:, :16].std()
    assert np.abs(image[:, 22:].mean() - image[:, :18].mean() - 0.6) < 0.01


def test_lens_blur_grows_towards_the_corners():
    size = 30 * OVERSAMPLE
    stripes = (np.indices((size, size))[1] // (2 * OVERSAMPLE) % 2).astype(np.float32)[:, :, None].repeat(3, axis=2)
    image = focus(stripes, Lens(blur_px=0.3, corner_blur_px=1.5))
    assert image[12:18, 12:18].std() > 1.3 * image[:6, :6].std()


def test_lateral_color_moves_red_outwards_and_blue_inwards():
    size = 60 * OVERSAMPLE
    spot = np.zeros((size, size, 3), np.float32)
    spot[size // 2, 50 * OVERSAMPLE] = 1.0
    image = focus(spot, Lens(blur_px=1.0, lateral_color=0.02))
    x = (image * np.arange(60)[None, :, None]).sum(axis=(0, 1)) / image.sum(axis=(0, 1))
    assert x[0] > x[1] + 0.2
    assert x[2] < x[1] - 0.2


def test_a_color_shift_moves_red_and_blue_to_opposite_sides_of_green():
    size = 20 * OVERSAMPLE
    spot = np.zeros((size, size, 3), np.float32)
    spot[size // 2, size // 2] = 1.0
    image = focus(spot, Lens(blur_px=1.0, color_shift_px=(0.3, -0.2)))
    y, x = (np.tensordot(index, image, axes=2) / image.sum(axis=(0, 1)) for index in np.indices((20, 20)))
    # OpenCV's cubic interpolation moves a spot by up to 0.05 px too far.
    assert np.allclose([x[0] - x[1], y[0] - y[1]], [0.3, -0.2], atol=0.06)
    assert np.allclose([x[2] - x[1], y[2] - y[1]], [-0.3, 0.2], atol=0.06)


def test_a_kind_draws_the_length_of_its_color_shift():
    kind = replace(TRAINING_KINDS[0], color_shift_px=(0.1, 0.1))
    shifts = [kind.draw(np.random.default_rng(seed)).lens.color_shift_px for seed in range(2)]
    assert np.allclose(np.hypot(*np.transpose(shifts)), 0.1)
    assert shifts[0] != shifts[1]


def test_cameras_are_drawn_from_the_seed_alone():
    one, other = (draw_chain(np.random.default_rng(8), TRAINING_KINDS) for _ in range(2))
    assert one == other
    assert one != draw_chain(np.random.default_rng(9), TRAINING_KINDS)


def test_no_trouble_is_still_and_sharp():
    for seed in range(10):
        chain = draw_chain(np.random.default_rng(seed), TRAINING_KINDS, trouble=0.0)
        assert chain.lens == replace(chain.lens, motion_px=(0.0, 0.0), defocus_px=0.0)
        assert chain.light.veil == 0.0


def test_cameras_to_report_on_are_not_those_to_train_on():
    assert not {kind.name for kind in TRAINING_KINDS} & {kind.name for kind in HELD_OUT_KINDS}
