"""Sizes of planar maps that are surveyed from ranges and bearings: simulated rooms, several recordings of each.

    uv run python benchmarks/planar_scale.py [--first 900] [--rooms 40]

Wheels err as `MotionNoise` says, in what they report or in what they do; the scale of their way is off by 10 %,
the factor of a recording's ranges by 2 % (standard deviations, the priors of the survey).
"""

from __future__ import annotations

import argparse
import math

import numpy as np
from track import fit

from lmkit.geometry.planar import wrap_angle, wrap_heading
from lmkit.localization.range_bearing_noise import DRIVE_NOISE
from lmkit.mapping.several_readings import survey_readings_together
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.observation import RangeBearing
from lmkit.model.recording import Odometry, Recording
from lmkit.odometry.wheel_odometry import PRIOR_SIGMA, MotionNoise

STEP_S, SPEED_MPS, SEEN_M, SEEN_RAD = 0.1, 0.15, 5.0, 0.6
LANDMARKS, ROOM_M, DRIVEN_M = 15, 5.0, 4.0
FRAME = 10  # steps


def record(rng: np.random.Generator, places: np.ndarray, seconds: float, reported: bool) -> Recording:
    """Drive from goal to goal; the noise is in what the wheels report, or in the motion itself."""
    noise, scale, factor = MotionNoise(), rng.normal(1, PRIOR_SIGMA[0]), rng.normal(1, DRIVE_NOISE.range_scale)
    state, goal = rng.uniform(-3, 3, 3), rng.uniform(-DRIVEN_M, DRIVEN_M, 2)
    rows, frames = [], []
    for k in range(int(seconds / STEP_S)):
        if np.hypot(*(goal - state[:2])) < 0.4:
            goal = rng.uniform(-DRIVEN_M, DRIVEN_M, 2)
        wanted = float(wrap_heading(math.atan2(*(goal - state[:2])[::-1]) - state[2]))
        move = np.array([SPEED_MPS, np.clip(wanted, -0.6, 0.6)]) * STEP_S
        root = math.sqrt(move[0])
        turns = math.hypot(noise.turn_per_root_m * root, noise.turn_per_root_rad * math.sqrt(abs(move[1])))
        strays = rng.normal(0, [noise.along_per_root_m * root, turns])
        rows.append((STEP_S * k, *((move + strays * reported) / STEP_S / [scale, 1.0])))
        way, turn = move + strays * (not reported)
        heading = state[2] + turn / 2
        state = state + np.array([way * math.cos(heading), way * math.sin(heading), turn])
        if k % FRAME == FRAME // 2 and (seen := _readings(rng, places, state, factor, STEP_S * (k + 1))):
            frames.append((STEP_S * (k + 1), seen))
    times, forward, turning = np.array(rows).T
    return Recording((), tuple(frames), Odometry.from_velocities(times, forward, turning))


def _readings(
    rng: np.random.Generator, places: np.ndarray, state: np.ndarray, factor: float, time_s: float
) -> tuple[RangeBearing, ...]:
    off = places - state[:2]
    ranges = np.hypot(*off.T)
    bearings = wrap_angle(np.arctan2(off[:, 1], off[:, 0]) - state[2])
    seen = np.flatnonzero((ranges < SEEN_M) & (np.abs(bearings) < SEEN_RAD))
    read = factor * ranges + rng.normal(0, DRIVE_NOISE.range_sigma(ranges))
    bearings = bearings + rng.normal(0, DRIVE_NOISE.bearing_rad, len(off))
    return tuple(RangeBearing(LandmarkId("lm8", int(k)), float(read[k]), float(bearings[k]), time_s) for k in seen)


def room(seed: int, recordings: int, seconds: float, reported: bool) -> tuple[float, float]:
    """Size of the true map over the found one, less 1, and the error of the map, m."""
    rng = np.random.default_rng([seed, 45])
    places = rng.uniform(-ROOM_M, ROOM_M, (LANDMARKS, 2))
    made = {str(k): record(rng, places, seconds, reported) for k in range(recordings)}
    found = survey_readings_together(made, 0.18).landmarks
    own = np.array([m.T_map_landmark.t[:2] for m in found])
    true = places[[m.id.code for m in found]]
    R, shift = fit(own, true)
    laid = own @ R.T + shift
    away = laid - laid.mean(axis=0)
    larger = float((away * (true - true.mean(axis=0))).sum() / (away**2).sum()) - 1
    return larger, float(np.sqrt(((laid - true) ** 2).sum(axis=1).mean()))


def main() -> None:
    """Print a row for each kind of noise."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=900)
    parser.add_argument("--rooms", type=int, default=40)
    parser.add_argument("--recordings", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=300.0)
    options = parser.parse_args()
    print("| noise of the wheels | rooms | true map larger by | rms | map error, rms |")
    print("|---|---|---|---|---|")
    for name, reported in (("in what they report", True), ("in what they do", False)):
        seeds = range(options.first, options.first + options.rooms)
        larger, error = np.array([room(s, options.recordings, options.seconds, reported) for s in seeds]).T
        mean, spread = 100 * larger.mean(), 100 * larger.std() / math.sqrt(len(larger))
        rms, cm = 100 * math.sqrt((larger**2).mean()), 100 * math.sqrt((error**2).mean())
        print(f"| {name} | {len(larger)} | {mean:.2f} ± {spread:.2f} % | {rms:.2f} % | {cm:.1f} cm |")


if __name__ == "__main__":
    main()
