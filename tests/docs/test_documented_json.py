"""Every key of the JSON that commands print is in docs/formats.md."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from command_line import run_command
from doc_pages import ROOT

from lmkit.demos.example_files import write_example_files

RECORDING = ["--detections", "detections.csv", "--odometry", "odometry.csv", "--gyro", "gyro.csv"]
RUNS = {
    "detect": ["left.png"],
    "locate": ["left.png", "right.png", "--rig", "rig.yaml", "--map", "map.yaml"],
    "survey": [*RECORDING, "--rig", "rig.yaml", "-o", "surveyed.yaml"],
    "track": [*RECORDING, "--rig", "rig.yaml", "--map", "map.yaml"],
    "evaluate": ["truth.tum", "truth.tum"],
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("json")
    write_example_files(path, board_pairs=0, seconds=10)
    return path


def documented(command: str) -> set[str]:
    """Keys in the tables of a command's section."""
    page = (ROOT / "docs/formats.md").read_text(encoding="utf-8")
    section = re.split(r"^##+ ", page.split(f"\n### {command}\n")[1], flags=re.MULTILINE)[0]
    rows = re.findall(r"^\| ([^|]+) \| (.+) \|$", section, re.MULTILINE)
    return {key for row in rows for key in re.findall(r"`\"?(\w+)\"?`", row[0])}


@pytest.mark.parametrize("command", RUNS)
def test_keys_are_documented(command: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    answer = run_command(command, *RUNS[command], "--json")
    assert answer.code == 0, answer.err
    found = json.loads(answer.out.splitlines()[0])
    if command == "detect":
        found |= found["detections"][0]
    assert set(found) <= documented(command)
