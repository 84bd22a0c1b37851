"""Rigs as users of ROS, OpenCV, Kalibr and OpenVINS have them, and impossible rigs."""

from __future__ import annotations

import warnings
from dataclasses import replace

import cv2
import numpy as np
import pytest
import yaml

from lmkit.errors import InputError, InputWarning
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig_plausibility import rig_warnings
from lmkit.io.any_rig import read_any_rig
from lmkit.io.kalibr import rig_to_camchain
from lmkit.io.opencv_rig import rig_to_opencv_yaml
from lmkit.io.rig import rig_to_yaml
from lmkit.io.ros_camera_info import FILES, rig_to_camera_infos
from lmkit.simulation.scene import make_rig

RIG = make_rig()


def file(folder, text: str):
    path = folder / "rig"
    path.write_text(text)
    return path


def camera_infos(folder, change):
    """Folder of camera_info files, each changed as a dict."""
    for name, text in zip(FILES, rig_to_camera_infos(RIG), strict=True):
        (folder / name).write_text(change(yaml.safe_load(text)))
    return folder


def as_message(info: dict) -> str:
    keys = {
        "K": "camera_matrix",
        "D": "distortion_coefficients",
        "R": "rectification_matrix",
        "P": "projection_matrix",
    }
    lines = [f"height: {info['image_height']}", f"width: {info['image_width']}", "distortion_model: plumb_bob"]
    lines += [f"{key}: {info[name]['data']}" for key, name in keys.items()]
    return "header:\n  frame_id: cam\n" + "\n".join(lines) + "\n---\n"


def as_camera_model(info: dict) -> str:
    info["camera_model"] = info.pop("distortion_model")
    return yaml.safe_dump(info)


def assert_is_the_rig(found, atol=1e-6):
    assert np.allclose(found.T_right_left.R, RIG.T_right_left.R, atol=atol)
    assert np.allclose(found.T_right_left.t, RIG.T_right_left.t, atol=atol)
    assert np.allclose(found.left.K, RIG.left.K)
    assert found.right.image_size == RIG.right.image_size


@pytest.mark.parametrize("change", [as_message, as_camera_model, lambda info: "\ufeff" + yaml.safe_dump(info)])
def test_camera_info_as_ros_tools_write_it(tmp_path, change):
    assert_is_the_rig(read_any_rig(camera_infos(tmp_path, change)))


@pytest.mark.parametrize("diagonal", [(0.0, 0.0, 0.0), (2.0, 1.0, 1.0), (-1.0, 1.0, 1.0)])
def test_a_camera_info_without_stereo_calibration_is_refused(tmp_path, diagonal):
    def spoiled(info: dict) -> str:
        info["rectification_matrix"]["data"] = np.diag(diagonal).ravel().tolist()
        return yaml.safe_dump(info)

    with pytest.raises(InputError, match="not a rotation"):
        read_any_rig(camera_infos(tmp_path, spoiled))


def test_a_camera_info_with_a_baseline_beyond_all_measure_is_refused(tmp_path):
    def spoiled(info: dict) -> str:
        info["projection_matrix"]["data"][3] = 1e308
        return yaml.safe_dump(info)

    with pytest.raises(InputError, match="no baseline in meters"):
        read_any_rig(camera_infos(tmp_path, spoiled))


@pytest.mark.parametrize("suffix", [".xml", ".json"])
def test_file_storage_in_xml_and_json(tmp_path, suffix):
    storage = cv2.FileStorage(suffix, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    for name, camera in (("1", RIG.left), ("2", RIG.right)):
        storage.write(f"M{name}", np.array(camera.K))
        storage.write(f"D{name}", np.array(camera.distortion).reshape(1, -1))
    storage.write("R", np.array(RIG.T_right_left.R))
    storage.write("T", np.array(RIG.T_right_left.t).reshape(3, 1))
    storage.write("image_width", RIG.left.image_size[0])
    storage.write("image_height", RIG.left.image_size[1])
    text = str(storage.releaseAndGetString())
    assert_is_the_rig(read_any_rig(file(tmp_path, text)))
    if suffix != ".xml":
        return
    with pytest.raises(InputError, match="declarations"):
        read_any_rig(
            file(tmp_path, text.replace("<opencv_storage>", '<!DOCTYPE a [<!ENTITY b "b">]><opencv_storage>'))
        )


def test_opencv_matrices_by_other_names_and_a_byte_order_mark(tmp_path):
    text = rig_to_opencv_yaml(RIG)
    for old, new in (
        ("M1:", "cameraMatrixL:"),
        ("M2:", "cameraMatrixR:"),
        ("D1:", "distCoeffsL:"),
        ("D2:", "distCoeffsR:"),
    ):
        text = text.replace(old, new)
    assert_is_the_rig(read_any_rig(file(tmp_path, "\ufeff" + text)))


@pytest.mark.parametrize("inverse", [False, True])
def test_cameras_related_through_an_imu(tmp_path, inverse):
    """Kalibr's T_cam_imu of both cameras, and the inverse that OpenVINS writes."""
    chain = yaml.safe_load(rig_to_camchain(RIG)[0])
    T_left_imu, T_right_left = np.eye(4), np.array(chain["cam1"].pop("T_cn_cnm1"))
    T_left_imu[:3, :3] = Pose.from_rvec("left", "imu", np.array([0.4, -1.0, 0.3]), np.zeros(3)).R
    T_left_imu[:3, 3] = [0.02, -0.01, 0.05]
    for name, T in (("cam0", T_left_imu), ("cam1", T_right_left @ T_left_imu)):
        chain[name]["T_imu_cam" if inverse else "T_cam_imu"] = (np.linalg.inv(T) if inverse else T).tolist()
    text = yaml.safe_dump(chain)
    assert_is_the_rig(read_any_rig(file(tmp_path, "%YAML:1.0\n\n" + text if inverse else text)))


def test_another_camera_model_is_named(tmp_path):
    text = rig_to_camchain(RIG)[0].replace("camera_model: pinhole", "camera_model: omni")
    with pytest.raises(InputError, match="'omni' is not supported"):
        read_any_rig(file(tmp_path, text))


def ros_files(folder, rig):
    for name, text in zip(FILES, rig_to_camera_infos(rig), strict=True):
        (folder / name).write_text(text)
    return folder


@pytest.mark.parametrize(
    "write",
    [
        lambda folder, rig: file(folder, rig_to_yaml(rig)),
        lambda folder, rig: file(folder, rig_to_opencv_yaml(rig)),
        lambda folder, rig: file(folder, rig_to_camchain(rig)[0]),
        ros_files,
    ],
    ids=["lmkit", "opencv", "kalibr", "ros"],
)
def test_what_no_rig_can_be_is_refused_or_named_on_every_way_in(tmp_path, write):
    def moved(t):
        return write(tmp_path, replace(RIG, T_right_left=Pose("right", "left", RIG.T_right_left.R, t)))

    t = np.array(RIG.T_right_left.t)
    with pytest.raises(InputError, match="millimeters"):
        read_any_rig(moved(1000 * t))
    with pytest.warns(InputWarning, match="are the cameras swapped"):
        read_any_rig(moved(-t))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_any_rig(moved(t))


def test_image_sizes_that_no_image_has_are_refused(tmp_path):
    large = replace(RIG, left=replace(RIG.left, image_size=(640 * 10**9, 480)))
    for text in (rig_to_yaml(large), rig_to_camchain(large)[0]):
        with pytest.raises(InputError, match="640000000000 x 480 pixels"):
            read_any_rig(file(tmp_path, text))


def test_lenses_that_no_camera_has_are_refused(tmp_path):
    for change in ({"K": np.diag([1e300, 460.0, 1.0])}, {"distortion": np.array([0.0, 0, 0, 6e304, 0])}):
        with pytest.raises(InputError, match="lens of camera left"):
            read_any_rig(file(tmp_path, rig_to_yaml(replace(RIG, left=replace(RIG.left, **change)))))


@pytest.mark.parametrize("fault", ["swapped files", "sign of Tx"])
def test_camera_infos_of_swapped_cameras_are_named(tmp_path, fault):
    left, right = map(yaml.safe_load, rig_to_camera_infos(RIG))
    if fault == "sign of Tx":
        data = right["projection_matrix"]["data"]
        data[3] = -data[3]
    else:
        left, right = right, left
    for name, info in zip(FILES, (left, right), strict=True):
        (tmp_path / name).write_text(yaml.safe_dump(info))
    with pytest.warns(InputWarning, match="are the cameras swapped"):
        read_any_rig(tmp_path)


def test_a_base_with_the_axes_of_an_optical_frame_is_named():
    rig = make_rig()
    base = Pose("base", "left", np.eye(3), np.array([0.1, 0.0, 0.3]))
    assert "optical frame" in rig_warnings(replace(rig, T_base_left=base), "rig.yaml")[0]
    ahead = Pose("base", "left", np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), np.zeros(3))
    assert rig_warnings(replace(rig, T_base_left=ahead), "rig.yaml") == ()


K = [700.1, 0.0, 640.2, 0.0, 701.3, 360.4, 0.0, 0.0, 1.0]
D = [0.05, -0.07, 1e-4, 2e-4, 0.01]
ROWS = [K[0:3], K[3:6], K[6:9]]
MATRIX = {"rows": 3, "cols": 3, "type": 6, "data": K}
LONG = {"rows": 1, "cols": 8, "type": 6, "data": [*D, 0.0, 0.0, 0.0]}
PHOTON = {"resolution": {"width": 1280.0, "height": 720.0}, "cameraIntrinsics": MATRIX}
EUROC = {"sensor_type": "camera", "resolution": [1280, 720], "camera_model": "pinhole",
         "intrinsics": [700.1, 701.3, 640.2, 360.4]}  # fmt: skip
SIZE = {"image_width": 1280, "image_height": 720}


@pytest.mark.parametrize(
    ("content", "model"),
    [
        (PHOTON | {"distCoeffs": LONG, "lensmodel": "LENSMODEL_OPENCV"}, "rational"),
        (PHOTON | {"cameraExtrinsics": {"rows": 1, "cols": 5, "type": 6, "data": D}}, "pinhole"),
        ({"camera": "x", "camera_matrix": ROWS, "distortion_coefficients": D, "img_size": [1280, 720],
          "distortion_model": "rectilinear"}, "pinhole"),
        (EUROC | {"distortion_model": "radial-tangential", "distortion_coefficients": D[:4]}, "pinhole"),
        (EUROC | {"distortion_model": "equidistant", "distortion_coefficients": D[:4]}, "fisheye"),
        (SIZE | {"camera_matrix": ROWS, "dist_coeff": [D]}, "pinhole"),
        ({"Camera_Matrix": MATRIX, "Distortion_Coefficients": {"rows": 5, "cols": 1, "data": D}, "image_Width": 1280,
          "image_Height": 720}, "pinhole"),
        (SIZE | {"camera_matrix": MATRIX, "fisheye_model": 1,
                 "distortion_coefficients": {"rows": 4, "cols": 1, "data": D[:4]}}, "fisheye"),
        (SIZE | {"model_type": "PINHOLE",
                 "distortion_parameters": {"k1": D[0], "k2": D[1], "p1": D[2], "p2": D[3]},
                 "projection_parameters": {"fx": 700.1, "fy": 701.3, "cx": 640.2, "cy": 360.4}}, "pinhole"),
        (SIZE | {"model_type": "KANNALA_BRANDT", "projection_parameters": {
            "k2": D[0], "k3": D[1], "k4": D[2], "k5": D[3], "mu": 700.1, "mv": 701.3, "u0": 640.2, "v0": 360.4}},
         "fisheye"),
    ],
    ids=["PhotonVision", "PhotonVision 2023", "calibdb", "EuRoC", "EuRoC fisheye", "lists", "OpenCV 2", "fisheye",
         "camodocal", "camodocal fisheye"],
)  # fmt: skip
def test_one_camera_of_other_tools(tmp_path, content, model):
    head = "%YAML:1.0\n---\n" if content.keys() & {"Camera_Matrix", "model_type"} else ""
    camera = read_any_rig(file(tmp_path, head + yaml.safe_dump(content))).left
    assert (camera.image_size, camera.model) == ((1280, 720), model)
    assert pytest.approx(np.array(ROWS)) == camera.K
    assert camera.distortion[:4] == pytest.approx(D[:4])


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (yaml.safe_dump(PHOTON | {"distCoeffs": LONG, "lensmodel": "LENSMODEL_STEREOGRAPHIC"}), "lensmodel"),
        (yaml.safe_dump(PHOTON), "distCoeffs"),
        (
            yaml.safe_dump(EUROC | {"distortion_model": "fov", "distortion_coefficients": [0.9]}),
            "fov is not supported",
        ),
        (yaml.safe_dump(SIZE | {"camera_matrix": MATRIX, "xi": 1.2}), "omnidirectional"),
        ("%YAML:1.0\nCamera.type: PinHole\nCamera1.fx: 458.6\n", "settings of ORB-SLAM"),
        ("Calibration results\n====\nCamera-system parameters:\ncam0 (/cam0/image_raw):\n", "Kalibr's report"),
        ("target_type: aprilgrid\ntagCols: 6\n", "a calibration target of Kalibr"),
        ("# oST version 5.0 parameters\n\n\n[image]\n\nwidth\n640\n", "INI file"),
        ("[LEFT_CAM_HD]\nfx=700\n", "neither YAML, JSON nor XML"),
        ("a: 1\nb: 2\n", "its keys are a, b"),
        ("%YAML:1.0\na: 1\nb: 2\n", "among its keys: a, b"),
        ("%YAML:1.0\nimage_width: 640\nimage_height: 480\ncam0_calib: 'a.yaml'\n", "settings of VINS"),
        ("%YAML:1.0\nrelative_config_imucam: 'a.yaml'\n", "settings of OpenVINS"),
        ("<?xml version='1.0'?><opencv_storage><Settings><a>1</a></Settings></opencv_storage>", "calibration sample"),
        ("%YAML:1.0\nmodel_type: MEI\nimage_width: 640\nimage_height: 480\n", "'MEI' is not supported"),
        ('{"value0": {"T_imu_cam": []}}', "Basalt"),
        (
            "cam0: {0}\ncam1: {0}".format(
                "{camera_model: pinhole, distortion_model: none, intrinsics: [9, 9, 5, 5], "
                "distortion_coeffs: [], resolution: [10, 10], rig_body: rig}"
            ),
            "cam1.T_cn_cnm1: missing",
        ),
        (
            "M1: {rows: 3, cols: 3, data: []}\nimage_width: 5\n",
            "M2, D1, D2, R, T, image_height: missing; stereo_calib",
        ),
    ],
)
def test_files_that_are_no_rig_are_named(tmp_path, text, match):
    with pytest.raises(InputError, match=match):
        read_any_rig(file(tmp_path, text))


@pytest.mark.parametrize("is_matrix", [False, True])
def test_transforms_of_a_camchain_as_msckf_and_vins_write_them(tmp_path, is_matrix):
    chain = yaml.safe_load(rig_to_camchain(RIG)[0])
    numbers = np.ravel(chain["cam1"]["T_cn_cnm1"]).tolist()
    chain["cam1"]["T_cn_cnm1"] = {"rows": 4, "cols": 4, "data": numbers} if is_matrix else numbers
    assert_is_the_rig(read_any_rig(file(tmp_path, yaml.safe_dump(chain))))


@pytest.mark.parametrize("part", [{"binning_x": 2}, {"roi": {"x_offset": 100, "width": 200, "height": 100}}])
def test_images_that_are_a_part_of_the_sensor_are_refused(tmp_path, part):
    with pytest.raises(InputError, match="binned, or a part"):
        read_any_rig(camera_infos(tmp_path, lambda info: yaml.safe_dump(info | part)))


def test_cameras_of_tagslam_are_a_camchain(tmp_path):
    chain = yaml.safe_load(rig_to_camchain(RIG)[0])
    chain["cam0"]["distortion_model"], chain["cam0"]["distortion_coeffs"] = (
        "plumb_bob",
        [-0.2, 0.05, 1e-3, 1e-4, 0.01],
    )
    found = read_any_rig(file(tmp_path, yaml.safe_dump(chain)))
    assert (found.left.model, len(found.left.distortion)) == ("pinhole", 5)
