"""`lmkit calibrate`, `rectify` and `convert` as a user runs them."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from board_views import BOARD, views
from shared_folders import written_once

from lmkit.cli.calibrate_pairs import written_lines
from lmkit.errors import InputWarning
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.pose import Pose
from lmkit.geometry.rotations import rotation_exp
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.io.board_corners import SavedCorners, corners_to_json
from lmkit.io.rig import read_rig, rig_to_yaml
from lmkit.simulation.scene import make_rig

SPEC = "chessboard:9x6:30mm"


@pytest.fixture
def corners(tmp_path) -> Path:
    path = tmp_path / "corners.json"
    path.write_text(corners_to_json(SavedCorners(BOARD, (640, 480), tuple(views(12, 0.1)), ())))
    return path


@pytest.fixture
def pairs(data, tmp_path) -> tuple[Path, Path]:
    """Six rendered pairs in two folders."""
    folders = tmp_path / "left", tmp_path / "right"
    for folder, side in zip(folders, "LR", strict=True):
        folder.mkdir()
        for k in (2, 3, 4, 5, 7, 8):
            shutil.copy(data / f"boards/chessboard/images/p{k:02d}_{side}.jpg", folder / f"{k:02d}.jpg")
    return folders


def standing(*folders: Path, scale: float = 1.0, stays: int = 3) -> Path:
    """A video in which every image stands still for some frames; of several folders, side by side."""
    film = folders[0].parent / ("".join(folder.name for folder in folders) + ".avi")
    size = round(640 * scale) * len(folders), round(480 * scale)
    writer = cv2.VideoWriter(str(film), cv2.VideoWriter.fourcc(*"MJPG"), 10, size)
    for files in zip(*(sorted(folder.iterdir()) for folder in folders), strict=True):
        image = cv2.resize(np.hstack([cv2.imread(str(file)) for file in files]), size, interpolation=cv2.INTER_AREA)
        for _ in range(stays):
            writer.write(image)
    writer.release()
    return film


def test_corners_saved_before_calibrate_without_images(lmkit, corners, tmp_path):
    answer = lmkit("calibrate", "--corners", corners, "-o", "rig.yaml", "--report", "r.html", "--json")
    assert answer.code == 0
    row = json.loads(answer.out)
    assert row["held_out_epipolar_px"] < 0.2
    assert row["model"] == "pinhole"
    assert [e["depth_m"] for e in row["depth_errors"]] == [1, 2, 4, 8]
    assert all(0 < e["calibration_m"] < e["total_m"] for e in row["depth_errors"])
    assert read_rig(tmp_path / "rig.yaml").baseline_m == pytest.approx(row["baseline_m"])
    assert (tmp_path / "r.html").read_text().startswith("<!doctype html>")


def test_a_rig_that_is_not_written_is_named():
    assert written_lines([Path("rig.yaml")], Path("rig.yaml")) == ["wrote                  rig.yaml"]
    assert "-o rig.yaml" in written_lines([Path("r.html")], None)[-1]


@pytest.mark.slow
def test_a_wrong_square_is_noticed_by_the_declared_baseline(lmkit, corners):
    right = lmkit("calibrate", "--corners", corners, "--json", "--baseline", "120mm")
    wrong = lmkit("calibrate", "--corners", corners, "--json", "--baseline", "100mm", "--fov", "30")
    assert "scale" not in [w["code"] for w in json.loads(right.out)["warnings"]]
    assert {"scale", "field_of_view"} <= {w["code"] for w in json.loads(wrong.out)["warnings"]}


@pytest.fixture
def calibrated(lmkit, pairs, tmp_path_factory) -> Path:
    """Folder with what `calibrate` made of the pairs: rig.yaml, c.json with their corners, and answer.json."""

    def calibrate(folder: Path) -> None:
        written = ("-o", folder / "rig.yaml", "--save-corners", folder / "c.json")
        answer = lmkit("calibrate", *pairs, "--board", SPEC, *written, "--json")
        assert answer.code == 0, answer.err
        (folder / "answer.json").write_text(answer.out)

    return written_once(tmp_path_factory, "calibrated_pairs", calibrate)


@pytest.mark.slow
def test_images_calibrate_are_saved_and_repeat(lmkit, pairs, calibrated):
    """Corners saved give the same rig again; a print measured 1 % larger gives a baseline 1 % longer."""
    left, right = pairs
    again = lmkit("calibrate", "--corners", calibrated / "c.json", "--json")
    one, other = json.loads((calibrated / "answer.json").read_text()), json.loads(again.out)
    assert one["pairs_used"] == other["pairs_used"]
    assert one["baseline_m"] == pytest.approx(other["baseline_m"], abs=1e-6)
    larger = lmkit("calibrate", left, right, "--board", SPEC, "--measured", "303x212.1mm", "--json")
    assert json.loads(larger.out)["baseline_m"] / one["baseline_m"] == pytest.approx(1.01, abs=1e-4)


@pytest.mark.slow
def test_check_says_true_of_its_own_rig_and_moved_of_another(lmkit, pairs, calibrated, tmp_path):
    left, right = pairs
    good = lmkit("calibrate", "--check", calibrated / "rig.yaml", left, right, "--board", SPEC)
    assert good.code == 0, good.err
    assert "still valid" in good.out
    (tmp_path / "other.yaml").write_text(rig_to_yaml(make_rig()))
    bad = lmkit("calibrate", "--check", "other.yaml", left, right, "--board", SPEC, "--json")
    assert bad.code == 1
    assert json.loads(bad.out)["state"] in ("moved", "lenses")
    assert "no longer valid" in bad.err


def test_check_of_videos_asks_for_a_board(lmkit, tmp_path):
    (tmp_path / "rig.yaml").write_text(rig_to_yaml(make_rig()))
    answer = lmkit("calibrate", "--check", "rig.yaml", "left.mp4", "right.mp4")
    assert answer.code == 2
    assert "--check of videos and side-by-side images needs a board" in answer.err


@pytest.mark.slow
def test_check_of_videos_says_true_of_their_own_rig_and_moved_of_another(lmkit, data, pairs, tmp_path):
    """Two videos agree with the true rig; the same images side by side do not agree with a right camera turned."""
    rendered = json.loads((data / "boards/chessboard/truth.json").read_text())["rig"]
    halved = np.array([[0.5, 0, -0.25], [0, 0.5, -0.25], [0, 0, 1.0]])  # pixel centers at integers
    left, right = (
        CameraModel((320, 240), halved @ rendered[side]["K"], np.array([*rendered[side]["dist"], 0.0]))
        for side in ("left", "right")
    )
    truth = StereoRig(left, right, Pose("right", "left", np.array(rendered["R"]), np.array(rendered["t"])))
    turned = Pose("right", "left", rotation_exp(np.array([0, 0.01, 0])) @ truth.T_right_left.R, truth.T_right_left.t)
    (tmp_path / "true.yaml").write_text(rig_to_yaml(truth))
    (tmp_path / "turned.yaml").write_text(rig_to_yaml(replace(truth, T_right_left=turned)))
    films = [standing(folder, scale=0.5, stays=2) for folder in pairs]
    both = f"split:{standing(*pairs, scale=0.5, stays=2)}"
    good = lmkit("calibrate", "--check", "true.yaml", *films, "--board", SPEC)
    assert good.code == 0, good.err
    assert "still valid" in good.out
    bad = lmkit("calibrate", "--check", "turned.yaml", both, "--board", SPEC, "--json")
    assert bad.code == 1
    row = json.loads(bad.out)
    assert row["state"] == "moved"
    assert row["turn_deg"][1] == pytest.approx(-np.rad2deg(0.01), abs=0.05)


@pytest.mark.slow
def test_capture_keeps_new_sharp_still_views_of_films(lmkit, pairs, tmp_path):
    """Every image stands still for three frames of the video, then the next one is there at once."""
    films = [standing(folder, scale=0.5) for folder in pairs]
    answer = lmkit("calibrate", *films, "--capture", "--board", SPEC, "--save-pairs", "kept", "-o", "rig.yaml")
    assert answer.code == 0, answer.err
    kept = sorted(p.name for p in (tmp_path / "kept" / "left").iterdir())
    assert 4 <= len(kept) <= 6
    assert kept == sorted(p.name for p in (tmp_path / "kept" / "right").iterdir())
    assert answer.out.startswith("kept 001 (1); next: ")
    assert "missing: " in answer.out
    assert read_rig(tmp_path / "rig.yaml").baseline_m == pytest.approx(0.12, abs=0.001)


@pytest.mark.slow
def test_capture_reads_both_cameras_side_by_side(lmkit, pairs, tmp_path):
    (tmp_path / "both").mkdir()
    for a, b in zip(*(sorted(folder.iterdir()) for folder in pairs), strict=True):
        both = np.hstack([cv2.imread(str(a)), cv2.imread(str(b))])
        cv2.imwrite(str(tmp_path / "both" / a.name), cv2.resize(both, (640, 240), interpolation=cv2.INTER_AREA))
    answer = lmkit("calibrate", "both", "--side-by-side", "--capture", "--board", SPEC, "--json")
    assert answer.code == 0, answer.err
    assert len(json.loads(answer.out)["pairs_used"]) >= 4


@pytest.mark.slow
@pytest.mark.parametrize("spec", ["chessboard:8x6:30mm", "chessboard:10x7:30mm"])
def test_capture_notices_another_board(lmkit, pairs, spec):
    """A smaller board is found inside the true one without a warning, a larger one never."""
    for folder in pairs:  # three pairs decide
        for k, file in enumerate(sorted(folder.iterdir())):
            image = cv2.resize(cv2.imread(str(file)), (320, 240), interpolation=cv2.INTER_AREA)
            cv2.imwrite(str(file), image) if k < 3 else file.unlink()
    answer = lmkit("calibrate", *pairs, "--capture", "--board", spec)
    assert answer.code == 2
    assert "chessboard:9x6:30mm" in answer.err


def test_convert_and_rectify(lmkit, pairs, tmp_path):
    left, right = pairs
    (tmp_path / "rig.yaml").write_text(rig_to_yaml(make_rig()))
    for kind, name in (("opencv", "cv.yml"), ("ros", "ros"), ("kalibr", "chain.yaml")):
        assert lmkit("convert", "rig.yaml", "--to", kind, "-o", name).code == 0
        assert lmkit("convert", name, "--to", "lmkit", "-o", f"{kind}.back.yaml").code == 0
        back = read_rig(tmp_path / f"{kind}.back.yaml")
        assert back.baseline_m == pytest.approx(make_rig().baseline_m, abs=1e-9)
    files = [tmp_path / "ros" / name for name in ("left.yaml", "right.yaml")]
    assert lmkit("convert", *files, "--to", "lmkit", "-o", "two.yaml").code == 0
    assert (tmp_path / "two.yaml").read_text() == (tmp_path / "ros.back.yaml").read_text()
    with pytest.warns(InputWarning, match="to the left of the left one"):
        lmkit("convert", *files[::-1], "--to", "lmkit", "-o", "swapped.yaml")
    answer = lmkit("rectify", left, right, "--rig", "ros", "-o", "flat")
    assert answer.code == 0, answer.err
    assert len(list((tmp_path / "flat").glob("*.png"))) == 12
    assert lmkit("rectify", left, right, "--rig", "cv.yml", "-o", "lines", "--lines").code == 0
    shown = cv2.imread(str(tmp_path / "lines" / "02_lines.png"))
    assert shown.shape == (480, 1280, 3)


@pytest.mark.slow
def test_rectified_rows_match(lmkit, pairs, calibrated, tmp_path):
    from lmkit.detection.boards import detect_board
    from lmkit.model.board import BoardSpec

    left, right = pairs
    rig = calibrated / "rig.yaml"
    assert lmkit("rectify", left / "03.jpg", right / "03.jpg", "--rig", rig, "-o", "flat").code == 0
    board = BoardSpec.parse(SPEC)
    seen = [detect_board(cv2.imread(str(tmp_path / "flat" / f"03_{side}.png")), board) for side in ("left", "right")]
    rows = seen[0].image_points[:, 1] - seen[1].image_points[:, 1]
    assert np.abs(rows).mean() < 0.15


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["l", "r"], "--board"),
        (["--board", SPEC], "images of a board"),
        (["l", "r", "--board", SPEC, "--measured", "10mm"], "WIDTHxHEIGHT"),
        (["l", "r", "--board", SPEC, "--measured", "400x300mm"], "the pattern of"),
        (["l", "r", "--board", SPEC, "--fov", "0"], "--fov 0"),
        (["l", "r", "--board", SPEC, "--baseline", "12"], "--baseline"),
        (["l", "r", "--board", SPEC, "--save-pairs", "x"], "--capture"),
        (["l", "r", "--corners", "c.json"], "--corners and images"),
        (["l", "r", "--check", "rig.yaml", "--measured", "1x1mm"], "--board"),
        (["l", "r", "--check", "rig.yaml", "-o", "x.yaml"], "--check and -o"),
        (["l", "--capture", "--board", SPEC], "--side-by-side"),
        (["camera:x", "camera:1", "--capture", "--board", SPEC], "no camera number"),
        (["camera:0", "film.avi", "--capture", "--board", SPEC], "different kinds"),
        (["--corners", "missing.json"], "missing.json"),
    ],
)
def test_wrong_use_is_explained_in_one_line(lmkit, arguments, words):
    answer = lmkit("calibrate", *arguments)
    assert answer.code == 2, answer
    assert words in answer.err
    assert len(answer.err.strip().splitlines()) == 1


def write_film(path, images):
    height, width = images[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10, (width, height))
    for image in images:
        writer.write(image)
    writer.release()


def test_rectify_reads_films_as_it_reads_images(lmkit, tmp_path):
    """Two films, and one with both images side by side, give the frames that the images give."""
    (tmp_path / "rig.yaml").write_text(rig_to_yaml(make_rig()))
    rows, columns = np.mgrid[:480, :640]
    images = [
        np.repeat((columns // 4 + shift + rows // 8).astype(np.uint8)[:, :, None], 3, axis=2) for shift in (0, 9)
    ]
    for side, image in zip(("left", "right"), images, strict=True):
        cv2.imwrite(str(tmp_path / f"{side}.png"), image)
        write_film(tmp_path / f"{side}.avi", [image] * 2)
    write_film(tmp_path / "both.avi", [np.hstack(images)] * 2)
    for sources in (["left.png", "right.png"], ["left.avi", "right.avi"], ["split:both.avi"]):
        answer = lmkit("rectify", *sources, "--rig", "rig.yaml", "-o", f"of {sources[0]}")
        assert answer.code == 0, answer.err
    expected = cv2.imread(str(tmp_path / "of left.png" / "left_left.png")).astype(int)
    for folder, name in (("of left.avi", "left_000001_left.png"), ("of split:both.avi", "both_000001_left.png")):
        off = np.abs(cv2.imread(str(tmp_path / folder / name)).astype(int) - expected)
        assert np.median(off) <= 2, name
    again = lmkit("rectify", "left.avi", "right.avi", "--rig", "rig.yaml", "-o", "of left.avi")
    assert (again.code, "--force" in again.err) == (2, True)
    alone = lmkit("rectify", "left.avi", "--rig", "rig.yaml", "-o", "alone")
    assert (alone.code, "1 source of images for a rig of 2" in alone.err) == (2, True)


@pytest.mark.slow
def test_one_camera_is_calibrated_from_a_folder_and_from_a_video(lmkit, pairs, tmp_path):
    left, _ = pairs
    options = ["--board", SPEC, "--model", "pinhole"]
    answer = lmkit("calibrate", left, *options, "-o", "rig.yaml", "--report", "r.html", "--json")
    assert answer.code == 0
    assert "Calibration of one camera" in (tmp_path / "r.html").read_text()
    row = json.loads(answer.out)
    assert len(row["images_used"]) == 6
    rig = read_rig(tmp_path / "rig.yaml")
    assert len(rig.cameras) == 1
    video = standing(left, scale=0.5, stays=2)
    answer = lmkit("calibrate", video, "--board", SPEC, "--model", "pinhole", "--json")
    assert answer.code == 0
    assert 4 <= len(json.loads(answer.out)["images_used"]) <= 6
    assert lmkit("calibrate", left, "--board", SPEC, "--baseline", "120mm").code == 2
