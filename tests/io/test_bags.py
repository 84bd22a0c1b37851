"""A recording out of a bag, and poses into one; the bag is written by rosbags, as ROS 2 would."""

import cv2
import numpy as np
import pytest
from bag_files import write_bag

from lmkit.errors import InputError
from lmkit.io.any_rig import read_any_rig
from lmkit.io.bags import find_topics, poses_to_bag, unpack_bag
from lmkit.io.recording_tables import read_gyro, read_odometry
from lmkit.io.ros_images import pixels_of
from lmkit.io.trajectory import read_trajectory
from lmkit.model.trajectory import Trajectory
from lmkit.simulation.scene import make_rig

pytest.importorskip("rosbags", reason="the extra bags is not installed")


def test_a_recording_comes_out_of_a_bag(tmp_path, lmkit):
    rig = make_rig()
    write_bag(tmp_path / "bag", rig)
    answer = lmkit("unbag", tmp_path / "bag", "-o", tmp_path / "out")
    assert answer.code == 0, answer.err
    images = sorted((tmp_path / "out" / "left").iterdir())
    assert [p.name for p in images] == [f"{k:06d}_{100 + k / 4:.6f}.png" for k in range(3)]
    # Red first in the bag, blue first in OpenCV.
    assert cv2.imread(str(images[2]))[0, 0].tolist() == [200, 100, 12]
    back = read_any_rig(tmp_path / "out" / "rig")
    assert back.T_right_left.t == pytest.approx(rig.T_right_left.t, abs=1e-6)
    odometry = read_odometry(tmp_path / "out" / "odometry.csv")
    assert odometry.forward_m[1:] == pytest.approx(0.1 * np.cos(0.2), abs=1e-5)
    poses = read_trajectory(tmp_path / "out" / "odometry.tum")
    assert poses.positions[:, 0] == pytest.approx(0.1 * np.arange(10))
    assert poses.quaternions[3] == pytest.approx([0.0, 0.0, np.sin(0.1), np.cos(0.1)])
    assert read_gyro(tmp_path / "out" / "gyro.csv").rate_radps == pytest.approx(0.3)


def test_images_of_different_times_make_no_pairs(tmp_path):
    write_bag(tmp_path / "bag", make_rig(), late=0.1)
    with pytest.raises(InputError, match="within 10 ms"):
        list(unpack_bag(tmp_path / "bag", {}))


def test_what_is_no_bag_is_refused(tmp_path):
    path = tmp_path / "no.bag"
    path.write_bytes(b"nothing")
    with pytest.raises(InputError, match="cannot read"):
        list(unpack_bag(path, {}))


def test_topics_are_found_by_type_and_name_or_asked_for(tmp_path):
    kinds = {
        "/a/left/raw": "sensor_msgs/msg/Image",
        "/a/right/raw": "sensor_msgs/msg/Image",
        "/o": "nav_msgs/msg/Odometry",
    }
    found = find_topics(kinds, {}, tmp_path)
    assert (found.left, found.right, found.odometry, found.imu) == ("/a/left/raw", "/a/right/raw", "/o", None)
    with pytest.raises(InputError, match="no topic /x"):
        find_topics(kinds, {"left": "/x"}, tmp_path)
    with pytest.raises(InputError, match="left and right images among /b, /c"):
        find_topics({"/b": kinds["/a/left/raw"], "/c": kinds["/a/left/raw"], "/o": kinds["/o"]}, {}, tmp_path)
    with pytest.raises(InputError, match="it contains no images"):
        find_topics({"/o": kinds["/o"]}, {}, tmp_path)
    with pytest.raises(InputError, match="one topic of images, /a/left/raw"):
        find_topics({"/a/left/raw": kinds["/a/left/raw"]}, {}, tmp_path)


def test_poses_go_into_a_bag(tmp_path):
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    track = Trajectory(
        np.array([1.0, 2.5]), np.array([[1.0, 2, 3], [4, 5, 6]]), np.array([[0, 0, 0, 1.0], [1, 0, 0, 0]])
    )
    poses_to_bag(tmp_path / "out", track)
    with AnyReader([tmp_path / "out"], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        topics = {
            topic: [c for c in reader.connections if c.topic == topic] for topic in ("/lmkit/pose", "/lmkit/path")
        }
        read, paths = (
            [(t, reader.deserialize(raw, c.msgtype)) for c, t, raw in reader.messages(connections=one)]
            for one in topics.values()
        )
    assert [len(path.poses) for _, path in paths] == [2]
    assert paths[0][1].header.frame_id == "map"
    assert paths[0][1].poses[1].pose.position.z == 6.0
    assert [t for t, _ in read] == [1_000_000_000, 2_500_000_000]
    assert read[1][1].pose.position.y == 5.0
    assert read[1][1].pose.orientation.x == 1.0
    with pytest.raises(InputError, match="exists"):
        poses_to_bag(tmp_path / "out", track)


@pytest.mark.parametrize(
    ("gravity", "rate", "word"),
    [
        ((0.1, -0.2, 9.8), (5.0, 5.0, 0.3), ""),
        ((0.2, -9.8, 0.3), (5.0, -0.3, 5.0), "minus y axis points up (axes of an optical frame)"),
        ((0.0, 0.1, -1.0), (5.0, 5.0, -0.3), "minus z axis points up"),
        ((0.6, 0.0, 0.8), (0.18, 5.0, 0.24), "37 deg off the vertical"),
        ((np.nan, 0.0, 0.0), (5.0, 5.0, 0.3), ""),
    ],
)
def test_the_vertical_axis_of_an_imu_is_recognized_by_gravity(tmp_path, recwarn, gravity, rate, word):
    write_bag(tmp_path / "bag", make_rig(image_size=(64, 48)), pairs=1, rate=rate, gravity=gravity)
    (table,) = [file.content for file in unpack_bag(tmp_path / "bag", {}) if file.name == "gyro.csv"]
    (tmp_path / "gyro.csv").write_bytes(table)
    assert read_gyro(tmp_path / "gyro.csv").rate_radps == pytest.approx(0.3)
    said = [str(warning.message) for warning in recwarn]
    assert len(said) == bool(word)
    assert word in "".join(said)


@pytest.mark.parametrize(
    ("encoding", "step", "data"),
    [
        ("8UC3", 6, [40, 120, 200] * 2),
        # Luma, and chroma that two pixels share.
        ("yuv422_yuy2", 4, [131, 83, 131, 173]),
        ("yuv422", 4, [83, 131, 173, 131]),
    ],
)
def test_encodings_of_usb_cameras(encoding, step, data):
    pixels = pixels_of(encoding, (2, 1), step, bytes(data), "/image")
    assert pixels.shape == (1, 2, 3)
    assert pixels[0].tolist() == pytest.approx(np.array([[40, 120, 200]] * 2), abs=6)


def write_mcap(folder):
    """A bag of one message."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/text", "std_msgs/msg/String", typestore=store)
        message = store.types["std_msgs/msg/String"]("a" * 300)
        writer.write(connection, 1, store.serialize_cdr(message, "std_msgs/msg/String"))
    return folder


def test_how_to_repair_a_recording_that_was_cut_off_is_said(tmp_path):
    write_bag(tmp_path / "bag", make_rig(), pairs=1)
    (tmp_path / "bag" / "metadata.yaml").unlink()
    (whole,) = write_mcap(tmp_path / "whole").glob("*.mcap")
    (tmp_path / "cut.mcap").write_bytes(whole.read_bytes()[:-200])
    for name, remedy in (("bag", "ros2 bag reindex"), ("cut.mcap", "mcap recover")):
        with pytest.raises(InputError) as refused:
            list(unpack_bag(tmp_path / name, {}))
        assert remedy in refused.value.hint
