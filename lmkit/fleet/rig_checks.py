"""Rig checks: whether a robot's rig file is valid for a recording, from the landmarks in it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from lmkit.calibration.rig_check import LEAST_VIEWS, check_dict, check_rig
from lmkit.errors import InputError
from lmkit.fleet.detection import parts_to_read, read_detected
from lmkit.fleet.jobs import StageJob, done_jobs
from lmkit.fleet.store import Store
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import AnyRig, MountedCamera, mounted_cameras
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.mapping.survey import landmark_sizes
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.recording import RigFrame
from lmkit.pipelines.landmark_views import recorded_landmark_pairs

STAGE = "check"
OPTIONS = f"{STAGE}/options.json"
VIEWS = 24  # views of landmarks in two cameras at once; the time of the check grows with their number
BUMPED_SIGMA = 5.0  # standard deviations of a rotation or shift of a moved camera
# Motions of a camera: words for the axes, key in `check_dict`, unit, digits, and the largest error of a rig file.
MOTIONS = (
    (("pitched", "yawed", "rolled"), "turn", "deg", 2, 0.15),
    (("shifted along x", "shifted along y", "shifted along z"), "shift", "mm", 1, 3.0),
)
UNKNOWN = "unknown"  # state if two cameras have too few common landmarks


def check_options(detect: Mapping[str, Any], size_m: float, known_m: Mapping[LandmarkId, float]) -> dict[str, Any]:
    """All options of the checks.

    Args:
        detect: options of detection.
        size_m: side of the landmarks, meters.
        known_m: side of landmarks with another size.
    """
    own = {str(id_): size for id_, size in sorted(known_m.items()) if size != size_m}
    return {"detect": dict(detect), "size_m": size_m, "known_m": own}


def store_check_options(store: Store, options: Mapping[str, Any]) -> None:
    """Store the options of the last checks, for the report."""
    store.write(OPTIONS, json.dumps(dict(options)))


def stored_check_options(store: Store) -> dict[str, Any] | None:
    """Options of the last checks; None if nothing was checked."""
    if not store.exists(OPTIONS):
        return None
    options: dict[str, Any] = json.loads(store.read(OPTIONS))
    return options


def bumped_recordings(store: Store, options: Mapping[str, Any]) -> dict[str, str]:
    """Reason, by name of the recording, why its rig file is no longer valid."""
    rows = done_jobs(store, STAGE, options)
    moved = {recording.name: moved_cameras(outcome.facts) for recording, _, outcome in rows}
    return {name: f"{bumped_sentence(some)} against its rig file" for name, some in moved.items() if some}


def check_recording(job: StageJob) -> dict[str, Any]:
    """Work of one job: compare each camera of the rig with the first one, as in `lmkit calibrate --check`.

    Of several parts, the last one with enough landmarks common to two cameras is checked.
    """
    options = job.options
    known_m = {LandmarkId.parse(id_): size for id_, size in options["known_m"].items()}
    cameras: list[dict[str, Any]] = []
    for part in reversed(parts_to_read(job)):
        recording, rig = read_detected(job.store, part)
        if rig is None:
            break
        sizes = landmark_sizes(recording.frames, options["size_m"], {}) | known_m
        cameras = pair_check(rig, recording.frames, sizes, VIEWS)
        if any(camera["state"] != UNKNOWN for camera in cameras):
            break
    return {"cameras": cameras}


def pair_check(
    rig: AnyRig, frames: Sequence[RigFrame], sizes_m: Mapping[LandmarkId, float], most: int
) -> list[dict[str, Any]]:
    """Facts of `check_dict` for each camera of a rig relative to the first one.

    Args:
        sizes_m: side of each landmark.
        most: largest number of views.
    """
    first, *others = mounted_cameras(rig)
    cameras = []
    for k, other in enumerate(others, start=1):
        points, views = recorded_landmark_pairs(frames, k, sizes_m, most)
        facts: dict[str, Any] = {"state": UNKNOWN, "sentence": "too few landmarks are seen by both cameras"}
        if len(views) >= LEAST_VIEWS:
            try:
                facts = check_dict(check_rig(_pair(first, other), points, views, lenses=False))
            except InputError as error:
                facts["sentence"] = error.message
        cameras.append({"camera": other.name, **{key: facts[key] for key in facts if not key.startswith("views")}})
    return cameras


def _pair(first: MountedCamera, other: MountedCamera) -> StereoRig:
    T = other.T_camera_left
    return StereoRig(first.model, other.model, Pose("right", "left", T.R, T.t))


def moved_cameras(facts: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Cameras of a checked recording whose pose relative to the first one differs from the rig file.

    A better fit with little difference from the rig file is not a moved camera: rig files have errors, surveys
    estimate these errors (`mapping/camera_relations.py`), and such recordings stay in the map.
    """
    judged = [camera for camera in facts.get("cameras", ()) if camera["state"] not in ("true", UNKNOWN)]
    return [camera for camera in judged if _surest_motion(camera)[0] > 1.0]


def bumped_sentence(cameras: list[dict[str, Any]]) -> str:
    """A clause about the cameras of `moved_cameras`."""
    return ", ".join(f"camera {camera['camera']} has {_surest_motion(camera)[1]}" for camera in cameras)


def _surest_motion(camera: dict[str, Any]) -> tuple[float, str]:
    """The most significant motion about or along one axis: its ratio to the limit, and its description."""
    found = [
        (abs(value) / max(BUMPED_SIGMA * sigma, least), f"{word} by {value:+.{digits}f} ± {sigma:.{digits}f} {unit}")
        for words, name, unit, digits, least in MOTIONS
        for word, value, sigma in zip(words, camera[f"{name}_{unit}"], camera[f"{name}_sigma_{unit}"], strict=True)
    ]
    return max(found)
