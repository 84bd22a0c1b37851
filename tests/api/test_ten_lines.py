"""The ten lines of Python that the README begins with run as they stand."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest

import lmkit

ROOT = Path(__file__).resolve().parents[2]


def test_the_lines_of_the_readme_run(
    files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    lines = next(block for block in blocks if "import lmkit\n" in block)
    shutil.copytree(files, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(compile(lines, "README.md", "exec"), names)
    assert isinstance(names["estimate"], lmkit.PoseEstimate)
    assert names["estimate"].status == lmkit.PoseStatus.OK
    assert capsys.readouterr().out
    assert (tmp_path / "landmarks.pdf").read_bytes().startswith(b"%PDF")


def test_results_become_json(files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(files)
    estimate = lmkit.locate("left.png", "right.png", rig="rig.yaml", landmarks="map.yaml")
    answer = json.loads(json.dumps(estimate.to_dict(), allow_nan=False))
    assert answer["status"] == "ok"
    assert answer["ids"] == [f"lm8:{code}" for code in answer["codes"]]
    assert estimate.T_map_base is not None
    assert answer["position"] == estimate.T_map_base.t.tolist()
    assert answer["position"] != estimate.to_dict("camera")["position"]
    error = lmkit.evaluate("truth.tum", "truth.tum").to_dict()
    assert json.loads(json.dumps(error, allow_nan=False))["pairs"] > 10
    found = lmkit.detect("left.png").to_dict()
    assert json.loads(json.dumps(found, allow_nan=False))["width"] == 640


def test_recordings_become_json(files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(files)
    recording = lmkit.read_recording(detections="detections.csv", odometry="odometry.csv", gyro="gyro.csv")
    survey = lmkit.survey(recording, "rig.yaml")
    answer = json.loads(json.dumps(survey.to_dict(), allow_nan=False))
    assert answer["frames"] == len(recording.frames) >= answer["located"] > 10
    assert [entry["id"] for entry in answer["landmarks"]] == [str(m.id) for m in survey.bundle.landmarks]
    assert all(isinstance(value, float) for value in answer["odometry"].values()) and answer["odometry"]
    tracked = lmkit.track(recording, "rig.yaml", survey.landmarks)
    first = json.loads(json.dumps(tracked.to_dict(0), allow_nan=False))
    assert first["position"] == tracked.poses[0].t.tolist()
    lmkit.write_trajectory(tracked, tmp_path / "poses.csv")
    lmkit.write_trajectory(tracked, tmp_path / "poses.tum")
    assert len((tmp_path / "poses.csv").read_text().splitlines()) == len(tracked) + 1
    assert len((tmp_path / "poses.tum").read_text().splitlines()) == len(tracked.sure)
