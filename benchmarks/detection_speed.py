"""Detection beside ArUco on the same images, in the same process, on one thread.

    OMP_NUM_THREADS=1 uv run --extra benchmark python benchmarks/detection_speed.py ROOMS [--plot docs/benchmarks]
        [--stages]

Time is the thread's processor time; ratios are of means, beside the 90th percentile of the ratios of single images.
The rooms are 640x480; larger sizes are enlarged by cubic interpolation, since no larger rooms are there, and show
cost, not quality.  With ``--stages``: how long the steps of detection take, also in the images whose ratio is the
largest.  ArUco is ``DICT_4X4_250`` with default settings on the gray image, the conversion included.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from peers import wilson
from rooms import is_counted

from lmkit.detection.candidates import find_candidates
from lmkit.detection.config import PROFILES, DetectOptions
from lmkit.detection.detector import detect_landmarks
from lmkit.detection.linear_image import LinearImage
from lmkit.detection.register_and_decode import register_all
from lmkit.detection.screening import LikelyRule, likely_squares
from lmkit.detection.veil import without_veil
from lmkit.kernels.load import describe
from lmkit.kernels.screening import Shares

ENLARGED = {"VGA": 1.0, "720 rows": 1.5, "1080 rows": 2.25}
STAGES = ("image", "outlines", "screening", "fits", "shadows, rest")
RUNS, TAIL = 5, 0.1  # of which the fastest counts; share of the images with the largest ratios
SHIFT = 0.04  # standard deviation of predicted corners, of the side


def timed(run: Callable[[], object]) -> tuple[float, object]:
    """Processor seconds of this thread, and the result."""
    start = time.thread_time()
    result = run()
    return time.thread_time() - start, result


def aruco() -> Callable[[np.ndarray], object]:
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_250))
    return lambda image: detector.detectMarkers(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))


def room_images(folder: Path) -> list[tuple[np.ndarray, list[dict]]]:
    """Images of the rooms, and the landmarks that count in them."""
    truth = json.loads((folder / "landmark" / "truth.json").read_text())
    images = [image for pair in truth["pairs"] for image in pair["images"]]
    return [
        (cv2.imread(str(folder / "landmark" / "images" / i["image"])), [e for e in i["landmarks"] if is_counted(e)])
        for i in images
    ]


def is_read(entry: dict, found: list, scale: float) -> bool:
    middle = (np.mean(entry["corners"], axis=0) + 0.5) * scale - 0.5
    near = 0.6 * entry["side_px"] * scale
    return any(d.code == entry["id"] and np.linalg.norm(d.corners.mean(axis=0) - middle) < near for d in found)


def print_profiles(rooms: list[tuple[np.ndarray, list[dict]]]) -> dict[str, tuple[float, list[bool]]]:
    """Ratios by image size; returns each profile's ratio, and which landmarks it read, at VGA."""
    peer, points = aruco(), {}
    print("| | " + " | ".join(f"{p}, ratio (90th percentile), read" for p in PROFILES) + " | ArUco, ms |")
    print("|---|" + "---|" * (len(PROFILES) + 1))
    for name, scale in ENLARGED.items():
        seconds: dict[str, list[float]] = {p: [] for p in ("ArUco", *PROFILES)}
        read: dict[str, list[bool]] = {p: [] for p in PROFILES}
        for image, landmarks in rooms:
            shown = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
            seconds["ArUco"].append(timed(lambda shown=shown: peer(shown))[0])
            for profile, config in PROFILES.items():
                options = DetectOptions(config=config)
                spent, found = timed(lambda shown=shown, options=options: detect_landmarks(shown, options))
                seconds[profile].append(spent)
                read[profile] += [is_read(entry, found, scale) for entry in landmarks]
        base = np.array(seconds["ArUco"])
        cells = []
        for profile in PROFILES:
            spent = np.array(seconds[profile])
            ratio, share = spent.mean() / base.mean(), float(np.mean(read[profile]))
            cells.append(f"{ratio:.2f} ({np.percentile(spent / base, 90):.2f}), {100 * share:.1f} %")
            if scale == 1.0:
                points[profile] = (float(ratio), read[profile])
        print(f"| {name}, {len(rooms)} images | " + " | ".join(cells) + f" | {1000 * base.mean():.1f} |")
    return points


def print_near(rooms: list[tuple[np.ndarray, list[dict]]]) -> None:
    """Time a landmark in windows around predictions, beside ArUco's whole image."""
    rng, peer = np.random.default_rng(0), aruco()
    spent = base = 0.0
    count = again = 0
    for image, _ in rooms:
        base += timed(lambda image=image: peer(image))[0]
        whole = detect_landmarks(image)
        if whole:
            corners = np.array([d.corners for d in whole])
            sides = np.linalg.norm(corners[:, 0] - corners[:, 1], axis=1)
            near = corners + rng.normal(0, SHIFT, (len(whole), 1, 2)) * sides[:, None, None]
            seconds, found = timed(lambda image=image, near=near: detect_landmarks(image, near=near))
            spent += seconds
            count += len(whole)
            again += len({d.code for d in found} & {d.code for d in whole})
    ratio = spent / count / (base / len(rooms))
    print(f"| near predictions: time of a landmark / ArUco's whole image | {ratio:.2f} ({again} of {count} again) |")


def stages_of(image: np.ndarray, options: DetectOptions) -> list[float]:
    """Processor seconds of ArUco, all of detection and its `STAGES`; then numbers of squares, fits and landmarks."""
    config, family = options.config, options.ring_families[0]
    rule = LikelyRule(Shares(config.min_pattern, config.min_aligned_pattern), config.align_rounds, config.aligned)
    linear, clear = LinearImage.of(image), without_veil(LinearImage.of(image))
    quads = find_candidates(clear.pyramid.levels, config.sources, config.where, clear.noise)
    likely = likely_squares(clear.pyramid, quads, family, rule).quads
    peer = aruco()
    steps: tuple[Callable[[], object], ...] = (
        lambda: peer(image),
        lambda: detect_landmarks(image, options),
        lambda: without_veil(LinearImage.of(image)),
        lambda: find_candidates(clear.pyramid.levels, config.sources, config.where, clear.noise),
        lambda: likely_squares(clear.pyramid, quads, family, rule),
        lambda: register_all(linear, likely, family, options),
    )
    spent = np.min([[timed(step)[0] for step in steps] for _ in range(RUNS)], axis=0)
    rest = spent[1] - spent[2:].sum()
    return [*spent, rest, len(quads), len(likely), len(detect_landmarks(image, options))]


def print_stages(rooms: list[tuple[np.ndarray, list[dict]]]) -> None:
    """Mean milliseconds of the stages, in all images and in those with the largest ratios."""
    for profile in ("fast", "balanced"):
        options = DetectOptions(config=PROFILES[profile])
        rows = np.array([stages_of(image, options) for image, _ in rooms])
        ratio = rows[:, 1] / rows[:, 0]
        order, count = np.argsort(ratio), round(TAIL * len(rows))
        print(
            f"\n| {profile}, ms | images | ratio | ArUco | lmkit | "
            + " | ".join(STAGES)
            + " | squares | fits | read |"
        )
        print("|---|" + "---|" * (len(STAGES) + 7))
        for name, some in (("all", order), ("largest ratios", order[-count:]), ("the others", order[:-count])):
            mean = rows[some].mean(axis=0)
            times = " | ".join(f"{1000 * spent:.2f}" for spent in mean[:-3])
            counts = " | ".join(f"{number:.1f}" for number in mean[-3:])
            print(f"| {name} | {len(some)} | {mean[1] / mean[0]:.2f} | {times} | {counts} |")
        logs = np.log(ratio), np.log(rows[:, 0]), np.log(rows[:, 1])
        by_aruco, by_own = (np.corrcoef(logs[0], other)[0, 1] for other in logs[1:])
        print(
            f"\n90th percentile of the ratio {np.percentile(ratio, 90):.2f}; its logarithm goes with ArUco's time by "
            f"{by_aruco:.2f}, with lmkit's {by_own:.2f}"
        )


def plot(points: dict[str, tuple[float, list[bool]]], folder: Path) -> None:
    """Share of landmarks read, with 95 % intervals, against time, of (ratio, which were read) by profile."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axis = plt.subplots(figsize=(5, 3.4), layout="constrained")
    for name, (ratio, read) in points.items():
        share, (low, high) = 100 * np.mean(read), 100 * np.array(wilson(sum(read), len(read)))
        axis.errorbar(ratio, share, [[share - low], [high - share]], fmt="o", color="#1f5fa8", capsize=3)
        axis.annotate(name, (ratio, high), textcoords="offset points", xytext=(0, 5), ha="center")
    axis.axvline(1.0, color="0.6", linewidth=0.8)
    place = {"xycoords": axis.get_xaxis_transform(), "textcoords": "offset points", "ha": "right", "va": "bottom"}
    axis.annotate("ArUco's time", (1.0, 0.0), xytext=(-4, 4), color="0.4", **place)
    axis.set_xlim(0.0, 1.35 * max(ratio for ratio, _ in points.values()))
    axis.margins(y=0.12)
    axis.set_xlabel("time / ArUco 4x4, 640x480, one thread")
    axis.set_ylabel("landmarks of 15 px and more read, %")
    axis.grid(alpha=0.3)
    axis.spines[["top", "right"]].set_visible(False)
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / "profiles.png", dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("rooms", type=Path)
    parser.add_argument("--plot", type=Path)
    parser.add_argument("--stages", action="store_true", help="times of the steps of detection, and nothing else")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    rooms = room_images(options.rooms)
    print(describe() + "\n")
    if options.stages:
        print_stages(rooms)
        return
    points = print_profiles(rooms)
    print()
    print_near(rooms)
    if options.plot:
        plot(points, options.plot)


if __name__ == "__main__":
    main()
