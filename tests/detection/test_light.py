"""The light of an image: shadows and their edges, and the noise of its pixels."""

from __future__ import annotations

import cv2
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from simulated import CAMERA, shoot

from lmkit.detection import linear_image
from lmkit.detection.config import DetectOptions
from lmkit.detection.detector import candidates_of, detect_landmarks
from lmkit.detection.linear_image import LinearImage
from lmkit.detection.screening import screen_candidates
from lmkit.detection.shadows import LARGEST_WINDOW_PX, ShadowEdge, local_white, white_within, window_for
from lmkit.kernels.workspace import Loans
from lmkit.model.landmark import LM8
from lmkit.simulation.photograph import Development, ImagingChain, Lens, Light, Sensor, Shadow


def test_the_local_white_bridges_the_dark_and_keeps_a_step():
    photo = np.full((60, 90, 3), 0.8, np.float32)
    photo[20:30, 10:80] = 0.05
    photo[:, 45:] *= 0.25
    white = local_white(photo, window_for(40))
    assert np.allclose(white[24, [20, 40]], 0.8, atol=0.01)
    assert np.allclose(white[24, [50, 70]], 0.2, atol=0.01)


def test_a_large_window_finds_the_same_white_in_a_halved_image():
    photo = np.full((300, 420, 3), 230, np.uint8)
    photo[90:160, 70:350] = 30
    photo[:, 200:] //= 2
    levels = LinearImage.of(photo).pyramid.levels
    box, window = (21, 13, 401, 290), 2 * LARGEST_WINDOW_PX + 41
    white = white_within(levels, box, window)
    whole = white_within(levels[:1], box, window)
    assert white.shape == whole.shape == (277, 380)
    # In a halved image, one pixel contains the step between the two lights.
    step = np.abs(np.arange(21, 401) - 199.5) < 10
    assert np.allclose(white[:, ~step], whole[:, ~step], rtol=0.01)
    bright, dark = whole[0, 0], whole[0, -1]
    before = [(row[0, step] - dark).sum() / (bright - dark) for row in (white, whole)]
    assert abs(before[0] - before[1]) < 0.7


def test_halvings_leave_out_a_last_row_and_column_without_partner():
    image = np.random.default_rng(0).integers(0, 256, (121, 131, 3), dtype=np.uint8)
    halved = LinearImage.of(image).pyramid.levels[1]
    means = image[:120, :130].reshape(60, 2, 65, 2, 3).mean(axis=(1, 3))
    assert np.array_equal(halved, np.floor(means + 0.5))


def test_memory_is_lent_again_and_cleared():
    loans = Loans(1)
    first = loans.lend((40, 50), np.float32, (slice(3, 9), slice(5, 7)))
    first[3:9, 5:7] = 2.0
    place, other = first.ctypes.data, loans.lend((40, 50), np.float32, (slice(0, 1), slice(0, 1)))
    assert other.ctypes.data != place
    del first
    again = loans.lend((40, 50), np.float32, (slice(0, 1), slice(0, 1)))
    assert again.ctypes.data == place
    assert not again.any()


def test_a_slice_of_lent_memory_keeps_it():
    loans = Loans(1)
    part = loans.lend((40, 50), np.float32)[3:9].T
    assert not np.shares_memory(loans.lend((40, 50), np.float32), part)


def test_a_landmark_of_ten_code_values_of_contrast_is_found_in_a_veil():
    """Code values lie around 128; their noise has a deviation of 1.6."""
    white, black = ((133 / 255) ** 2.2, (123 / 255) ** 2.2)
    light = Light((white - black) / 0.86, veil=black)
    chain = ImagingChain(Lens(0.7), light, Sensor(6000.0, 6.0), Development(tone="gamma"))
    seen = [detect_landmarks(shoot(137, 60.0, 10.0 * seed, 20.0, chain, seed)[0]) for seed in range(4)]
    assert sum([d.code for d in found] == [137] for found in seen) >= 3


@given(
    angle=st.floats(0, 2 * np.pi),
    offset=st.floats(-12, 12),
    ratio=st.floats(2, 8),
    seed=st.integers(0, 1000),
)
def test_a_shadows_edge_is_found_again(angle, offset, ratio, seed):
    rng = np.random.default_rng(seed)
    at = rng.uniform(-40, 40, (1500, 2))
    behind = at @ [np.cos(angle), np.sin(angle)] > offset
    light = np.where(behind, 0.6 / ratio, 0.6) * np.exp(rng.normal(0, 0.1, len(at)))
    edge = ShadowEdge.fit(at, light, np.ones(len(at)))
    drawn = np.where(at @ edge.normal > edge.offset, edge.lights[1], edge.lights[0])
    wrong = np.abs(np.log(drawn / np.where(behind, 0.6 / ratio, 0.6))) > 0.1
    # Directions 5 deg apart are tried, so the error is at most half of that, over half the width.
    assert wrong.mean() < 0.04


def test_only_squares_across_a_shadows_edge_are_looked_at_again():
    scores = []
    for shadow in (Shadow((120, 90), 30.0, 4.0), None):
        image, corners = shoot(137, 60.0, chain=ImagingChain(light=Light(shadow=shadow)))
        pyramid = LinearImage.of(image).pyramid
        scores.append(screen_candidates(pyramid, corners[None], LM8, in_shadow=True).pattern[0])
    assert scores[0] > 0.5
    assert scores[1] == 0


def test_light_written_to_one_image_is_not_in_the_next_though_its_memory_is_used_again():
    image = LinearImage.of(np.random.default_rng(0).integers(0, 256, (60, 80, 3), dtype=np.uint8))
    boxes = [(5, 5, 30, 20), (20, 10, 60, 50), (0, 0, 80, 60), (70, 50, 90, 70)]
    alive = image.renormalized(boxes[0], np.full((15, 25), 2, np.float32))
    for x0, y0, x1, y1 in boxes[1:]:
        x1, y1 = min(x1, 80), min(y1, 60)
        expected = np.zeros((60, 80), np.float32)
        expected[y0:y1, x0:x1] = 3
        lit = image.renormalized((x0, y0, x1, y1), np.full((y1 - y0, x1 - x0), 3, np.float32))
        assert np.array_equal(lit.white, expected)
        del lit
    assert alive.white.sum() == 2 * 15 * 25


def test_pixels_are_weighted_by_the_noise_and_by_one_code_value_at_least():
    """Enlarged and smoothed images have almost no noise, and all edges would be outliers."""
    grain = np.random.default_rng(1).normal(size=(120, 160, 3))
    for noise in (0.0, 0.3, 4.0):
        grainy = np.round(128 + noise * grain).astype(np.uint8)
        image, enlarged = LinearImage.of(grainy), LinearImage.of(cv2.resize(grainy, None, fx=3, fy=3))
        assert image.pixel_error == max(image.noise, 1 / 255)
        assert enlarged.noise < 1 / 255 <= enlarged.pixel_error
    assert image.pixel_error > 2 / 255


def test_the_shift_of_all_pixels_is_left_out_where_no_square_is_registered(monkeypatch):
    asked = []

    def none_yet(key):
        asked.append(key)
        return np.zeros((key.camera.image_size[1], key.camera.image_size[0], 2), np.float32)

    monkeypatch.setattr(linear_image, "_lens_shift", none_yet)
    options = DetectOptions((LM8,), camera=CAMERA)
    image = shoot(77, 60, seed=1)[0]
    assert candidates_of(np.full_like(image, 128), options) == [] and not asked
    assert candidates_of(image, options) and asked


def test_displaced_colors_do_not_move_corners():
    """Red and blue are displaced by 0.25 px from green, as far from the center of many lenses."""
    errors = []
    for seed in range(6):
        photos = [
            shoot(137, 50.0, 8.0 * seed, 20.0, ImagingChain(Lens(0.7, color_shift_px=shift), Light(), Sensor()), seed)
            for shift in ((0.0, 0.0), (0.2, -0.15))
        ]
        errors.append([np.abs(detect_landmarks(photo)[0].corners - corners).max() for photo, corners in photos])
    still, displaced = np.median(errors, axis=0)
    assert displaced < still + 0.02
