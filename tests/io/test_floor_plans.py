"""Floor plans of every kind give the same floor; what is wrong with them is named."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from floors import TWO_ROOMS, two_rooms

from lmkit.errors import InputError
from lmkit.io.floor_plan import read_floor

SVG = (
    '<svg xmlns="http://www.w3.org/2000/svg"><g transform="translate(7,9) scale(2)">'
    '<path d="M0 0 h30 v20 H0 z"/><line x1="15" y1="20" x2="15" y2="7"/></g></svg>'
)


def drawn() -> np.ndarray:
    """Image of the two rooms at 2 cm a pixel, paper around them."""
    picture = np.full((260, 360), 255, dtype=np.uint8)
    cv2.rectangle(picture, (30, 30), (330, 230), 0, 2)
    cv2.line(picture, (180, 230), (180, 100), 0, 2)
    return picture


def sides(floor):
    """Length and direction of every wall, as seen from the free side."""
    return sorted((round(w.length_m, 1), round(np.rad2deg(w.facing_rad)) % 360) for w in floor.walls)


WALLS = sorted([(6.0, 90), (6.0, 270), (4.0, 0), (4.0, 180), (2.6, 0), (2.6, 180)])


def test_lines_are_walls_with_two_sides(tmp_path):
    floor = two_rooms(tmp_path)
    assert sides(floor) == WALLS
    assert [w.name for w in floor.walls if not w.usable] == ["glass"]
    assert floor.places["dock"] == pytest.approx((1, 1, np.pi / 2))
    assert floor.free.sum() * floor.cell_m**2 == pytest.approx(6 * 4, rel=0.04)


def test_whoever_faces_a_wall_sees_its_left_end_on_the_left(tmp_path):
    for wall in two_rooms(tmp_path).walls:
        out = np.array([np.cos(wall.facing_rad), np.sin(wall.facing_rad)])
        right_hand = np.array([-out[1], out[0]])  # of someone who looks against it
        assert wall.along @ right_hand == pytest.approx(1.0)


def test_an_svg_drawing_is_the_same_floor(tmp_path):
    path = tmp_path / "floor.svg"
    path.write_text(SVG)
    assert sides(read_floor(path, 0.1)) == WALLS


def test_a_picture_and_a_ros_map_are_the_same_floor(tmp_path):
    cv2.imwrite(str(tmp_path / "floor.png"), drawn())
    picture = read_floor(tmp_path / "floor.png", 0.02)
    (tmp_path / "ros.yaml").write_text("image: floor.png\nresolution: 0.02\norigin: [-1.0, 2.0, 0.0]\nnegate: 0\n")
    ros = read_floor(tmp_path / "ros.yaml")
    assert ros.origin == (-1.0, 2.0)
    # In an image the inner wall ends the southern one; lines are as thick as they are drawn.
    parts = sorted([wall for wall in WALLS if wall != (6.0, 90)] + [(3.0, 90), (3.0, 90)])
    for floor in (picture, ros):
        found = sorted((round(w.length_m), round(np.rad2deg(w.facing_rad)) % 360, w.length_m) for w in floor.walls)
        assert [turn for _, turn, _ in found] == [turn for _, turn in sorted((round(m), turn) for m, turn in parts)]
        assert np.allclose(sorted(w[2] for w in found), sorted(m for m, _ in parts), atol=0.15)
        assert floor.free.sum() * floor.cell_m**2 == pytest.approx(24, rel=0.06)


def test_walls_hide_and_doors_show(tmp_path):
    floor = two_rooms(tmp_path)
    eyes = np.array([[1.5, 1.0], [1.5, 1.0], [2.0, 3.3]])
    points = np.array([[6.0, 1.0], [0.0, 2.0], [6.0, 3.0]])
    assert floor.sees(eyes, points).tolist() == [False, True, True]


def test_clearance_is_the_distance_to_the_nearest_wall(tmp_path):
    floor = two_rooms(tmp_path)
    at = np.array([[1.5, 1.0], [3.0, 3.3], [3.0, 1.0], [50.0, 1.0]])
    assert floor.clearance_at(at) == pytest.approx([1.0, 0.7, 0.0, 0.0], abs=0.08)


@pytest.mark.parametrize(
    ("name", "text", "scale", "code"),
    [
        ("f.svg", SVG, None, "no_scale"),
        ("f.yaml", TWO_ROOMS, 0.05, "two_scales"),
        ("f.yaml", TWO_ROOMS.replace("walls:", "doors: 3\nwalls:"), None, "bad_value"),
        ("f.yaml", TWO_ROOMS.replace("to: [6, 0]", "to: [0.001, 0]"), None, "short_wall"),
        ("f.yaml", "image: nowhere.png\nresolution: 0.05\n", None, "file_unreadable"),
        ("f.svg", SVG.replace("scale(2)", "warp(9)"), 0.1, "bad_svg"),
        ("f.svg", "<svg", 0.1, "not_svg"),
        ("f.svg", "<svg></svg>", 0.1, "no_walls"),
        ("f.svg", SVG, 1e4, "bad_scale"),
        ("f.svg", SVG, 500.0, "floor_too_large"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, name, text, scale, code):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError) as refused:
        read_floor(tmp_path / name, scale)
    assert refused.value.code == code


def test_a_black_picture_has_no_floor(tmp_path):
    cv2.imwrite(str(tmp_path / "f.png"), np.zeros((50, 50), np.uint8))
    with pytest.raises(InputError, match="no free floor"):
        read_floor(tmp_path / "f.png", 0.05)
