"""Rigs as OpenCV, ROS and Kalibr write them: there and back, and read by OpenCV's own reader."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from lmkit.errors import InputError
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.pose import Pose
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.io.any_rig import read_any_rig
from lmkit.io.kalibr import rig_to_camchain
from lmkit.io.opencv_rig import rig_to_opencv_yaml
from lmkit.io.rig import rig_to_yaml
from lmkit.io.ros_camera_info import FILES, rig_to_camera_infos
from lmkit.simulation.scene import make_rig

RATIONAL = np.array([0.3, -0.1, 0.0004, -0.0003, 0.02, 0.5, -0.05, 0.01])
FISHEYE = np.array([0.02, -0.015, 0.008, -0.002])


def rig(model: str = "pinhole") -> StereoRig:
    made = make_rig()
    if model == "pinhole":
        return made
    distortion = RATIONAL if model == "rational" else FISHEYE
    left, right = (CameraModel(c.image_size, c.K, distortion, model) for c in (made.left, made.right))
    return StereoRig(left, right, made.T_right_left)


def write(folder, kind: str, r: StereoRig):
    """The rig in a file (a folder for ros) of its kind."""
    if kind == "ros":
        folder.mkdir(exist_ok=True)
        for name, text in zip(FILES, rig_to_camera_infos(r), strict=True):
            (folder / name).write_text(text)
        return folder
    path = folder.with_suffix(".yaml")
    texts = {"opencv": rig_to_opencv_yaml, "lmkit": rig_to_yaml, "kalibr": lambda x: rig_to_camchain(x)[0]}
    path.write_text(texts[kind](r))
    return path


def assert_same(a: StereoRig, b: StereoRig, atol: float = 1e-9) -> None:
    assert np.allclose(a.T_right_left.R, b.T_right_left.R, atol=atol)
    assert np.allclose(a.T_right_left.t, b.T_right_left.t, atol=atol)
    for one, other in ((a.left, b.left), (a.right, b.right)):
        assert one.image_size == other.image_size
        assert one.model == other.model
        assert np.allclose(one.K, other.K, atol=atol)
        count = min(len(one.distortion), len(other.distortion))
        assert np.allclose(one.distortion[:count], other.distortion[:count], atol=atol)
        assert not one.distortion[count:].any()
        assert not other.distortion[count:].any()


@pytest.mark.parametrize("model", ["pinhole", "rational", "fisheye"])
@pytest.mark.parametrize("kind", ["lmkit", "opencv", "ros"])
def test_a_rig_comes_back(kind, model, tmp_path):
    made = rig(model)
    assert_same(read_any_rig(write(tmp_path / "x", kind, made)), made)


@pytest.mark.parametrize("model", ["pinhole", "fisheye"])
def test_a_rig_comes_back_from_kalibr(model, tmp_path):
    made = rig(model)
    assert_same(read_any_rig(write(tmp_path / "x", "kalibr", made)), made)


@settings(max_examples=25)
@given(
    turn=st.tuples(*[st.floats(-0.3, 0.3)] * 3),
    shift=st.tuples(st.floats(-0.5, -0.03), st.floats(-0.01, 0.01), st.floats(-0.01, 0.01)),
)
def test_ros_files_hold_any_relation_of_the_cameras(turn, shift, tmp_path_factory):
    """These files have no key for the relative pose; it is computed from the rectification."""
    made = replace(rig(), T_right_left=Pose.from_rvec("right", "left", np.array(turn), np.array(shift)))
    assert_same(
        read_any_rig(write(tmp_path_factory.mktemp("ros") / "x", "ros", made)), made, 2e-5
    )  # OpenCV drops rotations of 1e-5


def test_cameras_above_each_other_survive_ros(tmp_path):
    made = replace(
        rig(),
        T_right_left=Pose.from_rvec("right", "left", np.array([0.01, 0.0, 0.02]), np.array([0.002, -0.1, 0.001])),
    )
    assert_same(read_any_rig(write(tmp_path / "x", "ros", made)), made, 1e-8)


def test_opencv_reads_its_file_itself(tmp_path):
    """The rectification in the file agrees with cv2.stereoRectify."""
    made = rig()
    path = write(tmp_path / "x", "opencv", made)
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    got = {
        name: storage.getNode(name).mat() for name in ("M1", "D1", "M2", "D2", "R", "T", "R1", "R2", "P1", "P2", "Q")
    }
    assert np.array_equal(got["M1"], made.left.K)
    assert np.array_equal(got["D2"].ravel(), made.right.distortion)
    assert got["T"].shape == (3, 1)
    size = (int(storage.getNode("image_width").real()), int(storage.getNode("image_height").real()))
    R1, R2, P1, P2, Q, *_ = cv2.stereoRectify(
        got["M1"], got["D1"], got["M2"], got["D2"], size, got["R"], got["T"], alpha=-1
    )
    for name, matrix in (("R1", R1), ("R2", R2), ("P1", P1), ("P2", P2), ("Q", Q)):
        assert np.allclose(got[name], matrix, atol=1e-9), name


def test_what_ros_tools_look_for_is_there():
    left, right = (yaml.safe_load(text) for text in rig_to_camera_infos(rig()))
    assert left["distortion_model"] == "plumb_bob"
    P = np.array(right["projection_matrix"]["data"]).reshape(3, 4)
    # sensor_msgs/CameraInfo: Tx = -fx' * baseline, meters.
    assert P[0, 3] == pytest.approx(-P[0, 0] * rig().baseline_m)


def test_longer_lenses_are_replaced_by_the_nearest_that_kalibr_knows(tmp_path):
    made = rig()
    left = CameraModel(made.left.image_size, made.left.K, np.array([-0.2, 0.05, 0.0007, -0.0004, -0.004]))
    text, lens, error_px = rig_to_camchain(replace(made, left=left))
    assert lens == "radtan"
    assert 0 < error_px < 0.5
    path = tmp_path / "chain.yaml"
    path.write_text(text)
    points = np.column_stack([np.random.default_rng(0).uniform(-0.5, 0.5, (50, 2)) * [1.2, 0.9], np.ones(50)])
    read = read_any_rig(path)
    assert np.abs(read.left.project(points) - left.project(points)).max() < 2 * error_px


def test_a_barrel_that_radtan_cannot_hold_becomes_equidistant(tmp_path):
    """Strong third coefficients, as a fit to the middle of the image leaves them."""
    made = rig()
    barrel = CameraModel(
        made.left.image_size, made.left.K * [[1.16], [1.16], [1]], np.array([-0.28, 0.011, 0, 0, 0.218])
    )
    text, lens, error_px = rig_to_camchain(StereoRig(barrel, barrel, made.T_right_left))
    assert lens == "equidistant"
    path = tmp_path / "chain.yaml"
    path.write_text(text)
    points = np.column_stack([np.random.default_rng(0).uniform(-0.5, 0.5, (50, 2)) * [1.1, 0.8], np.ones(50)])
    assert np.abs(read_any_rig(path).left.project(points) - barrel.project(points)).max() < error_px < 1


def test_a_lens_that_kalibr_cannot_hold_is_refused():
    outlier = CameraModel((640, 480), make_rig().left.K, np.array([-0.42, 0.25, 0, 0, -0.1]))
    with pytest.raises(InputError, match="Kalibr's lens models"):
        rig_to_camchain(replace(rig(), left=outlier))


@pytest.mark.parametrize(
    ("kind", "old", "new", "named"),
    [
        ("opencv", "M1:", "N1:", "M1: missing"),
        ("opencv", "image_width:", "breadth:", "image_width: missing"),
        ("opencv", "rows: 3", "rows: oops", "M1.rows"),
        ("opencv", "rows: 3", "rows: 999999999", "a matrix of 999999999 x 3 holds 9 numbers"),
        ("kalibr", "T_cn_cnm1:", "T_wrong:", "cam1.T_cn_cnm1"),
        ("kalibr", "radtan", "magic", "cam0.distortion_model"),
        ("kalibr", "cam1:", "cam7:", "cam1: missing"),
    ],
)
def test_what_is_wrong_in_a_foreign_file_is_named(kind, old, new, named, tmp_path):
    path = write(tmp_path / "x", kind, rig())
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read_any_rig(path)
    assert named in caught.value.message
    assert str(path) in caught.value.message


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("plumb_bob", "telescope", "distortion_model 'telescope'"),
        ("image_width: 640\n", "", "image_width: missing"),
        ("rows: 3", "rows: 2", "is not 3 x 3"),
    ],
)
def test_what_is_wrong_in_a_ros_file_is_named(old, new, named, tmp_path):
    folder = write(tmp_path / "x", "ros", rig())
    path = folder / "right.yaml"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        read_any_rig(folder)
    assert named in caught.value.message


def test_two_single_cameras_are_no_pair(tmp_path):
    folder = write(tmp_path / "x", "ros", rig())
    (folder / "right.yaml").write_text((folder / "left.yaml").read_text())
    with pytest.raises(InputError, match="no baseline"):
        read_any_rig(folder)
    alone = read_any_rig(folder / "left.yaml")
    assert len(alone.cameras) == 1
    assert np.array_equal(alone.left.K, rig().left.K)
