"""Planning compared with simulation: predicted and simulated errors of placements, beside evenly spaced landmarks.

    uv run python benchmarks/plan.py [benchmarks/floors/room.yaml ...]

Per floor plan: landmarks placed for 5 cm and 2 deg, 2 in view, in a quarter of the directions, at 90 % of the places;
evenly spaced ones (middle of the wall height, the fewest whose share is as large); the time; the position error that
the placement promises where the demand holds, and what `locate_rig` makes of simulated corners there (root mean
squares, 400 poses); Spearman's rank correlation of predicted and simulated error over 200 random poses.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

from lmkit.io.floor_plan import read_floor
from lmkit.localization.absolute_pose import LocateOptions, locate_rig
from lmkit.localization.pose_prior import PosePrior
from lmkit.model.floor_plan import FloorPlan
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark, wall_pose
from lmkit.planning.coverage import Demand, expected_errors, places_on, predict_coverage, promised_errors
from lmkit.planning.mounting_sites import MountingOptions, possible_mounts
from lmkit.planning.placement import place_landmarks
from lmkit.planning.visibility import find_sights
from lmkit.simulation.recording import T_BASE_LEFT, WheelErrors
from lmkit.simulation.robot import SimulatedRobot
from lmkit.simulation.scene import make_rig

RIG = replace(make_rig(), T_base_left=T_BASE_LEFT)
RADIUS_M = 0.25
DRAWS = 8


def evenly(floor: FloorPlan, spacing_m: float) -> list[MappedLandmark]:
    height = RIG.T_base_left.t[2] + 0.25
    free = {(s.wall.name, round(s.along_m, 2)): s for s in possible_mounts(floor, RIG, MountingOptions("lm8"))}
    by_wall: dict[str, list[float]] = {}
    for name, along in free:
        by_wall.setdefault(name, []).append(along)
    mounted = []
    for wall in floor.walls:
        count = round(wall.length_m / spacing_m)
        for k in range(count):
            wanted = (k + 0.5) * wall.length_m / count
            if by_wall.get(wall.name) and min(abs(np.array(by_wall[wall.name]) - wanted)) < 0.4:
                place = [*(wall.left + wanted * wall.along), height]
                pose = wall_pose(place, wall.facing_rad)
                mounted.append(MappedLandmark(LandmarkId("lm8", len(mounted)), 0.18, pose))
    return mounted


def fewest_even(floor: FloorPlan, demand: Demand, step_m: float) -> int | None:
    """Halving the spacings between one that holds and one that does not."""
    spacings = np.geomspace(6.0, 0.35, 60)

    def holds(k: int) -> bool:
        mounted = evenly(floor, spacings[k])
        return bool(predict_coverage(floor, mounted, RIG, RADIUS_M, step_m).covered(demand).mean() >= demand.share)

    low, high = 0, len(spacings) - 1
    if not holds(high):
        return None
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if holds(middle) else (middle, high)
    return len(evenly(floor, spacings[high]))


def simulated_error(floor: FloorPlan, landmarks: LandmarkMap, state: np.ndarray, seed: int) -> float:
    """Root mean square over draws called ok; infinite where fewer than half are."""
    robot = SimulatedRobot(floor, landmarks, RIG, state, RADIUS_M, WheelErrors(), seed)
    prior = PosePrior(height_m=float(T_BASE_LEFT.t[2]), down=(0.0, 1.0, 0.0))
    off = []
    for _ in range(DRAWS):
        found = locate_rig(robot.look(), RIG, landmarks, LocateOptions(prior=prior, corner_floor_px=0.0))
        if found.status == "ok" and found.T_map_camera is not None:
            base = found.T_map_camera.t - found.T_map_camera.R @ T_BASE_LEFT.R.T @ T_BASE_LEFT.t
            off.append(float(np.sum((base[:2] - state[:2]) ** 2)))
    return float(np.sqrt(np.mean(off))) if len(off) >= DRAWS / 2 else np.inf


def study(path: Path) -> str:
    floor, demand = read_floor(path), Demand()
    before = time.perf_counter()
    placed = place_landmarks(floor, [], RIG, RADIUS_M, demand, MountingOptions("lm8"))
    took = time.perf_counter() - before
    even = fewest_even(floor, replace(demand, share=min(demand.share, placed.share)), placed.coverage.step_m)
    rng = np.random.default_rng(3)
    holds = np.argwhere(placed.coverage.holds(demand))
    some = holds[rng.integers(len(holds), size=400)]
    states = np.column_stack([placed.coverage.places[some[:, 0]], placed.coverage.headings[some[:, 1]]])
    promised = promised_errors(find_sights(states, list(placed.landmarks), RIG, floor), states, RIG)
    made = np.array([simulated_error(floor, placed.landmarks, s, k) for k, s in enumerate(states)])
    known = np.isfinite(made)
    ratio = np.sqrt(np.mean(made[known] ** 2)) / np.sqrt(np.mean(promised[known] ** 2))
    places, _ = places_on(floor, RADIUS_M)
    states = np.column_stack([places[rng.integers(len(places), size=200)], rng.uniform(-np.pi, np.pi, 200)])
    predicted = expected_errors(find_sights(states, list(placed.landmarks), RIG, floor), states, RIG)[0]
    found = np.array([simulated_error(floor, placed.landmarks, s, 1000 + k) for k, s in enumerate(states)])
    rank = spearmanr(np.minimum(predicted, 1e3), np.minimum(found, 1e3)).statistic
    both = np.isfinite(predicted) & np.isfinite(found)
    rank_both = spearmanr(predicted[both], found[both]).statistic
    fewer = "-" if even is None else f"{1 - len(placed.mounts) / even:.0%}"
    kept = f"{rank:.2f} | {rank_both:.2f} of {both.sum()}"
    return (
        f"| {path.stem} | {len(placed.mounts)} | {even or '-'} | {fewer} | {placed.share:.1%} | "
        f"{took:.0f} | {1000 * np.sqrt(np.mean(promised[known] ** 2)):.1f} | "
        f"{1000 * np.sqrt(np.mean(made[known] ** 2)):.1f} | {ratio:.2f} | {kept} |"
    )


def main(paths: Sequence[Path]) -> None:
    print(
        "| floor | placed | even | fewer | share held | s | promised mm | simulated mm | ratio | rank | both known |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    with ProcessPoolExecutor() as pool:
        for line in pool.map(study, paths):
            print(line, flush=True)


if __name__ == "__main__":
    main([Path(name) for name in sys.argv[1:]] or sorted(Path(__file__).parent.glob("floors/*.yaml")))
