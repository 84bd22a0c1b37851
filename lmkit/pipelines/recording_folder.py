"""Recording folder: one recording's files under fixed names, so that a command needs only the folder.

``detections.csv``, or ``readings.csv``, or a folder or video per camera of the rig (``left/``, ``left.mp4``); and,
if available, ``odometry.csv`` (wheels) or ``odometry.tum`` (visual odometry), and ``gyro.csv``.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from lmkit.errors import InputError
from lmkit.geometry.rig import AnyRig, mounted_cameras
from lmkit.model.landmark import LM8
from lmkit.model.recording import Recording
from lmkit.pipelines.detect_recording import POSES, OpenRecording, open_recording

DETECTIONS, READINGS, GYRO = "detections.csv", "readings.csv", "gyro.csv"
VIDEOS = (".mp4", ".avi", ".mkv", ".mov", ".m4v", ".webm")


def is_recording_folder(path: Path, cameras: Sequence[str]) -> bool:
    """Whether the folder contains a recording of a rig whose cameras have these names."""
    return path.is_dir() and (
        (path / DETECTIONS).is_file() or all(_camera_source(path, camera) is not None for camera in cameras)
    )


def read_recording_folder(
    path: Path, rig: AnyRig, families: Sequence[str] = (LM8.name,), hz: float | None = None
) -> Recording:
    """The whole recording of a folder; see `open_recording_folder`."""
    return open_recording_folder(path, rig, families, hz).read()


def has_readings(path: Path) -> bool:
    """Whether the folder's recording consists of ranges and bearings, which need no rig."""
    return (path / READINGS).is_file() and not (path / DETECTIONS).is_file()


def open_recording_folder(
    path: Path,
    rig: AnyRig | None,
    families: Sequence[str] = (LM8.name,),
    hz: float | None = None,
    wheel_track_m: float | None = None,
) -> OpenRecording:
    """The recording of a folder, whose frames are read one after the other.

    Args:
        rig: rig of the recording; None for ranges and bearings (`has_readings`).
        families, hz, wheel_track_m: see `open_recording`.

    Raises:
        InputError: the folder contains no recording of this rig, or a file cannot be read.
    """
    odometry, gyro = motion_files(path)
    if rig is None:
        return open_recording(
            readings=path / READINGS, odometry=odometry, gyro=gyro, wheel_track_m=wheel_track_m, families=families
        )
    names = [camera.name for camera in mounted_cameras(rig)]
    if not is_recording_folder(path, names):
        missing = next((name for name in names if _camera_source(path, name) is None), names[0])
        raise InputError(
            "no_recording",
            f"{path} contains no recording: neither {DETECTIONS}, nor a folder or video of camera '{missing}'",
            f"name the camera's images {missing}/, or its video {missing}.mp4",
        )
    sources, detections = image_files(path, names)
    return open_recording(sources, rig, detections, None, odometry, gyro, wheel_track_m, families, hz)


def image_files(path: Path, cameras: Sequence[str]) -> tuple[list[str], Path | None]:
    """Folders or videos, one per camera; none and the file of detections if there are no images."""
    if (path / DETECTIONS).is_file():
        return [], path / DETECTIONS
    return [str(_camera_source(path, name)) for name in cameras], None


def motion_files(path: Path) -> tuple[Path | None, Path | None]:
    """The files of odometry and gyro of a recording folder."""
    odometry = next((p for p in (path / f"odometry{end}" for end in (".csv", *POSES)) if p.is_file()), None)
    return odometry, path / GYRO if (path / GYRO).is_file() else None


def _camera_source(folder: Path, camera: str) -> Path | None:
    if (folder / camera).is_dir():
        return folder / camera
    videos = [path for path in sorted(folder.glob(f"{camera}.*")) if path.suffix.lower() in VIDEOS]
    return videos[0] if len(videos) == 1 else None
