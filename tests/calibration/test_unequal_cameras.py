"""A stereo pair of unequal cameras, 1280 x 720 beside 640 x 480: calibrated, rectified, and used to locate."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from board_views import BOARD, views

from lmkit.calibration.sanity_checks import Declared
from lmkit.calibration.stereo import calibrate_stereo
from lmkit.calibration.uncertainty import projection_uncertainty
from lmkit.errors import InputError
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.pose import Pose
from lmkit.geometry.rectification import epipolar_errors, rectified_rig, rectify_pair
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.io.board_corners import SavedCorners, corners_to_json, read_corners
from lmkit.io.landmark_map import map_to_yaml
from lmkit.io.rig import read_rig, rig_to_yaml
from lmkit.model.landmark import LM8
from lmkit.reports.calibration import calibration_report
from lmkit.simulation.photograph import ImagingChain, photograph
from lmkit.simulation.scene import board_panel, board_poses, drive, make_rig, make_room, studio

HD = make_rig((1280, 720), 900.0)
VGA = make_rig()
WIDE = CameraModel(
    (640, 480),
    np.array([[240.0, 0, 322], [0, 239.0, 241.0], [0, 0, 1]]),
    np.array([0.02, -0.015, 0.008, -0.002]),
    "fisheye",
)


def unequal(right: CameraModel = VGA.right) -> StereoRig:
    return StereoRig(HD.left, right, HD.T_right_left)


def swapped(rig: StereoRig) -> StereoRig:
    T = rig.T_right_left.inverse()
    return StereoRig(rig.right, rig.left, Pose("right", "left", T.R, T.t))


@pytest.fixture(scope="module")
def calibrated():
    seen = views(12, 0.1, 1, unequal())
    return calibrate_stereo(seen, BOARD, (1280, 720), "pinhole", right_size=(640, 480))


def test_each_camera_keeps_its_own_size_and_the_pair_is_found(calibrated, tmp_path):
    truth = unequal()
    (tmp_path / "rig.yaml").write_text(rig_to_yaml(calibrated.rig))
    rig = read_rig(tmp_path / "rig.yaml")
    assert (rig.left.image_size, rig.right.image_size) == ((1280, 720), (640, 480))
    assert abs(rig.baseline_m - truth.baseline_m) < 4 * calibrated.baseline_sigma_m < 0.001
    assert calibrated.held_out_epipolar_px < 0.15
    # The board fills a part of one image and all of the other: cells are counted in each camera's own pixels.
    assert min(calibrated.coverage.filled(side) for side in (0, 1)) > 0.5
    assert calibrated.to_dict()["model_right"] == "pinhole"
    assert [error.total_m < 0.03 * error.depth_m for error in calibrated.depth_errors[:3]] == [True] * 3


def test_the_report_shows_each_camera_in_its_own_pixels(calibrated):
    rng = np.random.default_rng(0)
    pair = tuple(rng.integers(0, 255, (h, w, 3), dtype=np.uint8) for w, h in ((1280, 720), (640, 480)))
    images = {calibrated.used[0].name: pair}
    html = calibration_report(calibrated, BOARD, images)
    assert "1280 x 720" in html
    assert "640 x 480" in html
    assert "viewBox='0 0 1280 720'" in html
    assert "viewBox='0 0 640 480'" in html


def test_unequal_lenses_are_chosen_by_each_cameras_own_images():
    seen = views(10, 0.05, 2, unequal(WIDE))
    result = calibrate_stereo(seen, BOARD, (1280, 720), "pinhole,auto", right_size=(640, 480))
    assert (result.rig.left.model, result.rig.right.model) == ("pinhole", "fisheye")
    assert result.to_dict()["models"].keys() == {"pinhole,fisheye"}
    assert abs(result.rig.baseline_m - HD.baseline_m) < 4 * result.baseline_sigma_m
    assert result.held_out_epipolar_px < 0.1
    assert result.depth_errors[0].total_m < 0.01
    assert "pinhole,fisheye" in calibration_report(result, BOARD, {})
    for camera, sigmas in zip((result.rig.left, result.rig.right), result.rig.intrinsics_sigma, strict=True):
        assert np.nanmax(projection_uncertainty(camera, np.diag(sigmas**2), None)) > 0


@pytest.mark.parametrize("rig", [unequal(), swapped(unequal()), unequal(WIDE), swapped(unequal(WIDE))])
def test_rows_of_rectified_images_match(rig):
    points = np.random.default_rng(1).uniform([-0.4, -0.3, 1.2], [0.4, 0.3, 2.5], (60, 3))
    in_right = points @ rig.T_right_left.R.T + rig.T_right_left.t
    assert np.abs(epipolar_errors(rig, rig.left.project(points), rig.right.project(in_right))).max() < 1e-6
    flat = rectified_rig(rig)
    assert flat.left.image_size == flat.right.image_size == (640, 480)
    images = [np.zeros((h, w, 3), dtype=np.uint8) for w, h in (rig.left.image_size, rig.right.image_size)]
    assert {image.shape for image in rectify_pair(rig, *images)} == {(480, 640, 3)}
    # Most of the coarser camera's field of view is in its rectified image.
    coarse = min((rig.left, flat.left), (rig.right, flat.right), key=lambda pair: pair[0].K[1, 1])
    rays = np.column_stack([coarse[0].unproject(np.array([[319.5, 239.5]])), [1.0]])
    assert np.abs(coarse[1].project(rays) - [319.5, 239.5]).max() < 60


def test_saved_corners_keep_both_sizes(tmp_path):
    saved = SavedCorners(BOARD, (1280, 720), tuple(views(4, 0.1, 1, unequal())), (), (640, 480))
    (tmp_path / "c.json").write_text(corners_to_json(saved))
    assert read_corners(tmp_path / "c.json").right_size == (640, 480)


def test_known_lenses_of_another_size_are_refused_for_the_camera_that_has_them():
    known = Declared(cameras=(HD.left, HD.right))
    with pytest.raises(
        InputError, match="right camera of --intrinsics has images of 1280 x 720, these are 640 x 480"
    ):
        calibrate_stereo(views(6, 0.1, 1, unequal()), BOARD, (1280, 720), declared=known, right_size=(640, 480))


@pytest.mark.slow
def test_images_of_unequal_cameras_calibrate_and_locate(lmkit, tmp_path):
    rig, rng = unequal(), np.random.default_rng(5)
    for k, pose in enumerate(board_poses(3, rig, BOARD, 7)):
        board = board_panel(BOARD, Pose("map", "board", pose.R, pose.t))
        save_pair(tmp_path / "boards", k, studio([board]), rig, Pose.identity("map", "camera"), rng)
    images = tmp_path / "boards"
    written = ("-o", "rig.yaml", "--report", "r.html", "--json")
    answer = lmkit("calibrate", images / "left", images / "right", "--board", str(BOARD), *written)
    assert answer.code == 0, answer.err
    row = json.loads(answer.out)
    assert row["held_out_epipolar_px"] < 0.15
    assert abs(row["baseline_m"] - rig.baseline_m) < 4 * row["baseline_sigma_m"]
    room = make_room(4, LM8)
    (tmp_path / "map.yaml").write_text(map_to_yaml(room.landmarks))
    T = drive(4, room, 1)[0]
    save_pair(tmp_path / "room", 0, room, rig, T, rng)
    pair = (tmp_path / "room/left/00.png", tmp_path / "room/right/00.png")
    answer = lmkit("locate", *pair, "--rig", "rig.yaml", "--map", "map.yaml", "--json")
    located = json.loads(answer.out)
    assert located["status"] == "ok"
    assert np.linalg.norm(np.array(located["position"]) - T.t) < 0.02
    answer = lmkit("rectify", "room/left", "room/right", "--rig", "rig.yaml", "-o", "flat")
    assert answer.code == 0, answer.err


def save_pair(folder, k, scene, rig, T_map_left, rng):
    for side, camera, T in (("left", rig.left, T_map_left), ("right", rig.right, rig.T_map_right(T_map_left))):
        (folder / side).mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(folder / side / f"{k:02d}.png"), photograph(scene, camera, T, ImagingChain(), rng))
