"""Fit the weights of acceptance, print the table of `lmkit/detection/acceptance.py`, and the cost of each limit.

    uv run --extra benchmark python benchmarks/train_acceptance.py ../shared/data/photos [--images 900] [--keep DIR]
        [--shift-only]

`acceptance_sets.py` holds the images.  The weights are fitted on simulated cameras, on images of look-alikes, on
words that are no code of their family, and on photographs as they are and in other colors.  Every square that was
registered is one example: right (a landmark, its code right) or not.  The weights are those of a logistic regression
whose signs are constrained by the meaning of the terms.  On a second set, of other seeds and photographs, the score
is stretched and shifted so that it is the log odds of the best square at each place, and the cost of every limit is
counted.  `benchmarks/acceptance.py` reports on a third set, of other cameras as well.  `--shift-only` keeps the
weights and finds the bias on the second set, with a 95 % interval over images.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from acceptance_sets import FIT, LIMIT, MOSTLY_LOOK_ALIKES, USUAL, ImageSet
from camera_scenes import Shown
from scipy.optimize import minimize
from scipy.special import expit

from lmkit.arrays import FloatArray
from lmkit.detection.acceptance import BIAS, TERMS, AcceptanceRule, ScoredReading
from lmkit.detection.config import BALANCED, DetectOptions
from lmkit.detection.detector import best_of_each_place, candidates_of
from lmkit.detection.register_and_decode import Candidate
from lmkit.model.landmark import LM8, LM8P

ANYTHING = AcceptanceRule(-1e9)
OPTIONS = DetectOptions(config=BALANCED, rule=ANYTHING)
LIMITS = (-1.0, -0.5, 0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0)
RIGHT_CORNERS = 0.3  # of the side: a code with corners further off is not right
FOR = ("margin", "evidence")  # speak for a landmark; all others can only speak against one
PENALTY = 1.0
REPEATS = 200  # of the bootstrap
KINDS = ((True, False), (True, True), (False, False), (False, True))  # is the code right, is the landmark hidden
REASONS = {
    "margin": "code",
    "evidence": "hidden",
    "foreign": "hidden",
    "uncertain parts": "unsure",
    "too uncertain parts": "unsure",
    "little red": "color",
    "too red": "color",
    "too much contrast": "contrast",
    "blur": "blur",
}


@dataclass(frozen=True, eq=False)
class Example:
    """A square that was registered.

    Attributes:
        reading: what it decodes to, and its figures.
        is_landmark, is_right: a landmark is there; and this code is its code.
        is_hidden: something stands before that landmark.
        is_best: no other square in the same place is surer.
    """

    reading: ScoredReading
    is_landmark: bool
    is_right: bool
    is_hidden: bool
    is_best: bool


def examples_of(image: np.ndarray, shown: Sequence[Shown], options: DetectOptions) -> list[Example]:
    """Everything that is registered in an image, each with the truth."""
    candidates = [found for found in candidates_of(image, options) if found.rejected != "cut"]
    best = {id(found) for found in best_of_each_place(candidates)}
    return [_example(found, shown, id(found) in best) for found in candidates]


def _example(found: Candidate, shown: Sequence[Shown], is_best: bool) -> Example:
    middle = found.corners.mean(axis=0)
    near = [s for s in shown if np.linalg.norm(s.corners.mean(axis=0) - middle) < 0.5 * s.side_px]
    is_right = any(
        s.code == found.decoding.code
        and np.linalg.norm(found.corners - s.corners, axis=1).max() < RIGHT_CORNERS * s.side_px
        for s in near
    )
    return Example(found.reading, bool(near), is_right, any(s.is_hidden for s in near), is_best)


def in_other_colors(image: np.ndarray) -> Iterator[np.ndarray]:
    """A photograph as it is, enlarged, with channels swapped, and in other colors."""
    large = cv2.resize(image, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
    yield from (image, large)
    for order in ((2, 1, 0), (0, 2, 1), (1, 0, 2)):
        yield np.ascontiguousarray(image[:, :, order])
        yield np.ascontiguousarray(large[:, :, order])
    yield np.clip(image * np.array([1.4, 0.8, 1.3]), 0, 255).astype(np.uint8)


def simulated(images: ImageSet, folder: Path, keep: Path | None, look_alikes: float, index: int) -> list[Example]:
    cv2.setNumThreads(1)
    image, shown = images.scene(images.photographs(folder), look_alikes, keep, index)
    return examples_of(image, shown, OPTIONS)


def words_and_no_words(folder: Path, keep: Path | None, look_alikes: float, index: int) -> list[Example]:
    """Examples of a scene to fit, and of every third one its landmarks of odd parity as words that are no code."""
    cv2.setNumThreads(1)
    image, shown = FIT.scene(FIT.photographs(folder), look_alikes, keep, index)
    return examples_of(image, shown, OPTIONS) + (no_words(image, shown) if index % 3 == 0 else [])


def no_words(image: np.ndarray, shown: Sequence[Shown]) -> list[Example]:
    """Landmarks of odd parity, which are no code of lm8p, taken for the nearest one."""
    words = {tuple(LM8P.gaps(code)) for code in range(LM8P.code_count)}
    other = [replace(s, code=-1) for s in shown if tuple(LM8.gaps(s.code)) not in words]
    examples = examples_of(image, other, DetectOptions((LM8P,), BALANCED, ANYTHING))
    return [e for e in examples if e.is_landmark]


def photographed(path: Path) -> list[Example]:
    cv2.setNumThreads(1)
    return [e for image in in_other_colors(cv2.imread(str(path))) for e in examples_of(image, (), OPTIONS)]


def fit(examples: Sequence[Example]) -> tuple[float, dict[str, float]]:
    """Bias and weights, by logistic regression with signs; ridge on standardized figures."""
    names = list(examples[0].reading.figures)
    X = np.array([list(e.reading.figures.values()) for e in examples])
    y = np.array([e.is_right for e in examples], dtype=np.float64)
    middle, scale = X.mean(axis=0), X.std(axis=0) + 1e-9
    Z = np.column_stack([np.ones(len(X)), (X - middle) / scale])

    def loss(b: np.ndarray) -> tuple[float, np.ndarray]:
        score = Z @ b
        value = np.sum(np.logaddexp(0, score) - y * score) + PENALTY / 2 * np.sum(b[1:] ** 2)
        slope = Z.T @ (expit(score) - y)
        slope[1:] += PENALTY * b[1:]
        return float(value), slope

    bounds = [(None, None)] + [(0, None) if name in FOR else (None, 0) for name in names]
    b = minimize(loss, np.zeros(Z.shape[1]), jac=True, bounds=bounds, method="L-BFGS-B").x
    slopes = b[1:] / scale
    return float(b[0] - slopes @ middle), dict(zip(names, slopes.tolist(), strict=True))


def scores_of(examples: Sequence[Example], bias: float, weights: dict[str, float]) -> FloatArray:
    rows = np.array([[e.reading.figures[name] for name in weights] for e in examples])
    return bias + rows @ np.array(list(weights.values()))


def calibrate(examples: Sequence[Example], bias: float, weights: dict[str, float]) -> tuple[float, dict[str, float]]:
    """The score stretched and shifted to log odds on images that were not fitted (Platt 1999)."""
    score, right = scores_of(examples, bias, weights), np.array([e.is_right for e in examples], dtype=np.float64)

    def loss(b: np.ndarray) -> float:
        odds = b[0] + b[1] * score
        return float(np.sum(np.logaddexp(0, odds) - right * odds))

    shift, stretch = minimize(loss, [0.0, 1.0]).x.tolist()
    return shift + stretch * bias, {name: stretch * weight for name, weight in weights.items()}


def shifted(images: Sequence[Sequence[Example]]) -> tuple[float, float, float]:
    """Bias of today's weights with which the score is calibrated on images, and its 95 % interval over them."""
    weights = {name: term.weight for name, term in TERMS.items()}
    rows = [np.column_stack([scores_of(some, 0.0, weights), [e.is_right for e in some]]) for some in images if some]
    rng = np.random.default_rng(0)
    drawn = [_bias_of([rows[k] for k in rng.integers(len(rows), size=len(rows))]) for _ in range(REPEATS)]
    low, high = np.quantile(drawn, (0.025, 0.975)).tolist()
    return _bias_of(rows), low, high


def _bias_of(images: Sequence[FloatArray]) -> float:
    """The bias that makes (N,2) scores without one, each with 1 where the code is right, log odds."""
    score, right = np.concatenate(images).T
    return float(minimize(lambda b: np.sum(np.logaddexp(0, score + b) - right * (score + b)), [BIAS]).x[0])


def print_table(examples: Sequence[Example], bias: float, weights: dict[str, float]) -> None:
    right = [e.reading.figures for e in examples if e.is_right]
    print(f"BIAS = {bias:.2f}\nTERMS = MappingProxyType(\n    {{")
    for name, weight in weights.items():
        usual = np.median([figures[name] for figures in right])
        print(f'        "{name}": Term({weight:.2f}, {usual:.2f}, "{REASONS.get(name, "pattern")}"),')
    print("    }\n)")


def print_limits(
    scenes: Sequence[Example], photographs: Sequence[Example], bias: float, weights: dict[str, float]
) -> None:
    """How many are read and how many are not right, from every limit on."""
    print("| limit | read, visible | read, hidden | wrong, visible | wrong, hidden | look-alikes | in photographs |")
    print("|---|---|---|---|---|---|---|")
    score, elsewhere = scores_of(scenes, bias, weights), scores_of(photographs, bias, weights)
    for limit in LIMITS:
        read = [e for e, one in zip(scenes, score.tolist(), strict=True) if one >= limit]
        on = [e for e in read if e.is_landmark]
        cells = [sum(e.is_right is right and e.is_hidden is hidden for e in on) for right, hidden in KINDS]
        print(
            f"| {limit:g} | "
            + " | ".join(map(str, [*cells, len(read) - len(on), int((elsewhere >= limit).sum())]))
            + " |"
        )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("photos", type=Path)
    parser.add_argument("--images", type=int, default=900, help="scenes to fit; of the other kinds fewer")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="folder for the images; those in it are not drawn again")
    parser.add_argument("--shift-only", action="store_true")
    options = parser.parse_args()
    folder, keep, n = options.photos, options.keep, options.images
    with ProcessPoolExecutor(options.jobs) as pool:
        scenes = pool.map(partial(simulated, LIMIT, folder, keep, USUAL), range(7 * n // 9), chunksize=8)
        places = [[e for e in some if e.is_best] for some in scenes]
        if options.shift_only:
            print("BIAS = {:.2f}  # 95 % between {:.2f} and {:.2f}".format(*shifted(places)))
            return
        apart = [e for some in places for e in some]
        fitted = (
            pool.map(partial(words_and_no_words, folder, keep, USUAL), range(n), chunksize=8),
            pool.map(partial(words_and_no_words, folder, keep, MOSTLY_LOOK_ALIKES), range(n // 3), chunksize=8),
            pool.map(photographed, FIT.photographs(folder), chunksize=8),
        )
        examples = [e for job in fitted for some in job for e in some]
        plain = [e for some in pool.map(photographed, LIMIT.photographs(folder), chunksize=8) for e in some]
    right, wrong = sum(e.is_right for e in examples), sum(e.is_landmark and not e.is_right for e in examples)
    print(f"# {right} right, {wrong} wrong, {len(examples) - right - wrong} false")
    model = calibrate(apart, *fit(examples))
    print_table(examples, *model)
    print_limits(apart, plain, *model)


if __name__ == "__main__":
    main()
