"""Codes that appear twice, overlap, are nested, mirrored or shown on a screen: read right or not at all."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from simulated import CAMERA, sheet

from lmkit.detection.detector import detect_landmarks
from lmkit.geometry.pose import Pose
from lmkit.model.landmark import LM8
from lmkit.model.landmark_map import LandmarkMap
from lmkit.simulation.photograph import ImagingChain, expose
from lmkit.simulation.render import render
from lmkit.simulation.scene import Panel, Scene

DISTANCE_M = 1.0
SHEET_M = 0.21


def lying(
    code: int, x_m: float, y_m: float, size: float = 1.0, before_m: float = 0.0, roll_deg: float = 0.0
) -> Panel:
    """A landmark's sheet that faces the camera; at size 1 the landmark has a side of 54 px."""
    roll = cv2.Rodrigues(np.array([0.0, 0.0, np.deg2rad(roll_deg)]))[0]
    T = Pose("map", "sheet", roll @ np.diag([1.0, -1.0, -1.0]), np.array([x_m, y_m, DISTANCE_M - before_m]))
    return Panel(T, (size * SHEET_M, size * SHEET_M), sheet(code, LM8))


def photograph(*panels: Panel, seed: int = 0) -> np.ndarray:
    wall = np.full((CAMERA.image_size[1], CAMERA.image_size[0], 3), 0.35, dtype=np.float32)
    radiance = render(Scene(panels, LandmarkMap([]), (1, 1, 1)), CAMERA, Pose.identity("map", "camera"), wall)
    return expose(radiance, ImagingChain(), np.random.default_rng(seed))


def codes_in(image: np.ndarray) -> list[int]:
    return sorted(d.code for d in detect_landmarks(image))


def test_a_repeated_code_is_read_at_every_place():
    assert codes_in(photograph(lying(52, -0.2, 0.0), lying(52, 0.15, 0.1, roll_deg=20.0))) == [52, 52]


@pytest.mark.parametrize("shift", [0.05, 0.09, 0.13, 0.17])
def test_of_two_that_overlap_the_nearer_one_is_read_and_the_other_one_right_or_not(shift):
    """The nearer sheet is as bright as paper and hides up to half of the rings."""
    for seed, (far, near) in enumerate([(137, 90), (255, 18), (16, 200)]):
        codes = codes_in(
            photograph(lying(far, -0.08, 0.0), lying(near, shift - 0.08, 0.07, before_m=0.01), seed=seed)
        )
        assert near in codes
        assert set(codes) <= {near, far}


@pytest.mark.parametrize("at", [(0.0, -0.02), (0.05, 0.03), (0.0, 0.06)])
def test_one_that_lies_on_another_one_does_not_change_its_code(at):
    for seed, (outer, inner) in enumerate([(200, 77), (15, 137), (240, 3)]):
        codes = codes_in(photograph(lying(outer, 0.0, 0.0, 2.2), lying(inner, *at, 0.6, before_m=0.01), seed=seed))
        assert set(codes) <= {outer, inner}


def test_a_mirrored_landmark_is_its_mirrored_code():
    for seed, code in enumerate((0b10110001, 0b00011100, 0b01100010, 19)):
        image = photograph(lying(code, 0.0, 0.0, roll_deg=10.0 * seed), seed=seed)
        assert codes_in(np.ascontiguousarray(image[:, ::-1])) == [LM8.mirrored_code(code)]


def on_a_screen(code: int, side_px: float, pixels: int, angle_deg: float, seed: int) -> np.ndarray:
    """A landmark on a screen, with ``pixels`` a side: stripes of three colors, dark lines between the rows."""
    face = cv2.resize(sheet(code, LM8), (pixels, pixels), interpolation=cv2.INTER_AREA)
    screen = np.zeros((6 * pixels, 6 * pixels, 3), np.float32)
    for channel in range(3):
        for stripe in (2 * channel, 2 * channel + 1):
            screen[:, stripe::6, channel] = 2.4 * np.repeat(face[:, :, channel], 6, axis=0)
    screen[5::6] *= 0.3
    size = 480  # three rays a pixel
    scale, middle = 3 * side_px * SHEET_M / 0.18 / len(screen), len(screen) / 2
    M = cv2.getRotationMatrix2D((middle, middle), angle_deg, scale)
    M[:, 2] += size / 2 - middle
    blurred = cv2.GaussianBlur(screen, (0, 0), 1.0 / scale)
    radiance = cv2.warpAffine(blurred, M, (size, size), borderValue=(0.15, 0.15, 0.15))
    return expose(radiance, ImagingChain(), np.random.default_rng(seed))


@pytest.mark.parametrize("pixels", [40, 64])
def test_a_landmark_on_a_screen_is_right_or_not_read(pixels):
    read = 0
    for seed in range(4):
        code = 37 + 60 * seed
        codes = codes_in(on_a_screen(code, 40.0, pixels, 7.0 * seed - 9.0, seed))
        assert codes in ([], [code])
        read += len(codes)
    assert read >= 2
