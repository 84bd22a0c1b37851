"""Shares of landmarks read and of wrong codes, and the reliability of the confidence, at every strictness.

    uv run --extra benchmark python benchmarks/acceptance.py ../shared/data/photos [--images 600] [--plots FOLDER]
        [--family lm12 --hidden 0.6] [--many | --moving] [--seed 90100] [--limits 2.5 3.5 4]

Cameras, seeds and photographs (`acceptance_sets.py`) that served neither the weights nor the limits
(`train_acceptance.py`); the photographs as they are and enlarged for false positives, and those that scikit-image
ships.  Intervals are Wilson's, 95 %.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import skimage
from acceptance_sets import MANY, MOVING, REPORT, USUAL, ImageSet
from peers import wilson
from tag_false_positives import SHIPPED, versions
from train_acceptance import OPTIONS, RIGHT_CORNERS

from lmkit.detection.acceptance import STRICTNESSES
from lmkit.detection.config import DetectOptions
from lmkit.detection.detector import best_of_each_place, candidates_of
from lmkit.model.families import families_named

SIDES_PX = (9, 12, 15, 20, 25, 30, 100)
CONFIDENCES = (0.0, 0.1, 0.3, 0.5, 0.7, 0.88, 0.95, 0.99, 1.0001)


@dataclass(frozen=True)
class Result:
    """Answers of one image.

    Attributes:
        answers: (log odds, right, on a landmark, on one that something hides) of every place.
        landmarks: (side in px, log odds of its right answer or -inf) of every landmark that nothing hides.
    """

    answers: tuple[tuple[float, bool, bool, bool], ...]
    landmarks: tuple[tuple[float, float], ...]


def result_of(image: np.ndarray, shown: Sequence, options: DetectOptions) -> Result:
    places = best_of_each_place([c for c in candidates_of(image, options) if c.rejected != "cut"])
    answers, read = [], {}
    for place in places:
        middle = place.corners.mean(axis=0)
        near = [s for s in shown if np.linalg.norm(s.corners.mean(axis=0) - middle) < 0.5 * s.side_px]
        right = [
            k
            for k, s in enumerate(shown)
            if s.code == place.decoding.code
            and np.linalg.norm(place.corners - s.corners, axis=1).max() < RIGHT_CORNERS * s.side_px
        ]
        read |= dict.fromkeys(right, place.log_odds)
        answers.append((place.log_odds, bool(right), bool(near), any(s.is_hidden for s in near)))
    landmarks = [(s.side_px, read.get(k, -np.inf)) for k, s in enumerate(shown) if not s.is_hidden]
    return Result(tuple(answers), tuple(landmarks))


def simulated(images: ImageSet, folder: Path, keep: Path | None, index: int) -> Result:
    cv2.setNumThreads(1)
    options = replace(OPTIONS, families=families_named(images.family))
    return result_of(*images.scene(images.photographs(folder), USUAL, keep, index), options)


def photographed(family: str, path: Path) -> list[Result]:
    cv2.setNumThreads(1)
    options = replace(OPTIONS, families=families_named(family))
    return [result_of(seen, (), options) for _, _, seen in versions([path])]


def rate(hits: int, n: int, per: float = 100.0) -> str:
    low, high = wilson(hits, max(n, 1))
    return f"{per * hits / max(n, 1):.1f} of {n} ({per * low:.1f} to {per * high:.1f})"


def print_rates(results: Sequence[Result], plain: Sequence[Result], limits: dict[str, float]) -> None:
    print("| | " + " | ".join(limits) + " |\n|---|" + "---|" * len(limits))
    levels = list(limits.values())
    landmarks = np.array([one for r in results for one in r.landmarks])
    for low, high in pairwise(SIDES_PX):
        here = landmarks[(landmarks[:, 0] >= low) & (landmarks[:, 0] < high), 1]
        cells = [rate(int((here >= level).sum()), len(here)) for level in levels]
        print(f"| read, %, side {low} to {high} px | " + " | ".join(cells) + " |")
    answers = np.array([one for r in results for one in r.answers])
    score, right, near, hidden = answers[:, 0], answers[:, 1] > 0, answers[:, 2] > 0, answers[:, 3] > 0
    for name, kind in (("visible", near & ~hidden), ("partly hidden", near & hidden)):
        read = [(score >= level) & kind for level in levels]
        cells = [rate(int((r & ~right).sum()), int(r.sum()), 1000) for r in read]
        print(f"| wrong codes in 1,000 {name} ones that are read | " + " | ".join(cells) + " |")
    cells = [rate(int(((score >= level) & ~near).sum()), len(results), 1000) for level in levels]
    print("| look-alikes read, in 1,000 such images | " + " | ".join(cells) + " |")
    false = [sum(a[0] >= level for r in plain for a in r.answers) for level in levels]
    cells = [rate(count, len(plain), 1000) for count in false]
    print("| false positives in 1,000 photographs without landmarks | " + " | ".join(cells) + " |")


def reliability(answers: np.ndarray) -> list[tuple[float, float, float, float, int]]:
    """(mean said, share right, its 95 % interval, n) of every step of confidence that answers fall into."""
    said, right = 1 / (1 + np.exp(-answers[:, 0])), answers[:, 1] > 0
    rows = []
    for low, high in pairwise(CONFIDENCES):
        chosen = (said >= low) & (said < high)
        n, hits = int(chosen.sum()), int(right[chosen].sum())
        if n:
            rows.append((float(said[chosen].mean()), hits / n, *wilson(hits, n), n))
    return rows


def print_reliability(results: Sequence[Result]) -> dict[str, list[tuple[float, float, float, float, int]]]:
    """Print the reliability of all answers, and of those on visible and on partly hidden landmarks."""
    answers = np.array([one for r in results for one in r.answers])
    near, hidden = answers[:, 2] > 0, answers[:, 3] > 0
    kinds = {"all": answers[:, 0] > -np.inf, "visible": near & ~hidden, "partly hidden": near & hidden}
    tables = {name: reliability(answers[kind]) for name, kind in kinds.items()}
    print("\n| answers | mean confidence | right, % |\n|---|---|---|")
    for name, rows in tables.items():
        for said, right, low, high, n in rows:
            print(f"| {name} | {said:.3f} | {100 * right:.1f} of {n} ({100 * low:.1f} to {100 * high:.1f}) |")
    return tables


def plot(tables: dict[str, list[tuple[float, float, float, float, int]]], folder: Path) -> None:
    """Share right against confidence said; both by their log odds, which show 0.98 and 0.998 apart."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    ticks = (0.01, 0.05, 0.2, 0.5, 0.8, 0.95, 0.99, 0.999)
    figure, axis = plt.subplots(figsize=(5.6, 5.0), layout="constrained")
    axis.plot([0.005, 0.9995], [0.005, 0.9995], color="0.6", linewidth=1)
    for (name, rows), style in zip(tables.items(), ("o-", "s--", "^:"), strict=True):
        said, right, low, high, n = np.array(rows).T
        shown = np.clip(right, 0.002, 0.9993)
        bars = [np.maximum(shown - np.clip(low, 0.002, 1), 0), np.maximum(np.minimum(high, 0.9995) - shown, 0)]
        axis.errorbar(said, shown, yerr=bars, fmt=style, capsize=3, label=f"{name} (n = {int(n.sum())})")
    for scale in (axis.set_xscale, axis.set_yscale):
        scale("logit")
    for side in (axis.xaxis, axis.yaxis):
        side.set_ticks(ticks, [f"{tick:g}" for tick in ticks])
        side.set_ticks([], minor=True)
    axis.set_xlabel("confidence said")
    axis.set_ylabel("share right (95 % interval)")
    axis.legend(frameon=False)
    axis.grid(alpha=0.3)
    axis.spines[["top", "right"]].set_visible(False)
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / "confidence.png", dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("photos", type=Path)
    parser.add_argument("--images", type=int, default=600)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="folder for the images, those of one family and share alone")
    parser.add_argument("--family", default=REPORT.family)
    parser.add_argument("--hidden", type=float, default=REPORT.hidden, help="share of the landmarks")
    parser.add_argument("--many", action="store_true", help="images of up to 24 sheets, to count what is rare")
    parser.add_argument("--moving", action="store_true", help="images of up to 20 sheets that all move")
    parser.add_argument(
        "--limits", type=float, nargs="*", default=[], help="least log odds, beside the three usual ones"
    )
    parser.add_argument("--seed", type=int, help="other images than those of the set")
    parser.add_argument("--plots", type=Path)
    options = parser.parse_args()
    shipped = [path for name in SHIPPED if (path := Path(skimage.data_dir) / name).exists()]
    with ProcessPoolExecutor(options.jobs) as pool:
        images = replace(
            MANY if options.many else MOVING if options.moving else REPORT,
            family=options.family,
            hidden=options.hidden,
        )
        if options.seed is not None:
            images = replace(images, seed=options.seed)
        work = partial(simulated, images, options.photos, options.keep)
        results = list(pool.map(work, range(options.images), chunksize=4))
        photographs = [*REPORT.photographs(options.photos), *shipped]
        plain = [one for some in pool.map(partial(photographed, options.family), photographs) for one in some]
    usual = {name: rule.least_log_odds for name, rule in STRICTNESSES.items()}
    print_rates(results, plain, usual | {f"{limit:g}": limit for limit in options.limits})
    tables = print_reliability(results)
    if options.plots:
        plot(tables, options.plots)


if __name__ == "__main__":
    main()
