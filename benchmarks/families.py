"""Costs of a family in distance, and gains in safety: side at 50 and 95 % recognition, wrong codes.

    uv run --extra benchmark python benchmarks/families.py ../shared/data/photos [--n 24] [--plots docs/benchmarks]

Simulated as `planar.py` tells, frontal and at 45 degrees, every family on the same scenes; wrong codes are counted
with the usual acceptance, and without a code margin, where the families differ.
"""

from __future__ import annotations

import argparse
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from functools import lru_cache, partial
from pathlib import Path

import cv2
import numpy as np
from detection import BASE, crossing
from peers import wilson
from planar import SIDE_M, View, background, backgrounds, camera, place

from lmkit.detection.acceptance import AcceptanceRule
from lmkit.detection.config import DetectOptions
from lmkit.detection.detector import best_of_each_place, candidates_of
from lmkit.generation.page import bare_landmark_page
from lmkit.generation.png import page_to_image
from lmkit.geometry.pose import Pose
from lmkit.model.landmark import FAMILIES
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.palette import srgb_to_linear
from lmkit.simulation.inks import OFFSET, as_printed
from lmkit.simulation.photograph import expose
from lmkit.simulation.render import render
from lmkit.simulation.scene import Panel, Scene

SIDES_PX = (8, 10, 12, 14, 16, 18, 20, 24, 28, 34)
LOOSE = AcceptanceRule(0.0)  # as likely right as not


@lru_cache(maxsize=512)
def texture(family: str, code: int) -> np.ndarray:
    """(h,w,3) linear RGB of the landmark with its white margin."""
    face = np.asarray(page_to_image(bare_landmark_page(FAMILIES[family], code, 180.0), 100))
    edge = round(face.shape[0] / 18)
    sheet = cv2.copyMakeBorder(face, edge, edge, edge, edge, cv2.BORDER_CONSTANT, value=(255, 255, 255))
    return as_printed(srgb_to_linear(sheet / 255).astype(np.float32), OFFSET)


def trial(photos: tuple[Path, ...], job: tuple[str, float, float, int]) -> dict:
    """One landmark before one photograph: read? wrong? wrong under the loose rule?"""
    name, side_px, tilt_deg, seed = job
    cv2.setNumThreads(1)
    family = FAMILIES[name]
    rng = np.random.default_rng(seed)
    T = place(View(side_px, tilt_deg, BASE), rng)
    code = int(rng.random() * family.code_count)
    paper = SIDE_M * 10 / 9
    panel = Panel(Pose("map", "marker", T.R, T.t), (paper, paper), texture(name, code))
    scene = Scene((panel,), LandmarkMap([]), (1.0, 1.0, 1.0))
    wall = background(photos[seed % len(photos)])
    image = expose(render(scene, camera(), Pose.identity("map", "camera"), wall), BASE, rng)
    trials = candidates_of(image, DetectOptions((family,)))
    strict = best_of_each_place([a for a in trials if a.rejected is None])
    loose = best_of_each_place([a for a in trials if a.rejected != "cut" and a.log_odds >= LOOSE.least_log_odds])
    return {
        "family": name,
        "side": side_px,
        "tilt": tilt_deg,
        "read": any(a.decoding.code == code for a in strict),
        "wrong": any(a.decoding.code != code for a in strict),
        "loose": any(a.decoding.code == code for a in loose),
        "loose_wrong": any(a.decoding.code != code for a in loose),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("photos", type=Path)
    parser.add_argument("--n", type=int, default=24)
    parser.add_argument("--seed", type=int, default=700)
    parser.add_argument("--plots", type=Path)
    parser.add_argument("--jobs", type=int, help="processes; as many as processors unless given")
    options = parser.parse_args()
    photos = backgrounds(options.photos)
    jobs = [
        (name, side, tilt, options.seed + k)
        for name in FAMILIES
        for tilt in (0.0, 45.0)
        for side in SIDES_PX
        for k in range(options.n)
    ]
    with ProcessPoolExecutor(options.jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        lines = list(pool.map(partial(trial, photos), jobs, chunksize=8))
    print(
        "| family | codes | distance | side at 50 / 95 %, px | at 45 deg | wrong codes | wrong with no code margin |"
    )
    print("|---|---|---|---|---|---|---|")
    curves: dict = {}
    for name, family in FAMILIES.items():
        cells = []
        for tilt in (0.0, 45.0):
            some = [line for line in lines if line["family"] == name and line["tilt"] == tilt]
            hits = np.array([sum(line["read"] for line in some if line["side"] == side) for side in SIDES_PX])
            n = np.full(len(SIDES_PX), options.n)
            curves[name, tilt] = hits / n
            cells.append(
                " / ".join(f"{crossing(np.array(SIDES_PX, float), hits, n, level):.1f}" for level in (0.5, 0.95))
            )
        own = [line for line in lines if line["family"] == name]
        wrong, loose = sum(line["wrong"] for line in own), sum(line["loose_wrong"] for line in own)
        answers = sum(line["loose"] or line["loose_wrong"] for line in own)
        low, high = wilson(loose, max(answers, 1))
        rate = f"{loose} of {answers} ({100 * low:.1f} to {100 * high:.1f} %)"
        answer = [name, family.code_count, family.distance, *cells, f"{wrong} of {len(own)}", rate]
        print("| " + " | ".join(map(str, answer)) + " |")
    if options.plots is not None:
        draw(options.plots, curves, options.n)


def draw(folder: Path, curves: dict, n: int) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(10, 4), sharey=True)
    for axis, tilt in zip(axes, (0.0, 45.0), strict=True):
        for name in FAMILIES:
            axis.plot(SIDES_PX, curves[name, tilt], marker="o", ms=3, label=name)
        axis.set_xlabel("side in the image, px")
        axis.set_title("frontal" if tilt == 0 else "tilted by 45 degrees")
        axis.grid(alpha=0.3)
    axes[0].set_ylabel(f"share read (n = {n} each)")
    axes[0].legend()
    figure.tight_layout()
    figure.savefig(folder / "families.png", dpi=110)


if __name__ == "__main__":
    main()
