"""Real robots through a known map, and through one they survey: UTIAS MRCLAM (Leung et al., IJRR 30(8), 2011).

    uv run python benchmarks/track.py ../shared/data/mrclam

Readings of landmarks and odometry alone, as `lmkit track` and `lmkit survey` take them, of five robots; delay and
scales are found, not given.  Errors at every frame with a reading.  NEES of an honest planar covariance has a mean
of 3.  A surveyed map and its recording are aligned with the true map by the rotation and shift that fit its
landmarks best; its size stays as it is.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from mrclam import table

from lmkit.geometry.pose import Pose
from lmkit.mapping.range_bearing_survey import survey_readings
from lmkit.mapping.several_readings import survey_readings_together
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.model.observation import RangeBearing
from lmkit.model.recording import Odometry, Recording
from lmkit.model.tracked_trajectory import TrackedTrajectory
from lmkit.tracking.batch import track_readings
from lmkit.tracking.online import track_live


def load(
    folder: Path, robot: int
) -> tuple[list[tuple[float, list[RangeBearing]]], Odometry, LandmarkMap, np.ndarray]:
    """Readings by frame, odometry, the map, and the truth (time, x, y, heading)."""
    places = {int(row[0]): row[1:3] for row in table(folder, "Landmark_Groundtruth")}
    subject = {int(code): int(number) for number, code in table(folder, "Barcodes")}
    truth, measured, odometry = (
        table(folder, f"Robot{robot}_{what}") for what in ("Groundtruth", "Measurement", "Odometry")
    )
    frames: dict[float, list[RangeBearing]] = {}
    for time_s, code, distance, bearing in measured:
        seen = subject.get(int(code), -1)
        if seen in places and truth[0, 0] < time_s < truth[-1, 0]:
            frames.setdefault(time_s, []).append(RangeBearing(LandmarkId("lm8", seen), distance, bearing, time_s))
    odometry = odometry[np.diff(odometry[:, 0], prepend=-1.0) > 0]
    mounted = [
        MappedLandmark(LandmarkId("lm8", k), 0.18, Pose("map", "landmark", np.eye(3), np.array([*place, 0.0])))
        for k, place in places.items()
    ]
    wheels = Odometry.from_velocities(odometry[:, 0], odometry[:, 1], odometry[:, 2])
    return sorted(frames.items()), wheels, LandmarkMap(mounted), truth


def errors(drive: TrackedTrajectory, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N,3) x, y (m), heading (rad), and NEES (N,), of all frames that have a pose."""
    heading = np.unwrap(truth[:, 3])
    true = np.column_stack(
        [np.interp(drive.times_s, truth[:, 0], column) for column in (truth[:, 1], truth[:, 2], heading)]
    )
    found = np.array([[*pose.t[:2], np.arctan2(pose.R[1, 0], pose.R[0, 0])] for pose in drive.poses])
    off = found - true
    off[:, 2] = np.angle(np.exp(1j * off[:, 2]))
    at = np.array([0, 1, 5])
    C = drive.covariances[:, at[:, None], at[None]]
    return off, np.einsum("ni,nij,nj->n", off, np.linalg.inv(C), off)


def main(folder: Path) -> None:
    print("| robot | smoother, cm | deg | NEES | live, cm | deg | NEES | not ok | ms a frame |")
    print("|---|---|---|---|---|---|---|---|---|")
    everything: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {"smoother": [], "live": []}
    for robot in range(1, 6):
        frames, wheels, landmarks, truth = load(folder, robot)
        row = f"| {robot} |"
        for name, follow in (("smoother", track_readings), ("live", track_live)):
            start = time.perf_counter()
            drive = follow(frames, wheels, None, landmarks)
            took = time.perf_counter() - start
            off, nees = errors(drive, truth)
            everything[name].append((off, nees))
            row += _cells(off, nees)
        lost = len(frames) - sum(status == "ok" for status in drive.statuses)
        print(f"{row} {lost} of {len(frames)} | {1000 * took / len(frames):.2f} |")
    row = "| all |"
    for parts in everything.values():
        row += _cells(np.concatenate([off for off, _ in parts]), np.concatenate([nees for _, nees in parts]))
    print(f"{row} | |\n")
    print("| robot, map unknown | map, cm | robot, cm | deg |")
    print("|---|---|---|---|")
    surveyed = [surveyed_errors(folder, robot) for robot in range(1, 6)]
    for robot, (places, off) in enumerate(surveyed, 1):
        print(f"| {robot} | {_surveyed_cells(places, off)}")
    print(f"| all | {_surveyed_cells(*(np.concatenate(parts) for parts in zip(*surveyed, strict=True)))}")
    off, larger = joint_errors(folder)
    cm = 100 * np.sqrt((off**2).sum(axis=1).mean())
    print(f"one map from all five recordings: {cm:.1f} cm; the true map is larger by {100 * (larger - 1):.1f} %")


def surveyed_errors(folder: Path, robot: int) -> tuple[np.ndarray, np.ndarray]:
    """(L,2) of the landmarks (m), and (N,3) of the recording, x, y, heading."""
    frames, wheels, landmarks, truth = load(folder, robot)
    found, drive = survey_readings(frames, wheels, None, 0.18)
    true = np.array([landmarks.find(m.id).T_map_landmark.t[:2] for m in found])
    own = np.array([m.T_map_landmark.t[:2] for m in found])
    R, shift = fit(own, true)
    turn = np.eye(3)
    turn[:2, :2] = R
    poses = [Pose("map", "base", turn @ pose.R, turn @ pose.t + [*shift, 0.0]) for pose in drive.poses]
    return own @ R.T + shift - true, errors(replace(drive, poses=poses), truth)[0]


def joint_errors(folder: Path) -> tuple[np.ndarray, float]:
    """(L,2) errors (m) of one map from all five recordings, and by how much the true map is larger."""
    loaded = {robot: load(folder, robot) for robot in range(1, 6)}
    recordings = {
        str(robot): Recording((), tuple((time_s, tuple(seen)) for time_s, seen in frames), wheels)
        for robot, (frames, wheels, *_) in loaded.items()
    }
    joint = survey_readings_together(recordings, 0.18)
    landmarks = loaded[1][2]
    true = np.array([landmarks.find(m.id).T_map_landmark.t[:2] for m in joint.landmarks])
    own = np.array([m.T_map_landmark.t[:2] for m in joint.landmarks])
    R, shift = fit(own, true)
    laid = own @ R.T + shift
    away = laid - laid.mean(axis=0)
    return laid - true, float((away * (true - true.mean(axis=0))).sum() / (away**2).sum())


def fit(own: np.ndarray, true: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation (2,2) and shift (2,) that lay points onto the true ones best."""
    U, _, Vt = np.linalg.svd((own - own.mean(axis=0)).T @ (true - true.mean(axis=0)))
    R = (U @ np.diag([1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt).T
    return R, true.mean(axis=0) - R @ own.mean(axis=0)


def _surveyed_cells(places: np.ndarray, off: np.ndarray) -> str:
    cm = [100 * np.sqrt((d**2).sum(axis=1).mean()) for d in (places, off[:, :2])]
    return f"{cm[0]:.1f} | {cm[1]:.1f} | {np.rad2deg(np.sqrt((off[:, 2] ** 2).mean())):.2f} |"


def _cells(off: np.ndarray, nees: np.ndarray) -> str:
    place = 100 * np.sqrt((off[:, :2] ** 2).sum(axis=1).mean())
    heading = np.rad2deg(np.sqrt((off[:, 2] ** 2).mean()))
    return f" {place:.1f} | {heading:.2f} | {nees.mean():.2f} |"


if __name__ == "__main__":
    main(Path(sys.argv[1]))
