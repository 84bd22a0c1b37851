"""Real robots through a known map: `lmkit track` on UTIAS MRCLAM (Leung et al., IJRR 30(8), 2011), five robots.

    uv run python benchmarks/track.py ../shared/data/mrclam

Readings of landmarks and odometry alone, as the command takes them; delay and scales are found, not given.  Errors at
every moment with a reading.  NEES of an honest planar covariance has a mean of 3.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
from mrclam import table

from lmkit.model.drive import Odometry
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.model.observation import RangeBearing
from lmkit.model.pose import Pose
from lmkit.track.drive import TrackedDrive, track_live, track_readings


def load(
    folder: Path, robot: int
) -> tuple[list[tuple[float, list[RangeBearing]]], Odometry, LandmarkMap, np.ndarray]:
    """Readings by moment, odometry, the map, and the truth (time, x, y, heading)."""
    places = {int(row[0]): row[1:3] for row in table(folder, "Landmark_Groundtruth")}
    subject = {int(code): int(number) for number, code in table(folder, "Barcodes")}
    truth, measured, odometry = (
        table(folder, f"Robot{robot}_{what}") for what in ("Groundtruth", "Measurement", "Odometry")
    )
    moments: dict[float, list[RangeBearing]] = {}
    for time_s, code, distance, bearing in measured:
        seen = subject.get(int(code), -1)
        if seen in places and truth[0, 0] < time_s < truth[-1, 0]:
            moments.setdefault(time_s, []).append(RangeBearing(seen, distance, bearing, time_s))
    odometry = odometry[np.diff(odometry[:, 0], prepend=-1.0) > 0]
    hung = [
        MappedLandmark(k, "lm8", 0.18, Pose("map", "landmark", np.eye(3), np.array([*place, 0.0])))
        for k, place in places.items()
    ]
    wheels = Odometry.from_velocities(odometry[:, 0], odometry[:, 1], odometry[:, 2])
    return sorted(moments.items()), wheels, LandmarkMap(hung), truth


def errors(drive: TrackedDrive, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N,3) x, y (m), heading (rad), and NEES (N,), of all moments that have a pose."""
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
    print("| robot | smoother, cm | deg | NEES | live, cm | deg | NEES | not ok | ms a moment |")
    print("|---|---|---|---|---|---|---|---|---|")
    everything: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {"smoother": [], "live": []}
    for robot in range(1, 6):
        moments, wheels, landmarks, truth = load(folder, robot)
        row = f"| {robot} |"
        for name, follow in (("smoother", track_readings), ("live", track_live)):
            start = time.perf_counter()
            drive = follow(moments, wheels, None, landmarks)
            took = time.perf_counter() - start
            off, nees = errors(drive, truth)
            everything[name].append((off, nees))
            row += _cells(off, nees)
        lost = len(moments) - sum(status == "ok" for status in drive.statuses)
        print(f"{row} {lost} of {len(moments)} | {1000 * took / len(moments):.2f} |")
    row = "| all |"
    for parts in everything.values():
        row += _cells(np.concatenate([off for off, _ in parts]), np.concatenate([nees for _, nees in parts]))
    print(f"{row} | |")


def _cells(off: np.ndarray, nees: np.ndarray) -> str:
    place = 100 * np.sqrt((off[:, :2] ** 2).sum(axis=1).mean())
    heading = np.rad2deg(np.sqrt((off[:, 2] ** 2).mean()))
    return f" {place:.1f} | {heading:.2f} | {nees.mean():.2f} |"


if __name__ == "__main__":
    main(Path(sys.argv[1]))
