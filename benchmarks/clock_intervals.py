"""Offsets of cameras' clocks, found by `lmkit calibrate --clocks`: errors, and whether their intervals hold.

    uv run python benchmarks/clock_intervals.py [--robots 20] [--first 0]

Simulated robots with three cameras that share no view drive 30 s through a room with 24 landmarks, in figures of
eight or rounds; clocks are up to 0.15 s off.  Corners err by 0.15 px, with 0.06 px more stated for the lens; wheels
by 8 % and 10 % and 1 cm per root of a meter, with the noise of turns of a plain odometry, of a gyro, or with slips.
``visual`` is odometry of poses that drift in six directions.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np
from base_mounting import looking_around

from lmkit.geometry.rig import with_time_offsets
from lmkit.mapping.clock_offsets import find_clock_offsets
from lmkit.odometry.motion_model import Motion
from lmkit.odometry.pose_odometry import PoseMotion
from lmkit.odometry.wheel_odometry import MotionModel
from lmkit.simulation.recording import WheelErrors, make_drive

LATE_S, SECONDS, CAMERAS = 0.15, 30.0, 3
KINDS = ("gyro", "wheels", "slips", "rounds", "visual")


def found_offsets(kind: str, seed: int) -> np.ndarray:
    """(C-1,2) errors and stated standard deviations, ms."""
    rng = np.random.default_rng([seed, 31])
    rig, _ = looking_around(rng, CAMERAS)
    offsets = rng.uniform(-LATE_S, LATE_S, CAMERAS - 1)
    errors = WheelErrors(slips=2 if kind == "slips" else 0)
    timed = with_time_offsets(rig, offsets.tolist())
    drive = make_drive(seed, SECONDS, rig=timed, count=24, eights=kind != "rounds", errors=errors)
    gyro = None if kind == "wheels" else drive.gyro
    motion: Motion = MotionModel(drive.odometry, gyro)
    if kind == "visual":
        motion = PoseMotion(drive.visual_odometry(seed))
    found = find_clock_offsets(drive.frames, rig, drive.landmarks, motion)
    return 1000 * np.column_stack([found.offsets_s - offsets, found.sigmas_s])


def row(kind: str, seeds: Sequence[int]) -> str:
    all_ = np.concatenate([found_offsets(kind, seed) for seed in seeds])
    inside = 100 * np.mean(np.abs(all_[:, 0]) < 1.96 * all_[:, 1])
    nees, rms = np.mean((all_[:, 0] / all_[:, 1]) ** 2), np.sqrt(np.mean(all_[:, 0] ** 2))
    stated = np.sqrt(np.mean(all_[:, 1] ** 2))
    largest = np.abs(all_[:, 0]).max()
    return f"| {kind} | {len(all_)} | {rms:.3f} | {largest:.2f} | {stated:.3f} | {inside:.0f} | {nees:.2f} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--kinds", default=",".join(KINDS))
    given = parser.parse_args()
    print("| odometry | offsets | rms, ms | largest | stated, ms | within 95 %, % | NEES |")
    print("|---|---|---|---|---|---|---|")
    for kind in given.kinds.split(","):
        print(row(kind, range(given.first, given.first + given.robots)), flush=True)


if __name__ == "__main__":
    main()
