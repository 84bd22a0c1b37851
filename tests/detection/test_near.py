"""Windows around expected squares: detections there agree with those of the whole image."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scenes import paste_landmark

import lmkit
from lmkit.detection.config import PROFILES, DetectOptions
from lmkit.detection.detector import detect_landmarks
from lmkit.errors import InputError


@pytest.fixture(scope="module")
def scene(photographs):
    """An image with three landmarks: (image, {code: true corners})."""
    rng = np.random.default_rng(11)
    image = cv2.resize(photographs[1], (640, 480), interpolation=cv2.INTER_CUBIC)
    truth = {}
    for code, center, side in ((137, (150, 150), 60), (52, (420, 300), 34), (9, (560, 90), 26)):
        image, truth[code] = paste_landmark(image, code, center, side, 20, rng)
    return image, truth


@pytest.mark.parametrize("profile", PROFILES)
def test_landmarks_are_found_around_where_they_are_expected(scene, profile):
    image, truth = scene
    options = DetectOptions(config=PROFILES[profile])
    whole = {d.code: d.corners for d in detect_landmarks(image, options)}
    assert profile == "fast" or whole.keys() == truth.keys()  # fast may overlook the smallest
    for shift in (0.0, 0.05, 0.4):
        sides = np.array([np.linalg.norm(c[0] - c[1]) for c in truth.values()])
        expected = np.array(list(truth.values())) + shift * sides[:, None, None]
        found = {d.code: d.corners for d in detect_landmarks(image, options, expected)}
        assert found.keys() == truth.keys()
        for code, corners in whole.items():
            assert np.abs(corners - found[code]).max() < 0.1


def test_only_the_windows_are_searched(scene):
    image, truth = scene
    found = detect_landmarks(image, near=truth[52][None])
    assert [d.code for d in found] == [52]


def test_order_and_sense_of_the_expected_corners_do_not_matter(scene):
    image, truth = scene
    for corners in (np.roll(truth[137], 3, axis=0), truth[137][::-1]):
        (found,) = detect_landmarks(image, near=corners[None])
        assert np.abs(found.corners - truth[137]).max() < 0.5


def test_expectations_outside_or_without_sense_find_nothing(scene):
    image, truth = scene
    outside = truth[137] + 5000
    nowhere = np.full((4, 2), np.nan)
    point = np.tile([100.0, 100.0], (4, 1))
    assert detect_landmarks(image, near=np.array([outside, nowhere])) == []
    assert detect_landmarks(image, near=point[None]) == []
    assert detect_landmarks(image, near=np.zeros((0, 4, 2))) == []


def test_the_detector_takes_the_last_detections(scene):
    image, truth = scene
    detector = lmkit.Detector()
    first = detector.detect(image)
    again = detector.detect(image, near=first)
    assert {d.code for d in again} == truth.keys()
    assert np.abs(again.corners - first.corners).max() < 0.1
    with pytest.raises(InputError, match="shape"):
        detector.detect(image, near=np.zeros((3, 2)))
