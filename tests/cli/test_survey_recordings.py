"""`lmkit survey` with several recording folders."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lmkit.io.external_maps import read_any_map
from lmkit.io.landmark_map import map_to_yaml
from lmkit.model.landmark_map import LandmarkMap
from lmkit.simulation.site import DAY_S, MONDAY_S, day_name, write_site


@pytest.fixture(scope="module")
def days(tmp_path_factory):
    folder = tmp_path_factory.mktemp("days")
    site = write_site(folder, halls=1, days=2, seconds=20.0, moved=False)
    return folder, sorted(str(path.parent) for path in folder.glob("logs/*/*/*/detections.csv")), site


def test_two_days_make_one_map(lmkit, days, tmp_path):
    folder, recordings, site = days
    rig = next(folder.glob("rigs/*/*.yaml"))
    # One landmark is known, and was at another place until a year ago.
    one = replace(next(iter(site.maps["hall0"])), covariance=np.eye(6), valid_from_s=MONDAY_S - 365 * DAY_S)
    before = replace(one, valid_from_s=None, valid_to_s=MONDAY_S - 366 * DAY_S)
    (tmp_path / "known.yaml").write_text(map_to_yaml(LandmarkMap([one, before])))
    given = ("--rig", str(rig), "--known", "known.yaml")
    answer = lmkit("survey", *recordings, *given, "-o", "map.yaml", "--tum", "poses.tum", "--json")
    assert answer.code == 0, answer.err
    summary = json.loads(answer.out)
    assert [r["name"] for r in summary["recordings"]] == [day_name(0), day_name(1)]
    assert summary["left_out"] == {} and summary["moved"] == []
    assert all(r["located"] > 0.9 * r["frames"] for r in summary["recordings"])
    found = read_any_map(tmp_path / "map.yaml")
    assert site.map_error_m("hall0", found) < 0.03
    assert found.find(one.id).valid_from_s == one.valid_from_s
    assert [(m.id, m.valid_to_s) for m in found.past] == [(one.id, before.valid_to_s)]
    assert all((tmp_path / f"poses-{day_name(day)}.tum").exists() for day in (0, 1))


def test_a_recording_that_is_given_again_counts_once_and_is_named(lmkit, days, tmp_path):
    folder, recordings, _ = days
    rig = next(folder.glob("rigs/*/*.yaml"))
    copy = shutil.copytree(Path(recordings[0]), tmp_path / "copy")
    answer = lmkit("survey", recordings[0], str(copy), recordings[0], "--rig", str(rig), "-o", "map.yaml", "--json")
    assert answer.code == 0, answer.err
    assert f"{recordings[0]} is given more than once: its recording counts once" in answer.err
    summary = json.loads(answer.out)
    assert summary["left_out"] == {"copy": f"it shows the same as '{day_name(0)}', in every frame"}
    assert [r["name"] for r in summary["recordings"]] == [day_name(0)]


def test_options_of_single_recordings_are_refused(lmkit, days):
    folder, recordings, _ = days
    rig = next(folder.glob("rigs/*/*.yaml"))
    answer = lmkit("survey", *recordings, "--rig", str(rig), "-o", "m.yaml", "--report", "r.html")
    assert answer.code == 2
    assert "--report" in answer.err and "several recordings" in answer.err


def test_a_folder_without_a_recording_is_named(lmkit, days, tmp_path):
    folder, recordings, _ = days
    (tmp_path / "empty").mkdir()
    rig = next(folder.glob("rigs/*/*.yaml"))
    answer = lmkit("survey", *recordings, "empty", "--rig", str(rig), "-o", "m.yaml")
    assert answer.code == 2
    assert "empty contains no recording" in answer.err and "left, right" in answer.err
