"""`lmkit plan`, as a user runs it."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
import typer
from floors import RIG, mounted_every, two_rooms

from lmkit.cli.app import build_app
from lmkit.io.landmark_map import map_to_yaml, read_map
from lmkit.io.rig import rig_to_yaml
from lmkit.model.landmark_map import LandmarkMap

DRAWING = {"scale", "islands", "thin_lines", "curves", "layers"}
EASY = ("--in-view", "1", "--headings", "20", "--share", "70")


@pytest.fixture
def files(tmp_path):
    floor = two_rooms(tmp_path)
    (tmp_path / "rig.yaml").write_text(rig_to_yaml(RIG))
    (tmp_path / "map.yaml").write_text(map_to_yaml(mounted_every(floor, 1.0)))
    return ("--floor", "floor.yaml", "--rig", "rig.yaml")


@pytest.mark.parametrize("names", ["plan place", "plan coverage", "plan route", "plan sheet", "map"])
def test_every_command_reads_a_drawing_by_the_same_options(names):
    """A warning of one command recommends options that all of these commands must accept."""
    command = typer.main.get_command(build_app())
    for name in names.split():
        command = command.commands[name]
    assert {option.name for option in command.params} >= DRAWING


@pytest.mark.slow
def test_place_writes_map_prints_list_and_plan(lmkit, files, tmp_path):
    done = lmkit("plan", "place", *files, *EASY, "--patience", "0", "--paper", "letter", "-o", "out")
    assert done.code == 0, done.err
    landmarks = list(read_map(tmp_path / "out" / "map.yaml"))
    rows = (tmp_path / "out" / "mounting.csv").read_text().splitlines()
    assert len(rows) == 1 + len(landmarks)
    assert rows[0].startswith("code,wall,from_left_end_m,height_m")
    assert f"{len(landmarks)} landmarks" in done.out
    for name in ("plan.png", "coverage.png"):
        assert (tmp_path / "out" / name).read_bytes()[:4] == b"\x89PNG"
    codes = ",".join(str(m.code) for m in landmarks)
    assert lmkit("verify", "out/landmarks.pdf", "--json").code == 0, codes
    assert "choose a4, letter" in lmkit("plan", "place", *files, *EASY, "-o", "other", "--paper", "a9").err
    again = lmkit("plan", "place", *files, *EASY, "-o", "out")
    assert (again.code, "--force" in again.err) == (2, True)


def test_sizes_and_heights_may_be_chosen_from(lmkit, files, tmp_path):
    asks = ("--size", "90mm", "--size", "300mm", "--height", "1m", "--height", "1.5m", "--no-prints")
    done = lmkit("plan", "place", *files, *EASY, *asks, "--patience", "0", "-o", "out", "--json")
    assert done.code == 0, done.err
    listed = json.loads(done.out)["landmarks"]
    assert {one["size_m"] for one in listed} <= {0.09, 0.3}
    assert {one["height_m"] for one in listed} <= {1.0, 1.5}
    rows = (tmp_path / "out" / "mounting.csv").read_text().splitlines()[1:]
    assert [int(row.split(",")[4]) for row in rows] == [round(1000 * one["size_m"]) for one in listed]


def test_landmarks_already_mounted_may_be_enough(lmkit, files, tmp_path):
    asks = ("--in-view", "0", "--headings", "20", "--share", "50", "--patience", "0")
    done = lmkit("plan", "place", *files, *asks, "--map", "map.yaml", "-o", "out")
    assert done.code == 0, done.err
    assert "0 more landmarks" in done.out
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "coverage.png",
        "map.yaml",
        "mounting.csv",
        "mounting.pdf",
        "plan.png",
    ]
    assert len(list(read_map(tmp_path / "out" / "map.yaml"))) == len(list(read_map(tmp_path / "map.yaml")))


def test_without_a_command_there_is_help(lmkit):
    done = lmkit("plan")
    assert done.code == 2
    assert all(name in done.out for name in ("coverage", "place", "route"))


def test_coverage_prints_uncertain_places_and_draws(lmkit, files, tmp_path):
    done = lmkit("plan", "coverage", *files, "--map", "map.yaml", "-o", "heat.svg", "--json")
    assert done.code == 0, done.err
    answer = json.loads(done.out)
    assert 0 < answer["share"] <= 1
    assert all(len(place["position"]) == 2 for place in answer["failing"])
    assert (tmp_path / "heat.svg").read_text().startswith("<svg")


def test_landmarks_of_another_place_are_named(lmkit, files, tmp_path):
    """No landmark is counted, and the predicted errors alone would not show this."""
    there = read_map(tmp_path / "map.yaml")
    moved = [replace(m, T_map_landmark=replace(m.T_map_landmark, t=m.T_map_landmark.t + 40)) for m in there]
    (tmp_path / "far.yaml").write_text(map_to_yaml(LandmarkMap(moved)))
    here, far = (
        lmkit("plan", "coverage", *files, "--map", name, "-o", f"{name}.png") for name in ("map.yaml", "far.yaml")
    )
    assert "count nowhere" not in here.err
    assert f"{len(there)} of {len(there)} landmarks face a wall or are outside of the rooms of floor.yaml" in far.err


def test_route_goes_from_sign_to_place(lmkit, files, tmp_path):
    done = lmkit("plan", "route", "dock", "5,1,0", *files, "--map", "map.yaml", "--csv", "way.csv", "--json")
    assert done.code == 0, done.err
    answer = json.loads(done.out)
    assert answer["waypoints"][0] == pytest.approx([1, 1])
    assert answer["waypoints"][-1] == pytest.approx([5, 1])
    assert answer["heading_deg"] == pytest.approx(0)
    assert (tmp_path / "way.csv").read_text().startswith("x_m,y_m,heading_deg,error_m")


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (("route", "9,9", "5,1"), 2, "nearest place"),
        (("route", "dock", "moon"), 2, "known places: dock"),
        (("route", "dock", "5,1", "--radius", "0.75m"), 1, "can be reached"),
        (("route", "dock", "5,1", "--radius", "9m"), 2, "--radius"),
        (("place", "--error", "0.01mm"), 1, "possible"),
        (("place", "--share", "140"), 2, "--share"),
        (("place", "--patience", "-1"), 2, "--patience"),
        (("route", "dock", "0.15,1"), 2, "nearest place"),
        (("place", "--not-on", "Z"), 2, "no wall 'Z'"),
        (("coverage", "--scale", "0.05"), 2, "leave --scale out"),
        (("coverage", "--plan", "heat.gif"), 2, ".png or .svg"),
    ],
)
def test_wrong_use_is_named(lmkit, files, arguments, code, said):
    wants_map = () if arguments[0] == "place" else ("--map", "map.yaml")
    done = lmkit("plan", *arguments, *files, *wants_map)
    assert done.code == code, done.err
    assert said in done.err
    assert done.err.count("\n") == 1


def test_a_rig_without_base_asks_for_the_camera_s_height(lmkit, files, tmp_path):
    text = (tmp_path / "rig.yaml").read_text()
    (tmp_path / "rig.yaml").write_text(text[: text.index("T_base_left")])
    done = lmkit("plan", "coverage", *files, "--map", "map.yaml")
    assert (done.code, "--camera-height" in done.err) == (2, True)
    assert lmkit("plan", "coverage", *files, "--map", "map.yaml", "--camera-height", "0.85m").code == 0


def test_an_image_needs_a_scale(lmkit, files, tmp_path):
    (tmp_path / "f.png").write_bytes(b"")
    done = lmkit("plan", "coverage", "--floor", "f.png", "--rig", "rig.yaml", "--map", "map.yaml")
    assert (done.code, "--scale" in done.err) == (2, True)


def test_a_floor_that_is_too_small_for_a_robot_has_its_scale_questioned(lmkit, files, tmp_path):
    (tmp_path / "plan.svg").write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" width="200" height="200">'
        '<path fill="none" stroke="#000" d="M 20 20 H 140 V 100 H 20 Z"/></svg>'
    )
    asked = ("plan", "coverage", "--floor", "plan.svg", "--map", "map.yaml", "--rig", "rig.yaml", "-o", "c.png")
    done = lmkit(*asked, "--scale", "0.01")
    assert "check --scale 0.01" in done.err
    done = lmkit(*asked, "--scale", "0.05")
    assert "--scale" not in done.err
