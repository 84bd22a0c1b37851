"""Laws of detection: changes of the image that must not change the answer, and objects that must not be found."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scenes import paste_landmark

from lmkit.detection.detector import detect_landmarks
from lmkit.detection.hypotheses import words_of
from lmkit.detection.pattern_model import LandmarkPattern
from lmkit.generation.page import bare_landmark_page
from lmkit.generation.png import page_to_image
from lmkit.kernels.plane import View, displaced_numpy, distorted_numpy
from lmkit.model.codewords import code_to_gaps
from lmkit.model.landmark import LM8


@pytest.fixture(scope="module")
def scene(photographs):
    """A real photograph with two landmarks in it: (image, {code: true corners})."""
    rng = np.random.default_rng(5)
    image = cv2.resize(photographs[0], (420, 320))
    truth = {}
    for code, center, side, tilt in ((137, (110, 150), 60, 30), (52, (300, 160), 34, 20)):
        image, truth[code] = paste_landmark(image, code, center, side, tilt, rng)
    return image, truth


def corners_by_code(image):
    return {d.code: d.corners for d in detect_landmarks(image)}


def test_landmarks_are_found_where_they_are(scene):
    image, truth = scene
    found = corners_by_code(image)
    assert found.keys() == truth.keys()
    for code, corners in truth.items():
        assert np.abs(found[code] - corners).max() < 0.5


def test_a_quarter_turn_of_the_image_turns_the_corners_along(scene):
    image, truth = scene
    turned = corners_by_code(np.ascontiguousarray(np.rot90(image)))  # counter-clockwise
    assert turned.keys() == truth.keys()
    for code, corners in truth.items():
        expected = np.column_stack([corners[:, 1], image.shape[1] - 1 - corners[:, 0]])
        assert np.abs(turned[code] - expected).max() < 0.6


def test_cropping_shifts_the_corners(scene):
    image, truth = scene
    cropped = corners_by_code(np.ascontiguousarray(image[40:, 30:]))
    for code, corners in truth.items():
        assert np.abs(cropped[code] + [30, 40] - corners).max() < 0.6


def test_enlarging_scales_the_corners(scene):
    image, truth = scene
    large = corners_by_code(cv2.resize(image, None, fx=2, fy=2, interpolation=cv2.INTER_LINEAR))
    for code, corners in truth.items():
        assert np.abs((large[code] + 0.5) / 2 - 0.5 - corners).max() < 0.6


def test_red_and_blue_swapped_is_no_landmark(scene):
    assert detect_landmarks(np.ascontiguousarray(scene[0][:, :, ::-1])) == []


def test_a_mirrored_landmark_is_not_read_as_the_same_code(scene):
    found = corners_by_code(np.ascontiguousarray(scene[0][:, ::-1]))
    assert 52 not in found or code_to_gaps(52, 8) == mirrored(52)
    assert 137 not in found or code_to_gaps(137, 8) == mirrored(137)


def mirrored(code):
    a, b, c, d, e, f, g, h = code_to_gaps(code, 8)
    return (a, d, c, b, h, g, f, e)


def test_a_gray_image_holds_no_landmark(scene):
    gray = cv2.cvtColor(cv2.cvtColor(scene[0], cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    assert detect_landmarks(gray) == []


def test_a_landmark_cut_by_the_edge_is_not_returned_with_invented_corners(scene):
    image, truth = scene
    cut = int(truth[137][:, 0].min()) + 8
    found = corners_by_code(np.ascontiguousarray(image[:, cut:]))
    assert 137 not in found
    assert 52 in found


def test_a_pole_over_one_side_does_not_move_the_other_corners(scene):
    image, truth = scene
    hidden = image.copy()
    left = int(truth[137][[0, 3], 0].mean())
    hidden[:, left - 1 : left + 4] = (60, 75, 70)
    found = corners_by_code(hidden)
    if 137 in found:  # it may be refused, but never misplaced
        assert np.abs(found[137] - truth[137]).max() < 2.0


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((16, 16, 3), np.uint8),
        np.full((50, 400, 3), 255, np.uint8),
        np.random.default_rng(0).integers(0, 256, (120, 160, 3), dtype=np.uint8),
        np.indices((90, 90)).sum(axis=0)[:, :, None].repeat(3, axis=2).astype(np.uint8) % 2 * 255,
    ],
    ids=["black", "white strip", "noise", "finest checks"],
)
def test_extreme_images_hold_nothing_and_break_nothing(image):
    assert detect_landmarks(image) == []


def test_covariance_is_as_large_as_the_errors(photographs):
    """The mean NEES of the corners over many draws is their number of coordinates, within a factor."""
    ratios = []
    for seed in range(12):
        rng = np.random.default_rng(100 + seed)
        image = cv2.resize(photographs[seed % len(photographs)], (200, 160))
        image, truth = paste_landmark(image, 3 + 17 * seed, (100, 80), rng.uniform(30, 70), 25, rng)
        for found in detect_landmarks(image):
            error = (found.corners - truth).ravel()
            ratios.append(error @ np.linalg.solve(found.covariance + 0.03**2 * np.eye(8), error) / 8)
    assert len(ratios) >= 10
    assert 0.1 < np.median(ratios) < 5


def test_turning_a_landmark_permutes_its_gaps():
    """The hypotheses of the decoder compared with the drawing, rotated by the image library."""
    size = 180
    pattern = LandmarkPattern(LM8)
    centers = (np.arange(size) + 0.5) / size * 180 - 90
    x, y = np.meshgrid(centers, -centers)
    points = np.column_stack([x.ravel(), y.ravel()])
    spread = np.tile([0.3, 0.0, 0.3], (len(points), 1))
    masks = words_of(LM8).masks
    upright = np.asarray(page_to_image(bare_landmark_page(LM8, 0b10110001, 180.0), size / 180 * 25.4), float)
    for quarter in range(4):
        turned = np.rot90(upright, -quarter)  # clockwise
        gaps = [k for k in range(8) if masks[quarter, 0b10110001] >> k & 1]
        white = pattern.inks(points, spread, gaps, quarter)[0, :, 0].reshape(size, size)
        assert np.corrcoef(white.ravel(), (turned[:, :, 1] > 170).ravel())[0, 1] > 0.98


@pytest.mark.parametrize("distortion", [-0.2, -0.05, 0.0, 0.1, 0.3])
def test_distortion_is_undone(distortion):
    at = np.random.default_rng(3).uniform([440, 40], [560, 160], (50, 2))
    view = View(np.array([500.0, 100.0]), np.array([319.5, 239.5]), 320.0, 90.0)
    flat = at + displaced_numpy(view, distortion, at - view.origin)[0]
    assert np.allclose(distorted_numpy(view, distortion, flat), at, atol=1e-6)


def test_displacement_is_that_of_the_lens_up_to_an_affine_map():
    view, k = View(np.array([500.0, 100.0]), np.array([319.5, 239.5]), 320.0, 90.0), 0.1
    at = np.random.default_rng(3).uniform(-60, 60, (50, 2))
    offset = at + view.origin - view.center
    r2 = np.sum(offset**2, axis=1, keepdims=True) / view.half_width**2
    displacement, by_distortion, by_at = displaced_numpy(view, k, at)
    affine = np.column_stack([at, np.ones(50)])
    left = offset * (k * r2 + k**2 * r2**2) - displacement
    assert np.abs(left - affine @ np.linalg.lstsq(affine, left, rcond=None)[0]).max() < 1e-9
    assert np.abs(displaced_numpy(view, k, np.zeros((1, 2)))[2]).max() == 0.0
    step = 1e-6
    more = displaced_numpy(view, k + step, at)[0] - displaced_numpy(view, k - step, at)[0]
    assert np.allclose(more / (2 * step), by_distortion, atol=1e-6)
    for axis, move in enumerate(np.eye(2) * 1e-4):
        more = displaced_numpy(view, k, at + move)[0] - displaced_numpy(view, k, at - move)[0]
        assert np.allclose(more / 2e-4, by_at[:, :, axis], atol=1e-7)


def test_repeated_nested_and_overlapped_landmarks_are_each_read_as_what_they_are():
    """A code twice, one landmark inside another, and one over the corner of another, which is then not read."""
    image = np.full((300, 420, 3), 110, dtype=np.uint8)
    for code, side, x, y in ((52, 60, 70, 60), (52, 60, 170, 60), (200, 160, 300, 130), (77, 24, 300, 170)):
        put_print(image, code, side, x, y)  # the inner landmark has a lower confidence than the outer one
    for code, x, y in ((137, 70, 180), (90, 130, 215)):
        put_print(image, code, 76, x, y)
    found = detect_landmarks(cv2.GaussianBlur(image, (0, 0), 0.7))
    at = sorted((d.id.code, *np.round(d.center + 0.5).astype(int).tolist()) for d in found)
    assert at == [(52, 70, 60), (52, 170, 60), (77, 300, 170), (90, 130, 215), (200, 300, 130)]


def put_print(image, code, side_px, x, y):
    """A bare landmark with white paper around it, its center at (x, y)."""
    page = bare_landmark_page(LM8, code, 180.0)
    face = np.asarray(page_to_image(page, side_px / 180 * 25.4))[:, :, ::-1]
    half, paper = side_px // 2, round(side_px / 12)
    image[y - half - paper : y + half + paper, x - half - paper : x + half + paper] = 255
    image[y - half : y + half, x - half : x + half] = face
