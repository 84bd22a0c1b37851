"""Every topic of docs/live.md, read by a Cyclone DDS reader, by a Zenoh session and by rosbags."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, is_dataclass
from typing import Any

import numpy as np
import pytest

from lmkit.geometry.planar import planar_pose
from lmkit.geometry.pose import Pose
from lmkit.live.events import Health
from lmkit.live.outputs.ros import RosOutput
from lmkit.live.ros.address import parse_ros
from lmkit.live.ros.cdr import Cdr
from lmkit.live.ros.messages import StepMessages
from lmkit.live.state import CameraView, LiveState
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.model.observation import Detection
from lmkit.model.pose_status import PoseStatus

pytest.importorskip("rosbags")

C = np.arange(36.0).reshape(6, 6) + np.arange(36.0).reshape(6, 6).T + 100 * np.eye(6)
ID = LandmarkId("tag36h11", 7)
SQUARE = np.array([[10.0, 10.0], [30.0, 11.0], [31.0, 30.0], [9.0, 30.0]])
LANDMARKS = LandmarkMap([MappedLandmark(ID, 0.2, Pose("map", "landmark", np.eye(3), [1.0, 0.0, 0.5]))])
OPTIONS = "?odometry=yes&dock=tag36h11:7"
# Topic, and the class of its messages in dds_types.py.
TOPICS = {
    "/lmkit/pose": "PoseWithCovarianceStamped",
    "/lmkit/odometry": "Odometry",
    "/tf": "TFMessage",
    "/lmkit/left/detections": "AprilTagDetectionArray",
    "/detected_dock_pose": "PoseStamped",
    "/diagnostics": "DiagnosticArray",
}
every_topic = pytest.mark.parametrize("topic", TOPICS)


def a_step(number: int) -> LiveState:
    """A step in each second, so that diagnostics are sent with each."""
    time_s = 1700000000.5 + number
    view = CameraView("left", None, time_s, (Detection(ID, SQUARE, 0.9, 3.0),))
    odom = planar_pose(np.array([0.5, -0.25, 0.1]))
    return LiveState(
        number, time_s, PoseStatus.OK, planar_pose(np.array([1.0, 2.0, 0.5])), C, (view,), ids=(ID,),
        sources=(Health("camera:0", True, 30.0),), T_map_odometry=Pose("map", "odometry", odom.R, odom.t),
    )  # fmt: skip


def sent(topic: str, number: int) -> dict[str, Any]:
    """Values of a step's message on a topic."""
    found = {m.topic: m.values for m in StepMessages(parse_ros(OPTIONS), LANDMARKS).of_step(a_step(number))}
    assert set(found) == set(TOPICS)
    return found[topic]


def plain(value: Any) -> Any:
    """Dictionaries (without rosbags' constants), lists and numbers; those of 32 bit as they are on the wire."""
    if is_dataclass(value):
        value = asdict(value)
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items() if not k.isupper()}
    if isinstance(value, list | tuple | np.ndarray):
        return [plain(v) for v in value]
    return float(np.float32(value)) if isinstance(value, float) else value


def check(got: Any, topic: str) -> None:
    """A message agrees with the step that has its time stamp."""
    stamped = got["transforms"][0] if topic == "/tf" else got
    number = stamped["header"]["stamp"]["sec"] - 1700000000
    assert plain(got) == plain(sent(topic, number))


def send_until(output: RosOutput, got: dict[str, Any], take: Callable[[], None] = lambda: None) -> None:
    """Send steps until every topic was read."""
    number, end = 0, time.monotonic() + 20
    while set(got) != set(TOPICS) and time.monotonic() < end:
        output.send(a_step(number))
        number += 1
        time.sleep(0.05)
        take()


@pytest.fixture(scope="module")
def by_cyclone() -> Iterator[dict[str, Any]]:
    """The newest message of every topic, as a Cyclone DDS reader has it."""
    pytest.importorskip("rosless")
    pytest.importorskip("cyclonedds")
    import dds_types
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic

    participant = DomainParticipant(81)
    readers = {
        topic: DataReader(participant, Topic(participant, f"rt{topic}", getattr(dds_types, name)))
        for topic, name in TOPICS.items()
    }
    output = RosOutput(parse_ros(OPTIONS + "&domain=81"), "dds", LANDMARKS, ["left"])
    got: dict[str, Any] = {}
    send_until(output, got, lambda: got.update((t, m) for t, reader in readers.items() for m in reader.take(10)))
    output.close()
    yield got


@pytest.fixture(scope="module")
def by_zenoh() -> Iterator[dict[str, tuple[str, bytes]]]:
    """Key and bytes of the newest message of every topic, as a Zenoh session has them."""
    zenoh = pytest.importorskip("zenoh")
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", '["tcp/127.0.0.1:17449"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    got: dict[str, tuple[str, bytes]] = {}

    def take(sample: Any) -> None:
        _, *topic, name, type_hash = str(sample.key_expr).split("/")
        got["/" + "/".join(topic)] = f"{name}/{type_hash}", bytes(sample.payload)

    with zenoh.open(config) as router:
        held = router.declare_subscriber("6/**", take)
        output = RosOutput(parse_ros(OPTIONS + "&domain=6&url=tcp/127.0.0.1:17449"), "zenoh", LANDMARKS, ["left"])
        send_until(output, got)
        output.close()
        held.undeclare()
    yield got


def type_of(topic: str) -> str:
    """Name of a topic's type."""
    return dict(StepMessages(parse_ros(OPTIONS), LANDMARKS).topics(["left"]))[topic]


@every_topic
def test_a_cyclone_dds_reader_reads(by_cyclone, topic):
    check(plain(by_cyclone[topic]), topic)


@every_topic
def test_a_zenoh_session_reads(by_zenoh, topic):
    key, payload = by_zenoh[topic]
    package, _, name = type_of(topic).split("/")
    assert key == f"{package}::msg::dds_::{name}_/{Cdr().type_hash(type_of(topic))}"
    check(Cdr().decode(type_of(topic), payload), topic)


@every_topic
def test_rosbags_deserialises(topic):
    cdr = Cdr()
    check(cdr.decode(type_of(topic), cdr.encode(type_of(topic), sent(topic, 3))), topic)
