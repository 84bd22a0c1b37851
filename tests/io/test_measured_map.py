"""Maps by hand: the form of tape measurements, its checks, and `lmkit map`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command_line import run_command
from ids import lm8

from lmkit.errors import InputError
from lmkit.io.floor_plan import rectangular_room
from lmkit.io.landmark_map import read_map
from lmkit.io.measured_map import FormDefaults, blank_form, read_measured_map
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark, wall_pose
from lmkit.model.map_checks import check_map

ROOM = rectangular_room(6.0, 4.0)


def read(folder: Path, text: str, defaults: FormDefaults = FormDefaults("lm8")) -> LandmarkMap:
    path = folder / "form.csv"
    path.write_text(text)
    return read_measured_map(path, ROOM.walls, defaults)


@pytest.mark.parametrize(
    ("wall", "position", "faces"),
    [
        ("north", (1.5, 4.0), (0, -1)),
        ("East", (6.0, 2.5), (-1, 0)),
        ("south", (4.5, 0.0), (0, 1)),
        ("WEST", (0.0, 1.5), (1, 0)),
    ],
)
def test_left_is_the_left_end_as_one_faces_the_wall(
    tmp_path: Path, wall: str, position: tuple[float, float], faces: tuple[float, float]
) -> None:
    landmark = read(tmp_path, f"code,wall,left_m,height_m\n7,{wall},1.5,1.2\n").find(lm8(7))
    assert landmark is not None
    np.testing.assert_allclose(landmark.T_map_landmark.t, [*position, 1.2], atol=1e-9)
    np.testing.assert_allclose(landmark.T_map_landmark.R[:, 2], [*faces, 0], atol=1e-9)
    np.testing.assert_allclose(landmark.T_map_landmark.R[:, 1], [0, 0, 1], atol=1e-9)


def test_right_and_position_give_the_same_place_as_left(tmp_path: Path) -> None:
    header = "code,wall,left_m,right_m,height_m,x_m,y_m,facing_deg"
    text = f"{header}\n0,north,1.5,,1,,,\n1,north,,4.5,1,,,\n2,,,,1,1.5,4,270\n"
    poses = [m.T_map_landmark for m in read(tmp_path, text)]
    for pose in poses[1:]:
        np.testing.assert_allclose(pose.t, poses[0].t, atol=1e-9)
        np.testing.assert_allclose(pose.R, poses[0].R, atol=1e-9)


def test_sizes_families_names_and_sigma_of_a_row_are_kept(tmp_path: Path) -> None:
    text = (
        "id;wall;from_left_end_m;z_m;size_mm;name\nlm12:5;north;1,50;1,20;;dock\n6;north;3,5;1,2;100;\n7;north;;;;\n"
    )
    first, second = read(tmp_path, text, FormDefaults("lm8", sigma=(0.01, 0.02)))
    assert (str(first.id), first.size_m, first.name) == ("lm12:5", 0.18, "dock")
    assert (str(second.id), second.size_m, second.name) == ("lm8:6", 0.1, None)
    assert first.covariance is not None
    np.testing.assert_allclose(np.diag(first.covariance), [1e-4] * 3 + [4e-4] * 3)


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ("code,wall,left_m,height_m\n1,north,150,1.2\n", "line 2: left_m 150 is beyond wall north.*centimeters"),
        ("code,wall,left_m,height_m\n1,nroth,1.5,1.2\n", "wall 'nroth' is unknown; walls are"),
        ("code,wall,left_m,height_m\n1,north,1.5,\n", "height_m is empty"),
        ("code,wall,left_m,height_m\n1,north,,1.2\n", "left_m is empty; measure"),
        ("code,wall,left_m,height_m\n1,north,a,1.2\n", "left_m 'a' is not a number"),
        ("code,wall,left_m,height_m\n999,north,1,1.2\n", "no code 999"),
        ("code,wall,left_m,height_m\n1,,1,1.2\n", "left_m needs a wall"),
        ("code,wall,left_m,height_m\n1,north,1.5,1.2\n1,north,2.5,1.2\n", "lm8:1 is in the map twice"),
        ("code,wall,left_m,right_m,height_m\n1,north,1.5,4.4,1.2\n", "add up to 5.90 m, but wall north is 6.00 m"),
        ("code,wall,left_m,height_m,x_m,y_m\n1,north,1.5,1.2,4.5,4\n", "differ"),
        ("code,wall,left_m,height_m,facing_deg\n1,north,1.5,1.2,90\n", "looks into wall north.*270"),
        ("code,wall,left,height_m\n1,north,1.5,1.2\n", "unknown column 'left'"),
        ("code,wall,left_m,height_m\n1,,,\n", "no row has a measurement"),
    ],
)
def test_what_cannot_be_meant_is_refused_with_its_line(tmp_path: Path, rows: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        read(tmp_path, rows)


def test_unusual_places_are_named() -> None:
    def at(code: int, x: float, y: float, z: float, facing_deg: float, size_m: float = 0.18) -> MappedLandmark:
        return MappedLandmark(lm8(code), size_m, wall_pose([x, y, z], np.radians(facing_deg)))

    good = [at(0, 1.5, 4.0, 1.2, 270), at(1, 0.0, 1.0, 1.2, 0)]
    assert check_map(LandmarkMap(good), ROOM) == []
    wrong = [
        at(2, 4.5, 4.0, 1.2, 90),
        at(3, 1.55, 4.0, 1.25, 270),
        at(4, 0.0, 3.0, 120, 0),
        at(5, 3.0, 0, 1, 90, 3.0),
    ]
    text = "\n".join(check_map(LandmarkMap(good + wrong), ROOM))
    assert "2: faces a wall" in text
    assert "0, 3: overlap" in text
    assert "4: center above 10 m" in text
    assert "5: larger than 2 m" in text


def test_the_command_writes_map_and_plan(tmp_path: Path) -> None:
    form, target, plan = (tmp_path / name for name in ("form.csv", "map.yaml", "plan.svg"))
    assert run_command("map", form, "--blank", "0-2").code == 0
    assert form.read_text() == blank_form([0, 1, 2])
    form.write_text("code,wall,left_m,height_m\n0,north,1.5,1.2\n1,east,1,1.3\n2,,,\n")
    answer = run_command("map", form, "--room", "6.00x4.00m", "-o", target, "--plan", plan)
    assert answer.code == 0, answer.err
    assert [m.code for m in read_map(target)] == [0, 1]
    assert ">north</text>" in plan.read_text()
    assert run_command("map", target).out.splitlines()[0].startswith("lm8:0: x 1.500 y 4.000")
    assert "give --room" in run_command("map", form).err
