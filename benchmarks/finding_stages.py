"""At which stage of detection landmarks are lost: candidates, gate, pattern, alignment, reading, acceptance.

    uv run --extra benchmark python benchmarks/finding_stages.py ../shared/data/photos [--rooms ../shared/data/rooms]

Simulated images before the photographs (`camera_scenes.py`), of kinds of cameras to train on, or of kinds to report
on with `--held-out`; with `--rooms`, the rendered rooms with even and with odd numbers apart.  Landmarks of 15 px and
more that nothing hides.  A square is near a landmark where all its corners lie within `NEAR` of the side, in the
landmark's plane, so that tilted ones are judged alike.  A landmark counts for a stage when it reached that stage or a
later one; the last two columns read it from its true corners, so that only reading and acceptance are judged.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from camera_scenes import draw_photograph, light_wall
from planar import SIZE, background, backgrounds
from rooms import is_counted

from lmkit.detection.candidates import find_candidates
from lmkit.detection.config import PROFILES, DetectOptions
from lmkit.detection.detector import best_of_each_place, candidates_of
from lmkit.detection.linear_image import LinearImage
from lmkit.detection.pixel_sampling import mean_side
from lmkit.detection.register_and_decode import Candidate, register_and_decode
from lmkit.detection.screening import screen_candidates
from lmkit.detection.shadows import window_for
from lmkit.detection.veil import without_veil
from lmkit.geometry.homography import homographies_from_points
from lmkit.kernels.screening import best_first_numpy
from lmkit.model.landmark import LM8
from lmkit.simulation.cameras import HELD_OUT_KINDS, TRAINING_KINDS
from lmkit.simulation.photograph import ImagingChain

NEAR = 0.15
SIDES_PX, CELLS = (15.0, 56.0), (5, 4)
STAGES = ("candidate", "gate", "pattern", "aligned", "registered", "read right", "accepted")
CUTS = {"side": (15, 20, 25, 30, 60, 1000), "tilt": (0, 30, 50, 65, 80)}


@dataclass(frozen=True)
class Truth:
    """A landmark in an image: its code, corners (4,2) in px, and the rows of the table that it belongs to."""

    code: int
    corners: np.ndarray
    groups: tuple[str, ...]


@dataclass(frozen=True)
class Outcome:
    """How far a landmark came: the number of its last stage from 1, why it was rejected, and from true corners."""

    groups: tuple[str, ...]
    stage: int
    reason: str
    read_from_truth: bool
    accepted_from_truth: bool


def near(quads: np.ndarray, truth: Truth, turns: int = 4) -> np.ndarray:
    """(N,) which quads have all corners within `NEAR` of the side, in the landmark's plane, in so many turns."""
    if len(quads) == 0:
        return np.zeros(0, dtype=bool)
    square = np.array([[0.0, 1], [1, 1], [1, 0], [0, 0]])
    H = homographies_from_points(truth.corners, square[None])[0]
    flat = np.concatenate([quads, np.ones((*quads.shape[:2], 1))], axis=2) @ H.T
    depth = flat[:, :, 2:]
    flat = flat[:, :, :2] / np.where(np.abs(depth) < 1e-9, 1e-9, depth)
    turned = [np.abs(np.roll(flat, k, axis=1) - square).max(axis=(1, 2)) < NEAR for k in range(turns)]
    return np.logical_or.reduce(turned) & (depth[:, :, 0] * depth[:, :1, 0] > 0).all(axis=1)


def stages_of(image: np.ndarray, truths: Sequence[Truth], options: DetectOptions) -> list[Outcome]:
    """How far every landmark of an image came."""
    config, linear = options.config, LinearImage.of(image, options.camera)
    clear = without_veil(linear)
    quads = find_candidates(clear.pyramid.levels, config.sources, config.where, clear.noise)
    passed: list[list[np.ndarray]] = [[quads], [], [], []]
    for in_shadow in (False, True)[: 1 + config.in_shadow]:
        found = screen_candidates(clear.pyramid, quads, LM8, in_shadow=in_shadow)
        best = best_first_numpy(found, config.min_pattern, per_place=2)
        moved = screen_candidates(clear.pyramid, best, LM8, config.align_rounds, config.aligned, in_shadow=in_shadow)
        likely = best_first_numpy(moved, config.min_aligned_pattern, per_place=1)
        for stage, some in zip(passed[1:], (quads[found.pattern >= 0], best, likely), strict=True):
            stage.append(some)
    registered = [c for c in candidates_of(image, options) if c.rejected != "cut"]
    accepted = best_of_each_place([c for c in registered if c.rejected is None])
    outcomes = []
    for truth in truths:
        here = [c for c in registered if near(c.corners[None], truth)[0]]
        right = [c for c in here if is_right(c, truth)]
        reached = [any(near(some, truth).any() for some in stage) for stage in passed]
        reached += [bool(here), bool(right), any(is_right(c, truth) for c in accepted)]
        stage = max((k + 1 for k, hit in enumerate(reached) if hit), default=0)
        best_right = max(right, key=lambda c: c.log_odds, default=None)
        alone = read_from_truth(linear, truth, options)
        outcomes.append(
            Outcome(
                truth.groups,
                stage,
                "" if best_right is None else str(best_right.rejected),
                alone is not None,
                alone is not None and alone.rejected is None,
            )
        )
    return outcomes


def is_right(candidate: Candidate, truth: Truth) -> bool:
    return candidate.decoding.code == truth.code and bool(near(candidate.corners[None], truth, turns=1)[0])


def read_from_truth(linear: LinearImage, truth: Truth, options: DetectOptions) -> Candidate | None:
    """The surest right reading from the true corners, with and without shadows taken out; or None."""
    window = window_for(mean_side(truth.corners))
    low = np.floor(truth.corners.min(axis=0)).astype(int) - window
    high = np.ceil(truth.corners.max(axis=0)).astype(int) + window
    images = [linear]
    if options.config.in_shadow:
        images.append(linear.shadow_normalized((*low.tolist(), *high.tolist()), window))
    read = [register_and_decode(image, truth.corners, LM8, options) for image in images]
    return max((c for c in read if c is not None and is_right(c, truth)), key=lambda c: c.log_odds, default=None)


def in_classes(side_px: float, tilt_deg: float) -> tuple[str, ...]:
    values = {"side": (side_px, "px"), "tilt": (tilt_deg, "deg")}
    return tuple(
        f"{name} {low} to {high} {unit}"
        for name, (value, unit) in values.items()
        for low, high in pairwise(CUTS[name])
        if low <= value < high
    )


def troubles(chain: ImagingChain) -> tuple[str, ...]:
    """Names of what troubles a simulated image."""
    lens, light = chain.lens, chain.light
    named = {
        "motion": np.hypot(*lens.motion_px) > 1,
        "defocus": lens.defocus_px > 0.8,
        "sharp": np.hypot(*lens.motion_px) <= 1 and lens.defocus_px <= 0.8,
        "dim": light.brightness < 0.15,
        "colored light": chain.development.balanced_for_k is not None,
        "veil": light.veil > 0.02,
        "hard shadow": light.shadow is not None,
    }
    return tuple(f"blur or light: {name}" for name, here in named.items() if here)


def simulated_image(
    photos: Sequence[Path], held_out: bool, on_light_walls: bool, seed: int, index: int
) -> tuple[np.ndarray, list[Truth]]:
    kinds = HELD_OUT_KINDS if held_out else TRAINING_KINDS
    wall = background(photos[index % len(photos)])
    if on_light_walls:
        wall = light_wall(wall, np.random.default_rng([seed, index, 1]))
    image, shown, chain = draw_photograph((seed, index), wall, kinds, SIDES_PX, cells=CELLS)
    truths = [
        Truth(s.code, s.corners, ("all", *in_classes(s.side_px, s.tilt_deg), *troubles(chain)))
        for s in shown
        if not s.is_hidden and s.side_px >= CUTS["side"][0] and is_inside(s.corners)
    ]
    return image, truths


def is_inside(corners: np.ndarray) -> bool:
    return bool(((corners >= 0) & (corners <= np.array(SIZE) - 1)).all())


def simulated(
    photos: Sequence[Path], held_out: bool, on_light_walls: bool, seed: int, options: DetectOptions, index: int
) -> list[Outcome]:
    cv2.setNumThreads(1)
    return stages_of(*simulated_image(photos, held_out, on_light_walls, seed, index), options)


def room_images(folder: Path, parity: int) -> Iterator[tuple[Path, list[Truth]]]:
    """Images of the rooms with even (0) or odd (1) numbers, and the landmarks that count."""
    truth = json.loads((folder / "landmark" / "truth.json").read_text())
    for pair in truth["pairs"]:
        if int(pair["room"]) % 2 != parity:
            continue
        conditions = tuple(f"{key}: {pair['conditions'][key]}" for key in ("blur", "light"))
        for view in pair["images"]:
            truths = [
                Truth(
                    e["id"],
                    np.array(e["corners"]),
                    ("all", *in_classes(e["side_px"], e["tilt_deg"]), *conditions),
                )
                for e in view["landmarks"]
                if is_counted(e)
            ]
            yield folder / "landmark" / "images" / view["image"], truths


def rendered(options: DetectOptions, job: tuple[Path, list[Truth]]) -> list[Outcome]:
    cv2.setNumThreads(1)
    return stages_of(cv2.imread(str(job[0])), job[1], options)


def print_stages(outcomes: Sequence[Outcome], name: str) -> None:
    print(f"\n{name}: share of landmarks that reached a stage, %\n")
    heads = ["", "n", *STAGES, "read, true corners", "accepted, true corners"]
    print("| " + " | ".join(heads) + " |\n|" + "---|" * len(heads))
    for group in sorted({g for o in outcomes for g in o.groups}):
        some = [o for o in outcomes if group in o.groups]
        shares = [np.mean([o.stage >= k + 1 for o in some]) for k in range(len(STAGES))]
        shares += [np.mean([o.read_from_truth for o in some]), np.mean([o.accepted_from_truth for o in some])]
        print(f"| {group} | {len(some)} | " + " | ".join(f"{100 * share:.1f}" for share in shares) + " |")
    lost = [o.reason for o in outcomes if o.stage == STAGES.index("read right") + 1]
    counts = {reason: lost.count(reason) for reason in sorted(set(lost))}
    print(f"\nread right and rejected, by reason: {counts}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("photos", type=Path)
    parser.add_argument("--rooms", type=Path)
    parser.add_argument("--images", type=int, default=80)
    parser.add_argument("--seed", type=int, default=7001)
    parser.add_argument("--held-out", action="store_true", help="kinds of cameras to report on")
    parser.add_argument("--light-walls", action="store_true", help="landmarks are mounted on painted walls")
    parser.add_argument("--profile", choices=list(PROFILES), default="balanced")
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    options = DetectOptions(config=PROFILES[given.profile])
    photos = backgrounds(given.photos)
    half = len(photos) // 2
    photos = photos[half:] if given.held_out else photos[:half]
    with ProcessPoolExecutor(given.jobs) as pool:
        work = partial(simulated, photos, given.held_out, given.light_walls, given.seed, options)
        seen = pool.map(work, range(given.images), chunksize=4)
        kinds = "kinds to report on" if given.held_out else "kinds to train on"
        kinds += ", light walls" if given.light_walls else ""
        print_stages([o for some in seen for o in some], f"Simulated, {kinds}, {given.profile}")
        for parity, name in enumerate(("even", "odd") if given.rooms else ()):
            jobs = room_images(given.rooms, parity)
            seen = pool.map(partial(rendered, options), jobs)
            print_stages([o for some in seen for o in some], f"Rooms of {name} numbers, {given.profile}")


if __name__ == "__main__":
    main()
