"""Rig checks: is the rig file of a robot still true on the day of a recording, by the landmarks that it saw?"""

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
VIEWS = 24  # of landmarks that two cameras see at once; the check takes time with their number
UNKNOWN = "unknown"  # state where too few landmarks are seen by two cameras


def check_options(detect: Mapping[str, Any], size_m: float, known_m: Mapping[LandmarkId, float]) -> dict[str, Any]:
    """Everything that the checks depend on.

    Args:
        detect: options of detection.
        size_m: side of the landmarks, meters.
        known_m: of landmarks that have another one.
    """
    own = {str(id_): size for id_, size in sorted(known_m.items()) if size != size_m}
    return {"detect": dict(detect), "size_m": size_m, "known_m": own}


def store_check_options(store: Store, options: Mapping[str, Any]) -> None:
    """Keep the options of the last checks, for the report."""
    store.write(OPTIONS, json.dumps(dict(options)))


def stored_check_options(store: Store) -> dict[str, Any] | None:
    """Options of the last checks; None: nothing was checked."""
    if not store.exists(OPTIONS):
        return None
    options: dict[str, Any] = json.loads(store.read(OPTIONS))
    return options


def bumped_recordings(store: Store, options: Mapping[str, Any]) -> dict[str, str]:
    """Reason by name of each recording whose rig file is no longer true."""
    rows = done_jobs(store, STAGE, options)
    moved = {recording.name: moved_cameras(outcome.facts) for recording, _, outcome in rows}
    return {name: f"{bumped_sentence(some)} against its rig file" for name, some in moved.items() if some}


def check_recording(job: StageJob) -> dict[str, Any]:
    """Work of one job: each camera of the rig against the first one, as `lmkit calibrate --check` does it.

    Of several parts the last one in which two cameras saw enough is checked.
    """
    options = job.options
    known_m = {LandmarkId.parse(id_): size for id_, size in options["known_m"].items()}
    cameras: list[dict[str, Any]] = []
    for part in reversed(parts_to_read(job)):
        recording, rig = read_detected(job.store, part)
        sizes = landmark_sizes(recording.frames, options["size_m"], {}) | known_m
        cameras = pair_check(rig, recording.frames, sizes, VIEWS)
        if any(camera["state"] != UNKNOWN for camera in cameras):
            break
    return {"cameras": cameras}


def pair_check(
    rig: AnyRig, frames: Sequence[RigFrame], sizes_m: Mapping[LandmarkId, float], most: int
) -> list[dict[str, Any]]:
    """Facts of `check_dict` about each camera of a rig against the first one.

    Args:
        sizes_m: side of each landmark.
        most: views at most.
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
    """Cameras of a checked recording that stand differently to the first one than the rig file says."""
    return [camera for camera in facts.get("cameras", ()) if camera["state"] not in ("true", UNKNOWN)]


def bumped_sentence(cameras: list[dict[str, Any]]) -> str:
    """A clause about the cameras of `moved_cameras`."""
    texts = []
    for camera in cameras:
        turn, sigma = camera["turn_deg"], camera["turn_sigma_deg"]
        axis = max(range(3), key=lambda k: abs(turn[k]))
        motion = ("pitched", "yawed", "rolled")[axis]
        texts.append(f"camera {camera['camera']} has {motion} by {turn[axis]:+.2f} ± {sigma[axis]:.2f} deg")
    return ", ".join(texts)
