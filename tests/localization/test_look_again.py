"""Landmarks that a pose expects are searched once more, and no other code is taken for them."""

from __future__ import annotations

import numpy as np
import pytest
from simulated import CAMERA, SIZE, sheet

from lmkit.detection.acceptance import EAGER
from lmkit.detection.config import DetectOptions
from lmkit.detection.detector import detect_landmarks
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import Rig
from lmkit.localization.absolute_pose import LocateOptions
from lmkit.model.landmark import LM8
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.pipelines import look_again
from lmkit.pipelines.look_again import FrameImage, locate_frame
from lmkit.simulation.photograph import ImagingChain, expose
from lmkit.simulation.render import render
from lmkit.simulation.scene import Panel, Scene

PLACES = {137: (-0.2, 0.02), 90: (0.22, -0.05)}
UPRIGHT = np.diag([1.0, -1.0, -1.0])


@pytest.fixture(scope="module")
def frame() -> tuple[FrameImage, list]:
    """An image of two landmarks, and the detections in it."""
    panels = tuple(
        Panel(Pose("map", "sheet", UPRIGHT, np.array([*at, 1.1])), (0.21, 0.21), sheet(code, LM8))
        for code, at in PLACES.items()
    )
    wall = np.full((SIZE[1], SIZE[0], 3), 0.35, dtype=np.float32)
    radiance = render(Scene(panels, LandmarkMap([]), (1, 1, 1)), CAMERA, Pose.identity("map", "camera"), wall)
    pixels = expose(radiance, ImagingChain(), np.random.default_rng(0))
    image = FrameImage(pixels, DetectOptions(camera=CAMERA))
    return image, sorted(detect_landmarks(pixels, image.options), key=lambda d: d.id.code)


def mapped(codes: dict[int, tuple[float, float]]) -> LandmarkMap:
    return LandmarkMap(
        [
            MappedLandmark(LandmarkId("lm8", code), 0.18, Pose("map", "landmark", UPRIGHT, np.array([*at, 1.1])))
            for code, at in codes.items()
        ]
    )


def located(monkeypatch, frame, codes, sure_m=0.0):
    monkeypatch.setattr(look_again, "SURE_M", sure_m)
    image, seen = frame
    assert [d.id.code for d in seen] == [90, 137]
    return locate_frame([image], [seen[1:]], Rig.of_one(CAMERA), mapped(codes), LocateOptions())


def test_what_the_pose_expects_is_found_and_makes_it_surer(monkeypatch, frame):
    alone, _ = located(monkeypatch, frame, PLACES, sure_m=np.inf)
    estimate, (seen,) = located(monkeypatch, frame, PLACES)
    assert [d.id.code for d in seen] == [137, 90]
    assert estimate.status == "ok"
    assert len(estimate.inliers) == 2
    assert estimate.sigma_m < 0.5 * alone.sigma_m


@pytest.mark.parametrize(
    "codes", [PLACES | {90: (0.22, 0.055)}, {137: PLACES[137], 91: PLACES[90]}], ids=["elsewhere", "another code"]
)
def test_only_the_expected_code_at_the_expected_place_stands(monkeypatch, frame, codes):
    estimate, (seen,) = located(monkeypatch, frame, codes)
    assert [d.id.code for d in seen] == [137]
    assert len(estimate.inliers) == 1


def test_what_is_expected_needs_less_evidence(monkeypatch, frame):
    """The limit is that of `--eager`: a reading that would not be accepted alone is accepted where it is expected."""
    limits = []

    def detect(pixels, options, near):
        limits.append(options.rule)
        return detect_landmarks(pixels, options, near)

    monkeypatch.setattr(look_again, "detect_landmarks", detect)
    located(monkeypatch, frame, PLACES)
    assert limits == [EAGER]
    assert EAGER.least_log_odds < frame[0].options.rule.least_log_odds


def test_detections_without_an_image_are_taken_as_they_are(monkeypatch, frame):
    monkeypatch.setattr(look_again, "SURE_M", 0.0)
    seen = [frame[1][1:]]
    estimate, same = locate_frame([None], seen, Rig.of_one(CAMERA), mapped(PLACES), LocateOptions())
    assert same is seen
    assert estimate.inliers == (LandmarkId("lm8", 137),)
