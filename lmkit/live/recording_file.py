"""The MCAP file of a recorded run: writing of steps, and reading of their frames."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from lmkit.errors import EXTRA, InputError
from lmkit.geometry.pose import Pose
from lmkit.live.frame_group import FrameGroup
from lmkit.live.motion import MotionRow
from lmkit.live.ros.messages import IMAGE
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.observation import Detection

if TYPE_CHECKING:
    from lmkit.arrays import ByteArray
    from lmkit.live.state import LiveState

STEP, SETTINGS, IMAGES = "/lmkit/step", "lmkit", "/image/compressed"
_HINT = "give a file that lmkit run --record has written"


def image_topic(camera: str) -> str:
    """Topic of a camera's images."""
    return f"/lmkit/{camera}{IMAGES}"


def step_values(state: LiveState) -> dict[str, Any]:
    """A step as JSON values: the object of every output, and under ``input`` the input of the loop."""
    group = state.group
    assert group is not None
    given = {
        "time_s": group.time_s,
        "stamps_s": list(group.stamps_s),
        "images": [image is not None for image in group.images],
        "profile": state.profile,
        "motion": [_row_values(row) for row in group.motion],
        "seen": None if group.seen is None else [[_detection_values(d) for d in seen] for seen in group.seen],
        "truth": _pose_values(state.truth),
    }
    return {**state.to_dict(), "input": given}


def _row_values(row: MotionRow) -> list[Any]:
    return [
        row.kind,
        row.time_s,
        list(row.values),
        _pose_values(row.T_odometry_base),
        _pose_values(row.T_smooth_base),
    ]


def _pose_values(pose: Pose | None) -> list[Any] | None:
    # The matrix, not a quaternion, to avoid rounding.
    return None if pose is None else [pose.to_frame, pose.from_frame, pose.R.tolist(), pose.t.tolist()]


def _pose(values: list[Any] | None) -> Pose | None:
    return None if values is None else Pose(values[0], values[1], np.array(values[2]), np.array(values[3]))


def _detection_values(d: Detection) -> list[Any]:
    C = None if d.covariance is None else d.covariance.tolist()
    return [d.id.family, d.id.code, d.corners.tolist(), d.confidence, d.margin, C]


def _detection(values: list[Any]) -> Detection:
    C = None if values[5] is None else np.array(values[5])
    return Detection(LandmarkId(values[0], values[1]), np.array(values[2]), values[3], values[4], C)


class RunRecording:
    """A recording that is open for reading.

    Attributes:
        settings: settings of the run with the keys of a run file, and ``motion``.
        attached: bytes by name.

    Raises:
        InputError: no such file, or not a recording of lmkit.
    """

    def __init__(self, path: Path) -> None:
        if find_spec("mcap") is None:
            raise InputError("extra_missing", "recordings need the package mcap", EXTRA.format("bags"))
        self.path = path
        self.attached: dict[str, bytes] = {}
        settings: str | None = None
        for record in self._records():
            if isinstance(record, self._types.Metadata) and record.name == SETTINGS:
                settings = record.metadata["values"]
            elif isinstance(record, self._types.Attachment):
                self.attached[record.name] = record.data
            elif isinstance(record, self._types.Message):
                break
        if settings is None:
            raise InputError("bad_recording", f"{path}: not a recording of lmkit run", _HINT)
        self.settings: dict[str, Any] = json.loads(settings)

    @property
    def _types(self) -> Any:
        return import_module("mcap.records")

    def _records(self) -> Iterator[Any]:
        """Records in the order of the file; a truncated file has no end and no index."""
        from mcap.exceptions import EndOfFile, McapError
        from mcap.stream_reader import StreamReader

        try:
            with self.path.open("rb") as file:
                yield from StreamReader(file).records
        except (EndOfFile, struct.error):  # within a record
            return
        except OSError as error:
            raise InputError(
                "file_unreadable", f"cannot read {self.path}: {error.strerror or error}", _HINT
            ) from None
        except McapError as error:
            raise InputError("bad_recording", f"{self.path}: {error}", _HINT) from None

    def groups(self) -> Iterator[FrameGroup]:
        """Input of every step, in order, up to the end of the file."""
        from lmkit.live.ros.cdr import Cdr

        cdr, types = Cdr(), self._types
        topics: dict[int, str] = {}
        images: list[ByteArray] = []
        for record in self._records():
            if isinstance(record, types.Channel):
                topics[record.id] = record.topic
            if not isinstance(record, types.Message):
                continue
            topic = topics[record.channel_id]
            if topic == STEP:
                yield _group(json.loads(record.data)["input"], images)
                images = []
            elif topic.endswith(IMAGES):
                data = np.asarray(cdr.decode_arrays(IMAGE, record.data).data, dtype=np.uint8)
                images.append(np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), dtype=np.uint8))


def _group(values: dict[str, Any], images: list[ByteArray]) -> FrameGroup:
    left = iter(images)
    rows = [MotionRow(kind, t, tuple(v), _pose(T), _pose(S)) for kind, t, v, T, S in values["motion"]]
    seen = values["seen"]
    return FrameGroup(
        values["time_s"],
        tuple(next(left) if shown else None for shown in values["images"]),
        tuple(values["stamps_s"]),
        tuple(rows),
        None if seen is None else tuple([_detection(d) for d in row] for row in seen),
        values["profile"],
        _pose(values["truth"]),
    )
