"""`lmkit fleet detect`: detect the landmarks of every recording once; later stages do not read images."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from lmkit.errors import InputError
from lmkit.fleet import parts
from lmkit.fleet.jobs import Outcome, StageJob, done_jobs, read_outcome
from lmkit.fleet.parts import Part, part_folder, read_part, split_frames, write_part
from lmkit.fleet.recordings import BAG_FOLDER_HAS, BAGS, FleetRecording, parse_topics
from lmkit.fleet.store import Store, open_uri
from lmkit.geometry.rig import AnyRig
from lmkit.io.any_rig import read_any_rig
from lmkit.model.recording import Recording
from lmkit.pipelines.detect_recording import OpenRecording
from lmkit.pipelines.recording_checks import require_plausible_recording
from lmkit.pipelines.recording_folder import has_readings, open_recording_folder

STAGE = "detect"
# Hints for file errors, by code, for this command.
SCAN_HINTS = {
    "no_track": "give the distance between the wheels to lmkit fleet scan: --wheel-track 0.4m",
    "no_images": "name them to lmkit fleet scan: --topic left=TOPIC --topic right=TOPIC",
    "no_base": "give lmkit fleet scan a rig file with T_base_left: --rig",
}


def detect_recording(job: StageJob) -> dict[str, Any]:
    """Work of one job: fetch the recording, detect, write tables part by part, delete the fetched files."""
    found = _Found()
    with tempfile.TemporaryDirectory(prefix="lmkit-") as scratch:
        folder = _fetched(job, Path(scratch))
        rig = None if has_readings(folder) else _rig_of(job, folder)
        opened = _opened(job, folder, rig)
        for whole, part in _parts(opened):
            require_plausible_recording(whole, rig)
            found.add(part)
            write_part(job.store, part_folder(f"{STAGE}/{job.key}", found.parts), part, rig)
    return {**found.facts(), "odometry": opened.rest.odometry is not None}


def _opened(job: StageJob, folder: Path, rig: AnyRig | None) -> OpenRecording:
    track_m = job.recording.wheel_track_m or None
    try:
        return open_recording_folder(folder, rig, job.options["families"], job.options.get("hz"), track_m)
    except InputError as error:
        raise InputError(error.code, error.message, SCAN_HINTS.get(error.code, error.hint)) from None


def _parts(opened: OpenRecording) -> Iterator[tuple[Recording, Recording]]:
    """Each part twice: with all odometry for checks, and with its own rows for the store; readings are one part."""
    if opened.rest.readings:
        yield opened.rest, opened.rest
        return
    for frames in split_frames(opened.frames, parts.FRAMES):
        yield replace(opened.rest, frames=frames), opened.rest.around(frames)


@dataclass
class _Found:
    """Sums over the parts of a recording."""

    parts: int = 0
    frames: int = 0
    detections: int = 0
    landmarks: set[str] = field(default_factory=set)
    from_s: float | None = None
    to_s: float | None = None

    def add(self, part: Recording) -> None:
        times_s = part.times_s
        self.parts += 1
        self.frames += len(times_s)
        self.detections += sum(len(f.detections) for f in part.frames) + sum(len(r) for _, r in part.readings)
        self.landmarks.update(map(str, part.ids))
        self.from_s = float(times_s[0]) if self.from_s is None else self.from_s
        self.to_s = float(times_s[-1])

    def facts(self) -> dict[str, Any]:
        return {**vars(self), "landmarks": len(self.landmarks)}


def _fetched(job: StageJob, scratch: Path) -> Path:
    """The folder with the recording's files, unpacked and on this machine."""
    from pyarrow import fs

    source = job.recording.source
    limit = job.options.get("max_bytes")
    if limit is not None and job.recording.bytes > limit:
        raise InputError(
            "too_large",
            f"{source} has {job.recording.bytes} bytes, more than {limit}",
            "raise --max-bytes, with --retry",
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
    try:
        for file in unpack_bag(path, parse_topics(job.recording.topics)):
            write_file(unpacked / file.name, file.content, True)
    except InputError as error:
        raise InputError(error.code, error.message, SCAN_HINTS.get(error.code, error.hint)) from None
    return unpacked


def _rig_of(job: StageJob, folder: Path) -> AnyRig:
    """The rig found by the scan, else the recording's own: its file, or camera_info of its bag."""
    if job.recording.rig and not Path(job.recording.rig).is_file():
        raise InputError(
            "no_rig",
            f"{job.recording.rig}, the rig of {job.recording.name}, does not exist",
            "check --rig, scan again",
        )
    own = [Path(job.recording.rig)] if job.recording.rig else [folder / "rig.yaml", folder / "rig"]
    rig = next((path for path in own if path.exists()), None)
    if rig is None:
        raise InputError(
            "no_rig",
            f"{job.recording.name} has no rig",
            "give --rig to lmkit fleet scan, or put rig.yaml into the recording's folder",
        )
    return read_any_rig(rig)


def detected_recordings(store: Store, options: Mapping[str, Any]) -> list[FleetRecording]:
    """Recordings that were detected with these options."""
    return [recording for recording, _, outcome in done_jobs(store, STAGE, options) if outcome.ok]


def parts_of(recording: FleetRecording, key: str, outcome: Outcome) -> list[Part]:
    """Parts of a detected recording."""
    count = outcome.facts["parts"]
    return [Part(recording.name, key, number, count) for number in range(1, count + 1)]


def parts_to_read(job: StageJob) -> list[Part]:
    """Parts of the recording of a later stage's job, whose options name those of detection as ``detect``.

    Raises:
        InputError: it is not detected.
    """
    key = job.recording.key(STAGE, job.options["detect"])
    outcome = read_outcome(job.store, STAGE, key)
    if outcome is None or not outcome.ok:
        raise InputError("not_detected", f"{job.recording.name} is not detected", "run lmkit fleet detect")
    return parts_of(job.recording, key, outcome)


def read_detected(store: Store, part: Part) -> tuple[Recording, AnyRig | None]:
    """Detections of a part, and its rig; None for ranges and bearings.

    Raises:
        InputError: a file is missing or damaged.
    """
    return read_part(store, part_folder(f"{STAGE}/{part.key}", part.number))
