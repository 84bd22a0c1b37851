"""Bags of ROS 1, ROS 2 and MCAP (extra ``bags``): unpack a recording into files, write poses to a bag.

Everything else in lmkit reads files, so a bag is unpacked once: stereo images named by their time, both
``camera_info`` as a rig, odometry and gyro as tables.
"""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from lmkit.errors import EXTRA, InputError, InputWarning, warn_caller
from lmkit.geometry.imu_axes import upward_rates
from lmkit.io.documents import dump_yaml
from lmkit.io.ros_camera_info import FILES
from lmkit.io.ros_images import COMPRESSED, IMAGE, pixels_of
from lmkit.model.scan import LaserScan
from lmkit.model.trajectory import Trajectory

APART_S = 0.01  # images of one frame
MOST_WAITING = 100
IMAGES = (IMAGE, COMPRESSED)
LASER = "sensor_msgs/msg/LaserScan"
INFO, ODOMETRY, IMU = "sensor_msgs/msg/CameraInfo", "nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu"


@dataclass(frozen=True)
class Topics:
    """Topics of a bag by role; None if there is none."""

    left: str
    right: str
    left_info: str | None
    right_info: str | None
    odometry: str | None
    imu: str | None


@dataclass(frozen=True)
class Unpacked:
    """One file of a recording: its name in the folder, and its bytes."""

    name: str
    content: bytes


# Words of rosbags for a recording that was cut off, or lacks a file.
_REPAIRS = {
    "File end magic": "the recording was cut off: mcap recover FILE -o NEW",
    "malformed": "the recording was cut off: sqlite3 FILE .recover | sqlite3 NEW",
    "Bag is not indexed": "the recording was cut off: rosbag reindex FILE",
    "metadata file": "ros2 bag reindex FOLDER, or give the .db3 or .mcap file itself",
}
LATEST_STAMP_S = 2.0**31  # 32 bits, in January 2038


def unpack_bag(bag: Path, wanted: dict[str, str | None]) -> Iterator[Unpacked]:
    """The files of a recording: images in the order of the bag, tables at the end.

    Args:
        wanted: topics by role (a field of :class:`Topics`); None or absent: found by type and name.

    Raises:
        InputError: rosbags is not installed, the bag cannot be read, or it has no stereo images.
    """
    _require_rosbags()
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    try:
        with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            topics = find_topics({c.topic: c.msgtype for c in reader.connections}, wanted, bag)
            yield from _unpack(reader, topics)
    except InputError:
        raise
    except Exception as error:  # damaged bags end in every kind of exception in rosbags
        problem = str(error) or type(error).__name__
        raise _unreadable(bag, problem) from None


def read_laser_messages(bag: Path, topic: str | None = None) -> list[LaserScan]:
    """All LaserScan messages of one topic.

    Raises:
        InputError: rosbags is not installed, the bag cannot be read, or not exactly one topic matches.
    """
    _require_rosbags()
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.rosbag1 import ReaderError as Ros1Error
    from rosbags.rosbag2 import ReaderError as Ros2Error
    from rosbags.serde import SerdeError
    from rosbags.typesys import Stores, TypesysError, get_typestore

    try:
        with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            wanted = _scan_topic({c.topic: c.msgtype for c in reader.connections}, topic, bag)
            connections = [c for c in reader.connections if c.topic == wanted]
            return [
                _laser_scan(reader.deserialize(raw, connection.msgtype))
                for connection, _, raw in reader.messages(connections=connections)
            ]
    except (AnyReaderError, Ros1Error, Ros2Error, SerdeError, TypesysError, OSError) as error:
        raise _unreadable(bag, str(error)) from None


def _unreadable(bag: Path, problem: str) -> InputError:
    """The error for a bag that rosbags cannot read; recordings that were cut off can be repaired."""
    remedy = next((remedy for words, remedy in _REPAIRS.items() if words in problem), None)
    return InputError("bad_bag", f"cannot read {bag} ({problem})", remedy or "give a ROS 1 or ROS 2 bag or MCAP")


def _scan_topic(types: dict[str, str], asked: str | None, bag: Path) -> str:
    fitting = sorted(topic for topic, kind in types.items() if kind == LASER)
    if asked is not None and asked in fitting:
        return asked
    if asked is None and len(fitting) == 1:
        return fitting[0]
    holds = ", ".join(fitting) if fitting else "none"
    hint = "name one with --scan-topic" if fitting else "record the scanner's topic"
    what = f"no topic {asked}" if asked is not None else "not one topic"
    raise InputError("no_topic", f"{bag}: {what} of {LASER} (it contains {holds})", hint)


def _laser_scan(message: Any) -> LaserScan:
    ranges = np.array(message.ranges, dtype=np.float64)
    low, high = float(message.range_min), float(message.range_max)
    seen = (ranges >= low) & (ranges <= (high if high > 0 else np.inf))
    intensities = np.array(message.intensities, dtype=np.float64)
    return LaserScan(
        message.header.stamp.sec + message.header.stamp.nanosec * 1e-9,
        float(message.angle_min),
        float(message.angle_increment),
        np.where(seen, ranges, np.nan),
        np.nan_to_num(intensities) if len(intensities) == len(ranges) else None,
        float(message.time_increment),
    )


def find_topics(types: dict[str, str], wanted: dict[str, str | None], bag: Path) -> Topics:
    """Topics by role, from the types of all topics.

    Raises:
        InputError: a topic asked for is not there, or no topics of left and right images are found.
    """
    found: dict[str, str | None] = {}
    for role, kinds, word in (
        ("left", IMAGES, "left"),
        ("right", IMAGES, "right"),
        ("left_info", (INFO,), "left"),
        ("right_info", (INFO,), "right"),
        ("odometry", (ODOMETRY,), ""),
        ("imu", (IMU,), ""),
    ):
        asked = wanted.get(role)
        if asked is not None:
            if types.get(asked) not in kinds:
                raise InputError(
                    "no_topic",
                    f"{bag}: no topic {asked} of {' or '.join(kinds)}",
                    f"it contains {', '.join(sorted(types))}",
                )
            found[role] = asked
            continue
        fitting = sorted((t for t, kind in types.items() if kind in kinds and word in t), key=lambda t: (len(t), t))
        beside = _beside(found[word], types) if role.endswith("_info") else None
        found[role] = beside or (fitting[0] if fitting else None)
    left, right = found["left"], found["right"]
    if left is None or right is None:
        images = sorted(topic for topic, kind in types.items() if kind in IMAGES)
        if len(images) < 2:
            holds = f"one topic of images, {images[0]}" if images else "no images"
            raise InputError(
                "not_stereo",
                f"{bag}: it contains {holds}, but images of two cameras are needed",
                "record the images of both cameras",
            )
        raise InputError(
            "no_images",
            f"{bag}: no topics of left and right images among {', '.join(images)}",
            "name them: --left TOPIC --right TOPIC",
        )
    return Topics(left, right, found["left_info"], found["right_info"], found["odometry"], found["imu"])


def _beside(images: str | None, types: dict[str, str]) -> str | None:
    """The camera_info that ROS drivers publish beside a topic of images; None if there is none."""
    names = [] if images is None else [f"{parent}/camera_info" for parent in _parents(images)]
    return next((name for name in names if types.get(name) == INFO), None)


def _parents(topic: str) -> list[str]:
    """The namespaces of a topic, the innermost first."""
    words = topic.split("/")
    return ["/".join(words[:count]) for count in range(len(words) - 1, 1, -1)]


def poses_to_bag(folder: Path, trajectory: Trajectory, frame: str = "map") -> None:
    """A ROS 2 bag (sqlite3): nav_msgs/Path of all poses on /lmkit/path, then each as PoseStamped on /lmkit/pose.

    Raises:
        InputError: rosbags is not installed, the folder exists, or it cannot be written.
    """
    _require_rosbags()
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    if folder.exists():
        raise InputError("file_exists", f"{folder} exists", "choose another name with -o")
    if (latest := float(np.abs(trajectory.times_s).max())) >= LATEST_STAMP_S:
        raise InputError(
            "implausible_times",
            f"the trajectory has times up to {latest:.10g} s, and stamps of ROS end at {LATEST_STAMP_S:g} s",
            "write times in seconds: divide milliseconds by 1000",
        )
    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    stamped, path = "geometry_msgs/msg/PoseStamped", "nav_msgs/msg/Path"
    poses = []
    for time_s, p, q in zip(trajectory.times_s, trajectory.positions, trajectory.quaternions, strict=True):
        nanoseconds = round(float(time_s) * 1e9)
        stamp = types["builtin_interfaces/msg/Time"](nanoseconds // 10**9, nanoseconds % 10**9)
        message = types[stamped](
            types["std_msgs/msg/Header"](stamp, frame),
            types["geometry_msgs/msg/Pose"](
                types["geometry_msgs/msg/Point"](*map(float, p)),
                types["geometry_msgs/msg/Quaternion"](*map(float, q)),
            ),
        )
        poses.append((nanoseconds, message))
    # Written to another folder first, so that no partial bag remains; files in a bag are named after the folder.
    partial = folder.with_name(f".{folder.name}.partial")
    try:
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
        with Writer(partial / folder.name, version=8) as writer:
            first: Any = poses[0][1]
            whole = types[path](first.header, [message for _, message in poses])
            on_path = writer.add_connection("/lmkit/path", path, typestore=store)
            writer.write(on_path, poses[0][0], store.serialize_cdr(whole, path))
            on_pose = writer.add_connection("/lmkit/pose", stamped, typestore=store)
            for nanoseconds, message in poses:
                writer.write(on_pose, nanoseconds, store.serialize_cdr(message, stamped))
        (partial / folder.name).rename(folder)
    except (OSError, sqlite3.Error) as error:
        raise InputError(
            "not_writable", f"cannot write {folder}: {error}", "choose a folder with space left"
        ) from None
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _require_rosbags() -> None:
    if find_spec("rosbags") is None:
        raise InputError("no_rosbags", "bags need the package rosbags", EXTRA.format("bags"))


def _unpack(reader: Any, topics: Topics) -> Iterator[Unpacked]:
    waiting: dict[str, list[tuple[float, bytes, str]]] = {"left": [], "right": []}
    roles = {topic: role for role, topic in vars(topics).items() if topic is not None}
    odometry, poses = ["time_s,x_m,y_m,heading_rad"], ["# time x y z qx qy qz qw"]
    inertial: list[tuple[float, ...]] = []
    last = {"odometry": -np.inf, "imu": -np.inf}
    infos: set[str] = set()
    number = 0
    connections = [c for c in reader.connections if c.topic in roles]
    for connection, _, raw in reader.messages(connections=connections):
        role, message = roles[connection.topic], reader.deserialize(raw, connection.msgtype)
        time_s = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9
        if role in ("left", "right"):
            waiting[role].append((time_s, *_image(message, connection.msgtype, connection.topic)))
            # So many images without a partner: the other camera has stopped.
            del waiting[role][:-MOST_WAITING]
            for pair in _pairs(waiting):
                for side, (_, content, suffix) in pair.items():
                    yield Unpacked(f"{side}/{number:06d}_{pair['left'][0]:.6f}{suffix}", content)
                number += 1
        elif role in ("left_info", "right_info"):
            if role not in infos:
                infos.add(role)
                yield Unpacked(f"rig/{FILES[role == 'right_info']}", dump_yaml(_camera_info(message)).encode())
        elif time_s > last[role]:
            last[role] = time_s
            if role == "odometry":
                p, q = message.pose.pose.position, message.pose.pose.orientation
                heading = np.arctan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y**2 + q.z**2))
                odometry.append(f"{time_s:.6f},{p.x:.6f},{p.y:.6f},{heading:.6f}")
                numbers = " ".join(f"{v:.9f}" for v in (p.x, p.y, p.z, q.x, q.y, q.z, q.w))
                poses.append(f"{time_s:.6f} {numbers}")
            else:
                measured = message.angular_velocity, message.linear_acceleration
                inertial.append((time_s, *(v for m in measured for v in (m.x, m.y, m.z))))
    if number == 0:
        raise InputError(
            "no_pairs",
            f"no images of {topics.left} and {topics.right} within {1000 * APART_S:g} ms of each other",
            "check that both cameras were recorded, with stamps of one clock",
        )
    for name, lines in (("odometry.csv", odometry), ("odometry.tum", poses), ("gyro.csv", _gyro_lines(inertial))):
        if len(lines) > 2:
            yield Unpacked(name, ("\n".join(lines) + "\n").encode())


def _gyro_lines(inertial: list[tuple[float, ...]]) -> list[str]:
    """Lines of a gyro table from time, angular velocity and linear acceleration of each message."""
    table = np.array(inertial, dtype=np.float64).reshape(-1, 7)
    rates, sentence = upward_rates(table[:, 1:4], table[:, 4:])
    if sentence is not None:
        warn_caller(InputWarning(sentence))
    rows = zip(table[:, 0].tolist(), rates.tolist(), strict=True)
    return ["time_s,rate_radps", *(f"{time_s:.6f},{rate:.6f}" for time_s, rate in rows)]


def _pairs(waiting: dict[str, list[tuple[float, bytes, str]]]) -> Iterator[dict[str, tuple[float, bytes, str]]]:
    """Images of one frame, removed from the lists; images that can no longer have a partner are dropped."""
    left, right = waiting["left"], waiting["right"]
    while left and right:
        apart = right[0][0] - left[0][0]
        if abs(apart) <= APART_S:
            yield {"left": left.pop(0), "right": right.pop(0)}
        elif apart > 0:
            left.pop(0)
        else:
            right.pop(0)


def _image(message: Any, kind: str, topic: str) -> tuple[bytes, str]:
    """The bytes of an image file, and its suffix."""
    if kind == IMAGES[1]:
        suffix = ".png" if "png" in message.format.lower() else ".jpg"
        return bytes(message.data), suffix
    size = message.width, message.height
    pixels = pixels_of(message.encoding, size, message.step, bytes(message.data), topic)
    return cv2.imencode(".png", pixels)[1].tobytes(), ".png"


def _camera_info(message: Any) -> dict[str, Any]:
    """Camera info as ROS's calibration files have it; ROS 1 writes the fields in capitals."""

    def values(name: str) -> list[float]:
        return [float(v) for v in getattr(message, name, getattr(message, name.upper(), []))]

    def matrix(name: str, rows: int) -> dict[str, Any]:
        data = values(name)
        return {"rows": rows, "cols": len(data) // rows, "data": data}

    return {
        "image_width": int(message.width),
        "image_height": int(message.height),
        "camera_name": str(message.header.frame_id) or "camera",
        "camera_matrix": matrix("k", 3),
        "distortion_model": str(message.distortion_model),
        "distortion_coefficients": matrix("d", 1),
        "rectification_matrix": matrix("r", 3),
        "projection_matrix": matrix("p", 3),
    }
