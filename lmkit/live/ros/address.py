"""Addresses of ROS 2, such as ``ros2?transport=zenoh`` and ``ros2:/odom``."""

from __future__ import annotations

import re
from dataclasses import dataclass
from urllib.parse import parse_qsl

from lmkit.errors import InputError
from lmkit.model.landmark_id import LandmarkId

TRANSPORTS = ("auto", "rclpy", "dds", "zenoh", "rosbridge")
TF = ("auto", "base", "no")
ZENOH_ROUTER = "tcp/localhost:7447"
ROSBRIDGE = "ws://localhost:9090"
_RATE = re.compile(r"\d{1,3}(\.\d+)?")
_NAME = re.compile(r"/?[A-Za-z_][\w/]*")


@dataclass(frozen=True)
class RosAddress:
    """Connection to ROS 2, and the names used in ROS 2.

    Attributes:
        topic: of an input; empty for the output.
        transport: ``auto``, ``rclpy``, ``dds``, ``zenoh`` or ``rosbridge``.
        domain: ROS_DOMAIN_ID.
        url: of the Zenoh router or the rosbridge server; empty: the usual one on this machine.
        namespace: of the topics, without slashes at its ends.
        map_frame, odom_frame, base_frame: names of the frames.
        tf: ``auto``: map->odom if odometry has poses; ``base``: map->base; ``no``.
        odometry: also publish the pose as nav_msgs/Odometry.
        dock: landmark of a dock.
        images_hz: largest rate of annotated images; 0: none.
        hashes: type hashes in Zenoh's keys (ROS 2 before Iron has none).
    """

    topic: str = ""
    transport: str = "auto"
    domain: int = 0
    url: str = ""
    namespace: str = "lmkit"
    map_frame: str = "map"
    odom_frame: str = "odom"
    base_frame: str = "base_link"
    tf: str = "auto"
    odometry: bool = False
    dock: LandmarkId | None = None
    hashes: bool = True
    images_hz: float = 0.0


def parse_ros(text: str) -> RosAddress:
    """The address after ``ros2``, such as ``:/odom?transport=zenoh``.

    Raises:
        InputError: an unknown option or value.

    Examples:
        >>> parse_ros(":/odom?transport=zenoh&domain=7").domain
        7
    """
    place, _, query = text.partition("?")
    given = dict(parse_qsl(query, keep_blank_values=True))
    topic = place.removeprefix(":")
    if topic and not _NAME.fullmatch(topic):
        raise InputError("bad_ros", f"ros2{text}: {topic!r} is not a topic", "write for example ros2:/odom")
    take = given.pop
    transport, tf, domain = take("transport", "auto"), take("tf", "auto"), take("domain", "0")
    odometry, hashes, dock = take("odometry", "no"), take("hashes", "yes"), take("dock", "")
    names = [
        take(name, default)
        for name, default in (("namespace", "lmkit"), ("map", "map"), ("odom", "odom"), ("base", "base_link"))
    ]
    url, images = take("url", ""), take("images", "0")
    wrong = (
        transport not in TRANSPORTS
        or tf not in TF
        or not (domain.isdecimal() and int(domain) <= 232)
        or not {odometry, hashes} <= {"yes", "no"}
        or not _RATE.fullmatch(images)
        or any(not _NAME.fullmatch(name) for name in names)
    )
    if given or wrong:
        raise InputError(
            "bad_ros",
            f"ros2{text}: unknown option or value",
            f"transport={'|'.join(TRANSPORTS)}, domain, url, namespace, map, odom, base, tf={'|'.join(TF)}, "
            "odometry=yes, dock, images=5 (a second), hashes=no",
        )
    return RosAddress(
        "/" + topic.strip("/") if topic else "", transport, int(domain), url, names[0].strip("/"),
        names[1], names[2], names[3], tf, odometry == "yes", LandmarkId.parse(dock) if dock else None,
        hashes == "yes", float(images),
    )  # fmt: skip
