"""Maps of other programs that give neither family nor size: each command takes both, or says how to convert."""

from __future__ import annotations

import pytest
from floors import RIG, mounted_every, two_rooms

from lmkit.cli.map_options import read_mounted_map
from lmkit.errors import InputError, InputWarning
from lmkit.io.any_rig import read_any_rig
from lmkit.io.landmark_map import map_to_yaml, read_map
from lmkit.io.rig import rig_to_yaml

GIVEN = ("--family", "aruco4x4_50", "--size", "140mm")
SIMULATED = ("run", "sim:?seconds=1&speed=max&images=no")


@pytest.fixture
def files(tmp_path):
    two_rooms(tmp_path)
    (tmp_path / "rig.yaml").write_text(rig_to_yaml(RIG))
    (tmp_path / "map.txt").write_text("3 1.0 0.1 1.2 90 0 0 0.01 5 4\n4 2.0 0.1 1.2 90 0 0 0.01 5 3\n")
    (tmp_path / "field.json").write_text(
        '{"tags": [{"ID": 1, "pose": {"translation": {"x": 1, "y": 0.1, "z": 1.2}, '
        '"rotation": {"quaternion": {"W": 1, "X": 0, "Y": 0, "Z": 0}}}}], "field": {"length": 8, "width": 5}}'
    )
    (tmp_path / "detections.csv").write_text("time_s,camera,code,x0,y0,x1,y1,x2,y2,x3,y3\n0,left,3,1,1,9,1,9,9,1,9\n")
    return tmp_path


@pytest.mark.parametrize(
    "words",
    [
        "plan place --floor floor.yaml --rig rig.yaml --map map.txt -o out",
        "survey --detections detections.csv --rig rig.yaml --known map.txt -o new.yaml",
        "fleet survey --store store --known map.txt -o new.yaml",
        "calibrate --base recording --rig rig.yaml --map map.txt -o new.yaml",
    ],
)
def test_commands_with_a_family_of_their_own_say_how_to_convert(lmkit, files, words):
    answer = lmkit(*words.split())
    assert answer.code == 2
    assert "states neither the family nor the size of its markers" in answer.err
    hint = answer.err.split("convert it first: ")[1].strip()
    assert lmkit(*hint.split()[1:]).code == 0
    assert {(m.family, m.size_m) for m in read_map(files / "map.yaml")} == {("aruco5x5_1000", 0.14)}


def test_a_family_that_is_assumed_is_named_with_the_conversion(files):
    with pytest.warns(InputWarning, match="tag36h11 is assumed; if it is another, convert the map first: lmkit"):
        read_mounted_map(files / "field.json")


@pytest.mark.parametrize(
    "words", [("plan", "sheet", "--map", "map.txt", "--room", "8x5m"), (*SIMULATED, "--map", "map.txt")]
)
def test_other_commands_take_family_and_size(lmkit, files, words):
    refused = lmkit(*words)
    assert (refused.code, "give both, such as --family" in refused.err) == (2, True), refused.err
    taken = lmkit(*words, *GIVEN)
    # The simulated robot drives among other landmarks.
    assert taken.code == (1 if words[0] == "run" else 0), taken.err
    assert "no pose was published" in taken.err or words[0] == "plan"


def test_a_run_file_gives_family_and_size(lmkit, files):
    stated = "format: lmkit-run/1\nsources: ['sim:?seconds=1&speed=max&images=no']\nmap: map.txt\n"
    (files / "run.yaml").write_text(stated + "family: aruco4x4_50\nsize: 140mm\n")
    assert lmkit("run", "run.yaml").code == 1
    (files / "run.yaml").write_text(stated + "family: nothing\nsize: 140mm\n")
    assert "family 'nothing'" in lmkit("run", "run.yaml").err


def test_a_recorded_run_replays_with_the_family_that_was_given(lmkit, files):
    pytest.importorskip("mcap", reason="the extra bags is not installed")
    lmkit(*SIMULATED, "--map", "map.txt", *GIVEN, "--record", "run.mcap")
    replayed = lmkit("run", "replay:run.mcap")
    assert (replayed.code, "no pose was published" in replayed.err) == (1, True), replayed.err


@pytest.mark.parametrize(
    ("name", "program"), [("map.txt", "fiducial_slam"), ("field.json", "WPILib"), ("map.yaml", "lmkit")]
)
def test_a_map_in_place_of_a_rig_is_named(lmkit, files, name, program):
    (files / "map.yaml").write_text(map_to_yaml(mounted_every(two_rooms(files), 1.0)))
    answer = lmkit("convert", name, "--to", "lmkit", "-o", "out.yaml")
    assert answer.code == 2
    assert f"{name} is a map of {program}, and --to lmkit writes a rig" in answer.err
    assert "give --to map, wpilib or tagslam" in answer.err.lower()
    with pytest.raises(InputError, match=r"a map of|expected 'lmkit-rig/1'"):
        read_any_rig(files / name)
