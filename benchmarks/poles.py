"""The source paper's experiment with poles and a laser scanner, repeated in simulation, scan by scan.

    uv run python benchmarks/poles.py [--stations 400]

Poles at (4, 2) and (4, -1) m, scanner at (0.160, 0.007) m on the robot, as the paper has them.  The paper prints
neither its stations nor its scanner: here the robot stands 1 to 4 m in front of the poles and up to 1.5 m aside,
among the legs of two tables, and its pose is known beforehand to 0.5 m and 15 deg.  Percentage error:
|actual - measured| / actual of X and Y, counted from a corner of the room 4 m behind and 4 m beside the origin, so
that no actual distance is near zero.
"""

from __future__ import annotations

import argparse
import math

import numpy as np

from lmkit.detection.scan_poles import ScanNoise, find_poles
from lmkit.geometry.planar import wrap_heading
from lmkit.localization.pole_association import PosePriorPlanar, associate_poles
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark, wall_pose
from lmkit.model.pose_status import PoseStatus
from lmkit.model.scan import POLE, ScannerMount
from lmkit.simulation.scanner import ScannedScene, ScannerModel, room_walls, scatter_clutter

POLES, MORE = ((4.0, 2.0), (4.0, -1.0)), ((1.0, 3.5), (0.0, -3.0))
SCANNER = ScannerMount(0.160, 0.007)
PRINTED = (1.95, 1.93)
CORNER, ROOM = (-4.0, -4.0), (10.0, 8.0)
DIAMETER_M = 0.11
CHI2_95 = 7.815


def run(step_deg: float, range_m: float, count: int, stations: int) -> str:
    """One row of the table."""
    places = (*POLES, *MORE)[:count]
    landmarks = LandmarkMap(
        [MappedLandmark(LandmarkId(POLE, k), DIAMETER_M, wall_pose([*p, 0.0], 0.0)) for k, p in enumerate(places)]
    )
    model = ScannerModel(math.radians(step_deg), range_m=range_m)
    prior = np.diag([0.5, 0.5, math.radians(15)]) ** 2
    percent, errors, within, wrong, tried = [], [], 0, 0, 0
    for seed in range(stations):
        rng = np.random.default_rng([seed, 7])
        state = np.array([4 - rng.uniform(1, 4), 0.5 + rng.uniform(-1.5, 1.5), rng.uniform(-0.5, 0.5)])
        clutter = scatter_clutter(rng, 2, ROOM, CORNER)
        clutter = clutter[np.hypot(*(clutter[:, :2] - state[:2]).T) > 0.5]
        tried += 1
        scan = ScannedScene.of(landmarks, room_walls(ROOM, CORNER), clutter).scan(state, model, rng, SCANNER)
        rough = PosePriorPlanar(state + np.sqrt(np.diag(prior)) * rng.normal(size=3), prior)
        found = find_poles(scan, [DIAMETER_M / 2], ScanNoise(range_m=range_m))
        poles = [pole.seen_from_base(SCANNER) for pole in found]
        answer = associate_poles(poles, landmarks, rough, scan, SCANNER).estimate
        if answer.status != PoseStatus.OK or answer.pose is None or answer.covariance is None:
            continue
        if len(answer.inliers) < 2:
            continue
        off = np.array([answer.pose.x_m - state[0], answer.pose.y_m - state[1], 0.0])
        off[2] = wrap_heading((answer.pose.heading_rad or 0.0) - state[2])
        wrong += bool(np.hypot(*off[:2]) > 0.25)
        within += bool(off @ np.linalg.solve(answer.covariance, off) < CHI2_95)
        percent.append(100 * np.abs(off[:2]) / (state[:2] - np.array(CORNER)))
        errors.append(off)
    values, n = np.array(errors), len(errors)
    mean = np.mean(percent, axis=0)
    rms = np.sqrt((values**2).mean(axis=0))
    return (
        f"| {step_deg:g} deg | {1000 * range_m:g} mm | {count} | {n} of {tried} | {wrong} "
        f"| {mean[0]:.2f} / {mean[1]:.2f} | "
        f"{1000 * rms[0]:.0f} / {1000 * rms[1]:.0f} mm | {math.degrees(rms[2]):.2f} deg | {100 * within / n:.0f} % |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--stations", type=int, default=400)
    stations = parser.parse_args().stations
    print(f"Printed: X {PRINTED[0]} %, Y {PRINTED[1]} %.\n")
    print("| step | range noise | poles | located | wrong | error X / Y, % | rms X / Y | heading | within 95 % |")
    print("|---|---|---|---|---|---|---|---|---|")
    for step_deg, range_m in ((0.25, 0.01), (0.5, 0.01), (1.0, 0.01), (1.0, 0.03)):
        for count in (2, 4):
            print(run(step_deg, range_m, count, stations), flush=True)


if __name__ == "__main__":
    main()
