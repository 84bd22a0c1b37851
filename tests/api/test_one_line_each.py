"""The repr of each type is one line, for users of notebooks; examples in docstrings show the results."""

from __future__ import annotations

from pathlib import Path

import pytest

import lmkit

LONGEST = 120  # letters


def test_types_show_themselves_in_one_line(files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(files)
    recording = lmkit.read_recording(detections="detections.csv")
    rig, landmarks, truth = lmkit.read_rig("rig.yaml"), lmkit.read_map("map.yaml"), lmkit.read_trajectory("truth.tum")
    pose = lmkit.Pose.identity("map", "base")
    shown: dict[object, str] = {
        rig.left: "CameraModel(pinhole, 640 x 480, f 460.0 459",
        rig: "StereoRig(pinhole, 640 x 480, baseline ",
        lmkit.Rig.of_one(rig.left).cameras[0]: "MountedCamera(camera, pinhole, at x 0.000 y 0.000 z 0.000 m)",
        recording.frames[0].detections[0]: f"Detection({recording.frames[0].detections[0].id}, center ",
        next(iter(landmarks)): f"MappedLandmark({next(iter(landmarks)).id}, 180 mm, x ",
        truth: f"Trajectory({len(truth)} poses, ",
        lmkit.evaluate(truth, truth): f"TrajectoryError({len(truth)} pairs, RMS 0.0 mm and 0.00 deg)",
        lmkit.PoseArray.from_poses("map", "base", [pose] * 3): "PoseArray(3 x T_map_base)",
    }
    for thing, words in shown.items():
        line = repr(thing)
        assert line.startswith(words)
        assert "\n" not in line
        assert len(line) < LONGEST
