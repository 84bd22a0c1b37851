"""Landmarks partly hidden: a pole across, a bar from one side, something over a corner.

    uv run --extra benchmark python benchmarks/hidden.py [--n 120] [--profile accurate]

Simulated: sides of 30 to 90 px, tilts to 40 degrees, Bayer, filmic tone, JPEG 85.  What hides is dark, gray
or bright.  "Gaps clear": nothing lies over a gap position, so that the code is there to be read.
"""

from __future__ import annotations

import argparse
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from functools import partial

import cv2
import numpy as np
from families import texture
from peers import wilson

from lmkit.detection.config import PROFILES, DetectOptions
from lmkit.detection.detector import detect_landmarks
from lmkit.detection.pattern_model import LandmarkPattern
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.pose import Pose
from lmkit.model.landmark import LM8
from lmkit.model.landmark_map import LandmarkMap
from lmkit.simulation.photograph import Development, ImagingChain, Lens, Light, Sensor, expose
from lmkit.simulation.render import render
from lmkit.simulation.scene import Panel, Scene

CAMERA = CameraModel((240, 180), np.array([[300.0, 0, 119.5], [0, 300.0, 89.5], [0, 0, 1]]), np.zeros(5))
CHAIN = ImagingChain(Lens(0.7), Light(0.6), Sensor(3000, 8, True), Development(tone="filmic", jpeg_quality=85))
KINDS = ("pole across", "bar from one side", "corner")


def hiding_panel(kind: str, T: Pose, rng: np.random.Generator) -> tuple[Panel, np.ndarray]:
    """Occluder, 5 mm before the landmark, and its corners (4,2) in the landmark's plane, m."""
    angle = rng.uniform(0, 2 * np.pi)
    if kind == "corner":
        angle = np.pi / 4 + np.pi / 2 * rng.integers(4)
    way = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-way[1], way[0]])
    width, length, middle = {
        "pole across": (rng.uniform(0.02, 0.06), 0.5, across * rng.uniform(-0.09, 0.09)),
        "bar from one side": (
            rng.uniform(0.02, 0.06),
            0.1,
            way * rng.uniform(0.11, 0.13) + across * rng.uniform(-0.06, 0.06),
        ),
        "corner": (0.2, 0.1, way * rng.uniform(0.145, 0.17)),
    }[kind]
    R = np.column_stack([np.append(across, 0), np.append(-way, 0), [0, 0, 1.0]])
    color = rng.choice([0.02, 0.05, 0.15, 0.4, 0.8]) * np.array(
        [rng.uniform(0.5, 1), rng.uniform(0.6, 1), rng.uniform(0.4, 1)]
    )
    t = T.R @ np.array([*middle, 0.005]) + T.t
    panel = Panel(Pose("map", "cover", T.R @ R, t), (width, length), np.tile(color.astype(np.float32), (8, 8, 1)))
    corners = [
        middle + sx * width / 2 * across + sy * length / 2 * way for sx, sy in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    return panel, np.array(corners)


def gaps_clear(cover_m: np.ndarray) -> bool:
    """Nothing lies over a gap position."""
    steps = np.arange(-89.0, 90.0, 2.0)
    points = np.column_stack([grid.ravel() for grid in np.meshgrid(steps, steps)])
    hidden = np.array(
        [
            cv2.pointPolygonTest((cover_m * 1000).astype(np.float32), (float(x), float(y)), False) >= 0
            for x, y in points
        ]
    )
    spread = np.tile([1.0, 0.0, 1.0], (int(hidden.sum()), 1))
    return not hidden.any() or bool(LandmarkPattern(LM8).coverage(points[hidden], spread).gaps.max() < 0.2)


def trial(options: DetectOptions, job: tuple[str, int]) -> tuple[str, bool, bool, bool]:
    """(kind, gaps clear, read, wrong)."""
    kind, seed = job
    cv2.setNumThreads(1)
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    code, side = int(rng.integers(256)), float(rng.uniform(30, 90))
    tilt = cv2.Rodrigues(np.array([0.0, np.deg2rad(rng.uniform(-40, 40)), 0.0]))[0]
    T = Pose("map", "sheet", tilt @ np.diag([1.0, -1.0, -1.0]), np.array([0.01, -0.02, 300 * 0.18 / side]))
    cover, corners = hiding_panel(kind, T, rng)
    scene = Scene((Panel(T, (0.2, 0.2), texture("lm8", code)), cover), LandmarkMap([]), (1, 1, 1))
    wall = np.full((180, 240, 3), rng.uniform(0.1, 0.5), dtype=np.float32)
    image = expose(render(scene, CAMERA, Pose.identity("map", "camera"), wall), CHAIN, rng)
    codes = [d.code for d in detect_landmarks(image, options)]
    return kind, gaps_clear(corners), code in codes, any(c != code for c in codes)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=120, help="scenes of each kind")
    parser.add_argument("--seed", type=int, default=5000)
    parser.add_argument("--profile", choices=list(PROFILES), default="balanced")
    parser.add_argument("--jobs", type=int, help="processes; as many as processors unless given")
    options = parser.parse_args()
    jobs = [(kind, options.seed + k) for kind in KINDS for k in range(options.n)]
    work = partial(trial, DetectOptions(config=PROFILES[options.profile]))
    with ProcessPoolExecutor(options.jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        answers = list(pool.map(work, jobs, chunksize=8))
    print("| hidden by | gaps | n | read | wrong |")
    print("|---|---|---|---|---|")
    for kind in KINDS:
        for clear in (True, False):
            some = [a for a in answers if a[0] == kind and a[1] == clear]
            if some:
                read, wrong = sum(a[2] for a in some), sum(a[3] for a in some)
                low, high = wilson(read, len(some))
                share = f"{read / len(some):.2f} ({low:.2f} to {high:.2f})"
                print(f"| {kind} | {'clear' if clear else 'covered'} | {len(some)} | {share} | {wrong} |")


if __name__ == "__main__":
    main()
