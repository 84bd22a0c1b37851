"""Images of ROS 2 topics as sources: a Cyclone DDS writer, a Zenoh session and a rosbridge server publish them."""

from __future__ import annotations

import base64
import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import cv2
import numpy as np
import pytest

from lmkit.errors import InputError
from lmkit.io.ros_images import COMPRESSED, IMAGE
from lmkit.live.captures import SourceLost
from lmkit.live.clock import LoopClock
from lmkit.live.open_capture import open_capture
from lmkit.live.open_run import open_run
from lmkit.live.ros_capture import image_of
from lmkit.live.run_settings import settings_of
from lmkit.live.source_address import parse_source

SHOWN = np.random.default_rng(4).integers(0, 256, (48, 64, 3), dtype=np.uint8)
TOPIC = {IMAGE: "/left/image_raw", COMPRESSED: "/left/image_raw/compressed"}
both_types = pytest.mark.parametrize("type_name", [IMAGE, COMPRESSED])
Send = Callable[[dict[str, Any]], object]


def message(type_name: str, image: np.ndarray, time_s: float) -> dict[str, Any]:
    """Values of an image's message, stored without loss."""
    stamp = {"sec": int(time_s), "nanosec": round(1e9 * (time_s % 1))}
    header = {"stamp": stamp, "frame_id": "left"}
    if type_name == COMPRESSED:
        return {"header": header, "format": "png", "data": cv2.imencode(".png", image)[1].ravel()}
    height, width = image.shape[:2]
    size = {"height": height, "width": width, "is_bigendian": 0, "step": 3 * width}
    return {"header": header, **size, "encoding": "rgb8", "data": image[:, :, ::-1].ravel()}


@contextmanager
def by_cyclone(topics: dict[str, str]) -> Iterator[dict[str, Send]]:
    """A Cyclone DDS writer for each topic, by its type."""
    pytest.importorskip("rosless")
    pytest.importorskip("cyclonedds")
    import dds_types
    from cyclonedds.core import Policy, Qos
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.pub import DataWriter
    from cyclonedds.topic import Topic
    from cyclonedds.util import duration

    participant = DomainParticipant(82)
    quality = Qos(Policy.Reliability.Reliable(duration(milliseconds=200)), Policy.History.KeepLast(5))

    def sender(topic: str, type_name: str) -> Send:
        kind = getattr(dds_types, type_name.split("/")[-1])
        writer = DataWriter(participant, Topic(participant, f"rt{topic}", kind, qos=quality), qos=quality)

        def send(values: dict[str, Any]) -> None:
            stamp = dds_types.Time(**values["header"]["stamp"])
            header = dds_types.Header(stamp, values["header"]["frame_id"])
            writer.write(kind(**{**values, "header": header, "data": values["data"].tobytes()}))

        return send

    yield {topic: sender(topic, type_name) for topic, type_name in topics.items()}


@contextmanager
def by_zenoh(topics: dict[str, str]) -> Iterator[dict[str, Send]]:
    """A Zenoh session that puts CDR under the keys of `rmw_zenoh`."""
    zenoh = pytest.importorskip("zenoh")
    from lmkit.live.ros.cdr import Cdr
    from lmkit.live.ros.zenoh_transport import dds_type

    config, cdr = zenoh.Config(), Cdr()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", '["tcp/127.0.0.1:17450"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config) as router:

        def sender(topic: str, type_name: str) -> Send:
            key = f"82{topic}/{dds_type(type_name)}/{cdr.type_hash(type_name)}"
            return lambda values: router.put(key, cdr.encode(type_name, values))

        yield {topic: sender(topic, type_name) for topic, type_name in topics.items()}


@contextmanager
def by_rosbridge(topics: dict[str, str]) -> Iterator[dict[str, Send]]:
    """A rosbridge server, which writes bytes as base64."""
    server = pytest.importorskip("websockets.sync.server")
    peers: list[Any] = []

    def talk(peer: Any) -> None:
        for _ in peer:
            peers.append(peer)

    def sender(topic: str) -> Send:
        def send(values: dict[str, Any]) -> None:
            text = base64.b64encode(values["data"].tobytes()).decode()
            for peer in peers:
                peer.send(json.dumps({"op": "publish", "topic": topic, "msg": {**values, "data": text}}))

        return send

    with server.serve(talk, "127.0.0.1", 17451) as serving:
        threading.Thread(target=serving.serve_forever, daemon=True).start()
        yield {topic: sender(topic) for topic in topics}
        serving.shutdown()


TRANSPORTS = {
    "dds": (by_cyclone, "transport=dds&domain=82"),
    "zenoh": (by_zenoh, "transport=zenoh&domain=82&url=tcp/127.0.0.1:17450"),
    "rosbridge": (by_rosbridge, "transport=rosbridge&url=ws://127.0.0.1:17451"),
}
every_transport = pytest.mark.parametrize("transport", TRANSPORTS)


@contextmanager
def sending(send: Callable[[], object]) -> Iterator[None]:
    """Send repeatedly in the meantime."""
    stop = threading.Event()

    def repeat() -> None:
        while not stop.wait(0.05):
            send()

    thread = threading.Thread(target=repeat, daemon=True)
    thread.start()
    yield
    stop.set()
    thread.join()


@every_transport
@both_types
def test_an_image_arrives_as_it_was_sent(transport, type_name):
    publisher, options = TRANSPORTS[transport]
    topic, clock = TOPIC[type_name], LoopClock()
    with publisher({topic: type_name}) as send:
        capture = open_capture(parse_source(f"ros2:{topic}?{options}"), clock)
        sent: list[float] = []

        def once() -> None:
            sent.append(clock.now() - 0.01)
            send[topic](message(type_name, SHOWN, sent[-1]))

        with sending(once):
            stamp, (image,) = until_read(capture)
        capture.close()
    assert np.array_equal(image, SHOWN)
    assert min(abs(stamp - s) for s in sent) < 1e-5


def until_read(capture: Any) -> Any:
    """The first image; a publisher may take seconds to be found."""
    for _ in range(8):
        try:
            return capture.read()
        except SourceLost:
            continue
    raise AssertionError("no image")


@pytest.mark.slow
def test_a_robot_is_located_by_the_images_of_two_topics(tmp_path):
    """Over DDS, compressed, from a writer of another implementation to a published pose."""
    from lmkit.io.landmark_map import map_to_yaml
    from lmkit.io.rig import rig_to_yaml
    from lmkit.simulation.robot_course import RobotCourse

    course = RobotCourse(3, 4.0)
    poses = [course.T_map_base(t) for t in np.arange(0, 4, 0.1)]
    truth = max(poses, key=lambda T: sum(map(len, course.corners(T))))
    images = dict(
        zip(("/left/image_raw/compressed", "/right/image_raw/compressed"), course.images(truth), strict=True)
    )
    (tmp_path / "rig.yaml").write_text(rig_to_yaml(course.rig))
    (tmp_path / "map.yaml").write_text(map_to_yaml(course.landmarks))
    options = TRANSPORTS["dds"][1]
    values = {"sources": [f"ros2:{t}?{options}" for t in images], "rig": "rig.yaml", "map": "map.yaml", "confirm": 1}
    with by_cyclone(dict.fromkeys(images, COMPRESSED)) as send:
        run, states = open_run(settings_of(values, tmp_path)), []
        end = time.monotonic() + 20

        def listen(state: Any) -> None:
            states.append(state)
            if state.T_map_base is not None or time.monotonic() > end:
                run.stop()

        def once() -> None:
            now = run.clock.now()
            for topic, image in images.items():
                noise = np.random.default_rng(int(1000 * now)).integers(0, 2, image.shape, dtype=np.uint8)
                send[topic](message(COMPRESSED, cv2.add(image, noise), now))

        run.listeners.append(listen)
        with sending(once):
            run.run()
    assert states[-1].T_map_base is not None, states[-1].reason
    assert np.linalg.norm(states[-1].T_map_base.t - truth.t) < 0.03


@pytest.mark.parametrize(
    ("change", "says"),
    [({"encoding": "32FC1"}, "encoding 32FC1"), ({"step": 7}, "bytes for an image"), ({"width": 0}, "0x48")],
)
def test_an_image_that_cannot_be_read_is_named(change, says):
    with pytest.raises(InputError, match=says):
        image_of({**message(IMAGE, SHOWN, 1.0), **change}, False, "/left/image_raw")
    with pytest.raises(InputError, match="neither JPEG nor PNG"):
        image_of({"data": b"no image"}, True, "/left/image_raw/compressed")


@pytest.mark.parametrize("text", ["ros2:", "ros2:/a?color=red", "ros2:/a!"])
def test_a_bad_address_is_refused(text):
    with pytest.raises(InputError):
        parse_source(text)


def test_a_topic_without_images_is_named():
    pytest.importorskip("rosless")
    capture = open_capture(parse_source("ros2:/nothing?transport=dds&domain=82"), LoopClock())
    with pytest.raises(SourceLost, match="no image on /nothing"):
        capture.read()
    capture.close()
