"""Maps of ROS in modes trinary, scale and raw: the same floor; unknown is neither free nor a wall."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from lmkit.errors import InputError, InputWarning
from lmkit.io.floor_plan import read_floor

FREE, WALL, UNKNOWN = range(3)


def room() -> np.ndarray:
    """(100,140) cells of 5 cm: a room of 5 x 3 m, walls of 10 cm, a doorway of 1 m into the unknown."""
    cells = np.full((100, 140), UNKNOWN)
    cells[18:82, 18:122] = WALL
    cells[20:80, 20:120] = FREE
    cells[40:60, 120:126] = UNKNOWN
    return cells


def write(folder: Path, pixels: np.ndarray, **keys: object) -> Path:
    Image.fromarray(pixels).save(folder / "map.png")
    lines = {"image": "map.png", "resolution": 0.05, "origin": [-1.0, -2.0, 0.0], "negate": 0} | keys
    (folder / "map.yaml").write_text("".join(f"{key}: {value}\n" for key, value in lines.items()))
    return folder / "map.yaml"


def with_alpha(gray: np.ndarray, unknown: np.ndarray) -> np.ndarray:
    return np.dstack([gray, np.where(unknown, 0, 255)]).astype(np.uint8)


CELLS = room()
SAVED = np.array([254, 0, 205], np.uint8)[CELLS]
PERCENT = np.array([0, 100, 255], np.uint8)[CELLS]
AS_SAVED = {
    "map_server": (SAVED, {"free_thresh": 0.196, "occupied_thresh": 0.65}),
    "nav2": (SAVED, {"mode": "trinary", "free_thresh": 0.25, "occupied_thresh": 0.65}),
    "raw": (PERCENT, {"mode": "raw", "free_thresh": 0.25}),
    "scale": (with_alpha(np.array([255, 0, 255])[CELLS], CELLS == UNKNOWN), {"mode": "scale", "free_thresh": 0.25}),
    "negated": (np.array([0, 255, 128], np.uint8)[CELLS], {"negate": 1}),
}


@pytest.mark.parametrize("name", AS_SAVED)
def test_every_mode_gives_the_same_floor(tmp_path, name):
    pixels, keys = AS_SAVED[name]
    floor = read_floor(write(tmp_path, pixels, **keys))
    assert np.array_equal(floor.free[::-1], CELLS == FREE)
    walls = sorted((round(w.length_m, 1), round(np.rad2deg(w.facing_rad)) % 360) for w in floor.walls)
    # The eastern wall is two pieces: nothing is mounted in the doorway.
    assert walls == sorted([(5.0, 90), (5.0, 270), (3.0, 0), (1.0, 180), (1.0, 180)])
    assert all(-0.01 <= w.left[0] + 1.0 - 1.0 <= 5.01 for w in floor.walls)


def test_half_occupied_pixels_are_neither_free_nor_walls(tmp_path):
    pixels = SAVED.copy()
    pixels[20:80, 20:40] = 150
    floor = read_floor(write(tmp_path, pixels, mode="scale"))
    assert floor.free.sum() == 80 * 60
    assert sorted(round(w.length_m, 1) for w in floor.walls) == [1.0, 1.0, 4.0, 4.0]


@pytest.mark.parametrize("angle", [0.7853, -2.0])
def test_a_rotated_origin_rotates_floor_and_walls(tmp_path, angle):
    still = read_floor(write(tmp_path, SAVED))
    floor = read_floor(write(tmp_path, SAVED, origin=[-1.0, -2.0, angle]))
    R = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    corner = np.array([-1.0, -2.0])
    for a, b in zip(still.walls, floor.walls, strict=True):
        np.testing.assert_allclose(b.left, R @ (a.left - corner) + corner, atol=1e-9)
        np.testing.assert_allclose(b.right, R @ (a.right - corner) + corner, atol=1e-9)
    points = np.random.default_rng(3).uniform(-6, 8, (4000, 2))
    expected, found = still.is_free((points - corner) @ R + corner), floor.is_free(points)
    assert not (found & ~expected & (still.clearance_at((points - corner) @ R + corner) == 0)).any()
    assert (found != expected).mean() < 0.03
    assert floor.free.sum() == pytest.approx(still.free.sum(), rel=0.06)


@pytest.mark.parametrize(
    ("keys", "code"),
    [
        ({"mode": "costmap"}, "bad_value"),
        ({"mode": "raw", "negate": 1}, "map_mode"),
        ({"free_thresh": 0.7}, "bad_value"),
        ({"free_thresh": 25}, "bad_value"),
        ({"resolution": 1e-10}, "fine_plan"),
        ({"origin": [0, -1e308, 0]}, "bad_value"),
    ],
)
def test_what_map_servers_do_not_agree_on_is_refused(tmp_path, keys, code):
    with pytest.raises(InputError) as refused:
        read_floor(write(tmp_path, SAVED, **keys))
    assert refused.value.code == code


def test_a_pgm_as_map_saver_writes_it(tmp_path):
    """With the comment and the thresholds of YAML files of nav2."""
    head = b"P5\n# CREATOR: map_saver.cpp 0.050 m/pix\n%d %d\n255\n" % SAVED.shape[::-1]
    (tmp_path / "map.pgm").write_bytes(head + SAVED.tobytes())
    floor = read_floor(
        write(tmp_path, SAVED, image="map.pgm", mode="trinary", occupied_thresh=0.65, free_thresh=0.25)
    )
    assert np.array_equal(floor.free[::-1], CELLS == FREE)


def test_a_map_with_wrong_negate_is_doubted(tmp_path):
    with pytest.warns(InputWarning, match="is negate wrong"):
        read_floor(write(tmp_path, SAVED, negate=1))


def test_a_yaw_in_degrees_is_refused(tmp_path):
    with pytest.raises(InputError, match="a yaw of 90 rad: degrees"):
        read_floor(write(tmp_path, SAVED, origin=[-1.0, -2.0, 90.0]))
