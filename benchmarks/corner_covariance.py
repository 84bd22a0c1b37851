"""Fit of the covariance of corners in `lmkit/detection/registration.py` to the errors of simulated cameras.

    uv run --extra benchmark python benchmarks/corner_covariance.py [--images 120] [--first 6000] [--keep FILE]

Scenes and `TRAINING_KINDS` of `pose_intervals.py`.  Every landmark is detected with the covariance that residuals
alone let expect.  The constants (`GROWTH`, `FULL_PX`, `STRETCH`, `LEAST_ERROR_PX`) are those of the largest
likelihood of all corners' errors under a multivariate t distribution; a Gaussian would follow a few landmarks whose
tone curve shifts all edges.  Below them stands how many of the poses lie in their 95 % ellipsoids, for several
enlargements of the fitted `GROWTH`.  `pose_intervals.py --reported` reports on other cameras and seeds.
"""

from __future__ import annotations

import argparse
import pickle
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from pose_intervals import Seen, look, roll_of, row
from scipy.optimize import minimize
from scipy.special import gammaln

from lmkit.arrays import FloatArray
from lmkit.detection import fit_steps, registration
from lmkit.detection.pixel_sampling import mean_side
from lmkit.simulation.cameras import TRAINING_KINDS

ANOTHER_PX = 3.0  # further off it is no corner error but another shape
FREEDOM = 8.0  # of the t distribution
ENLARGEMENTS = (1.0, 1.2, 1.4, 1.6)
SIDES_PX = (10, 15, 20, 25, 35, 50, 120)
TURNS_DEG = (0, 5, 15, 45)


@dataclass(frozen=True)
class Constants:
    """Constants of `registration.with_processing`."""

    growth: float
    full_px: float
    stretch: float
    least_px: float

    @contextmanager
    def in_use(self) -> Iterator[None]:
        before = [getattr(registration, name) for name in NAMES]
        self._set([self.growth, self.full_px, self.stretch, self.least_px])
        yield
        self._set(before)

    @staticmethod
    def _set(values: Sequence[float]) -> None:
        for name, value in zip(NAMES, values, strict=True):
            setattr(registration, name, value)
            setattr(fit_steps, name, value)
        fit_steps._task.cache_clear()


NAMES = ("GROWTH", "FULL_PX", "STRETCH", "LEAST_ERROR_PX")
TODAY = Constants(*(getattr(registration, name) for name in NAMES))
NEUTRAL = Constants(1.0, 1e-9, 0.0, 0.0)  # the scatter itself


@dataclass(frozen=True, eq=False)
class Corners:
    """One landmark in one image: (4,2) px as detected, (8,) error, (8,8) covariance from residuals alone."""

    kind: str
    corners: FloatArray
    error: FloatArray
    scatter: FloatArray

    @property
    def turn_deg(self) -> float:
        """Between the upper side and the rows or columns of pixels, 0 to 45."""
        x, y = self.corners[1] - self.corners[0]
        turn = np.rad2deg(np.arctan2(y, x)) % 90
        return float(min(turn, 90 - turn))


def rolled(seed: int) -> float:
    """Every third camera is rolled by up to 45 deg; those of robots are mostly upright."""
    return roll_of(seed, 45.0 if seed % 3 == 0 else 0.0)


def with_covariance(seen: Seen) -> Seen:
    """Detections with the covariance that the constants in use make of the scatter."""
    left, right = (
        [replace(d, covariance=registration.with_processing(d.corners, d.covariance)) for d in found]
        for found in seen.detections
    )
    return replace(seen, detections=(left, right))


def corners_of(seen: Seen) -> list[Corners]:
    rows = []
    for found, true in zip(seen.detections, seen.true_corners, strict=True):
        for d in found:
            error = (d.corners - true[d.id]).ravel() if d.id in true else np.full(8, np.inf)
            if np.abs(error).max() < ANOTHER_PX:
                rows.append(Corners(seen.kind, d.corners, error, d.covariance))
    return rows


def squares_of(rows: Sequence[Corners]) -> tuple[FloatArray, FloatArray]:
    """(N) squared normalized errors and log determinants with the constants in use."""
    C = np.array([registration.with_processing(r.corners, r.scatter) for r in rows])
    e = np.array([r.error for r in rows])
    return np.einsum("ni,nij,nj->n", e, np.linalg.inv(C), e), np.linalg.slogdet(C)[1]


def log_likelihood(rows: Sequence[Corners], constants: Constants) -> float:
    """Log likelihood of all errors under a t distribution of 8 dimensions whose covariance is the stated one."""
    with constants.in_use():
        nees, log_det = squares_of(rows)
    tail = -(FREEDOM + 8) / 2 * np.log1p(nees / (FREEDOM - 2))
    shape = gammaln((FREEDOM + 8) / 2) - gammaln(FREEDOM / 2) - 4 * np.log((FREEDOM - 2) * np.pi)
    return float(np.sum(shape - log_det / 2 + tail))


def fit(rows: Sequence[Corners]) -> Constants:
    start = np.log([TODAY.growth, TODAY.full_px, TODAY.stretch, TODAY.least_px])
    found = minimize(
        lambda x: -log_likelihood(rows, Constants(*np.exp(x).tolist())),
        start,
        method="Nelder-Mead",
        options={"xatol": 0.01, "fatol": 0.1, "maxiter": 400},
    )
    return Constants(*np.exp(found.x).tolist())


def print_corners(rows: Sequence[Corners], constants: Constants) -> None:
    """Stated and true errors by size, turn and kind."""
    with constants.in_use():
        nees = squares_of(rows)[0] / 8
        stated = np.array([np.trace(registration.with_processing(r.corners, r.scatter)) / 8 for r in rows])
    true = np.array([np.mean(r.error**2) for r in rows])
    side, turn = np.array([mean_side(r.corners) for r in rows]), np.array([r.turn_deg for r in rows])
    kinds = np.array([r.kind for r in rows])
    groups = {f"{low} to {high} px": (side >= low) & (side < high) for low, high in pairwise(SIDES_PX)}
    groups |= {f"turned by {low} to {high} deg": (turn >= low) & (turn <= high) for low, high in pairwise(TURNS_DEG)}
    groups |= {kind: kinds == kind for kind in dict.fromkeys(kinds)}
    print("| | landmarks | stated rms, px | true rms, px | true, middle | NEES / 8, mean | middle |")
    print("|---|---|---|---|---|---|---|")
    for name, chosen in groups.items():
        if chosen.any():
            figures = (np.sqrt(stated[chosen].mean()), np.sqrt(true[chosen].mean()), np.sqrt(np.median(true[chosen])))
            cells = " | ".join(f"{value:.3f}" for value in figures)
            print(
                f"| {name} | {chosen.sum()} | {cells} | {nees[chosen].mean():.2f} | {np.median(nees[chosen]):.2f} |"
            )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--images", type=int, default=120, help="pairs by each kind of camera")
    parser.add_argument("--first", type=int, default=6000, help="seed")
    parser.add_argument("--keep", type=Path, help="file of what was detected; read where it exists")
    options = parser.parse_args()
    kinds = tuple(dict.fromkeys(TRAINING_KINDS))
    if options.keep and options.keep.exists():
        seen = pickle.loads(options.keep.read_bytes())
    else:
        seeds = range(options.first, options.first + options.images)
        with NEUTRAL.in_use():
            seen = [look(kind, seed, rolled(seed)) for seed in seeds for kind in kinds]
    if options.keep:
        options.keep.write_bytes(pickle.dumps(seen))
    rows = [r for one in seen for r in corners_of(one)]
    found = fit(rows)
    for name, constants in (("today", TODAY), ("fitted", found)):
        print(f"\n{name}: {constants}, 2 log likelihood {2 * log_likelihood(rows, constants):.0f}\n")
        print_corners(rows, constants)
    print("\n| growth times | located | place in its ellipsoid, % | turn | both | middle over expected | error, mm |")
    print("|---|---|---|---|---|---|---|")
    for factor in (None, *ENLARGEMENTS):
        constants = TODAY if factor is None else replace(found, growth=factor * found.growth)
        with constants.in_use():
            print(row("today" if factor is None else f"{factor:g}", [with_covariance(one).located for one in seen]))


if __name__ == "__main__":
    main()
