"""The source paper's Table 1, repeated in simulation: which range noise gives its 1.95 % and 1.93 %?

    uv run python benchmarks/two_landmarks.py [--draws 4000]

Two poles 3 m apart, as in the paper.  Where its robot stood is not printed; here it stands anywhere 1 to 5 m before
them and up to 2 m aside, looking between the poles, and X and Y count from a corner of the room 2 m beside pole A, so
that no actual distance is near zero.  Percentage error: |actual - measured| / actual, each axis on its own, the
mean.  Simulated readings: ranges off by a share of themselves, bearings by 0.25 deg.
"""

from __future__ import annotations

import argparse
import math

import numpy as np

from lmkit.localization.range_bearing import locate_planar
from lmkit.localization.range_bearing_noise import ReadingNoise
from lmkit.localization.two_landmarks import locate_by_two
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark, wall_pose
from lmkit.model.observation import RangeBearing

A, B = np.array([6.0, 2.0]), np.array([6.0, 5.0])
MORE = (np.array([6.0, 8.0]), np.array([3.0, 8.0]))
BEARING_RAD = math.radians(0.25)
PRINTED = (1.95, 1.93)


def as_printed(ranges: np.ndarray, bearings: np.ndarray) -> tuple[float, float]:
    """x and y by the paper's own formulas, which hold since the two poles share their x (its +- taken as -)."""
    y = (ranges[0] ** 2 - ranges[1] ** 2) / (2 * (B[1] - A[1])) + (A[1] + B[1]) / 2
    return A[0] - math.sqrt(max(ranges[0] ** 2 - (y - A[1]) ** 2, 0.0)), y


def percent(share: float, draws: int, landmarks: int) -> dict[str, np.ndarray]:
    """Mean percentage errors (X, Y) of every method at a range noise of ``share``."""
    rng = np.random.default_rng(5)
    places = [A, B, *MORE][:landmarks]
    known = LandmarkMap(
        [MappedLandmark(LandmarkId("lm8", k), 0.18, wall_pose([*p, 1.0], math.pi)) for k, p in enumerate(places)]
    )
    noise = ReadingNoise(0.0, share, BEARING_RAD, 0.0)
    errors: dict[str, list[np.ndarray]] = {"as printed": [], "two landmarks": [], "lmkit": []}
    for _ in range(draws):
        robot = np.array([6.0 - rng.uniform(1, 5), rng.uniform(1.5, 5.5)])
        heading = rng.uniform(-0.3, 0.3)
        offs = [p - robot for p in places]
        ranges = np.array([np.hypot(*off) for off in offs]) * (1 + share * rng.normal(size=landmarks))
        bearings = np.array([math.atan2(off[1], off[0]) - heading for off in offs])
        bearings = bearings + BEARING_RAD * rng.normal(size=landmarks)
        closed = locate_by_two(A, B, *ranges[:2], *bearings[:2])
        readings = [
            RangeBearing(LandmarkId("lm8", k), float(ranges[k]), float(bearings[k])) for k in range(landmarks)
        ]
        found = locate_planar(readings, known, noise).pose
        for name, xy in (
            ("as printed", as_printed(ranges, bearings)),
            ("two landmarks", (closed.x_m, closed.y_m)),
            ("lmkit", None if found is None else (found.x_m, found.y_m)),
        ):
            errors[name].append(np.full(2, np.nan) if xy is None else 100 * np.abs(np.array(xy) - robot) / robot)
    return {name: np.nanmean(values, axis=0) for name, values in errors.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=4000)
    draws = parser.parse_args().draws
    print(f"Printed: X {PRINTED[0]} %, Y {PRINTED[1]} %.  {draws} draws a row, X / Y in %.\n")
    print("| range noise | paper's formulas | corrected | lmkit, 2 landmarks | lmkit, 3 | lmkit, 4 |")
    print("|---|---|---|---|---|---|")
    for share in (0.005, 0.01, 0.0125, 0.015, 0.02, 0.03, 0.05):
        two = percent(share, draws, 2)
        cells = [two["as printed"], two["two landmarks"], two["lmkit"]]
        cells += [percent(share, draws // 4, count)["lmkit"] for count in (3, 4)]
        print(f"| {100 * share:g} % | " + " | ".join(f"{x:.2f} / {y:.2f}" for x, y in cells) + " |")


if __name__ == "__main__":
    main()
