"""Rig files of one to N cameras, and those of other programs."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import yaml

from lmkit.errors import InputError, InputWarning
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import MountedCamera, Rig, as_stereo, mounted_cameras, with_time_offsets
from lmkit.geometry.stereo_rig import StereoRig, mounted_ahead
from lmkit.io.any_rig import read_any_rig
from lmkit.io.image_groups import frame_groups, list_groups
from lmkit.io.kalibr import rig_to_camchain
from lmkit.io.opencv_rig import camera_to_opencv_yaml
from lmkit.io.rig import rig_to_yaml
from lmkit.io.ros_camera_info import rig_to_camera_info
from lmkit.simulation.scene import make_rig

CAMERA = make_rig().left
CORRELATION = 0.5 * np.eye(9) + 0.5


def rig_of(count: int, base: Pose | None = None) -> Rig:
    rng = np.random.default_rng(count)
    poses = [Pose.identity("camera", "left")]
    poses += [Pose.from_rvec("camera", "left", rng.normal(size=3), rng.normal(size=3)) for _ in range(count - 1)]
    names = ["front", "left side", "right side", "rear", "up"]
    cameras = [
        MountedCamera(name, CAMERA, T, None if k == 0 else 1e-6 * np.eye(6), np.arange(9.0), CORRELATION)
        for k, (name, T) in enumerate(zip(names, poses, strict=False))
    ]
    return Rig(tuple(cameras), base)


def written(tmp_path, text, name="rig.yaml"):
    path = tmp_path / name
    path.write_text(text)
    return path


def same(a, b):
    for one, other in zip(mounted_cameras(a), mounted_cameras(b), strict=True):
        assert np.allclose(one.T_camera_left.matrix, other.T_camera_left.matrix, atol=1e-9)
        assert np.allclose(one.model.K, other.model.K)
    return True


@pytest.mark.parametrize("count", [1, 2, 3, 5])
@pytest.mark.parametrize("base", [None, mounted_ahead(0.5)])
def test_a_rig_comes_back(count, base, tmp_path):
    rig = rig_of(count, base)
    back = read_any_rig(written(tmp_path, rig_to_yaml(rig)))
    assert isinstance(back, Rig)
    assert same(rig, back)
    assert [c.name for c in back.cameras] == [c.name for c in rig.cameras]
    assert (back.T_base_left is None) == (base is None)
    assert np.array_equal(back.cameras[-1].intrinsics_sigma, np.arange(9.0))
    assert np.array_equal(back.cameras[-1].intrinsics_correlation, CORRELATION)


def changed(rig, change):
    """The text of a rig file whose second camera was changed."""
    data = yaml.safe_load(rig_to_yaml(rig))
    change(data["cameras"][1])
    return yaml.safe_dump(data)


HERE = {"R": np.eye(3).tolist(), "t": [0, 0, 0]}


def test_cameras_may_be_placed_on_the_base(tmp_path):
    rig = rig_of(2, mounted_ahead(0.5))
    T = rig.T_base_left @ rig.cameras[1].T_camera_left.inverse()

    def on_the_base(camera):
        del camera["T_first_camera"]
        camera["T_base_camera"] = {"R": T.R.tolist(), "t": T.t.tolist()}

    assert same(rig, read_any_rig(written(tmp_path, changed(rig, on_the_base))))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda camera: camera.update(name="front"), "same name"),
        (lambda camera: camera.update(correlation=[[1.0, 0.5], [0.5, 1.0]]), "2 rows for 9"),
        (lambda camera: camera.update(correlation=[[1.0, 2.0], [2.0, 1.0]]), "negative eigenvalue"),
        (lambda camera: camera.update(T_second_camera=HERE), "T_second_camera"),
        (lambda camera: camera.update(T_base_camera=camera.pop("T_first_camera")), "cameras[0].T_base_camera"),
        (lambda camera: camera.update(T_base_camera=HERE), "exactly one"),
        (lambda camera: camera.pop("T_first_camera"), "exactly one"),
    ],
)
def test_what_is_wrong_is_named(change, words, tmp_path):
    with pytest.raises(InputError) as caught:
        read_any_rig(written(tmp_path, changed(rig_of(2), change)))
    assert words in f"{caught.value.message} {caught.value.hint}"


@pytest.mark.parametrize("count", [1, 3, 5])
def test_camchains_hold_any_number_of_cameras(count, tmp_path):
    rig = rig_of(count)
    assert same(rig, read_any_rig(written(tmp_path, rig_to_camchain(rig)[0])))


def test_one_camera_of_ros_and_opencv(tmp_path):
    rig = Rig.of_one(CAMERA)
    for name, text in (("ros.yaml", rig_to_camera_info(rig)), ("cv.yaml", camera_to_opencv_yaml(CAMERA))):
        back = read_any_rig(written(tmp_path, text, name))
        assert same(rig, back)
        assert np.allclose(back.left.distortion[: len(CAMERA.distortion)], CAMERA.distortion)
    storage = cv2.FileStorage(str(tmp_path / "cv.yaml"), cv2.FILE_STORAGE_READ)
    assert np.array_equal(storage.getNode("camera_matrix").mat(), CAMERA.K)


def test_a_rig_of_two_is_a_stereo_pair_where_one_is_needed():
    stereo = make_rig()
    back = as_stereo(Rig(mounted_cameras(stereo)), "rectify")
    assert isinstance(back, StereoRig)
    assert np.array_equal(back.T_right_left.t, stereo.T_right_left.t)
    with pytest.raises(InputError, match="rectify needs a stereo pair, and the rig has 1 camera"):
        as_stereo(Rig.of_one(CAMERA), "rectify")


def test_images_are_grouped_by_name_and_split_in_halves(tmp_path):
    for camera in "abc":
        (tmp_path / camera).mkdir()
        for k in range(2):
            image = np.full((40, 60, 3), 10 * k, dtype=np.uint8)
            image[:, 30:] = 200
            cv2.imwrite(str(tmp_path / camera / f"{k}.png"), image)
    sources = [str(tmp_path / camera) for camera in "abc"]
    assert [[p.name for p in files] for files in list_groups(sources)] == [["0.png"] * 3, ["1.png"] * 3]
    halves = list(frame_groups([f"split:{sources[0]}"]))
    assert [len(frames) for frames in halves] == [2, 2]
    assert (halves[1][0].pixels == 10).all()
    assert (halves[1][1].pixels == 200).all()
    (tmp_path / "c" / "1.png").unlink()
    with pytest.warns(InputWarning, match="without a partner are left out"):
        assert [[p.name for p in files] for files in list_groups(sources)] == [["0.png"] * 3]
    (tmp_path / "c" / "0.png").rename(tmp_path / "c" / "front.png")
    with pytest.raises(InputError, match="2, 2, 1 images"):
        list_groups(sources)


def test_time_offsets_are_read_and_written(tmp_path):
    rig = with_time_offsets(rig_of(3), [0.03, -0.02])
    again = read_any_rig(written(tmp_path, rig_to_yaml(rig)))
    assert [camera.time_offset_s for camera in mounted_cameras(again)] == [0.0, 0.03, -0.02]
    pair = with_time_offsets(as_stereo(rig_of(2), "a test"), [0.004])
    again = read_any_rig(written(tmp_path, rig_to_yaml(pair)))
    assert [camera.time_offset_s for camera in mounted_cameras(again)] == [0.0, 0.004]
    assert as_stereo(Rig(mounted_cameras(again)), "a test").right_time_offset_s == 0.004
    text = rig_to_yaml(rig).replace("name: front", "name: front\n  time_offset_s: 0.1")
    with pytest.raises(InputError, match=r"cameras\[0\].time_offset_s"):
        read_any_rig(written(tmp_path, text))


def test_kalibrs_time_shifts_are_offsets_to_the_first_camera(tmp_path):
    chain = yaml.safe_load(rig_to_camchain(rig_of(3))[0])
    for name, shift in zip(chain, (0.010, 0.012, 0.005), strict=True):
        chain[name]["timeshift_cam_imu"] = shift
    rig = read_any_rig(written(tmp_path, yaml.safe_dump(chain), "camchain.yaml"))
    rig = read_any_rig(written(tmp_path, rig_to_camchain(rig)[0], "camchain.yaml"))
    assert np.allclose([camera.time_offset_s for camera in mounted_cameras(rig)], [0.0, 0.002, -0.005])
