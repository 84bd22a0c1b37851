"""Fit the weights of acceptance, and print the table that `lmkit/detection/acceptance.py` holds.

    uv run --extra benchmark python benchmarks/train_acceptance.py ../shared/data/photos [--images 220] [--jobs 1]

Trained on simulated cameras of `TRAINING_KINDS` before the first half of the photographs (`camera_scenes.py`), on
images of look-alikes alone, on words that are no code of their family, and on those photographs as they are and in
other colors.  Every square that was registered is one example: right (a landmark, its code right) or not.  The
weights are those of a logistic regression whose signs are held to what the terms mean.  `benchmarks/acceptance.py`
reports on other cameras, seeds and photographs.
"""

from __future__ import annotations

import argparse
import pickle
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from camera_scenes import LOOK_ALIKES, Shown, draw_scene
from planar import background, backgrounds
from scipy.optimize import minimize

from lmkit.detection.acceptance import AcceptanceRule, ScoredReading
from lmkit.detection.config import ACCURATE, DetectOptions
from lmkit.detection.detector import candidates_of
from lmkit.model.landmark import LM8, LM8P
from lmkit.simulation.cameras import TRAINING_KINDS

ANYTHING = AcceptanceRule(-1e9)
SEED = 101
RIGHT_CORNERS = 0.3  # of the side: a code with corners further off is not right
FOR = ("margin",)  # speaks for a landmark; all others can only speak against one
# A false square is rarer here than in use, where thousands of images show none of these landmarks.
FALSE_WEIGHT, PENALTY = 3.0, 1.0
REASONS = {
    "margin": "code",
    "gap residual": "hidden",
    "uncertain parts": "unsure",
    "too uncertain parts": "unsure",
    "little red": "color",
    "too red": "color",
    "too much contrast": "contrast",
    "blur": "blur",
}


@dataclass(frozen=True, eq=False)
class Example:
    """A square that was registered: its reading, and whether a landmark with this code is there."""

    reading: ScoredReading
    is_landmark: bool
    is_right: bool


def examples_of(image: np.ndarray, shown: Sequence[Shown], options: DetectOptions) -> list[Example]:
    """Everything that is registered in an image, each with the truth."""
    examples = []
    for found in candidates_of(image, options):
        if found.rejected == "cut":
            continue
        middle = found.corners.mean(axis=0)
        near = [s for s in shown if np.linalg.norm(s.corners.mean(axis=0) - middle) < 0.5 * s.side_px]
        is_right = any(
            s.code == found.decoding.code
            and np.linalg.norm(found.corners - s.corners, axis=1).max() < RIGHT_CORNERS * s.side_px
            for s in near
        )
        examples.append(Example(found.reading, bool(near), is_right))
    return examples


def in_other_colors(image: np.ndarray) -> Iterator[np.ndarray]:
    """A photograph as it is, enlarged, with channels swapped, and in other colors."""
    large = cv2.resize(image, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
    yield from (image, large)
    for order in ((2, 1, 0), (0, 2, 1), (1, 0, 2)):
        yield np.ascontiguousarray(image[:, :, order])
        yield np.ascontiguousarray(large[:, :, order])
    yield np.clip(image * np.array([1.4, 0.8, 1.3]), 0, 255).astype(np.uint8)


def simulated(photos: Sequence[Path], look_alikes: float, seed: int) -> list[Example]:
    cv2.setNumThreads(1)
    sides = (9.0, 60.0) if look_alikes < 0.5 else (13.0, 60.0)
    image, shown = draw_scene(
        (SEED, round(100 * look_alikes), seed),
        background(photos[seed % len(photos)]),
        TRAINING_KINDS,
        sides,
        look_alikes=look_alikes,
    )
    examples = examples_of(image, shown, DetectOptions(config=ACCURATE, rule=ANYTHING))
    return examples + no_words(image, shown)


def no_words(image: np.ndarray, shown: Sequence[Shown]) -> list[Example]:
    """Landmarks of odd parity, which are no code of lm8p, taken for the nearest one."""
    words = {tuple(LM8P.gaps(code)) for code in range(LM8P.code_count)}
    other = [replace(s, code=-1) for s in shown if tuple(LM8.gaps(s.code)) not in words]
    examples = examples_of(image, other, DetectOptions((LM8P,), ACCURATE, ANYTHING))
    return [e for e in examples if e.is_landmark]


def photographed(path: Path) -> list[Example]:
    cv2.setNumThreads(1)
    options = DetectOptions(config=ACCURATE, rule=ANYTHING)
    return [e for image in in_other_colors(cv2.imread(str(path))) for e in examples_of(image, (), options)]


def fit(examples: Sequence[Example]) -> tuple[float, dict[str, float]]:
    """Bias and weights, by logistic regression with signs; ridge on standardized figures."""
    names = list(examples[0].reading.figures)
    X = np.array([list(e.reading.figures.values()) for e in examples])
    y = np.array([e.is_right for e in examples], dtype=np.float64)
    weight = np.where([e.is_landmark for e in examples], 1.0, FALSE_WEIGHT)
    middle, scale = X.mean(axis=0), X.std(axis=0) + 1e-9
    Z = np.column_stack([np.ones(len(X)), (X - middle) / scale])

    def loss(b: np.ndarray) -> tuple[float, np.ndarray]:
        score = Z @ b
        value = np.sum(weight * (np.logaddexp(0, score) - y * score)) + PENALTY / 2 * np.sum(b[1:] ** 2)
        slope = Z.T @ (weight * (1 / (1 + np.exp(-score)) - y))
        slope[1:] += PENALTY * b[1:]
        return float(value), slope

    bounds = [(None, None)] + [(0, None) if name in FOR else (None, 0) for name in names]
    b = minimize(loss, np.zeros(Z.shape[1]), jac=True, bounds=bounds, method="L-BFGS-B").x
    slopes = b[1:] / scale
    return float(b[0] - slopes @ middle), dict(zip(names, slopes.tolist(), strict=True))


def print_table(examples: Sequence[Example], bias: float, weights: dict[str, float]) -> None:
    right = [e.reading.figures for e in examples if e.is_right]
    print(f"BIAS = {bias:.2f}\nTERMS = MappingProxyType(\n    {{")
    for name, weight in weights.items():
        usual = np.median([figures[name] for figures in right])
        print(f'        "{name}": Term({weight:.2f}, {usual:.2f}, "{REASONS.get(name, "pattern")}"),')
    print("    }\n)")


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("photos", type=Path)
    parser.add_argument("--images", type=int, default=220)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="file for the examples, read instead where it exists")
    options = parser.parse_args()
    photos = backgrounds(options.photos)
    photos = photos[: len(photos) // 2]
    if options.keep is not None and options.keep.exists():
        examples = pickle.loads(options.keep.read_bytes())
    else:
        with ProcessPoolExecutor(options.jobs) as pool:
            jobs = (
                pool.map(partial(simulated, photos, LOOK_ALIKES), range(options.images), chunksize=8),
                pool.map(partial(simulated, photos, 0.97), range(options.images // 3), chunksize=8),
                pool.map(photographed, photos, chunksize=8),
            )
            examples = [e for job in jobs for some in job for e in some]
        if options.keep is not None:
            options.keep.write_bytes(pickle.dumps(examples))
    right, wrong = sum(e.is_right for e in examples), sum(e.is_landmark and not e.is_right for e in examples)
    print(f"# {right} right, {wrong} wrong, {len(examples) - right - wrong} false")
    print_table(examples, *fit(examples))


if __name__ == "__main__":
    main()
