"""A recording of a live run in one MCAP file: all inputs of its poses, and its ROS 2 messages."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2

from lmkit.geometry.rig import AnyRig
from lmkit.io.landmark_map import map_to_yaml
from lmkit.io.rig import rig_to_yaml
from lmkit.live.outputs.base import OutputLost
from lmkit.live.recording_file import SETTINGS, STEP, image_topic, step_values
from lmkit.live.ros.cdr import Cdr
from lmkit.live.ros.messages import IMAGE, StepMessages, header
from lmkit.live.state import LiveState
from lmkit.model.landmark_map import LandmarkMap

CHUNK = 1 << 16  # largest loss of an interrupted run, bytes, besides one image
PNG_LEVEL = 1  # lossless at every level; this level is the fastest


class Recorder:
    """Writes every step; an existing file is never overwritten: the new name gets a number.

    Args:
        attached: files by name, such as ``map.yaml``, kept in the file.
        settings: settings of the loop, with the keys of a run file.

    Raises:
        OutputLost: the file cannot be written.
    """

    def __init__(
        self,
        path: Path,
        attached: dict[str, bytes],
        settings: dict[str, Any],
        messages: StepMessages,
        cameras: Sequence[str],
    ) -> None:
        from mcap.writer import CompressionType, Writer

        self._messages, self._cdr = messages, Cdr()
        try:
            self._path = free_name(path)
            self._file = self._path.open("wb")
            self._writer: Any = Writer(self._file, CHUNK, compression=CompressionType.NONE)
            self._writer.start(profile="ros2", library="lmkit")
            self._channels: dict[str, int] = {}
            for topic, type_name in [*messages.topics(cameras), *((image_topic(c), IMAGE) for c in cameras)]:
                self._channels[topic] = self._channel(topic, type_name)
            schema = self._writer.register_schema("lmkit.step", "jsonschema", b'{"type":"object"}')
            self._channels[STEP] = self._writer.register_channel(STEP, "json", schema)
            self._writer.add_metadata(SETTINGS, {"values": json.dumps(settings)})
            for name, data in attached.items():
                self._writer.add_attachment(0, 0, name, "application/octet-stream", data)
        except OSError as error:
            raise OutputLost(f"{path}: {error.strerror or error}") from None

    def _channel(self, topic: str, type_name: str) -> int:
        definition = self._cdr.definition(type_name).encode()
        schema = self._writer.register_schema(type_name, "ros2msg", definition)
        return int(self._writer.register_channel(topic, "cdr", schema))

    def send(self, state: LiveState) -> bool:
        """See `Output`."""
        if state.group is None:
            return False
        at = max(0, round(state.time_s * 1e9))
        try:
            for view in state.views:
                if view.image is not None:
                    _, data = cv2.imencode(".png", view.image, [cv2.IMWRITE_PNG_COMPRESSION, PNG_LEVEL])
                    values = {"header": header(view.time_s, view.name), "format": "png", "data": data.ravel()}
                    self._write(image_topic(view.name), self._cdr.encode(IMAGE, values), at)
            for message in self._messages.of_step(state):
                self._write(message.topic, self._cdr.encode(message.type_name, message.values), at)
            # The step is written last, after its data.
            self._write(STEP, json.dumps(step_values(state), allow_nan=False).encode(), at)
        except OSError as error:
            raise OutputLost(f"{self._path}: {error.strerror or error}") from None
        return True

    def _write(self, topic: str, data: bytes, at: int) -> None:
        self._writer.add_message(self._channels[topic], at, data, at)

    def close(self) -> None:
        """See `Output`; the index is written last, and a file without one is read as well."""
        try:
            self._writer.finish()
        finally:
            self._file.close()


def attached_files(
    rig_path: Path | None, map_path: Path | None, rig: AnyRig, landmarks: LandmarkMap
) -> dict[str, bytes]:
    """Files of rig and map, to replay a recording without other files; original files are unchanged."""
    return {
        **_file("rig", rig_path, rig_to_yaml(rig)),
        **_file("map", map_path, map_to_yaml(landmarks)),
    }


def _file(kind: str, path: Path | None, text: str) -> dict[str, bytes]:
    if path is None or not path.is_file():
        return {f"{kind}.yaml": text.encode()}
    return {kind + path.suffix: path.read_bytes()}


def free_name(path: Path) -> Path:
    """The path, or the first unused path with a number."""
    number, free = 1, path
    while free.exists():
        number += 1
        free = path.with_name(f"{path.stem}-{number}{path.suffix}")
    return free
