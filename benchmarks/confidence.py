"""Is a confidence of 0.9 right nine times in ten?  The reliability of what `lmkit detect` says of itself.

    uv run --extra benchmark python benchmarks/confidence.py ../shared/data/photos [--n 800] [--plots docs/benchmarks]

Simulated (`planar.py`): small, blurred, noisy and moving landmarks before real photographs, most of
them at the edge of what can be read.  The acceptance rule is opened wide, so that unsure answers are
seen at all; what the rule of every day lets through is counted beside.
"""

from __future__ import annotations

import argparse
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from peers import wilson
from planar import View, background, backgrounds, shoot

from lmkit.detection.acceptance import AcceptanceRule
from lmkit.detection.config import DetectOptions, DetectorConfig
from lmkit.detection.detector import candidates_of
from lmkit.simulation.photograph import Development, ImagingChain, Lens, Light, Sensor

WIDE = AcceptanceRule(
    turn_margin=8.0,
    code_margin=0.0,
    parts_misfit=6.0,
    plain_parts_misfit=6.0,
    part_sigma=1.0,
    part_deviation=1.0,
    hidden=40.0,
)
EDGES = (0.0, 0.3, 0.5, 0.7, 0.85, 0.95, 0.99, 1.0001)


def view(seed: int) -> View:
    rng = np.random.default_rng([seed, 9])
    motion = rng.normal(0, 1.5, 2)
    warm = float(rng.uniform(2700, 6500))
    chain = ImagingChain(
        Lens(float(rng.uniform(0.5, 1.2)), motion_px=(float(motion[0]), float(motion[1]))),
        Light(float(rng.uniform(0.05, 0.8)), temperature_k=warm),
        Sensor(3000.0, 8.0, bayer=True),
        Development(
            balanced_for_k=float(np.clip(warm * rng.uniform(0.8, 1.2), 2500, 7500)),
            tone=str(rng.choice(["srgb", "filmic"])),
            jpeg_quality=int(rng.integers(70, 95)),
        ),
    )
    return View(float(rng.uniform(9, 24)), float(rng.uniform(0, 50)), chain)


def attempt(photos: tuple[Path, ...], seed: int) -> list[tuple[float, bool, bool]]:
    """(confidence, right, let through every day) of what is read where the landmark is."""
    cv2.setNumThreads(1)
    shot = shoot("lm8", view(seed), background(photos[seed % len(photos)]), seed)
    middle, side = shot.corners.mean(axis=0), np.sqrt(cv2.contourArea(shot.corners.astype(np.float32)))
    here = [
        a
        for a in candidates_of(shot.image, DetectOptions(config=DetectorConfig(min_aligned_pattern=0.1)))
        if np.linalg.norm(a.corners.mean(axis=0) - middle) < 0.5 * side and a.decoding.reason_to_reject(WIDE) is None
    ]
    here.sort(key=lambda a: -a.decoding.margin)
    return [(a.decoding.confidence, a.decoding.code == shot.code, a.rejected is None) for a in here[:1]]


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("photos", type=Path)
    parser.add_argument("--n", type=int, default=800)
    parser.add_argument("--seed", type=int, default=80_000)
    parser.add_argument("--plots", type=Path)
    options = parser.parse_args()
    photos = tuple(backgrounds(options.photos))
    with ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn")) as pool:
        seeds = range(options.seed, options.seed + options.n)
        lines = [line for some in pool.map(partial(attempt, photos), seeds, chunksize=8) for line in some]
    said, right, daily = (np.array(column) for column in zip(*lines, strict=True))
    rows = []
    print(f"{len(lines)} answers in {options.n} images\n")
    print("| confidence said | mean | right | of which let through every day |\n|---|---|---|---|")
    for low, high in pairwise(EDGES):
        chosen = (said >= low) & (said < high)
        n, hits = int(chosen.sum()), int(right[chosen].sum())
        if n == 0:
            continue
        a, b = wilson(hits, n)
        rows.append((float(said[chosen].mean()), hits / n, a, b))
        every_day = f"{int(right[chosen & daily].sum())} right of {int((chosen & daily).sum())}"
        rate = f"{hits / n:.3f} of {n} ({a:.2f} to {b:.2f})"
        print(f"| {low:g} to {min(high, 1):g} | {rows[-1][0]:.3f} | {rate} | {every_day} |")
    if options.plots:
        plot(rows, options.plots)


def plot(rows: list[tuple[float, float, float, float]], folder: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    said, right, low, high = np.array(rows).T
    figure, axis = plt.subplots(figsize=(4.6, 4.4), layout="constrained")
    axis.plot([0, 1], [0, 1], color="0.6", linewidth=1)
    axis.errorbar(said, right, yerr=[np.maximum(right - low, 0), np.maximum(high - right, 0)], fmt="o-", capsize=3)
    axis.set_xlabel("confidence said")
    axis.set_ylabel("share right (95 % interval)")
    axis.grid(alpha=0.3)
    axis.spines[["top", "right"]].set_visible(False)
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / "confidence.png", dpi=110)


if __name__ == "__main__":
    main()
