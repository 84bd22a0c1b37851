"""Calibrations as scripts around OpenCV and drivers of ROS write them, and those that are something else."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace

import cv2
import numpy as np
import pytest
import yaml

from lmkit.errors import InputError, InputWarning
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import Rig
from lmkit.geometry.rig_plausibility import rig_warnings
from lmkit.io.any_rig import read_any_rig
from lmkit.io.ros_camera_info import rig_to_camera_info
from lmkit.simulation.scene import make_rig

RIG = make_rig()
FISHEYE = [-0.012, 0.021, -0.034, 0.017]  # k1 k2 k3 k4


def file(folder, content: str | bytes):
    path = folder / "rig"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def as_json(names: str, **more) -> str:
    """JSON of the rig with the names of K D K D R T, as scripts write it with ``tolist``."""
    cameras = RIG.left, RIG.right
    values = [v for camera in cameras for v in (camera.K, camera.distortion)]
    values += [RIG.T_right_left.R, RIG.T_right_left.t]
    lists = [np.asarray(value).tolist() for value in values]
    return json.dumps(dict(zip(names.split(), lists, strict=True)) | (more or {"image_size": [640, 480]}))


@pytest.mark.parametrize(
    "names",
    [
        "mtxL distL mtxR distR R T",
        "left_camera_matrix left_distortion right_camera_matrix right_distortion rotation translation",
        "K_left D_left K_right D_right Rot Trns",
        "camera_matrix_1 dist_coeffs_1 camera_matrix_2 dist_coeffs_2 R T",
        "K0 D0 K1 D1 R T",
        "CM1 D1 CM2 D2 R T",
    ],
)
def test_names_that_scripts_give_to_matrices(tmp_path, names):
    found = read_any_rig(file(tmp_path, as_json(names)))
    for camera, truth in ((found.left, RIG.left), (found.right, RIG.right)):
        assert np.array_equal(camera.K, truth.K)
        assert np.array_equal(camera.distortion, truth.distortion)
    assert np.allclose(found.T_right_left.t, RIG.T_right_left.t)
    assert np.allclose(found.T_right_left.R, RIG.T_right_left.R)


def test_two_names_of_one_matrix_must_agree(tmp_path):
    text = json.loads(as_json("K1 D1 K2 D2 R T"))
    assert read_any_rig(file(tmp_path, json.dumps(text | {"cameraMatrix1": text["K1"]}))).baseline_m > 0
    with pytest.raises(InputError, match="K1 and cameraMatrix1 are both M1"):
        read_any_rig(file(tmp_path, json.dumps(text | {"cameraMatrix1": text["K2"]})))


def test_coefficients_k1_and_k2_are_no_matrices(tmp_path):
    nerf = {"camera_model": "OPENCV", "fl_x": 460, "fl_y": 460, "w": 640, "h": 480, "k1": -0.2, "k2": 0.05}
    with pytest.raises(InputError, match="not a rig that is known"):
        read_any_rig(file(tmp_path, json.dumps(nerf)))


def of_one(distortion, *, one_dimension: bool = False, model: str = "") -> str:
    storage = cv2.FileStorage(".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.write("camera_matrix", np.array(RIG.left.K))
    flat = np.array(distortion, dtype=np.float64)
    storage.write("distortion_coefficients", flat if one_dimension else flat.reshape(-1, 1))
    if model:
        storage.write("model", model)
    return str(storage.releaseAndGetString())


def test_arrays_of_one_dimension_as_opencv_5_writes_them(tmp_path):
    distortion = [-0.21, 0.055, 0.0007, -0.0004, 0.01]
    text = of_one(distortion, one_dimension=True)
    assert np.array_equal(read_any_rig(file(tmp_path, text)).cameras[0].model.distortion, distortion)


def test_a_wrong_number_of_coefficients_is_said(tmp_path):
    with pytest.raises(InputError, match="6 distortion coefficients, expected 0, 4, 5, 8, 12 or 14"):
        read_any_rig(file(tmp_path, of_one([0.1] * 6)))


def test_four_coefficients_without_a_model_are_not_taken_in_silence(tmp_path):
    with pytest.warns(InputWarning, match="where cv2.fisheye gave them"):
        read_any_rig(file(tmp_path, of_one([-0.01, 0.002, -0.001, 0.0005])))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read_any_rig(file(tmp_path, of_one(FISHEYE, model="fisheye"))).cameras[0].model.model == "fisheye"
        read_any_rig(file(tmp_path, of_one([0.0] * 4)))


def camera_info(distortion, model: str, **changes) -> str:
    info = yaml.safe_load(rig_to_camera_info(Rig.of_one(CameraModel((640, 480), RIG.left.K, np.zeros(5)))))
    info["distortion_model"] = model
    info["distortion_coefficients"] = {"rows": 1, "cols": len(distortion), "data": list(distortion)}
    info = {key: value for key, value in (info | changes).items() if value is not None}
    return yaml.safe_dump(info)


@pytest.mark.parametrize(
    ("distortion", "stated", "model", "count"),
    [
        ([], "", "pinhole", 0),
        ([0.0] * 5, "none", "pinhole", 0),
        ([0.1] * 8, "plumb_bob", "rational", 8),
        ([-0.2, 0.05, 0.0, 0.0, 0.01], "rational_polynomial", "pinhole", 5),
    ],
)
def test_distortions_as_drivers_of_ros_state_them(tmp_path, distortion, stated, model, count):
    camera = read_any_rig(file(tmp_path, camera_info(distortion, stated))).cameras[0].model
    assert camera.model == model
    assert len(camera.distortion) == count


def test_a_distortion_without_a_model_is_refused(tmp_path):
    with pytest.raises(InputError, match="distortion_model 'none'"):
        read_any_rig(file(tmp_path, camera_info([-0.2, 0.05, 0.0, 0.0, 0.0], "none")))


def test_a_camera_that_was_not_calibrated_is_named(tmp_path):
    zero = {"rows": 3, "cols": 3, "data": [0.0] * 9}
    with pytest.raises(InputError, match="the camera is not calibrated"):
        read_any_rig(file(tmp_path, camera_info([], "plumb_bob", camera_matrix=zero)))


def test_one_camera_of_rtabmap(tmp_path):
    """Its files begin with the line of cv2.FileStorage, and those of one camera have no rectification."""
    info = camera_info([-0.2, 0.05, 0, 0, 0], "plumb_bob", rectification_matrix=None, projection_matrix=None)
    found = read_any_rig(file(tmp_path, "%YAML:1.0\n---\n" + info))
    assert np.allclose(found.cameras[0].model.K, RIG.left.K)


def test_a_fisheye_read_as_a_pinhole_camera_is_doubted():
    honest = CameraModel((752, 480), [[458, 0, 367], [0, 457, 248], [0, 0, 1]], [-0.283, 0.074, 0.0002, 0.00002])
    doubtful = replace(honest, distortion=np.array(FISHEYE))
    assert not rig_warnings(Rig.of_one(honest), "rig")
    assert not rig_warnings(Rig.of_one(replace(doubtful, model="fisheye")), "rig")
    assert "fisheye lens" in rig_warnings(Rig.of_one(doubtful), "rig")[0]


def test_swapped_width_and_height_are_doubted():
    upright = replace(RIG.left, image_size=(480, 640))
    assert "are width and height swapped" in rig_warnings(Rig.of_one(upright), "rig")[0]
    assert not rig_warnings(Rig.of_one(RIG.left), "rig")
    shifted = replace(RIG.left, K=RIG.left.K + np.array([[0, 0, 40.0], [0, 0, 30.0], [0, 0, 0]]))
    assert not rig_warnings(Rig.of_one(shifted), "rig")


def test_a_baseline_in_centimeters_is_doubted():
    wide = replace(RIG, T_right_left=Pose("right", "left", np.eye(3), np.array([-6.0, 0.0, 0.0])))
    assert "centimeters or inches" in rig_warnings(wide, "rig")[0]


@pytest.mark.parametrize(
    ("content", "remedy"),
    [
        (b"PK\x03\x04\xff\xfe", "tolist"),
        (b"\x80\x04\x95\xff", "pickle"),
        (b"MATLAB 5.0 MAT-file\xff", "write its variables"),
        (b"SQLite format 3\0", "exported"),
        ("name: Küche\n".encode("latin-1"), "save it as UTF-8"),
    ],
)
def test_what_to_do_with_other_files_is_said(tmp_path, content, remedy):
    with pytest.raises(InputError) as refused:
        read_any_rig(file(tmp_path, content))
    assert remedy in refused.value.hint
