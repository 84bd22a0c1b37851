"""Codes, geometry, cameras, maps and boards."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ids import lm8

import lmkit
from lmkit.errors import InputError
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.homography import homography_from_points, transform_points
from lmkit.geometry.pose import Pose
from lmkit.model.board import BoardSpec
from lmkit.model.codewords import code_to_gaps, format_codes, gaps_to_code, parse_codes
from lmkit.model.landmark import LM8
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark, wall_pose


@given(st.integers(0, 255))
def test_codes_and_gaps_are_the_same_thing(code):
    assert gaps_to_code(code_to_gaps(code, 8)) == code


def test_the_first_bit_is_the_outer_ring_at_the_top():
    assert code_to_gaps(0b10000000, 8) == (True, *[False] * 7)
    assert LM8.rings[0].gap_centers_deg == (0, 90, 180, 270)
    assert LM8.rings[1].gap_centers_deg == (45, 135, 225, 315)


@given(st.lists(st.integers(0, 255), min_size=1, unique=True))
def test_codes_survive_writing_and_reading(codes):
    assert parse_codes(format_codes(codes), 256) == codes


@pytest.mark.parametrize("text", ["5-2", "256", "0-256", "", "a", "-1", "1,,2", "1.5"])
def test_wrong_codes_are_refused(text):
    with pytest.raises(InputError):
        parse_codes(text, 256)


def test_object_points_are_what_ippe_square_wants():
    points = LM8.object_points(0.18)
    assert np.allclose(points, [[-0.09, 0.09, 0], [0.09, 0.09, 0], [0.09, -0.09, 0], [-0.09, -0.09, 0]])


CAMERAS = [
    CameraModel((640, 480), np.array([[460.0, 0, 325], [0, 458, 236], [0, 0, 1]]), np.array(d), model)
    for d, model in (
        ([-0.2, 0.05, 0.001, -0.001, 0.01], "pinhole"),
        ([0.1, 0.02, 0.001, -0.001, 0.01, 0.3, 0.03, 0.01], "rational"),
        ([0.02, -0.01, 0.003, -0.001], "fisheye"),
    )
]


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda c: c.model)
def test_projection_is_opencvs_and_unprojection_undoes_it(camera):
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-0.5, 0.5, (50, 2)), rng.uniform(1, 3, 50)])
    project = cv2.fisheye.projectPoints if camera.model == "fisheye" else cv2.projectPoints
    theirs, _ = project(points.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), camera.K, camera.distortion)
    pixels = camera.project(points)
    assert np.allclose(pixels, theirs.reshape(-1, 2))
    assert np.allclose(camera.unproject(pixels), points[:, :2] / points[:, 2:], atol=1e-6)


@pytest.mark.parametrize("camera", CAMERAS, ids=lambda c: c.model)
def test_projection_derivatives_are_those_of_finite_differences(camera):
    point = np.array([[0.3, -0.2, 1.7]])
    pixels, by_point, by_camera = camera.project_with_jacobian(point)
    step = 1e-6
    for k in range(3):
        moved = point + step * np.eye(3)[k]
        assert np.allclose((camera.project(moved) - pixels)[0] / step, by_point[0, :, k], rtol=1e-3, atol=1e-2)
    vector = np.array([camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2], *camera.distortion])
    for k in range(len(vector)):
        changed = vector.copy()
        changed[k] += 1e-6
        K = np.array([[changed[0], 0, changed[2]], [0, changed[1], changed[3]], [0, 0, 1]])
        other = CameraModel(camera.image_size, K, changed[4:], camera.model)
        assert np.allclose((other.project(point) - pixels)[0] / 1e-6, by_camera[0, :, k], rtol=1e-3, atol=1e-2)


def test_a_landmark_on_a_wall_faces_the_room_upright():
    pose = wall_pose([1.0, 0.0, 1.5], np.pi / 2)  # on the wall y = 0, looking along +y
    assert np.allclose(pose.R[:, 2], [0, 1, 0])
    assert np.allclose(pose.R[:, 1], [0, 0, 1])
    # A viewer looks along -y and has -x on the right.
    assert np.allclose(pose.R[:, 0], [-1, 0, 0])


def test_a_code_is_mounted_once():
    twice = [MappedLandmark(lm8(7), 0.18, wall_pose([0, 0, 1], 0.0))] * 2
    with pytest.raises(InputError, match="twice"):
        LandmarkMap(twice)


@pytest.mark.parametrize("text", ["chessboard:9x6:30mm", "charuco:8x6:30mm:22mm:DICT_5X5_100:legacy"])
def test_board_specifications_survive_writing_and_reading(text):
    assert str(BoardSpec.parse(text)) == text


@pytest.mark.parametrize(
    "text",
    ["", "chessboard", "chessboard:9:30mm", "chessboard:9x6:30", "chessboard:9x6:-3mm", "chess:9x6:3mm",
     "charuco:8x6:30mm", "charuco:8x6:30mm:31mm:DICT_5X5_100", "charuco:8x6:30mm:22mm:DICT_5X5_100:new"],
)  # fmt: skip
def test_wrong_board_specifications_are_refused(text):
    with pytest.raises(InputError):
        BoardSpec.parse(text)


@given(st.integers(0, 10_000))
def test_a_homography_takes_its_points_where_they_belong(seed):
    rng = np.random.default_rng(seed)
    source = LM8.corners_mm
    target = source * 0.3 + rng.uniform(-12, 12, (4, 2)) + 200
    assert np.allclose(transform_points(homography_from_points(source, target), source), target, atol=1e-6)


@pytest.mark.parametrize(
    ("size_m", "pose", "words"),
    [
        (180, wall_pose([1, 2, 3], 0.0), "0.18 for 180 mm"),
        ("180mm", wall_pose([1, 2, 3], 0.0), "meters"),
        (0.18, np.eye(4), "Pose.from_matrix"),
    ],
)
def test_a_mapped_landmark_says_what_its_arguments_must_be(size_m, pose, words):
    with pytest.raises((TypeError, ValueError), match=words):
        MappedLandmark(lm8(1), size_m, pose)


def test_a_map_that_no_one_could_read_is_not_written(tmp_path):
    pose = Pose.identity("map", "landmark")
    landmarks = LandmarkMap([MappedLandmark(LandmarkId("lm99", 1), 0.18, pose)])
    with pytest.raises(InputError, match="lm99"):
        lmkit.write_map(landmarks, tmp_path / "map.yaml")
    assert not list(tmp_path.iterdir())
