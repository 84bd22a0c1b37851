"""The public names: which there are, that each has an example, and that the examples run."""

from __future__ import annotations

import doctest
import inspect
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import lmkit

FUNCTIONS = [
    "read_image",
    "read_rig",
    "read_map",
    "read_recording",
    "read_trajectory",
    "write_rig",
    "write_map",
    "write_trajectory",
    "detect",
    "calibrate",
    "calibrate_base",
    "calibrate_clocks",
    "locate",
    "survey",
    "survey_recordings",
    "track",
    "evaluate",
    "print_landmarks",
    "place_landmarks",
    "plan_route",
    "draw",
    "write_example_files",
]
CLASSES = [
    "BaseMounting",
    "BoardSpec",
    "CameraCalibration",
    "CameraModel",
    "Demand",
    "Detection",
    "DetectorConfig",
    "Detections",
    "Detector",
    "InputError",
    "ImageWarning",
    "JointSurvey",
    "LandmarkFamily",
    "LandmarkId",
    "LandmarkMap",
    "LmkitError",
    "MappedLandmark",
    "MountedCamera",
    "NegativeAnswer",
    "Pose",
    "PoseArray",
    "PoseEstimate",
    "PoseStatus",
    "Recording",
    "Rig",
    "StereoCalibration",
    "StereoRig",
    "Survey",
    "TrackedTrajectory",
    "Trajectory",
]
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def test_these_are_the_public_names() -> None:
    assert set(lmkit.__all__) == {*FUNCTIONS, *CLASSES, "LM8", "__version__"}
    assert dir(lmkit) == sorted(lmkit.__all__)


# Classes without an example of their own: results, whose functions show them, and kinds of errors.
RESULTS = {
    "BaseMounting", "CameraCalibration", "ImageWarning", "InputError", "JointSurvey", "NegativeAnswer",
    "PoseEstimate", "PoseStatus", "StereoCalibration", "Survey", "TrackedTrajectory",
}  # fmt: skip


@pytest.mark.parametrize("name", [*FUNCTIONS, *(name for name in CLASSES if name not in RESULTS)])
def test_the_example_runs(name: str, files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    thing = getattr(lmkit, name)
    shutil.copytree(files, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    (example,) = [e for e in doctest.DocTestFinder(recurse=False).find(thing, name, globs={}) if e.examples]
    printed: list[str] = []
    failed, _ = doctest.DocTestRunner(optionflags=FLAGS).run(example, out=printed.append)
    assert not failed, "".join(printed)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_document_themselves(name: str) -> None:
    function = getattr(lmkit, name)
    text = inspect.getdoc(function) or ""
    assert "Examples:" in text
    for parameter in inspect.signature(function).parameters:
        assert parameter in text, parameter


def test_import_is_light() -> None:
    code = "import sys, lmkit\nsys.exit(bool({'numpy', 'cv2', 'scipy', 'pydantic'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
