"""`lmkit fleet detect`: landmarks of every recording, once; cost follows the images, all later stages are cheap."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lmkit.errors import InputError
from lmkit.fleet.jobs import StageJob, done_jobs
from lmkit.fleet.recordings import BAG_FOLDER_HAS, BAGS, FleetRecording
from lmkit.fleet.store import Store, open_uri
from lmkit.geometry.rig import AnyRig, mounted_cameras
from lmkit.io.any_rig import read_any_rig
from lmkit.io.rig import rig_to_yaml
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.observation import Detection
from lmkit.model.recording import Gyro, Odometry, Recording, RigFrame
from lmkit.model.trajectory import Trajectory
from lmkit.pipelines.recording_checks import require_plausible_recording
from lmkit.pipelines.recording_folder import read_recording_folder

STAGE = "detect"


@dataclass(frozen=True)
class Detected:
    """A detected recording, read back from the store."""

    name: str
    rig: AnyRig
    recording: Recording


def detect_recording(job: StageJob) -> dict[str, Any]:
    """Work of one job: fetch the recording, detect, write tables, delete what was fetched."""
    with tempfile.TemporaryDirectory(prefix="lmkit-") as scratch:
        folder = _fetched(job, Path(scratch))
        rig = _rig_of(job, folder)
        options = job.options
        recording = read_recording_folder(
            folder, rig, options["families"], options.get("hz"), options.get("wheel_track_m")
        )
    require_plausible_recording(recording, rig)
    write_recording(job.store, f"{STAGE}/{job.key}", recording, rig)
    times = [frame.time_s for frame in recording.frames]
    seen = {d.id for frame in recording.frames for d in frame.detections}
    return {
        "frames": len(times),
        "detections": sum(len(frame.detections) for frame in recording.frames),
        "landmarks": len(seen),
        "from_s": min(times, default=None),
        "to_s": max(times, default=None),
        "odometry": recording.odometry is not None,
    }


def _fetched(job: StageJob, scratch: Path) -> Path:
    """The folder with the recording's files, unpacked and on this machine."""
    from pyarrow import fs

    source = job.recording.source
    limit = job.options.get("max_bytes")
    if limit is not None and job.recording.bytes > limit:
        raise InputError(
            "too_large", f"{source} has {job.recording.bytes} bytes, more than {limit}", "raise --max-bytes"
        )
    path = Path(source)
    if "://" in source:
        files, inside = open_uri(source)
        path = scratch / Path(inside).name
        fs.copy_files(inside, str(path), source_filesystem=files, destination_filesystem=fs.LocalFileSystem())
    is_bag = path.suffix.lower() in BAGS or (path.is_dir() and (path / BAG_FOLDER_HAS).exists())
    if not is_bag:
        if not path.is_dir():
            raise InputError("file_missing", f"{source} no longer exists", "scan again")
        return path
    from lmkit.io.bags import unpack_bag
    from lmkit.io.files import write_file

    unpacked = scratch / "unpacked"
    for file in unpack_bag(path, {}):
        write_file(unpacked / file.name, file.content, True)
    return unpacked


def _rig_of(job: StageJob, folder: Path) -> AnyRig:
    rig = Path(job.recording.rig) if job.recording.rig else folder / "rig.yaml"
    if not rig.is_file():
        hint = "give --rig to lmkit fleet scan, or put rig.yaml into the recording's folder"
        raise InputError("no_rig", f"{rig}, the rig of {job.recording.name}, does not exist", hint)
    return read_any_rig(rig)


def write_recording(store: Store, folder: str, recording: Recording, rig: AnyRig) -> None:
    """Write detections, odometry, gyro and rig as files of one folder of the store."""
    rows: dict[str, list[Any]] = {
        name: [] for name in ("frame", "camera", "id", "corners", "covariance", "confidence", "margin")
    }
    for k, frame in enumerate(recording.frames):
        for camera, seen in enumerate(frame.seen):
            for d in seen:
                C = None if d.covariance is None else d.covariance.ravel().tolist()
                values = (k, camera, str(d.id), d.corners.ravel().tolist(), C, d.confidence, d.margin)
                for column, value in zip(rows.values(), values, strict=True):
                    column.append(value)
    store.write_table(f"{folder}/detections.parquet", rows)
    times, names = [f.time_s for f in recording.frames], [f.name for f in recording.frames]
    store.write_table(f"{folder}/frames.parquet", {"time_s": times, "name": names})
    odometry, gyro = recording.odometry, recording.gyro
    if isinstance(odometry, Odometry):
        columns = {name: getattr(odometry, name).tolist() for name in ("times_s", "forward_m", "turn_rad")}
        store.write_table(f"{folder}/odometry.parquet", columns)
    elif odometry is not None:
        columns = {name: getattr(odometry, name).tolist() for name in ("times_s", "positions", "quaternions")}
        store.write_table(f"{folder}/odometry.parquet", columns)
    if gyro is not None:
        store.write_table(
            f"{folder}/gyro.parquet", {"times_s": gyro.times_s.tolist(), "rate_radps": gyro.rate_radps.tolist()}
        )
    store.write(f"{folder}/rig.yaml", rig_to_yaml(rig))


def detected_recordings(store: Store, options: Mapping[str, Any]) -> list[FleetRecording]:
    """Recordings that were detected with these options."""
    return [recording for recording, _, outcome in done_jobs(store, STAGE, options) if outcome.ok]


def read_detected(store: Store, name: str, key: str) -> Detected:
    """A recording as `detect_recording` wrote it.

    Raises:
        InputError: a file is missing or damaged.
    """
    folder = f"{STAGE}/{key}"
    with tempfile.TemporaryDirectory(prefix="lmkit-") as scratch:
        path = Path(scratch) / "rig.yaml"
        path.write_bytes(store.read(f"{folder}/rig.yaml"))
        rig = read_any_rig(path)
    frames, _ = store.read_table(f"{folder}/frames.parquet")
    rows, _ = store.read_table(f"{folder}/detections.parquet")
    count = len(mounted_cameras(rig))
    seen: list[list[list[Detection]]] = [[[] for _ in range(count)] for _ in frames["time_s"]]
    for k, camera, id_, corners, C, confidence, margin in zip(*rows.values(), strict=True):
        covariance = None if C is None else np.array(C).reshape(8, 8)
        points = np.array(corners).reshape(4, 2)
        seen[k][camera].append(Detection(LandmarkId.parse(id_), points, confidence, margin, covariance))
    rig_frames = tuple(
        RigFrame(time_s, tuple(map(tuple, some)), label)
        for time_s, label, some in zip(frames["time_s"], frames["name"], seen, strict=True)
    )
    return Detected(name, rig, Recording(rig_frames, (), _odometry(store, folder), _gyro(store, folder)))


def _odometry(store: Store, folder: str) -> Odometry | Trajectory | None:
    if not store.exists(f"{folder}/odometry.parquet"):
        return None
    columns = {name: np.array(values) for name, values in store.read_table(f"{folder}/odometry.parquet")[0].items()}
    return Odometry(**columns) if "forward_m" in columns else Trajectory(**columns)


def _gyro(store: Store, folder: str) -> Gyro | None:
    if not store.exists(f"{folder}/gyro.parquet"):
        return None
    return Gyro(**{name: np.array(values) for name, values in store.read_table(f"{folder}/gyro.parquet")[0].items()})
