"""Wrong arguments of the public functions and types end in one sentence that names what, where and how to fix it."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import lmkit

NAN = float("nan")
POSE = lmkit.Pose.identity("map", "landmark")
ID = lmkit.LandmarkId("lm8", 1)
EMPTY = np.zeros((0, 0, 3), np.uint8)
BOARD = "chessboard:9x6:25mm"

Call = Callable[[Any], object]

# Functions: InputError.
CALLS: dict[str, tuple[Call, str]] = {
    "align": (lambda x: lmkit.evaluate(x.truth, x.truth, align="x"), "choose none, rigid, scale"),
    "max_apart": (lambda x: lmkit.evaluate(x.truth, x.truth, max_apart_s=NAN), "0 or more"),
    "evaluate a rig": (lambda x: lmkit.evaluate(x.truth, x.rig), "estimate: a value of type StereoRig"),
    "sigma alone": (lambda x: lmkit.survey(x.recording, x.rig, known_sigma=(0.1, 0.1)), "without known"),
    "negative sigma": (lambda x: lmkit.survey(x.recording, x.rig, known=x.map, known_sigma=(-1, 1)), "outside 0 to"),
    "NaN sigma": (lambda x: lmkit.survey(x.recording, x.rig, known=x.map, known_sigma=(NAN, 1)), "outside 0 to"),
    "one sigma": (lambda x: lmkit.survey(x.recording, x.rig, known=x.map, known_sigma=0.1), "not a pair"),
    "size None": (lambda x: lmkit.survey(x.recording, x.rig, size=None), "size: a value of type NoneType"),
    "constraints": (lambda x: lmkit.survey(x.recording, x.rig, constraints=["wall"]), "LandmarkConstraint"),
    "survey nothing": (lambda x: lmkit.survey(None, x.rig), "read_recording"),
    "survey an image": (lambda x: lmkit.survey("left.png", x.rig), "left.png is not a CSV"),
    "track a list": (lambda x: lmkit.track([x.recording], x.rig, x.map), "recording: a value of type list"),
    "rig and map swapped": (lambda x: lmkit.track(x.recording, x.map, x.rig), "landmarks: .* StereoRig"),
    "recordings in a list": (lambda x: lmkit.survey_recordings([x.recording], x.rig), "by name"),
    "recording without rig": (lambda x: lmkit.survey_recordings({"a": x.recording}, {"b": x.rig}), "'a' has no rig"),
    "base of nothing": (lambda x: lmkit.calibrate_base(None, x.rig, x.map), "recording: "),
    "base without odometry": (lambda x: lmkit.calibrate_base("detections.csv", x.rig, x.map), "wheel odometry"),
    "clocks of a number": (lambda x: lmkit.calibrate_clocks(5, x.rig, x.map), "recording: a value of type int"),
    "share": (lambda x: lmkit.Demand(share=90), "share of the demand is 90"),
    "share NaN": (lambda x: lmkit.Demand(share=NAN), "share of the demand is nan"),
    "headings": (lambda x: lmkit.Demand(headings=20), "headings of the demand is 20"),
    "in_view": (lambda x: lmkit.Demand(in_view=-1), "in_view of the demand is -1"),
    "half a landmark": (lambda x: lmkit.Demand(in_view=1.5), "in_view of the demand is 1.5"),
    "error as text": (lambda x: lmkit.Demand(error_m="5cm"), "error_m of the demand is '5cm'"),
    "demand": (lambda x: lmkit.place_landmarks("floor.yaml", x.rig, demand={}), "demand: a value of type dict"),
    "options": (lambda x: lmkit.place_landmarks("floor.yaml", x.rig, options={}), "options: a value of type dict"),
    "start NaN": (lambda x: lmkit.plan_route("floor.yaml", x.rig, x.map, (NAN, 1), (3, 2)), "start: .nan, 1."),
    "goal of one number": (lambda x: lmkit.plan_route("floor.yaml", x.rig, x.map, (1, 1), (1,)), "goal: .1,."),
    "start None": (lambda x: lmkit.plan_route("floor.yaml", x.rig, x.map, None, (3, 2)), "start: None"),
    "frame": (lambda x: x.estimate.to_dict("foo"), "choose base or camera"),
    "draw a rig alone": (lambda x: lmkit.draw(x.image, x.seen, x.estimate, rig=x.rig), "without landmarks"),
    "draw no image": (lambda x: lmkit.draw(EMPTY), "no pixels"),
    "enlarge 0": (lambda x: lmkit.draw(x.image, enlarge=0), "enlarge 0"),
    "enlarge 1.5": (lambda x: lmkit.draw(x.image, enlarge=1.5), "enlarge 1.5"),
    "estimate second": (lambda x: lmkit.draw(x.image, x.estimate), "estimate comes third"),
    "detections third": (lambda x: lmkit.draw(x.image, x.seen, x.seen), "estimate: a value of type Detections"),
    "no families": (lambda x: lmkit.detect(x.image, families=[]), "names no families"),
    "families None": (lambda x: lmkit.detect(x.image, families=None), "names no families"),
    "families 5": (lambda x: lmkit.detect(x.image, families=5), "names no families"),
    "detect nothing": (lambda x: lmkit.detect(EMPTY), "no pixels"),
    "camera a rig": (lambda x: lmkit.detect(x.image, camera=x.rig), "camera: a value of type StereoRig"),
    "profile": (lambda x: lmkit.detect(x.image, profile={}), "fast, balanced, accurate"),
    "strictness": (lambda x: lmkit.detect(x.image, strictness=[]), "choose strict"),
    "near NaN": (lambda x: lmkit.Detector().detect(x.image, near=np.full((1, 4, 2), NAN)), "not finite"),
    "near one": (lambda x: lmkit.Detector().detect(x.image, near=x.seen[0]), "list of detections"),
    "near text": (lambda x: lmkit.Detector().detect(x.image, near="x"), "list of detections"),
    "goal as an array": (lambda x: lmkit.plan_route("floor.yaml", x.rig, x.map, (1, 1), np.array(3)), "goal: array"),
    "null in a path": (lambda x: lmkit.read_image("a\0b"), "null byte"),
    "id of a list": (lambda x: lmkit.LandmarkId.parse([1]), "FAMILY:CODE"),
    "map of an int": (lambda x: lmkit.LandmarkMap([1]), "not a MappedLandmark"),
    "find a bare code": (lambda x: x.map.find(5), "'lm8:137'"),
    "contains a bare code": (lambda x: 5 in x.map, "'lm8:137'"),
    "other image size": (
        lambda x: lmkit.locate(lmkit.Detections(x.seen, (320, 240)), rig=x.rig, landmarks=x.map),
        "320 x 240",
    ),
    "locate a number": (lambda x: lmkit.locate([1], rig=x.rig, landmarks=x.map), "detections 1: "),
    "map as rig": (lambda x: lmkit.locate(x.image, rig=x.map, landmarks=x.map), "rig: a value of type LandmarkMap"),
    "locate options": (lambda x: lmkit.locate(x.image, rig=x.rig, landmarks=x.map, options={}), "options: "),
    "empty map": (lambda x: lmkit.locate(x.image, rig=x.rig, landmarks=lmkit.LandmarkMap([])), "no landmarks"),
    "read arrays": (lambda x: lmkit.read_recording(x.image, x.image, rig=x.rig), "images: a value of type ndarray"),
    "negative rate": (lambda x: lmkit.read_recording("left.png", "right.png", rig=x.rig, hz=-1), "hz -1"),
    "write a map as rig": (lambda x: lmkit.write_rig(x.map, "new.yaml"), "rig: a value of type LandmarkMap"),
    "write a rig as map": (lambda x: lmkit.write_map(x.rig, "new.yaml"), "landmarks: a value of type StereoRig"),
    "write a rig as poses": (
        lambda x: lmkit.write_trajectory(x.rig, "new.tum"),
        "trajectory: a value of type",
    ),
    "overwrite": (lambda x: lmkit.write_rig(x.rig, "rig.yaml"), "overwrite"),
    "print nothing": (lambda x: lmkit.print_landmarks([]), "no codes"),
    "print None": (lambda x: lmkit.print_landmarks(None), "None is not a code"),
    "print half a code": (lambda x: lmkit.print_landmarks([1.5]), "1.5 is not a code"),
    "print another family": (lambda x: lmkit.print_landmarks(lmkit.LandmarkId("lm12", 3)), "family='lm12'"),
    "print too small": (lambda x: lmkit.print_landmarks(3, size="0.1mm"), "below 5 mm"),
    "no board": (lambda x: lmkit.calibrate("boards/left", "boards/right", None), "board: "),
    "no images": (lambda x: lmkit.calibrate(None, None, BOARD), "left: a value of type NoneType"),
    "right 5": (lambda x: lmkit.calibrate("boards/left", 5, BOARD), "right: a value of type int"),
    "progress": (lambda x: lmkit.calibrate("boards/left", "boards/right", BOARD, progress=None), "progress"),
    "model": (lambda x: lmkit.calibrate("boards/left", "boards/right", BOARD, model=None), "model: "),
}

# Constructors of plain data: TypeError or ValueError, as the docstrings say.
TYPES: dict[str, tuple[Call, str]] = {
    "code as text": (lambda x: lmkit.LandmarkId("lm8", "137"), "LandmarkId.parse"),
    "code 1.5": (lambda x: lmkit.LandmarkId("lm8", 1.5), "whole number"),
    "swapped": (lambda x: lmkit.LandmarkId(137, "lm8"), "family of a landmark id"),
    "negative code": (lambda x: lmkit.LandmarkId("lm8", -1), "0 or more"),
    "covariance shape": (lambda x: lmkit.MappedLandmark(ID, 0.18, POSE, np.eye(3)), "covariance of lm8:1 has shape"),
    "covariance sign": (lambda x: lmkit.MappedLandmark(ID, 0.18, POSE, -np.eye(6)), "negative variance"),
    "frames": (lambda x: lmkit.MappedLandmark(ID, 0.18, POSE.inverse()), "wrong frames"),
    "PoseArray": (lambda x: lmkit.PoseArray("a", "b", np.eye(3), np.zeros(3)), r"\(N,3,3\)"),
    "falling times": (
        lambda x: lmkit.Trajectory([0, 2, 1], np.zeros((3, 3)), np.tile([0, 0, 0, 1.0], (3, 1))),
        "fall after row 1",
    ),
    "quaternions": (lambda x: lmkit.Trajectory([0.0], np.zeros((1, 3)), np.zeros((1, 4))), "length 0"),
    "half a pixel": (lambda x: lmkit.CameraModel((640.5, 480), x.rig.left.K, np.zeros(5)), "whole pixels"),
    "one side": (lambda x: lmkit.CameraModel(640, x.rig.left.K, np.zeros(5)), "width, height"),
    "K as text": (lambda x: lmkit.CameraModel((640, 480), "K", np.zeros(5)), "K is not an array"),
    "matrix for a pose": (lambda x: lmkit.StereoRig(x.rig.left, x.rig.right, np.eye(4)), "Pose.from_matrix"),
    "text for a camera": (lambda x: lmkit.StereoRig("l", x.rig.right, x.rig.T_right_left), "left of a StereoRig"),
    "base in other frames": (lambda x: lmkit.StereoRig(x.rig.left, x.rig.right, x.rig.T_right_left, POSE), "T_base"),
    "rig of models": (lambda x: lmkit.Rig((x.rig.left,)), "Rig.of_one"),
    "no model": (lambda x: lmkit.MountedCamera("a", 5, lmkit.Pose.identity("camera", "left")), "model of camera 'a'"),
    "pose times array": (lambda x: POSE @ np.eye(4), "Pose.apply"),
    "points of a camera": (lambda x: x.rig.left.project(np.zeros((4, 2))), r"\(N,3\), not \(4, 2\)"),
    "derivatives": (lambda x: x.rig.left.project_with_jacobian([[0.0]]), r"\(N,3\), not \(1, 1\)"),
    "pixels of a camera": (lambda x: x.rig.left.unproject("x"), r"\(N,2\), not \(\)"),
    "points of poses": (lambda x: lmkit.PoseArray("a", "b", [np.eye(3)], np.zeros((1, 3))).apply([[0]]), r"\(1, 1\)"),
    "quaternion first": (
        lambda x: lmkit.Pose.from_quaternion("a", "b", [0, 0, 0, 1], [1, 2, 3]),
        "after the position",
    ),
    "confidence 7": (lambda x: lmkit.Detection(ID, np.zeros((4, 2)), 7.0, 1.0), "outside 0 to 1"),
    "points": (lambda x: POSE.apply(np.zeros((4, 2))), r"\(4, 2\)"),
    "detection": (lambda x: lmkit.Detection(1, np.zeros((4, 2)), 1.0, 1.0), "LandmarkId"),
    "odometry": (lambda x: lmkit.Recording(odometry=5), "odometry of a recording"),
}


@pytest.fixture(scope="module")
def given(files: Path) -> Any:
    before = Path.cwd()
    os.chdir(files)
    rig, landmarks, image = lmkit.read_rig("rig.yaml"), lmkit.read_map("map.yaml"), lmkit.read_image("left.png")
    seen = lmkit.detect(image, camera=rig.left)
    recording = lmkit.read_recording(detections="detections.csv", odometry="odometry.csv", gyro="gyro.csv")
    yield SimpleNamespace(
        rig=rig,
        map=landmarks,
        image=image,
        seen=seen,
        recording=recording,
        estimate=lmkit.locate(seen, rig=rig, landmarks=landmarks),
        truth=lmkit.read_trajectory("truth.tum"),
    )
    os.chdir(before)


@pytest.mark.parametrize("name", CALLS)
def test_a_function_says_what_is_wrong_with_an_argument(name: str, given: Any) -> None:
    call, words = CALLS[name]
    with pytest.raises(lmkit.InputError, match=words) as caught:
        call(given)
    assert caught.value.hint
    for text in (caught.value.message, caught.value.hint):  # an option of the command line stands in brackets
        assert "--" not in re.sub(r"\([^()]*--[^()]*\)", "", text)


@pytest.mark.parametrize("name", TYPES)
def test_a_type_says_what_is_wrong_with_a_value(name: str, given: Any) -> None:
    call, words = TYPES[name]
    with pytest.raises((TypeError, ValueError), match=words):
        call(given)


def test_what_users_give_is_taken(given: Any) -> None:
    assert len(lmkit.LandmarkMap(m for m in given.map)) == len(given.map)
    first = next(iter(given.map))
    assert str(first.id) in given.map
    assert given.map.find(str(first.id)) is first
    assert "lm12:99" not in given.map
    plain = lmkit.locate(list(given.seen), rig=given.rig, landmarks=given.map)
    assert plain.to_dict() == given.estimate.to_dict()
    drawn = lmkit.draw(given.image, given.seen, plain, rig="rig.yaml", landmarks="map.yaml")
    assert (drawn != lmkit.draw(given.image, given.seen, plain)).any()
    tracked = lmkit.track("detections.csv", "rig.yaml", "map.yaml")
    assert lmkit.evaluate(tracked, tracked).position_m.rmse == 0
    pages = lmkit.print_landmarks("3-4").pdf
    assert pages == lmkit.print_landmarks([np.int64(3), lmkit.LandmarkId("lm8", 4)]).pdf


def test_a_gray_array_is_warned_of_once(given: Any) -> None:
    gray = np.full((64, 64), 90, np.uint8)
    with pytest.warns(lmkit.ImageWarning) as seen:
        lmkit.detect(gray)
        lmkit.draw(gray)
    assert len(seen) == 1


def test_warnings_name_the_line_that_called_lmkit(given: Any) -> None:
    swapped = np.ascontiguousarray(given.image[:, :, ::-1])
    with pytest.warns(lmkit.ImageWarning) as seen:
        lmkit.detect(swapped)
        lmkit.locate(swapped, swapped, rig=given.rig, landmarks=given.map)
    assert {warning.filename for warning in seen} == {__file__}


def test_empty_images_are_searched_for_swapped_colors_now_and_then(
    given: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    import lmkit.detection.detector

    searched: list[np.ndarray] = []
    search = lmkit.detection.detector.detect_landmarks
    monkeypatch.setattr(
        lmkit.detection.detector,
        "detect_landmarks",
        lambda image, *rest: searched.append(image) or search(image, *rest),
    )
    empty = np.full((64, 64, 3), (90, 60, 30), np.uint8)
    detector = lmkit.Detector()
    for _ in range(64):
        detector.detect(empty)
    assert len(searched) - 64 == 7  # 1, 2, 4, 8, 16, 32, 64
    for settled in (lmkit.Detector("tag36h11"), lmkit.Detector()):
        settled.detect(given.image)  # landmarks were found: red is red
        searched.clear()
        for _ in range(5):
            settled.detect(empty)
        assert len(searched) == 5
    with pytest.warns(lmkit.ImageWarning, match="swapped"):
        lmkit.Detector().detect(np.ascontiguousarray(given.image[:, :, ::-1]))
