"""Every step of the imaging chain compared with its specification."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from lmkit.errors import InputError
from lmkit.geometry.pose import Pose
from lmkit.model.palette import BLUE, RED, WHITE, srgb_to_linear
from lmkit.simulation.inks import ALL_INKS, INKJET, as_printed
from lmkit.simulation.photograph import (
    TONES,
    Development,
    Gloss,
    ImagingChain,
    Lens,
    Light,
    Sensor,
    Shadow,
    apply_tone,
    black_body_rgb,
    count_electrons,
    develop,
    expose,
    focus,
    light_up,
)
from lmkit.simulation.render import OVERSAMPLE, render
from lmkit.simulation.scene import Panel, Scene, make_rig, studio


def gray(height=60, width=80, value=0.5):
    return np.full((height * OVERSAMPLE, width * OVERSAMPLE, 3), value, dtype=np.float32)


def point():
    photo = gray(41, 41, 0.0)
    middle = 20 * OVERSAMPLE + OVERSAMPLE // 2
    photo[middle, middle] = OVERSAMPLE**2
    return photo


def center_and_variance(photo):
    y, x = np.mgrid[: photo.shape[0], : photo.shape[1]]
    w = photo[:, :, 0] / photo[:, :, 0].sum()
    mx, my = (w * x).sum(), (w * y).sum()
    return mx, my, (w * (x - mx) ** 2).sum(), (w * (y - my) ** 2).sum()


@pytest.mark.parametrize(
    ("lens", "xx", "yy"),
    [
        (Lens(blur_px=1.5), 2.25, 2.25),
        (Lens(blur_px=0.0, defocus_px=4.0), 4.0, 4.0),  # a disc: r^2 / 4
        (Lens(blur_px=0.0, motion_px=(6.0, 0.0)), 3.0, 0.0),  # a line: l^2 / 12
    ],
)
def test_blur_spreads_a_point_as_it_should(lens, xx, yy):
    mx, my, vx, vy = center_and_variance(focus(point(), lens))
    assert mx == pytest.approx(20, abs=1e-3)
    assert my == pytest.approx(20, abs=1e-3)
    # The point itself is a third of a pixel wide and falls into one pixel.
    assert vx == pytest.approx(xx, rel=0.06, abs=0.1)
    assert vy == pytest.approx(yy, rel=0.06, abs=0.1)


def test_no_blur_loses_light():
    assert focus(point(), Lens(0.7, 3.0, (4.0, 2.0))).sum() == pytest.approx(3.0, rel=1e-4)


def test_shadow_and_gradient():
    lit = light_up(focus(gray(), Lens()), Light(brightness=1.0, shadow=Shadow((40, 30), 0.0, 8.0)))
    assert lit[30, 70, 0] == pytest.approx(lit[30, 10, 0] / 8, rel=1e-3)
    slope = light_up(focus(gray(), Lens()), Light(brightness=1.0, gradient=(0.5, 0.0)))
    assert slope[0, -1, 0] / slope[0, 0, 0] == pytest.approx(3.0, rel=0.05)


def test_gloss_adds_light_where_it_is():
    lit = light_up(focus(gray(), Lens()), Light(brightness=1.0, gloss=Gloss((40, 30), 5.0, 0.3)))
    assert lit[30, 40, 1] == pytest.approx(0.8, abs=1e-3)
    assert lit[5, 5, 1] == pytest.approx(0.5, abs=1e-3)


def test_warm_light_is_warm_and_balanced_away():
    assert np.allclose(black_body_rgb(6500), 1)
    red, green, blue = black_body_rgb(2700)
    assert red > 1.5
    assert green == 1
    assert blue < 0.45
    chain = ImagingChain(light=Light(brightness=0.5, temperature_k=2700), sensor=Sensor(1e7, 0.0))
    image = expose(gray(), chain, np.random.default_rng(0))
    assert np.ptp(image[30, 40].astype(int)) <= 1
    wrong = ImagingChain(chain.lens, chain.light, chain.sensor, Development(balanced_for_k=6500))
    b, g, r = expose(gray(), wrong, np.random.default_rng(0))[30, 40].astype(int)
    assert r > g + 20 > b + 40
    with pytest.raises(InputError):
        black_body_rgb(500)


def test_noise_is_poisson_plus_reading():
    sensor = Sensor(full_well=1000.0, read_noise=10.0)
    measured = count_electrons(np.full((200, 200, 3), 0.4), sensor, np.random.default_rng(0)) * 1000
    assert measured.mean() == pytest.approx(400, rel=0.01)
    assert measured.var() == pytest.approx(400 + 100, rel=0.03)


def test_mosaic_keeps_colors_in_their_places():
    colors = np.zeros((64, 64, 3))
    colors[:, :32], colors[:, 32:] = (0.6, 0.2, 0.1), (0.1, 0.2, 0.7)
    seen = count_electrons(colors, Sensor(1e8, 0.0, bayer=True), np.random.default_rng(0))
    assert np.allclose(seen[:, 4:28], colors[:, 4:28], atol=2e-3)
    assert np.allclose(seen[:, 36:60], colors[:, 36:60], atol=2e-3)


@pytest.mark.parametrize("tone", TONES)
def test_tones_rise_from_black_to_white(tone):
    curve = apply_tone(np.linspace(0, 1, 200), tone)
    assert (np.diff(curve) > 0).all()
    assert curve[0] == pytest.approx(0, abs=1e-9)
    assert curve[-1] == pytest.approx(1)


def test_chroma_at_half_resolution_smears_color():
    stripes = np.zeros((64, 64, 3))
    stripes[:, ::2], stripes[:, 1::2] = (0.8, 0.1, 0.1), (0.1, 0.1, 0.8)
    spread = {}
    for chroma in ("420", "444"):
        image = develop(stripes, Development(jpeg_quality=95, chroma=chroma))
        spread[chroma] = np.std(image[:, :, 2].astype(float) - image[:, :, 0])
    assert spread["420"] < 0.5 * spread["444"]


def test_sharpening_overshoots():
    edge = np.full((32, 32, 3), 0.2)
    edge[:, 16:] = 0.5
    plain, sharp = (develop(edge, Development(sharpen=a)).astype(int) for a in (0.0, 1.0))
    assert sharp.max() > plain.max()
    assert sharp.min() < plain.min()


def test_unknown_tone_is_refused():
    with pytest.raises(InputError, match="tone"):
        Development(tone="sepia")


@pytest.mark.parametrize("name", ALL_INKS)
def test_inks_take_the_place_of_the_files_colors(name):
    inks = ALL_INKS[name]
    paper, red, blue, black = inks.reflectance
    assert paper.min() > 0.65
    assert red[0] > 4 * red[2]
    assert blue[2] > 1.5 * blue[0]
    assert black.max() < 0.1
    file = srgb_to_linear(np.array([[WHITE, RED, BLUE]]) / 255).astype(np.float32)
    assert np.allclose(as_printed(file, inks)[0], np.clip(inks.reflectance[:3], 0, 1), atol=1e-4)
    halfway = (file[:, :1] + file[:, 1:2]) / 2
    assert np.allclose(
        as_printed(halfway, INKJET)[0, 0], np.clip(INKJET.reflectance[:2], 0, 1).mean(axis=0), atol=1e-4
    )


def test_bowed_paper_is_where_its_bow_puts_it():
    """A dot at the center of paper that stands 5 cm out, seen from the side, moves by parallax."""
    texture = np.full((101, 101, 3), 0.8, dtype=np.float32)
    texture[46:55, 46:55] = 0.0
    camera = make_rig((320, 240), 230.0).left
    aside = Pose("map", "camera", cv2.Rodrigues(np.array([0.0, -0.5, 0.0]))[0], np.array([0.4, 0.0, 0.25]))
    facing = np.diag([1.0, -1.0, -1.0])
    for bow in (0.0, 0.05):
        panel = Panel(Pose("map", "sheet", facing, np.array([0, 0, 1.0])), (0.3, 0.3), texture, bow)
        photo = focus(render(Scene((panel,), studio([]).landmarks, (1, 1, 1)), camera, aside), Lens(0.0))[:, :, 0]
        middle = np.array([0.0, 0.0, 1.0 - bow])
        ((u, v),) = camera.project(aside.inverse().apply(middle[None]))
        found = photo[round(v) - 3 : round(v) + 4, round(u) - 1 : round(u) + 2]
        assert found.max() < 0.1
