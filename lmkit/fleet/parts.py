"""Parts: sections of a recording as tables of the store, so that a job needs memory for one section only."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.fleet.store import Store
from lmkit.geometry.rig import AnyRig, mounted_cameras
from lmkit.io.any_rig import read_any_rig
from lmkit.io.rig import rig_to_yaml
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.observation import Detection, RangeBearing
from lmkit.model.recording import Gyro, Odometry, Recording, RigFrame
from lmkit.model.trajectory import Trajectory

PART_NAME = re.compile(r", part \d+ of \d+$")
READINGS = "readings.parquet"
FRAMES = 9000  # of a part: ten minutes at 15 frames a second


@dataclass(frozen=True)
class Part:
    """One part of a detected recording.

    Attributes:
        recording: the recording's name.
        key: of the recording's detections.
        number, count: number of the part, from 1, and number of parts.
    """

    recording: str
    key: str
    number: int
    count: int

    @property
    def name(self) -> str:
        """Name in messages and reports: the recording's name, with the part if there are several."""
        return self.recording if self.count == 1 else f"{self.recording}, part {self.number} of {self.count}"


def recording_of(part: str) -> str:
    """Name of the recording from the name of one of its parts."""
    return PART_NAME.sub("", part)


def split_frames(frames: Iterable[RigFrame], most: int) -> Iterator[tuple[RigFrame, ...]]:
    """Parts of ``most`` frames; the last one has 0.5 to 1.5 times as many, unless it is the only one."""
    source = iter(frames)
    part = tuple(islice(source, most))
    while part:
        following = tuple(islice(source, most))
        if 2 * len(following) < most:
            yield part + following
            return
        yield part
        part = following


def part_folder(folder: str, number: int) -> str:
    """Folder of a part inside its recording's folder."""
    return f"{folder}/{number:04d}"


def write_part(store: Store, folder: str, recording: Recording, rig: AnyRig | None) -> None:
    """Write detections or readings, odometry, gyro and rig as files of one folder of the store."""
    if rig is None:
        _write_readings(store, folder, recording)
    else:
        _write_detections(store, folder, recording)
        store.write(f"{folder}/rig.yaml", rig_to_yaml(rig))
    odometry, gyro = recording.odometry, recording.gyro
    if odometry is not None:
        kind = ("forward_m", "turn_rad") if isinstance(odometry, Odometry) else ("positions", "quaternions")
        store.write_table(
            f"{folder}/odometry.parquet", {name: getattr(odometry, name) for name in ("times_s", *kind)}
        )
    if gyro is not None:
        store.write_table(f"{folder}/gyro.parquet", {"times_s": gyro.times_s, "rate_radps": gyro.rate_radps})


def _write_readings(store: Store, folder: str, recording: Recording) -> None:
    rows = [(time_s, reading) for time_s, seen in recording.readings for reading in seen]
    columns: dict[str, Any] = {
        "time_s": np.array([time_s for time_s, _ in rows], dtype=np.float64),
        "id": [str(r.id) for _, r in rows],
        "range_m": np.array([r.range_m for _, r in rows], dtype=np.float64),  # None: NaN
        "bearing_rad": np.array([r.bearing_rad for _, r in rows], dtype=np.float64),
    }
    store.write_table(f"{folder}/{READINGS}", columns)


def _write_detections(store: Store, folder: str, recording: Recording) -> None:
    rows = [
        (k, camera, d)
        for k, frame in enumerate(recording.frames)
        for camera, seen in enumerate(frame.seen)
        for d in seen
    ]
    unknown = np.full((8, 8), np.nan)
    detections = [d for _, _, d in rows]
    columns: dict[str, Any] = {
        "frame": np.array([k for k, _, _ in rows], dtype=np.int32),
        "camera": np.array([camera for _, camera, _ in rows], dtype=np.int32),
        "id": [str(d.id) for d in detections],
        "corners": np.array([d.corners for d in detections], dtype=np.float64).reshape(-1, 8),
        "covariance": np.array(
            [unknown if d.covariance is None else d.covariance for d in detections], dtype=np.float64
        ).reshape(-1, 64),
        "confidence": np.array([d.confidence for d in detections], dtype=np.float64),
        "margin": np.array([d.margin for d in detections], dtype=np.float64),
    }
    store.write_table(f"{folder}/detections.parquet", columns)
    names = [f.name for f in recording.frames]
    store.write_table(f"{folder}/frames.parquet", {"time_s": recording.times_s, "name": names})


def read_part(store: Store, folder: str) -> tuple[Recording, AnyRig | None]:
    """A part as `write_part` wrote it.

    Raises:
        InputError: a file is missing or damaged.
    """
    odometry, gyro = _odometry(store, folder), _gyro(store, folder)
    if store.exists(f"{folder}/{READINGS}"):
        return Recording((), _readings(store, folder), odometry, gyro), None
    frames, rig = _frames(store, folder)
    return Recording(frames, (), odometry, gyro), rig


def _readings(store: Store, folder: str) -> tuple[tuple[float, tuple[RangeBearing, ...]], ...]:
    columns, _ = store.read_table(f"{folder}/{READINGS}")
    seen: dict[float, list[RangeBearing]] = {}
    for time_s, id_, *values in zip(*columns.values(), strict=True):
        distance, bearing = (None if np.isnan(value) else float(value) for value in values)
        seen.setdefault(float(time_s), []).append(
            RangeBearing(LandmarkId.parse(id_), distance, bearing, float(time_s))
        )
    return tuple((time_s, tuple(some)) for time_s, some in seen.items())


def _frames(store: Store, folder: str) -> tuple[tuple[RigFrame, ...], AnyRig]:
    with tempfile.TemporaryDirectory(prefix="lmkit-") as scratch:
        path = Path(scratch) / "rig.yaml"
        path.write_bytes(store.read(f"{folder}/rig.yaml"))
        rig = read_any_rig(path)
    frames, _ = store.read_table(f"{folder}/frames.parquet")
    rows, _ = store.read_table(f"{folder}/detections.parquet")
    count = len(mounted_cameras(rig))
    seen: list[list[list[Detection]]] = [[[] for _ in range(count)] for _ in frames["time_s"]]
    ids = {text: LandmarkId.parse(text) for text in set(rows["id"])}
    for k, camera, id_, corners, C, confidence, margin in zip(*rows.values(), strict=True):
        covariance = None if np.isnan(C).any() else C.reshape(8, 8)
        seen[k][camera].append(
            Detection(ids[id_], corners.reshape(4, 2), float(confidence), float(margin), covariance)
        )
    rig_frames = tuple(
        RigFrame(float(time_s), tuple(map(tuple, some)), label)
        for time_s, label, some in zip(frames["time_s"], frames["name"], seen, strict=True)
    )
    return rig_frames, rig


def _odometry(store: Store, folder: str) -> Odometry | Trajectory | None:
    columns = _numbers(store, f"{folder}/odometry.parquet")
    if columns is None:
        return None
    return Odometry(**columns) if "forward_m" in columns else Trajectory(**columns)


def _gyro(store: Store, folder: str) -> Gyro | None:
    columns = _numbers(store, f"{folder}/gyro.parquet")
    return None if columns is None else Gyro(**columns)


def _numbers(store: Store, name: str) -> dict[str, FloatArray] | None:
    return store.read_table(name)[0] if store.exists(name) else None
