"""Range and bearing of real robots: UTIAS MRCLAM (Leung et al., IJRR 30(8), 2011), instant by instant.

    uv run python benchmarks/mrclam.py ../shared/data/mrclam

Readings of landmarks with one time stamp, no odometry, `locate_planar` with its default noise.  The last line starts
every fit from the truth and takes the best of a grid of weightings and losses: the least error that these readings
allow.
"""

from __future__ import annotations

import argparse
import gzip
import math
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from lmkit.geometry.pose import Pose
from lmkit.localization.range_bearing import locate_planar
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.model.observation import RangeBearing

RANGE_M, RANGE_SHARES, BEARINGS_DEG, LOSSES = (0.0, 0.02), (0.015, 0.03, 0.05), (0.1, 0.2, 0.4), ("linear", "cauchy")


@dataclass(frozen=True)
class Instant:
    """Readings of one robot at one time, and its true x, y, heading."""

    readings: list[RangeBearing]
    truth: np.ndarray

    @property
    def codes(self) -> int:
        return len({r.id for r in self.readings})


def table(folder: Path, name: str) -> np.ndarray:
    return np.loadtxt(gzip.open(folder / f"{name}.dat.gz", "rt"))


def load(folder: Path) -> tuple[dict[int, np.ndarray], list[Instant]]:
    """Landmarks by subject, and all instants inside the truth's time."""
    places = {int(row[0]): row[1:3] for row in table(folder, "Landmark_Groundtruth")}
    subject = {int(code): int(number) for number, code in table(folder, "Barcodes")}
    instants = []
    for robot in range(1, 6):
        truth, measured = (table(folder, f"Robot{robot}_{what}") for what in ("Groundtruth", "Measurement"))
        heading = np.unwrap(truth[:, 3])
        frames: dict[float, list[RangeBearing]] = {}
        for time, code, distance, bearing in measured:
            seen = subject.get(int(code), -1)
            if seen in places and truth[0, 0] < time < truth[-1, 0]:
                frames.setdefault(time, []).append(RangeBearing(LandmarkId("lm8", seen), distance, bearing, time))
        for time, readings in frames.items():
            at = [np.interp(time, truth[:, 0], column) for column in (truth[:, 1], truth[:, 2], heading)]
            instants.append(Instant(readings, np.array(at)))
    return places, instants


def wrapped(angle: np.ndarray) -> np.ndarray:
    return (angle + np.pi) % (2 * np.pi) - np.pi


def from_the_truth(
    instant: Instant, places: dict[int, np.ndarray], noise: tuple[float, float, float], loss: str
) -> float:
    """Position error, m."""
    fixed, share, bearing_deg = noise
    P = np.array([places[r.id.code] for r in instant.readings])
    ranges = np.array([r.range_m for r in instant.readings])
    bearings = np.array([r.bearing_rad for r in instant.readings])

    def errors(x: np.ndarray) -> np.ndarray:
        off = P - x[:2]
        turned = wrapped(bearings - np.arctan2(off[:, 1], off[:, 0]) + x[2])
        return np.concatenate(
            [(ranges - np.hypot(*off.T)) / (fixed + share * ranges), turned / math.radians(bearing_deg)]
        )

    return float(np.hypot(*(least_squares(errors, instant.truth, loss=loss).x - instant.truth)[:2]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    places, instants = load(parser.parse_args().folder)
    landmarks = LandmarkMap(
        [
            MappedLandmark(LandmarkId("lm8", code), 0.18, Pose("map", "landmark", np.eye(3), np.array([*place, 0.0])))
            for code, place in places.items()
        ]
    )
    print("| landmarks read | instants | without a pose | position, median / 90 % | heading, median | NEES, median |")
    print("|---|---|---|---|---|---|")
    for least in (2, 3):
        chosen = [instant for instant in instants if instant.codes >= least]
        off, squared = [], []
        for instant in chosen:
            estimate = locate_planar(instant.readings, landmarks)
            if estimate.pose is None:
                continue
            found = np.array([estimate.pose.x_m, estimate.pose.y_m, estimate.pose.heading_rad])
            error = found - instant.truth
            error[2] = wrapped(error[2])
            off.append(error)
            squared.append(error @ np.linalg.solve(estimate.covariance, error))
        places_off = 100 * np.hypot(*np.array(off)[:, :2].T)
        print(
            f"| {least} or more | {len(chosen)} | {len(chosen) - len(off)} "
            f"| {np.median(places_off):.1f} / {np.percentile(places_off, 90):.0f} cm "
            f"| {np.rad2deg(np.median(np.abs(np.array(off)[:, 2]))):.2f} deg "
            f"| {np.median(squared):.1f} (mean {np.mean(squared):.1f}) |"
        )
    grid = list(product(RANGE_M, RANGE_SHARES, BEARINGS_DEG, LOSSES))
    best = min(
        float(np.median([from_the_truth(i, places, (fixed, share, bearing), loss) for i in chosen]))
        for fixed, share, bearing, loss in grid
    )
    print(f"\nFrom the truth, three or more, best of {len(grid)} weightings and losses: {100 * best:.1f} cm")


if __name__ == "__main__":
    main()
