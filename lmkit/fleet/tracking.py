"""`lmkit fleet track`: every recording through the map of its site, and what that says of its robot."""

from __future__ import annotations

import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

from lmkit.api.recordings import track
from lmkit.errors import InputError
from lmkit.fleet.detection import STAGE as DETECT
from lmkit.fleet.detection import read_detected
from lmkit.fleet.jobs import StageJob
from lmkit.io.external_maps import read_any_map
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.tracked_trajectory import TrackedTrajectory

STAGE = "track"


def track_recording(job: StageJob) -> dict[str, Any]:
    """Work of one job: the trajectory as a table, and a summary.

    Options: ``maps`` has the text of every site's map; ``detect`` the options of detection.
    """
    maps = job.options["maps"]
    if job.recording.site not in maps:
        raise InputError("no_map", f"site '{job.recording.site}' has no map", "run lmkit fleet survey")
    detected = read_detected(job.store, job.recording.name, job.recording.key(DETECT, job.options["detect"]))
    landmarks = map_of(maps[job.recording.site])
    if detected.recording.frames:
        landmarks = landmarks.at(detected.recording.frames[0].time_s)
    tracked = track(detected.recording, detected.rig, landmarks)
    job.store.write_table(f"{STAGE}/{job.key}.parquet", _columns(tracked))
    counts = Counter(map(str, tracked.statuses))
    outliers = Counter(str(id_) for some in tracked.outliers for id_ in some)
    return {
        "frames": len(tracked),
        "ok": counts.get("ok", 0),
        "statuses": dict(counts),
        "outliers": dict(outliers.most_common(10)),
        "remarks": list(tracked.remarks),
        "parameters": {name: float(value) for name, value in tracked.parameters.items()},
        "parameter_sigmas": {name: float(value) for name, value in tracked.parameter_sigmas.items()},
    }


def map_of(text: str) -> LandmarkMap:
    """A landmark map from the text of its file."""
    with tempfile.TemporaryDirectory(prefix="lmkit-") as scratch:
        path = Path(scratch) / "map.yaml"
        path.write_text(text, encoding="utf-8")
        return read_any_map(path)


def _columns(tracked: TrackedTrajectory) -> dict[str, list[Any]]:
    rows = [tracked.to_dict(k) for k in range(len(tracked))]
    return {name: [row[name] for row in rows] for name in ("time_s", "position", "quaternion")} | {
        "status": [str(row["status"]) for row in rows],
        "covariance": [[value for line in row["covariance"] for value in line] for row in rows],
    }
