"""`lmkit fleet track`: every recording located in the map of its site, and the state of its robot."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from lmkit.api.recordings import track
from lmkit.errors import InputError
from lmkit.fleet.detection import parts_to_read, read_detected
from lmkit.fleet.jobs import StageJob
from lmkit.fleet.parts import part_folder
from lmkit.fleet.views import Views, write_views
from lmkit.io.external_maps import read_any_map
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.tracked_trajectory import TrackedTrajectory

STAGE = "track"
LEAST_SIGMA = 1e-9  # of a fixed parameter


def track_recording(job: StageJob) -> dict[str, Any]:
    """Work of one job: the trajectory of every part as a table, the reading quality of landmarks, and a summary.

    Options: ``maps`` has the text of every site's map; ``detect`` the options of detection.
    """
    maps = job.options["maps"]
    if job.recording.site not in maps:
        raise InputError("no_map", f"site '{job.recording.site}' has no map", "run lmkit fleet survey")
    landmarks = map_of(maps[job.recording.site])
    passed, views = _Passed(), Views()
    for part in parts_to_read(job):
        recording, rig = read_detected(job.store, part)
        then = landmarks.at(float(recording.times_s[0]))
        tracked = track(recording, rig, then)
        if rig is not None:
            views.add(recording.frames, rig, then, tracked)
        job.store.write_table(f"{part_folder(f'{STAGE}/{job.key}', part.number)}.parquet", _columns(tracked))
        passed.add(tracked)
    write_views(job.store, job.key, views)
    return passed.facts()


@dataclass
class _Passed:
    """Sums over the parts of a recording."""

    statuses: Counter[str] = field(default_factory=Counter)
    outliers: Counter[str] = field(default_factory=Counter)
    remarks: list[str] = field(default_factory=list)
    known: dict[str, list[tuple[float, float]]] = field(default_factory=dict)

    def add(self, tracked: TrackedTrajectory) -> None:
        self.statuses.update(map(str, tracked.statuses))
        self.outliers.update(str(id_) for some in tracked.outliers for id_ in some)
        self.remarks += [remark for remark in tracked.remarks if remark not in self.remarks]
        for name, value in tracked.parameters.items():
            self.known.setdefault(name, []).append((float(value), float(tracked.parameter_sigmas.get(name, 0.0))))

    def facts(self) -> dict[str, Any]:
        means = {name: _weighted_mean(*zip(*some, strict=True)) for name, some in self.known.items()}
        return {
            "frames": self.statuses.total(),
            "ok": self.statuses["ok"],
            "statuses": dict(self.statuses),
            "outliers": dict(self.outliers.most_common(10)),
            "remarks": self.remarks,
            "parameters": {name: value for name, (value, _) in means.items()},
            "parameter_sigmas": {name: sigma for name, (_, sigma) in means.items()},
        }


def _weighted_mean(values: Sequence[float], sigmas: Sequence[float]) -> tuple[float, float]:
    """Mean of independent estimates, and its standard deviation; a single one is unchanged."""
    if len(values) == 1:
        return values[0], sigmas[0]
    weights = 1 / np.maximum(sigmas, LEAST_SIGMA) ** 2
    return float(np.average(values, weights=weights)), float(1 / np.sqrt(weights.sum()))


def map_of(text: str) -> LandmarkMap:
    """A landmark map from the text of its file."""
    with tempfile.TemporaryDirectory(prefix="lmkit-") as scratch:
        path = Path(scratch) / "map.yaml"
        path.write_text(text, encoding="utf-8")
        return read_any_map(path)


def _columns(tracked: TrackedTrajectory) -> dict[str, Any]:
    return {
        "time_s": tracked.times_s,
        "position": tracked.positions,
        "quaternion": np.array([pose.quaternion_xyzw for pose in tracked.poses]).reshape(-1, 4),
        "status": [str(status) for status in tracked.statuses],
        "covariance": np.asarray(tracked.covariances).reshape(-1, 36),
    }
