"""Runs to a goal, simulated: how often the robot arrives, how near, and whether its pose is right.

    uv run python benchmarks/navigate.py [--runs 20] [--first 0] [--every-second] [--images]
        [--lens 0.06] [--wheel-noise 0.02]

In each of the plans in benchmarks/floors, landmarks as `lmkit plan place` places them; random starts (0.4 m clear of
walls, any heading) and goals (where the placement holds its demand); wheels that report 8 % too much distance and 10
% too much rotation, three slips of up to 5 cm and 5 deg, a gyro with bias and noise, images 0.1 s late, a robot that
leans by 0.3 deg, corners and recognition as measured.  ``--every-second`` takes half of the landmarks off walls and
map; ``--images`` photographs the room and reads the images, end to end (minutes a recording).  Arrived means: within
5 cm and 3 deg of the goal, in truth, without touching a wall.
"""

from __future__ import annotations

import argparse
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from lmkit.io.floor_plan import read_floor
from lmkit.localization.correspondences import CORNER_FLOOR_PX
from lmkit.model.floor_plan import FloorPlan
from lmkit.model.landmark_map import LandmarkMap
from lmkit.navigation.navigator import Site, drive_to
from lmkit.pipelines.rendered_cameras import RenderedCameras
from lmkit.planning.coverage import Demand, PoseCoverage, predict_coverage
from lmkit.planning.mounting_sites import MountingOptions
from lmkit.planning.placement import place_landmarks
from lmkit.planning.route import Goal
from lmkit.simulation.lens_errors import with_lens_errors
from lmkit.simulation.recording import T_BASE_LEFT, WheelErrors
from lmkit.simulation.robot import SimulatedRobot
from lmkit.simulation.scene import floor_scene, make_rig
from lmkit.tracking.range_bearing_filter import TrackedPose

RIG = replace(make_rig(), T_base_left=T_BASE_LEFT)
RADIUS_M = 0.25
CLEAR_M = 0.4
WHEELS = WheelErrors(slips=3, delay_s=0.1)


@dataclass(frozen=True)
class Run:
    """One recording: what it says, and the truth."""

    status: str
    off_m: float
    off_deg: float
    touched: bool
    inside: tuple[bool, ...]
    seconds: float

    @property
    def there(self) -> bool:
        return self.off_m < 0.05 and self.off_deg < 3.0


@lru_cache(maxsize=1)
def prepared(path: Path, half: bool) -> tuple[FloorPlan, LandmarkMap, PoseCoverage, PoseCoverage]:
    floor = read_floor(path)
    placed = place_landmarks(floor, [], RIG, RADIUS_M, Demand(), MountingOptions("lm8"))
    full = predict_coverage(floor, list(placed.landmarks), RIG, RADIUS_M)
    if not half:
        return floor, placed.landmarks, full, full
    left = LandmarkMap(list(placed.landmarks)[::2])
    return floor, left, predict_coverage(floor, list(left), RIG, RADIUS_M), full


def wrapped(angle: float) -> float:
    return float(np.arctan2(np.sin(angle), np.cos(angle)))


def drive(seed: int, path: Path, half: bool, images: bool, lens_px: float, wheels: WheelErrors) -> Run:
    floor, landmarks, coverage, full = prepared(path, half)
    rng = np.random.default_rng(seed)
    clear = floor.clearance_at(full.places) > CLEAR_M
    start = np.array([*full.places[rng.choice(np.flatnonzero(clear))], rng.uniform(-np.pi, np.pi)])
    goals = np.argwhere(full.holds(Demand()) & clear[:, None])
    place, turn = goals[rng.integers(len(goals))]
    goal = Goal(*full.places[place].tolist(), float(full.headings[turn]))
    cameras = RenderedCameras(floor_scene(seed, floor, landmarks), RIG, seed) if images else None
    robot = SimulatedRobot(floor, landmarks, RIG, start, RADIUS_M, wheels, seed, cameras)
    inside: list[bool] = []

    def note(pose: TrackedPose) -> None:
        if pose.state is not None and pose.covariance is not None and pose.status == "ok":
            off = pose.state[:2] - robot.seen_from[:2]
            inside.append(bool(off @ np.linalg.solve(pose.covariance[:2, :2], off) < 5.991))

    # Simulated corners have no lens and no paper that the floor could stand for.
    floor_px = CORNER_FLOOR_PX if images else 0.0
    rig = with_lens_errors(RIG, lens_px, seed)
    site = Site(floor, landmarks, rig, RADIUS_M, Demand(), coverage, corner_floor_px=floor_px)
    journey = drive_to(robot, site, goal, on_pose=note)
    off = float(np.hypot(goal.x_m - robot.state[0], goal.y_m - robot.state[1]))
    off_deg = float(np.rad2deg(abs(wrapped(robot.state[2] - (goal.heading_rad or 0.0)))))
    return Run(journey.status, off, off_deg, robot.touched, tuple(inside), robot.time_s)


def row(name: str, runs: list[Run]) -> str:
    arrived = [run for run in runs if run.status == "arrived" and run.there and not run.touched]
    wrong = [run for run in runs if run.status == "arrived" and not run.there]
    rest = Counter(run.status for run in runs if run.status != "arrived")
    off = sorted(100 * run.off_m for run in arrived) or [np.nan]
    inside = np.mean([hit for run in runs for hit in run.inside])
    return (
        f"| {name} | {len(runs)} | {len(arrived)} | {len(wrong)} | {sum(run.touched for run in runs)} | "
        f"{', '.join(f'{count} {status}' for status, count in rest.items()) or '-'} | "
        f"{np.median(off):.1f} / {off[-1]:.1f} | {inside:.1%} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="seed")
    parser.add_argument("--every-second", action="store_true")
    parser.add_argument("--images", action="store_true")
    parser.add_argument("--lens", type=float, default=0.0, help="px, rms, by which the robot's lenses are off")
    parser.add_argument("--wheel-noise", type=float, default=WHEELS.noise_per_root_m, help="m per root of a meter")
    parser.add_argument("floors", type=Path, nargs="*")
    arguments = parser.parse_args()
    wheels = replace(WHEELS, noise_per_root_m=arguments.wheel_noise)
    floors = arguments.floors or sorted(Path(__file__).parent.glob("floors/*.yaml"))
    print("| floor | runs | arrived | claimed wrongly | touched | else | off cm, middle / worst | in 95 % ellipse |")
    print("|---|---|---|---|---|---|---|---|")
    everything: list[Run] = []
    for path in floors:
        with ProcessPoolExecutor() as pool:
            job = partial(
                drive,
                path=path,
                half=arguments.every_second,
                images=arguments.images,
                lens_px=arguments.lens,
                wheels=wheels,
            )
            seeds = range(arguments.first, arguments.first + arguments.runs)
            runs = list(pool.map(job, seeds, chunksize=(arguments.runs + 1) // 2))
        print(row(path.stem, runs), flush=True)
        everything += runs
    print(row("all", everything))


if __name__ == "__main__":
    main()
