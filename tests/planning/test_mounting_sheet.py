"""Mounting sheets: rooms, and distances from corners that a tape measure reaches."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pypdfium2
import pytest
from typer.testing import CliRunner

from lmkit.cli.app import build_app
from lmkit.io.floor_plan import read_floor, rectangular_room
from lmkit.io.landmark_map import map_to_yaml
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark, wall_pose
from lmkit.model.rooms import split_rooms, tape_ends, wall_of
from lmkit.reports.mounting_sheet import mounting_sheets

# Two rooms with a door of 1.2 m between them; in the lower one a wall with a passage of 1.6 m, which divides nothing.
FLOOR = """format: lmkit-floor/1
walls:
  - {from: [0, 0], to: [10, 0], name: south}
  - {from: [10, 0], to: [10, 7], name: east}
  - {from: [10, 7], to: [0, 7], name: north}
  - {from: [0, 7], to: [0, 0], name: west}
  - {from: [0, 4.2], to: [3.5, 4.2], name: E}
  - {from: [4.7, 4.2], to: [10, 4.2], name: F}
  - {from: [5.5, 0], to: [5.5, 2.6], name: G}
places:
  shelf: {position: [8.4, 5.8]}
"""


def landmark(code, x, y, facing_deg, turned_deg=0.0):
    pose = wall_pose([x, y, 1.1], np.deg2rad(facing_deg))
    c, s = np.cos(np.deg2rad(turned_deg)), np.sin(np.deg2rad(turned_deg))
    R = pose.R @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return MappedLandmark(LandmarkId("lm8", code), 0.18, replace(pose, R=R))


LANDMARKS = LandmarkMap(
    [
        landmark(3, 7.4, 0.0, 90),
        landmark(14, 2.6, 0.0, 90, turned_deg=90),
        landmark(41, 3.15, 4.2, 90),
        landmark(29, 1.95, 4.2, -90),
        landmark(7, 3.0, 2.0, 45),
    ]
)


@pytest.fixture(scope="module")
def floor(tmp_path_factory):
    path = tmp_path_factory.mktemp("sheet") / "floor.yaml"
    path.write_text(FLOOR)
    return read_floor(path)


def words_of(pdf):
    return [page.get_textpage().get_text_range() for page in pypdfium2.PdfDocument(pdf)]


def test_doors_separate_rooms_and_wide_passages_do_not(floor):
    rooms, numbers = split_rooms(floor)
    assert [room.title for room in rooms] == ["Room 1 (shelf)", "Room 2"]
    assert ((numbers > 0) == floor.free).all()
    at = {name: int(numbers[floor.cells(np.array(p))]) for name, p in {"a": (1, 1), "b": (9, 1), "c": (5, 6)}.items()}
    assert at == {"a": 2, "b": 2, "c": 1}


def test_furniture_divides_no_room(tmp_path):
    """A table leaves passages of 1 m on both sides of it, as doors do."""
    plan = np.full((600, 1000), 255, np.uint8)
    cv2.rectangle(plan, (50, 100), (950, 500), 0, 10)
    cv2.rectangle(plan, (450, 210), (570, 390), 0, 4)
    cv2.imwrite(str(tmp_path / "flat.png"), plan)
    floor = read_floor(tmp_path / "flat.png", 0.01)
    assert [island.use for island in floor.islands] == ["obstacle"]
    rooms, numbers = split_rooms(floor)
    assert len(rooms) == 1
    assert ((numbers > 0) == floor.free).all()


def test_a_corridor_is_a_room():
    ground = rectangular_room(12.0, 1.2)
    assert len(split_rooms(ground)[0]) == 1


@pytest.mark.parametrize(
    ("place", "facing_deg", "expected"),
    [
        ((7.4, 0.0), 90, [(2.6, "east"), (1.9, "G1")]),
        ((2.6, 0.0), 90, [(2.9, "G2"), (2.6, "west")]),
        ((3.15, 4.2), 90, [(0.35, None), (3.15, "west")]),
        ((1.95, 4.2), -90, [(1.95, "west"), (1.55, None)]),
        ((10.0, 3.0), 180, [(1.2, "F1"), (3.0, "south")]),
        ((10.0, 5.0), 180, [(2.0, "north"), (0.8, "F2")]),
    ],
)
def test_a_tape_starts_at_the_nearest_corner(floor, place, facing_deg, expected):
    facing = np.deg2rad(facing_deg)
    wall = wall_of(floor, np.array([*place, 1.0]), np.array([np.cos(facing), np.sin(facing), 0.0]))
    assert wall is not None
    found = tape_ends(floor, wall, float((np.array(place) - wall.left) @ wall.along))
    assert [end.distance_m for end in found] == pytest.approx([d for d, _ in expected], abs=1e-9)
    assert [end.wall for end in found] == [name for _, name in expected]


def test_each_room_has_its_landmarks_in_a_table(floor):
    overview, upper, lower = words_of(mounting_sheets(LANDMARKS, floor, "map.yaml", "letter"))
    assert "5 landmarks in 2 rooms" in overview and "Room 1 (shelf): 41" in overview
    assert "0.350 m from the end" in upper and "29" not in upper
    assert "1.900 m from G" in lower and "2.600 m from west" in lower and "rotated 90" in lower
    assert "x 3.000 m, y 2.000 m, faces 45" in lower and "1.190 m" in lower


def test_the_command_writes_sheets_without_a_floor(tmp_path):
    (tmp_path / "map.yaml").write_text(map_to_yaml(LANDMARKS))
    out = tmp_path / "sheet.pdf"
    arguments = ["plan", "sheet", "--map", str(tmp_path / "map.yaml"), "-o", str(out), "--paper", "a3"]
    ended = CliRunner().invoke(build_app(), arguments)
    assert ended.exit_code == 0, ended.output
    (page,) = words_of(out.read_bytes())
    assert "x 7.400 m, y 0.000 m, faces 90" in page
