"""The simulator against geometry and against itself."""

from __future__ import annotations

import json
from itertools import pairwise

import cv2
import numpy as np
import pytest

from lmkit.detection.config import DetectOptions
from lmkit.detection.detector import detect_landmarks
from lmkit.errors import InputError
from lmkit.geometry.pose import Pose
from lmkit.io.floor_plan import read_floor
from lmkit.io.landmark_map import read_map
from lmkit.io.rig import read_rig
from lmkit.model.board import BoardSpec
from lmkit.model.families import family_named
from lmkit.model.landmark import LM8
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark, wall_pose
from lmkit.model.square_marker import SQUARE_FAMILIES
from lmkit.simulation import render as rendering
from lmkit.simulation.dataset import description_files, make_dataset, truth
from lmkit.simulation.photograph import ImagingChain, Lens, Sensor, focus, photograph
from lmkit.simulation.render import render
from lmkit.simulation.scene import board_panel, floor_scene, landmark_sheet, make_rig, make_room


@pytest.mark.parametrize("board", ["aprilgrid:6x6:99mm:0.3", "chessboard:9x6:90mm"])
def test_a_board_larger_than_a_sheet_lies_on_its_own_page(board):
    spec = BoardSpec.parse(board)
    panel = board_panel(spec, Pose.identity("map", "board"))
    assert np.all(1000 * np.array(panel.size_m) > spec.pattern_mm)


def test_a_board_that_never_fits_is_refused():
    with pytest.raises(InputError, match="is too large"):
        make_dataset(1, 1, 1, 4, LM8, BoardSpec.parse("aprilgrid:6x6:222mm:0.3"))


def test_the_same_seed_gives_the_same_room_and_image():
    rig = make_rig((160, 120), 115.0)
    images = []
    for _ in range(2):
        data = make_dataset(4, 2, 0, 6, family=LM8)
        images.append(photograph(data.scene, rig.left, data.poses[0], ImagingChain(), np.random.default_rng(1)))
    assert np.array_equal(*images)


def test_rays_are_met_where_they_can_see_a_panel(monkeypatch):
    """Walls beside the camera reach behind it."""
    data = make_dataset(4, 3, 0, 6, family=LM8)
    bounded = [render(data.scene, data.rig.left, pose) for pose in data.poses]
    monkeypatch.setattr(rendering, "_window", lambda T, size_m, rays: tuple(map(slice, rays.shape[:2])))
    assert all(
        np.array_equal(image, render(data.scene, data.rig.left, pose))
        for image, pose in zip(bounded, data.poses, strict=True)
    )


@pytest.mark.slow
def test_the_truth_stands_where_the_image_is_red():
    """The true corners against the image itself: red just inside each, no red just outside."""
    data = make_dataset(12, 4, 0, 12, family=LM8)
    checked = 0
    for index, pair in enumerate(truth(data)["pairs"]):
        image = focus(render(data.scene, data.rig.left, data.poses[index]), Lens(blur_px=0.0))
        for landmark in pair["landmarks"]["left"]:
            if landmark["side_px"] < 38:
                continue
            corners = np.array(landmark["corners"])
            middle = corners.mean(axis=0)
            for corner in corners:
                inside, outside = (corner + share * (middle - corner) for share in (0.055, -0.06))
                places = np.array([[inside, outside]], dtype=np.float32)
                (colors,) = cv2.remap(image.astype(np.float32), places[..., 0], places[..., 1], cv2.INTER_LINEAR)
                redness = colors[:, 0] / colors.sum(axis=1)
                assert redness[0] > 0.55
                assert redness[1] < 0.5
                checked += 1
    assert checked >= 8


def test_files_can_be_read_back(tmp_path):
    data = make_dataset(3, 2, 1, 5, family=LM8)
    for name, text in description_files(data).items():
        (tmp_path / name).write_text(text)
    assert len(read_map(tmp_path / "map.yaml")) == 5
    assert np.array_equal(read_rig(tmp_path / "rig.yaml").left.K, data.rig.left.K)
    described = json.loads((tmp_path / "truth.json").read_text())
    assert len(described["pairs"]) == 2
    assert len(described["boards"]) == 1


def test_noise_grows_with_less_light():
    scene = make_room(1, LM8, 4)
    rig = make_rig((80, 60), 57.0)
    pose = make_dataset(1, 1, 0, 4, family=LM8).poses[0]
    spreads = []
    for full_well in (20000.0, 500.0):
        chain = ImagingChain(sensor=Sensor(full_well=full_well))
        shots = [photograph(scene, rig.left, pose, chain, np.random.default_rng(k)).astype(float) for k in range(6)]
        spreads.append(np.std(shots, axis=0).mean())
    assert spreads[1] > 3 * spreads[0]


def test_rooms_show_any_family():
    data = make_dataset(3, 2, 0, 6, SQUARE_FAMILIES["tag36h11"])
    assert {landmark.family for landmark in data.scene.landmarks} == {"tag36h11"}
    seen = [one for pair in truth(data)["pairs"] for one in pair["landmarks"]["left"]]
    assert seen
    assert all(one["id"] == f"tag36h11:{one['code']}" for one in seen)
    image = photograph(data.scene, data.rig.left, data.poses[0], ImagingChain(), np.random.default_rng(1))
    found = detect_landmarks(image, DetectOptions((SQUARE_FAMILIES["tag36h11"],), camera=data.rig.left))
    true = {one["code"]: np.array(one["corners"]) for one in truth(data)["pairs"][0]["landmarks"]["left"]}
    assert found
    for one in found:
        assert np.abs(one.corners - true[one.code]).max() < 0.5


@pytest.mark.parametrize("name", ["lm8", "tag36h11", "aruco4x4_50"])
def test_a_landmark_sheet_has_the_white_margin_that_its_family_asks_for(name):
    family, wall = family_named(name), wall_pose((1.0, 2.0, 1.5), 0.0)
    sheet = landmark_sheet(MappedLandmark(LandmarkId(name, 7), 0.18, wall))
    assert min(sheet.size_m) > 0.18 * (1 + 2 * family.margin_mm / family.side_mm) - 0.0005


def test_a_landmark_sheet_has_its_landmark_centered_to_the_texel():
    wall = wall_pose([0.0, 0.0, 1.0], 0.0)
    sheet = landmark_sheet(MappedLandmark(LandmarkId("lm8", 137), 0.18, wall))
    rows, columns = (np.flatnonzero(np.ptp(sheet.texture, axis=(axis, 2)) > 0.1) for axis in (1, 0))
    height, width = sheet.texture.shape[:2]
    assert (rows[0], columns[0]) == (height - 1 - rows[-1], width - 1 - columns[-1])
    assert sheet.size_m[1] * len(rows) / height == pytest.approx(0.18)
    assert sheet.size_m == pytest.approx((0.21, 0.297), abs=3e-4)


def test_sheets_on_a_floor_plan_stand_where_the_map_says_and_before_their_walls(tmp_path):
    corners = [[0, 0], [4, 0], [4, 3], [0, 3], [0, 0]]
    walls = "".join(f"  - {{from: {a}, to: {b}}}\n" for a, b in pairwise(corners))
    (tmp_path / "floor.yaml").write_text(f"format: lmkit-floor/1\nwalls:\n{walls}")
    floor = read_floor(tmp_path / "floor.yaml")
    landmarks = LandmarkMap([MappedLandmark(LandmarkId("lm8", 137), 0.18, wall_pose([2.0, 0.0, 1.0], np.pi / 2))])
    *panels, sheet = floor_scene(1, floor, landmarks).panels
    landmark = next(iter(landmarks)).T_map_landmark
    assert sheet.T_map_panel.t == pytest.approx(landmark.t, abs=1e-12)
    behind = [(landmark.t - wall.T_map_panel.t) @ wall.T_map_panel.R[:, 2] for wall in panels[: len(floor.walls)]]
    assert min(behind) > 0.001
