"""Are the live filter's covariances honest?  NEES on simulated recordings, lenses exact and lenses slightly wrong.

    uv run python benchmarks/live_nees.py [--seeds 20] [--first 1] [--seconds 20] [--fps 10] [--images] [--late 0.04]

Per row: NEES of x, y and heading over three (mean of the runs' means, and their 10 to 90 % range), the same of x and
y over two, root mean square error.  1 is honest, less is cautious.  ``lens px``: the filter's lenses differ from the
true ones by a smooth field of so many pixels root mean square, drawn anew per run, the same in every image of it: the
error that calibration leaves, which no number of images takes away.  ``floor px`` and ``wheels``: the filter's corner
floor, and its motion noise in shares of the default.  ``--images`` detects in rendered images instead of simulating
corners.  ``--late``: the second camera exposes so many seconds after the first; lenses exact, the default floor.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import cv2
import numpy as np

from lmkit.arrays import FloatArray
from lmkit.geometry.planar import wrap_heading
from lmkit.geometry.rig import AnyRig
from lmkit.live.loop import LiveLoop, LoopSettings
from lmkit.live.motion import GYRO, WHEELS, MotionRow
from lmkit.live.publication import PublicationRule
from lmkit.live.simulated_source import SimulatedRun
from lmkit.live.source_address import parse_source
from lmkit.localization.correspondences import CORNER_FLOOR_PX
from lmkit.model.observation import Detection
from lmkit.model.pose_status import PoseStatus
from lmkit.odometry.wheel_odometry import MotionNoise
from lmkit.simulation.lens_errors import with_lens_errors
from lmkit.tracking.planar_stereo_filter import RigFilter

SETTLED_S = 3.0
CHI2_95 = 7.815  # of three numbers
FLOORS = (CORNER_FLOOR_PX, 0.03, 0.0)
SHARES = (1.0, 0.3)
LENSES = (0.0, 0.06)


@dataclass(frozen=True, eq=False)
class Frame:
    """One time of a recording."""

    time_s: float
    rows: tuple[MotionRow, ...]
    seen: Sequence[Sequence[Detection]]
    truth: FloatArray  # x, y, heading
    stamps_s: tuple[float, ...] = ()  # of the cameras, where they do not expose together


def drive(
    seed: int, seconds: float, fps: float, from_images: bool, late_s: float = 0.0
) -> tuple[SimulatedRun, list[Frame]]:
    """A run and what is seen in it."""
    images = "" if from_images else "&images=no"
    run = SimulatedRun(parse_source(f"sim:?seconds={seconds}&seed={seed}&fps={fps}&speed=max{images}"))
    settings = LoopSettings("wheels", rule=PublicationRule(confirm=1))
    loop = LiveLoop(run.course.rig, run.course.landmarks, settings) if from_images else None
    frames = []
    for group in run.groups():
        seen = group.seen
        if loop is not None:
            state = loop.step(group)
            assert state is not None
            seen = tuple(view.detections for view in state.views)
        assert seen is not None
        stamps: tuple[float, ...] = ()
        if late_s:
            stamps = group.time_s, group.time_s + late_s
            seen = tuple(run.course.corners(run.course.T_map_base(stamp))[k] for k, stamp in enumerate(stamps))
        frames.append(Frame(group.time_s, group.motion, seen, run.course.state(group.time_s), stamps))
    return run, frames


def nees(run: SimulatedRun, frames: list[Frame], rig: AnyRig, floor_px: float, noise: MotionNoise) -> FloatArray:
    """(K,4) NEES / 3, NEES / 2 of x and y, squared error (m²) and trace of the stated covariance of x and y."""
    tracker = RigFilter(run.course.landmarks, rig, noise, floor_px)
    found = []
    for frame in frames:
        for row in frame.rows:
            if row.kind == WHEELS:
                tracker.wheels.add_odometry(row.time_s, *row.values)
            elif row.kind == GYRO:
                tracker.wheels.add_gyro(row.time_s, *row.values)
        answer = tracker.observe(frame.time_s, frame.seen, frame.stamps_s)
        if answer.state is None or answer.covariance is None or answer.status != PoseStatus.OK:
            continue
        if frame.time_s < SETTLED_S or not any(frame.seen):
            continue
        d = answer.state - frame.truth
        d[2] = float(wrap_heading(d[2]))
        C = answer.covariance
        xy = d[:2] @ np.linalg.solve(C[:2, :2], d[:2])
        found.append([d @ np.linalg.solve(C, d) / 3, xy / 2, d[:2] @ d[:2], np.trace(C[:2, :2])])
    return np.array(found).reshape(-1, 4)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--fps", type=float, default=10.0)
    parser.add_argument("--images", action="store_true")
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--late", default="", help="seconds, one or more")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    if arguments.late:
        print("| late, s | wheels | NEES/3 | 10 to 90 % | NEES/2 of x, y | within 95 % | error mm | stated mm |")
        print("|---|---|---|---|---|---|---|---|")
        for late_s in map(float, arguments.late.split(",")):
            drives = [drive(s, arguments.seconds, arguments.fps, False, late_s) for s in seeds]
            for share in SHARES:
                noise = motion_noise(share)
                rows = [nees(run, frames, run.course.rig, CORNER_FLOOR_PX, noise) for run, frames in drives]
                print(f"| {late_s:g} | {share:g} | {cells(rows)} |", flush=True)
        return
    drives = [drive(s, arguments.seconds, arguments.fps, arguments.images) for s in seeds]
    print(
        "| lens px | floor px | wheels | NEES/3 | 10 to 90 % | NEES/2 of x, y | within 95 % | error mm | stated mm |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for lens in LENSES:
        rigs = [with_lens_errors(run.course.rig, lens, k) for k, (run, _) in enumerate(drives)]
        for floor in FLOORS:
            for share in SHARES:
                rows = [
                    nees(run, frames, rig, floor, motion_noise(share))
                    for (run, frames), rig in zip(drives, rigs, strict=True)
                ]
                print(f"| {lens:g} | {floor:g} | {share:g} | {cells(rows)} |", flush=True)


def motion_noise(share: float) -> MotionNoise:
    """The default noise of motions times a share."""
    return MotionNoise(**{name: share * value for name, value in asdict(MotionNoise()).items()})


def cells(rows: Sequence[FloatArray]) -> str:
    """Cells of a table, from the numbers of every run, as of :func:`nees`."""
    means = np.array([r.mean(axis=0) for r in rows if len(r)])
    low, high = np.percentile(means[:, 0], [10, 90])
    within = np.mean([np.mean(3 * r[:, 0] < CHI2_95) for r in rows if len(r)])
    error, stated = 1000 * np.sqrt(means[:, 2:].mean(axis=0))
    return (
        f"{means[:, 0].mean():.2f} | {low:.2f} to {high:.2f} | {means[:, 1].mean():.2f} | {100 * within:.0f} % | "
        f"{error:.1f} | {stated:.1f}"
    )


if __name__ == "__main__":
    main()
