"""Cost of detection against the size of the image, landmarks in view, clutter and families, and its memory.

    OMP_NUM_THREADS=1 uv run --extra benchmark python benchmarks/detection_cost.py [--images 3]

Images are drawn: a soft gray ground with noise, landmarks of 40 px at random places that do not touch, and as clutter
dark squares of like sizes without a pattern.  Each image is searched several times by one `lmkit.Detector`, and the
fastest counts: processor time of the thread, beside ArUco (``DICT_4X4_250``, defaults, the conversion to gray
included) on the same images.  Drawn images show how the cost grows, not how much is read.
"""

from __future__ import annotations

import argparse
import multiprocessing
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

import lmkit
from lmkit.generation.page import bare_landmark_page
from lmkit.generation.png import page_to_image
from lmkit.kernels.load import describe
from lmkit.model.landmark import FAMILIES

RUNS = 5
SIDE_PX = 40
QUIET_PX = 8  # white paper around a landmark


@dataclass(frozen=True)
class Scenery:
    """One row of the tables: an image's content, and the families that are looked for."""

    width: int = 640
    height: int = 480
    landmarks: int = 2
    squares: int = 0
    family: str = "lm8"
    wanted: str = "lm8"


@lru_cache(maxsize=128)
def sheet(family: str, code: int, side_px: int = SIDE_PX) -> np.ndarray:
    """A landmark on white paper, BGR."""
    known = FAMILIES[family]
    page = page_to_image(bare_landmark_page(known, code, known.side_mm), 100)
    face = cv2.resize(np.asarray(page)[:, :, ::-1], (side_px, side_px), interpolation=cv2.INTER_AREA)
    edge = [QUIET_PX] * 4
    return cv2.copyMakeBorder(face, *edge, cv2.BORDER_CONSTANT, value=(255, 255, 255))


def draw(scenery: Scenery, seed: int) -> np.ndarray:
    """(H,W,3) BGR: things stand in cells of a grid, so that none meets another."""
    rng = np.random.default_rng(seed)
    h, w = scenery.height, scenery.width
    ground = cv2.resize(rng.uniform(90, 170, (6, 8, 1)), (w, h), interpolation=cv2.INTER_CUBIC)
    image = np.repeat(ground[:, :, None], 3, axis=2)
    cell = SIDE_PX + 2 * QUIET_PX + 4
    cells = [(x, y) for y in range(0, h - cell, cell) for x in range(0, w - cell, cell)]
    order = rng.permutation(len(cells))
    for k, number in enumerate(order[: scenery.landmarks + scenery.squares]):
        x, y = cells[number]
        if k < scenery.landmarks:
            thing = 0.85 * sheet(scenery.family, k).astype(np.float64)
            image[y : y + len(thing), x : x + len(thing)] = thing
        else:
            side = int(rng.integers(20, SIDE_PX))
            image[y + 5 : y + 5 + side, x + 5 : x + 5 + side] = rng.uniform(20, 60)
    image = cv2.GaussianBlur(image, (0, 0), 0.7)
    return np.clip(image + rng.normal(0, 2.0, image.shape), 0, 255).astype(np.uint8)


def fastest_ms(search: Callable[[np.ndarray], object], image: np.ndarray) -> float:
    search(image)
    spent = []
    for _ in range(RUNS):
        start = time.thread_time()
        search(image)
        spent.append(time.thread_time() - start)
    return 1000 * min(spent)


def row(name: str, scenery: Scenery, images: int) -> None:
    """Print one row: mean times of the images, and how many of their landmarks are read."""
    detector = lmkit.Detector(families=scenery.wanted)
    aruco = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_250))
    drawn = [draw(scenery, seed) for seed in range(images)]
    ours = [fastest_ms(detector.detect, image) for image in drawn]
    theirs = [
        fastest_ms(lambda i: aruco.detectMarkers(cv2.cvtColor(i, cv2.COLOR_BGR2GRAY)), image) for image in drawn
    ]
    read = sum(len(detector.detect(image)) for image in drawn)
    print(
        f"| {name} | {np.mean(ours):.2f} ({min(ours):.2f} to {max(ours):.2f}) | {np.mean(theirs):.2f} "
        f"| {np.mean(ours) / np.mean(theirs):.2f} | {read} of {scenery.landmarks * images} |",
        flush=True,
    )


def memory_mb(field: str) -> float:
    """``VmRSS`` (now) or ``VmHWM`` (largest since it was reset) of this process, as Linux has it."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith(field))


def memory_of(image: np.ndarray) -> tuple[float, float, float]:
    """Most that the first image of this size takes, what of it stays, and what 50 more add; MB."""
    detector = lmkit.Detector()
    detector.detect(image[:200, :200])  # tables and libraries
    before = memory_mb("VmRSS")
    Path("/proc/self/clear_refs").write_text("5")  # the largest so far is now
    detector.detect(image)
    most, kept = memory_mb("VmHWM") - before, memory_mb("VmRSS") - before
    for _ in range(50):
        detector.detect(image)
    return most, kept, memory_mb("VmRSS") - before - kept


def print_memory(sizes: list[tuple[int, int]]) -> None:
    """Memory by size, each in a process of its own: memory that was freed before hides what is taken."""
    print("\n| size | image, MB | most during the first image, MB | kept, MB | the next 50 add, MB |")
    print("|---|---|---|---|---|")
    for width, height in sizes:
        image = draw(Scenery(width, height), 0)
        with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as worker:
            most, kept, added = worker.submit(memory_of, image).result()
        print(
            f"| {width} x {height} | {image.nbytes / 2**20:.1f} | {most:.1f} | {kept:.1f} | {added:.1f} |", flush=True
        )


def main() -> None:
    parser = argparse.ArgumentParser(description="Cost of detection.")
    parser.add_argument("--images", type=int, default=3)
    images = parser.parse_args().images
    cv2.setNumThreads(1)
    sizes = [(320, 240), (640, 480), (1280, 720), (1920, 1080), (3840, 2160)]
    print(f"{describe()}; {images} images a row")
    print_memory(sizes)
    print("\n| | lmkit, ms (range) | ArUco, ms | ratio | read |\n|---|---|---|---|---|")
    base = Scenery()
    for width, height in sizes:
        row(f"{width} x {height}, 2 landmarks", replace(base, width=width, height=height), images)
    for count in (0, 1, 2, 4, 8, 16, 32):
        row(f"{count} landmarks", replace(base, landmarks=count), images)
    for count in (0, 10, 20, 40):
        row(f"2 landmarks, {count} squares without a pattern", replace(base, squares=count), images)
    for name in ("lm4", "lm8", "lm12"):
        row(f"2 landmarks of {name}", replace(base, family=name, wanted=name), images)
    row("2 landmarks, three families looked for", replace(base, wanted="lm4,lm8,lm12"), images)


if __name__ == "__main__":
    main()
