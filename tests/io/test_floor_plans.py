"""Floor plans of every kind give the same floor; what is wrong with them is named."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from floors import TWO_ROOMS, two_rooms

from lmkit.errors import InputError, InputWarning
from lmkit.io.floor_islands import DrawingOptions, drawing_warnings, parse_island_rules
from lmkit.io.floor_plan import read_floor
from lmkit.visualization.floor_layer import OBSTACLE, floor_underlay, island_notes, wall_notes

SVG = (
    '<svg xmlns="http://www.w3.org/2000/svg"><g transform="translate(7,9) scale(2)">'
    '<path d="M0 0 h30 v20 H0 z"/><line x1="15" y1="20" x2="15" y2="7"/></g></svg>'
)


def drawn() -> np.ndarray:
    """Image of the two rooms at 2 cm a pixel, paper around them."""
    photo = np.full((260, 360), 255, dtype=np.uint8)
    cv2.rectangle(photo, (30, 30), (330, 230), 0, 2)
    cv2.line(photo, (180, 230), (180, 100), 0, 2)
    return photo


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
        right_hand = np.array([-out[1], out[0]])  # as seen by someone who faces the wall
        assert wall.along @ right_hand == pytest.approx(1.0)


def test_an_svg_drawing_is_the_same_floor(tmp_path):
    path = tmp_path / "floor.svg"
    path.write_text(SVG)
    assert sides(read_floor(path, 0.1)) == WALLS


def test_an_image_and_a_ros_map_are_the_same_floor(tmp_path):
    cv2.imwrite(str(tmp_path / "floor.png"), drawn())
    photo = read_floor(tmp_path / "floor.png", 0.02)
    (tmp_path / "ros.yaml").write_text("image: floor.png\nresolution: 0.02\norigin: [-1.0, 2.0, 0.0]\nnegate: 0\n")
    ros = read_floor(tmp_path / "ros.yaml")
    assert ros.origin == (-1.0, 2.0)
    # In an image the inner wall ends the southern one; lines are as thick as they are drawn.
    parts = sorted([wall for wall in WALLS if wall != (6.0, 90)] + [(3.0, 90), (3.0, 90)])
    for floor in (photo, ros):
        found = sorted((round(w.length_m), round(np.rad2deg(w.facing_rad)) % 360, w.length_m) for w in floor.walls)
        assert [turn for _, turn, _ in found] == [turn for _, turn in sorted((round(m), turn) for m, turn in parts)]
        assert np.allclose(sorted(w[2] for w in found), sorted(m for m, _ in parts), atol=0.15)
        assert floor.free.sum() * floor.cell_m**2 == pytest.approx(24, rel=0.06)


def test_walls_hide_and_doors_show(tmp_path):
    floor = two_rooms(tmp_path)
    cameras = np.array([[1.5, 1.0], [1.5, 1.0], [2.0, 3.3]])
    points = np.array([[6.0, 1.0], [0.0, 2.0], [6.0, 3.0]])
    assert floor.sees(cameras, points).tolist() == [False, True, True]


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
        ("f.yaml", TWO_ROOMS.replace("to: [6, 0]", "to: [1.0e+308, 0]"), None, "bad_value"),
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


def test_a_black_image_has_no_floor(tmp_path):
    cv2.imwrite(str(tmp_path / "f.png"), np.zeros((50, 50), np.uint8))
    with pytest.raises(InputError, match="no free floor"):
        read_floor(tmp_path / "f.png", 0.05)


def furnished(path):
    """The two rooms with a word, a table and a long wall inside, and a thin line that closes the door."""
    image = drawn()
    cv2.putText(image, "8.0 m", (60, 80), cv2.FONT_HERSHEY_SIMPLEX, 0.5, 0, 2)
    cv2.rectangle(image, (220, 180), (260, 200), 0, 1)
    cv2.rectangle(image, (190, 60), (320, 66), 0, -1)
    cv2.line(image, (180, 30), (180, 100), 0, 1)
    cv2.imwrite(str(path), image)
    return path


def test_small_islands_block_the_robot_and_hold_no_landmarks(tmp_path):
    floor = read_floor(furnished(tmp_path / "f.png"), 0.02)
    small = [island for island in floor.islands if island.use == "obstacle"]
    assert small and all((island.high - island.low < 2.5).all() for island in small)
    table = np.array([1.0 + 0.02 * 210, 0.02 * (260 - 190)])
    assert not floor.is_free(table - [0.4, 0.0]), "the inside of a table is no floor"
    for wall in floor.walls:
        middle = (wall.left + wall.right) / 2
        assert not any((middle > island.low - 0.1).all() and (middle < island.high + 0.1).all() for island in small)
    assert [wall.name for wall in floor.walls[:3]] == ["A", "B", "C"]
    shown = floor_underlay(floor)
    assert (shown.rgb == OBSTACLE).all(axis=2).any() and len(island_notes(floor)) == len(floor.islands)
    assert any("carry no landmarks: (" in text for text in drawing_warnings(floor.islands, floor.free, floor.cell_m))


def test_a_line_along_several_letters_is_no_wall(tmp_path):
    image = np.full((380, 480), 255, dtype=np.uint8)
    cv2.rectangle(image, (40, 40), (440, 340), 0, 6)
    cv2.putText(image, "living room", (150, 280), cv2.FONT_HERSHEY_SIMPLEX, 0.8, 0, 2)
    cv2.imwrite(str(tmp_path / "text.png"), image)
    floor = read_floor(tmp_path / "text.png", 0.02)
    assert len(floor.islands) > 3
    assert len(floor.walls) == 4


def test_islands_are_left_out_or_used_as_walls_where_asked_for(tmp_path):
    path = furnished(tmp_path / "f.png")
    plain = read_floor(path, 0.02)
    without = read_floor(path, 0.02, DrawingOptions("ignore"))
    assert without.free.sum() > plain.free.sum()
    assert {island.use for island in without.islands} <= {"ignore", "wall"}
    number = next(island.number for island in plain.islands if island.use == "obstacle" and island.low[0] > 4)
    one = read_floor(path, 0.02, DrawingOptions(*parse_island_rules(f"walls:{number}")))
    assert len(one.walls) >= len(plain.walls) + 2
    with pytest.raises(InputError, match="no island 99"):
        read_floor(path, 0.02, DrawingOptions(by_number={99: "wall"}))


def test_thin_lines_are_left_out_where_asked_for(tmp_path):
    path = furnished(tmp_path / "f.png")
    floor = read_floor(path, 0.02)
    assert any("no opening" in text for text in drawing_warnings(floor.islands, floor.free, floor.cell_m))
    thick = cv2.erode(drawn(), np.ones((5, 5), np.uint8))
    thick[98:103, 170:190] = 255  # an opening above the wall between the rooms
    outline = thick.copy()
    cv2.line(outline, (180, 30), (180, 100), 0, 2)  # closed by a thin line
    cv2.imwrite(str(path), outline)
    closed, opened = (read_floor(path, 0.02, DrawingOptions(thin_m=m)) for m in (0.0, 0.08))
    warned = [drawing_warnings(floor.islands, floor.free, floor.cell_m) for floor in (closed, opened)]
    assert any("no opening" in text for text in warned[0]) and not warned[1]
    assert sides(opened)[:2] == [(2.5, 0), (2.5, 180)], "the thick wall keeps its length"
    with pytest.raises(InputError, match="2 pixels"):
        read_floor(path, 0.02, DrawingOptions(thin_m=0.02))


def test_curves_of_svg_are_left_out_where_asked_for(tmp_path):
    """A door in the opening between the rooms: its leaf and arc close it; the straight leaf stays."""
    path = tmp_path / "floor.svg"
    door = '<path d="M15 7 h7 a7 7 0 0 0 -7 -7 z"/><circle cx="8" cy="8" r="2"/>'
    path.write_text(SVG.replace("</g>", door + "</g>"))
    whole, straight = (read_floor(path, 0.1, DrawingOptions(curves=curves)) for curves in (True, False))
    assert len(whole.walls) > len(straight.walls)
    assert len(whole.islands) == 1 and not straight.islands
    assert not whole.is_free(np.array([2 * 0.8 - 0.4, 0.2 * (20 - 8)])) and straight.is_free(np.array([1.2, 2.4]))


def test_an_open_outer_door_counts_as_shut(tmp_path):
    """The table is closed, but is no room; and not every piece of the door's arc has a name in drawings."""
    path = tmp_path / "floor.svg"
    lines = "M0 30 V80 H120 V0 H0 V12 M0 30 A18 18 0 0 1 18 12"
    table = "M60 40 h10 v6 h-10 z"
    path.write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="-9 -9 140 99"><path d="{lines} {table}"/></svg>'
    )
    with pytest.warns(InputWarning, match="an outer door is open"):
        floor = read_floor(path, 0.05)
    assert [island.use for island in floor.islands] == ["obstacle"]
    assert floor.free.sum() * floor.cell_m**2 == pytest.approx(6.0 * 4.0, rel=0.07)
    names = {note.text for note in wall_notes(floor)}
    long = {wall.name for wall in floor.walls if wall.length_m > 0.3}
    assert long == names and len(floor.walls) > len(names) + 10


@pytest.mark.parametrize("text", ["walls:x", "drop", "ignore:1-"])
def test_rules_for_islands_that_cannot_be_read(text):
    with pytest.raises(InputError, match="--islands"):
        parse_island_rules(text)
