"""A simulated site as files: halls, robots, recordings of several days, with planted faults."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lmkit.geometry.pose import Pose
from lmkit.io.recording_tables import detections_to_csv, gyro_to_csv, odometry_to_csv
from lmkit.io.rig import rig_to_yaml
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.model.recording import Gyro, Odometry, RigFrame
from lmkit.simulation.recording import make_drive

DAY_S = 86400.0
MONDAY_S = 1_790_000_000.0  # seconds since 1970
SHIFT_M = 0.4


@dataclass(frozen=True)
class Site:
    """The true maps by hall, and the landmark of each that is moved before the last day."""

    maps: dict[str, LandmarkMap]
    moved: dict[str, MappedLandmark]


def write_site(
    folder: Path, halls: int, days: int, seconds: float = 40.0, count: int = 10, moved: bool = True
) -> Site:
    """Write ``logs/HALL/ROBOT/DAY/`` with detections.csv, odometry.csv and gyro.csv, and ``rigs/ROBOT.yaml``."""
    maps, away_by_hall = {}, {}
    for hall in range(halls):
        first = make_drive(100 + hall, seconds, count=count)
        name = f"hall{hall}"
        maps[name] = first.landmarks
        other = most_seen(first.frames, first.landmarks)
        T = other.T_map_landmark
        away = replace(other, T_map_landmark=Pose("map", "landmark", T.R, T.t + SHIFT_M * T.R[:, 0]))
        away_by_hall[name] = away
        later = LandmarkMap([away if m.id == other.id else m for m in first.landmarks])
        for day in range(days):
            landmarks = later if moved and day == days - 1 > 0 else first.landmarks
            drive = make_drive(1000 * hall + day, seconds, count=count, landmarks=landmarks)
            start = MONDAY_S + DAY_S * day
            robot = folder / "logs" / name / f"robot{(hall + day) % 2}" / f"day{day}"
            robot.mkdir(parents=True)
            frames = [RigFrame(f.time_s + start, f.seen, f.name) for f in drive.frames]
            (robot / "detections.csv").write_text(detections_to_csv(frames))
            o, g = drive.odometry, drive.gyro
            (robot / "odometry.csv").write_text(odometry_to_csv(Odometry(o.times_s + start, o.forward_m, o.turn_rad)))
            (robot / "gyro.csv").write_text(gyro_to_csv(Gyro(g.times_s + start, g.rate_radps)))
            (folder / "rigs").mkdir(exist_ok=True)
            (folder / "rigs" / f"{robot.parent.name}.yaml").write_text(rig_to_yaml(drive.rig))
    return Site(maps, away_by_hall if moved else {})


def most_seen(frames: tuple[RigFrame, ...], landmarks: LandmarkMap) -> MappedLandmark:
    """The landmark with most detections."""
    counts = {m.id: sum(d.id == m.id for f in frames for d in f.detections) for m in landmarks}
    return next(m for m in landmarks if m.id == max(counts, key=lambda id_: counts[id_]))


def map_error_m(found: LandmarkMap, true: LandmarkMap) -> float:
    """Root mean square of the landmarks' places after the best rigid alignment, meters."""
    both = [(m.T_map_landmark.t, t.T_map_landmark.t) for m in found if (t := true.find(m.id)) is not None]
    a, b = (np.array(points) for points in zip(*both, strict=True))
    U, _, Vt = np.linalg.svd((a - a.mean(0)).T @ (b - b.mean(0)))
    R = Vt.T @ np.diag([1, 1, np.sign(np.linalg.det(Vt.T @ U.T))]) @ U.T
    off = (a - a.mean(0)) @ R.T - (b - b.mean(0))
    return float(np.sqrt((off**2).sum(axis=1).mean()))
