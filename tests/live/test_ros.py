"""ROS 2 on loopback: the messages of every transport are read by a reader of another project."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest

import lmkit
from lmkit.errors import InputError
from lmkit.geometry.planar import planar_pose
from lmkit.geometry.pose import Pose
from lmkit.live.events import Health
from lmkit.live.outputs.base import OutputLost
from lmkit.live.outputs.ros import RosOutput
from lmkit.live.ros.address import parse_ros
from lmkit.live.ros.messages import IMAGE, POSE, StepMessages
from lmkit.live.ros.open_transport import choose_transport
from lmkit.live.state import CameraView, LiveState
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.model.observation import Detection
from lmkit.model.pose_status import PoseStatus

C = np.arange(36.0).reshape(6, 6) + np.arange(36.0).reshape(6, 6).T + 100 * np.eye(6)
ID = LandmarkId("tag36h11", 7)
SQUARE = np.array([[10.0, 10.0], [30.0, 10.0], [30.0, 30.0], [10.0, 30.0]])
T_ODOM = planar_pose(np.array([0.5, -0.25, 0.1]))


def a_step(status: PoseStatus = PoseStatus.OK) -> LiveState:
    view = CameraView("left", np.zeros((4, 4, 3), np.uint8), 1700000000.5, (Detection(ID, SQUARE, 0.9, 3.0),))
    T = planar_pose(np.array([1.0, 2.0, 0.5])) if status == PoseStatus.OK else None
    return LiveState(
        3, 1700000000.5, status, T, C if T else None, (view,), ids=(ID,), sources=(Health("camera:0", True, 30.0),),
        T_map_odometry=Pose("map", "odometry", T_ODOM.R, T_ODOM.t) if T else None,
    )  # fmt: skip


WALL = Pose("map", "landmark", np.eye(3), [1.0, 0.0, 0.5])
LANDMARKS = LandmarkMap([MappedLandmark(ID, 0.2, WALL)])


def messages(text: str, state: LiveState) -> dict[str, dict]:
    return {m.topic: m.values for m in StepMessages(parse_ros(text), LANDMARKS).of_step(state)}


def read_until(send: Callable[[], object], done: Callable[[], bool], seconds: float = 15.0) -> None:
    """Send repeatedly until a reader has received a message."""
    end = time.monotonic() + seconds
    while not done() and time.monotonic() < end:
        send()
        time.sleep(0.05)


def test_a_frame_has_one_parent_and_poses_go_out_only_when_sure():
    step = messages("?odometry=yes&dock=tag36h11:7", a_step())
    assert set(step) == {
        "/lmkit/left/detections", "/lmkit/pose", "/lmkit/odometry", "/tf", "/detected_dock_pose", "/diagnostics",
    }  # fmt: skip
    assert [t["child_frame_id"] for t in step["/tf"]["transforms"]] == ["odom"]
    assert step["/lmkit/pose"]["header"] == {"stamp": {"sec": 1700000000, "nanosec": 500000000}, "frame_id": "map"}
    assert step["/lmkit/pose"]["pose"]["covariance"] == C.ravel().tolist()
    assert [t["child_frame_id"] for t in messages("?tf=base", a_step())["/tf"]["transforms"]] == ["base_link"]
    assert set(messages("?odometry=yes&tf=base", a_step(PoseStatus.LOST))) == {
        "/lmkit/left/detections",
        "/diagnostics",
    }
    assert {s["level"] for s in messages("", a_step(PoseStatus.LOST))["/diagnostics"]["status"]} == {0, 1}


def test_images_go_out_as_often_as_asked_for_with_what_was_read_outlined():
    pytest.importorskip("rosbags")
    from lmkit.live.ros.cdr import Cdr

    address = parse_ros("?images=5")
    sender = StepMessages(address, LANDMARKS)
    assert ("/lmkit/image/compressed", IMAGE) in sender.topics(["left"])
    view = replace(a_step().views[0], image=np.full((480, 640, 3), 128, np.uint8))
    sent = []
    for k in range(30):
        step = replace(a_step(), time_s=1700000000.0 + k / 30, views=(view,))
        sent += [m for m in sender.of_step(step) if m.topic == "/lmkit/image/compressed"]
    assert len(sent) == 5
    cdr = Cdr()
    back = cdr.decode(IMAGE, cdr.encode(IMAGE, sent[0].values))
    image = cv2.imdecode(np.asarray(back["data"]), cv2.IMREAD_COLOR).astype(int)
    assert back["format"] == "jpeg" and image.shape == (360, 480, 3)
    green = image[..., 1] - image[..., [0, 2]].max(axis=2)
    assert green[:40, :40].max() > 50 and green[100:].max() < 20
    assert all(m.topic != "/lmkit/image/compressed" for m in StepMessages(parse_ros(""), LANDMARKS).of_step(step))


def test_detections_are_as_apriltag_counts_corners():
    apriltag = pytest.importorskip("pupil_apriltags")
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    image = np.full((400, 400), 255, np.uint8)
    image[100:300, 100:300] = cv2.aruco.generateImageMarker(dictionary, ID.code, 200)
    detector = apriltag.Detector(families="tag36h11")
    # It would free its families before the detector that still reads them, and would sometimes abort.
    detector.tag_families.clear()
    (theirs,) = detector.detect(image)
    (ours,) = lmkit.detect(np.repeat(image[:, :, None], 3, axis=2), "tag36h11")
    state = LiveState(0, 1.0, PoseStatus.LOST, None, None, (CameraView("left", None, 1.0, (ours,)),))
    (row,) = messages("", state)["/lmkit/left/detections"]["detections"]
    corners = np.array([[p["x"], p["y"]] for p in row["corners"]])
    assert np.abs(corners - theirs.corners).max() < 2
    center = [row["center"]["x"], row["center"]["y"]]
    assert np.abs(center - theirs.center).max() < 2
    H = np.array(row["homography"]).reshape(3, 3)
    assert np.abs(H / H[2, 2] - theirs.homography / theirs.homography[2, 2]).max() < 2


def test_rosbags_reads_every_message():
    pytest.importorskip("rosbags")
    from lmkit.live.ros.cdr import Cdr

    cdr = Cdr()
    for message in StepMessages(parse_ros("?odometry=yes&dock=tag36h11:7"), LANDMARKS).of_step(a_step()):
        back = cdr.decode(message.type_name, cdr.encode(message.type_name, message.values))
        back.pop("__msgtype__", None)
        assert json.dumps(back)
        if message.type_name == POSE:
            assert back["pose"]["covariance"] == C.ravel().tolist()
            assert back["pose"]["pose"]["position"] == {"x": 1.0, "y": 2.0, "z": 0.0}
            assert back["header"]["frame_id"] == "map"


def test_a_zenoh_session_reads_keys_bytes_and_attachments():
    zenoh = pytest.importorskip("zenoh")
    from lmkit.live.ros.cdr import Cdr

    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", '["tcp/127.0.0.1:17447"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config) as router:
        got: list = []
        held = router.declare_subscriber("5/lmkit/pose/**", got.append)
        output = RosOutput(parse_ros("?domain=5&url=tcp/127.0.0.1:17447"), "zenoh", LANDMARKS, ["left"])
        read_until(lambda: output.send(a_step()), lambda: len(got) > 1)
        tokens = [str(reply.ok.key_expr) for reply in router.liveliness().get("@ros2_lv/**")]
        output.close()
        held.undeclare()
    name, type_hash = str(got[0].key_expr).split("/")[-2:]
    assert name == "geometry_msgs::msg::dds_::PoseWithCovarianceStamped_"
    # The hash that ROS 2 itself prints for this type.
    assert type_hash == "RIHS01_26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e"
    values = Cdr().decode(POSE, bytes(got[0].payload))
    assert values["pose"]["pose"]["position"]["y"] == 2.0
    attachment = bytes(got[1].attachment)
    assert len(attachment) == 33
    assert int.from_bytes(attachment[:8], "little") - int.from_bytes(bytes(got[0].attachment)[:8], "little") == 1
    assert any("/MP/%/%/lmkit/%lmkit%pose/" in token for token in tokens)


def test_a_cyclone_dds_reader_reads_poses():
    pytest.importorskip("rosless")
    pytest.importorskip("cyclonedds")
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic
    from dds_types import PoseWithCovarianceStamped

    participant = DomainParticipant(77)
    reader = DataReader(participant, Topic(participant, "rt/lmkit/pose", PoseWithCovarianceStamped))
    output = RosOutput(parse_ros("?domain=77"), "dds", LANDMARKS, ["left"])
    got: list = []
    read_until(lambda: output.send(a_step()), lambda: bool(got.extend(reader.take(10)) or got))
    output.close()
    assert got[0].header.frame_id == "map"
    assert got[0].header.stamp.nanosec == 500000000
    assert (got[0].pose.pose.position.x, got[0].pose.pose.position.y) == (1.0, 2.0)
    assert list(got[0].pose.covariance) == C.ravel().tolist()


@dataclass
class Bridge:
    """A rosbridge server's side of the protocol."""

    port: int
    got: list


@pytest.fixture
def bridge():
    server = pytest.importorskip("websockets.sync.server")
    got: list = []

    def talk(peer) -> None:
        for text in peer:
            got.append(json.loads(text))

    with server.serve(talk, "127.0.0.1", 0) as serving:
        threading.Thread(target=serving.serve_forever, daemon=True).start()
        yield Bridge(serving.socket.getsockname()[1], got)
        serving.shutdown()


def test_a_rosbridge_server_gets_announced_topics_and_poses(bridge):
    url = f"ws://127.0.0.1:{bridge.port}"
    output = RosOutput(parse_ros(f"?url={url}"), "rosbridge", LANDMARKS, ["left"])
    output.send(a_step())
    read_until(lambda: None, lambda: any(m.get("topic") == "/diagnostics" and "msg" in m for m in bridge.got))
    output.close()
    announced = {m["topic"]: m["type"] for m in bridge.got if m["op"] == "advertise"}
    assert announced["/lmkit/pose"] == POSE
    (pose,) = [m["msg"] for m in bridge.got if m["op"] == "publish" and m["topic"] == "/lmkit/pose"]
    assert pose["pose"]["pose"]["position"]["y"] == 2.0
    assert pose["header"]["stamp"]["nanosec"] == 500000000
    with pytest.raises(OutputLost, match="rosbridge"):
        RosOutput(parse_ros("?url=ws://127.0.0.1:9"), "rosbridge", LANDMARKS, ["left"])


@pytest.mark.parametrize("text", ["?transport=tcp", "?domain=-1", "?tf=both", ":/odom!", "?color=red", "?dock=x"])
def test_a_bad_address_is_refused(text):
    with pytest.raises(InputError):
        parse_ros(text)


def test_a_missing_installation_is_named():
    with pytest.raises(InputError, match="rclpy"):
        choose_transport(parse_ros("?transport=rclpy"))
