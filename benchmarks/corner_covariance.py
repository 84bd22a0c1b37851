"""Fit of the covariance of corners, `corner_errors` of landmarks and of square markers, to simulated cameras.

    uv run --extra benchmark python benchmarks/corner_covariance.py [--images 120] [--first 6000] [--keep FILE]
        [--families lm8] [--kinds training] [--displaced] [--report]

Scenes of `pose_intervals.py`.  Every landmark is detected with the covariance that follows from the residuals alone.
The constants (`growth`, `full`, `stretch`, `least`) maximize the likelihood of all corners' errors under a
multivariate t distribution; a Gaussian would follow a few landmarks whose tone curve shifts all edges.  The second
table has the share of poses within their 95 % ellipsoids, for several enlargements of the fitted `growth`.  With
``--report`` nothing is fitted: the constants in use, on the cameras, seeds and families named.  With ``--displaced``
every camera displaces red and blue against green (`with_displaced_colors`).
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
from scipy.stats import chi2

from lmkit.arrays import FloatArray
from lmkit.detection import fit_steps
from lmkit.detection.pixel_sampling import mean_side
from lmkit.detection.registration import DrawingFit, PatternRegistration, with_processing
from lmkit.detection.tag_registration import TagFit
from lmkit.kernels.landmark_fit import CornerErrors
from lmkit.localization.correspondences import CORNER_FLOOR_PX
from lmkit.model.families import family_named
from lmkit.model.square_marker import SquareMarkerFamily
from lmkit.simulation.cameras import HELD_OUT_KINDS, TRAINING_KINDS, CameraKind

ANOTHER_PX = 3.0  # further off it is no corner error but another shape
FREEDOM = 8.0  # of the t distribution
ENLARGEMENTS = (1.0, 1.2, 1.4, 1.6)
SIDES_PX = (10, 15, 20, 25, 35, 50, 120)
TURNS_DEG = (0, 5, 15, 45)
SHIFT_PX, LATERAL = 0.15, 1e-3
KINDS = {"training": tuple(dict.fromkeys(TRAINING_KINDS)), "held-out": HELD_OUT_KINDS}
FITTED = ("growth", "full", "stretch", "least")
NEUTRAL = CornerErrors(
    least=0.0, few_edges=30.0, mosaic=2.0, growth=1.0, full=1e-9, stretch=0.0
)  # the scatter itself


@contextmanager
def in_use(fit: type[DrawingFit], errors: CornerErrors) -> Iterator[None]:
    """State these constants for landmarks that are fitted so."""
    before = fit.corner_errors
    fit.corner_errors = errors
    fit_steps._task.cache_clear()
    yield
    fit.corner_errors = before
    fit_steps._task.cache_clear()


def with_displaced_colors(kind: CameraKind) -> CameraKind:
    """Cameras that move red and blue by up to `SHIFT_PX` and enlarge them by up to `LATERAL`."""
    return replace(kind, lateral_color=(-LATERAL, LATERAL), color_shift_px=(0.0, SHIFT_PX))


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


def with_covariance(seen: Seen, errors: CornerErrors) -> Seen:
    """Detections with the covariance that the constants make of the scatter."""
    left, right = (
        [replace(d, covariance=with_processing(d.corners, d.covariance, errors)) for d in found]
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


def squares_of(rows: Sequence[Corners], errors: CornerErrors, floor_px: float = 0.0) -> tuple[FloatArray, FloatArray]:
    """(N) squared normalized errors and log determinants."""
    C = np.array([with_processing(r.corners, r.scatter, errors) for r in rows]) + floor_px**2 * np.eye(8)
    e = np.array([r.error for r in rows])
    return np.einsum("ni,nij,nj->n", e, np.linalg.inv(C), e), np.linalg.slogdet(C)[1]


def log_likelihood(rows: Sequence[Corners], errors: CornerErrors) -> float:
    """Log likelihood of all errors under a t distribution of 8 dimensions whose covariance is the stated one."""
    nees, log_det = squares_of(rows, errors)
    tail = -(FREEDOM + 8) / 2 * np.log1p(nees / (FREEDOM - 2))
    shape = gammaln((FREEDOM + 8) / 2) - gammaln(FREEDOM / 2) - 4 * np.log((FREEDOM - 2) * np.pi)
    return float(np.sum(shape - log_det / 2 + tail))


def fit(rows: Sequence[Corners], start: CornerErrors) -> CornerErrors:
    def of(logs: FloatArray) -> CornerErrors:
        return start._replace(**dict(zip(FITTED, np.exp(logs).tolist(), strict=True)))

    found = minimize(
        lambda logs: -log_likelihood(rows, of(logs)),
        np.log([getattr(start, name) for name in FITTED]),
        method="Nelder-Mead",
        options={"xatol": 0.01, "fatol": 0.1, "maxiter": 400},
    )
    return of(found.x)


def print_corners(rows: Sequence[Corners], errors: CornerErrors) -> None:
    """Stated and true errors by size, turn and kind."""
    nees, floored = (squares_of(rows, errors, floor)[0] / 8 for floor in (0.0, CORNER_FLOOR_PX))
    stated = np.array([np.trace(with_processing(r.corners, r.scatter, errors)) / 8 for r in rows])
    true = np.array([np.mean(r.error**2) for r in rows])
    side, turn = np.array([mean_side(r.corners) for r in rows]), np.array([r.turn_deg for r in rows])
    kinds = np.array([r.kind for r in rows])
    groups = {"all": side > 0}
    groups |= {f"{low} to {high} px": (side >= low) & (side < high) for low, high in pairwise(SIDES_PX)}
    groups |= {f"turned by {low} to {high} deg": (turn >= low) & (turn <= high) for low, high in pairwise(TURNS_DEG)}
    groups |= {kind: kinds == kind for kind in dict.fromkeys(kinds)}
    limit = chi2.ppf(0.95, 8) / 8
    print("| | landmarks | stated rms, px | true, px | middle | NEES / 8, mean | middle | inside, % | with floor |")
    print("|---|---|---|---|---|---|---|---|---|")
    for name, chosen in groups.items():
        if chosen.any():
            figures = (np.sqrt(stated[chosen].mean()), np.sqrt(true[chosen].mean()), np.sqrt(np.median(true[chosen])))
            cells = " | ".join(f"{value:.3f}" for value in figures)
            inside = " | ".join(f"{100 * np.mean(values[chosen] < limit):.0f}" for values in (nees, floored))
            middle = f"{nees[chosen].mean():.2f} | {np.median(nees[chosen]):.2f}"
            print(f"| {name} | {chosen.sum()} | {cells} | {middle} | {inside} |")


def print_poses(seen: Sequence[Seen], stated: dict[str, CornerErrors]) -> None:
    print("\n| growth times | located | place in its ellipsoid, % | turn | both | middle over expected | error, mm |")
    print("|---|---|---|---|---|---|---|")
    for name, errors in stated.items():
        print(row(name, [with_covariance(one, errors).located for one in seen]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, default=120, help="pairs by each kind of camera")
    parser.add_argument("--first", type=int, default=6000, help="seed")
    parser.add_argument("--keep", type=Path, help="file of what was detected; read where it exists")
    parser.add_argument("--families", nargs="+", default=["lm8"], help="of landmarks, or of square markers")
    parser.add_argument("--kinds", choices=KINDS, default="training", help="of cameras")
    parser.add_argument("--displaced", action="store_true", help="red and blue are displaced")
    parser.add_argument("--report", action="store_true", help="fit nothing")
    options = parser.parse_args()
    families = [family_named(name) for name in options.families]
    way: type[DrawingFit] = TagFit if isinstance(families[0], SquareMarkerFamily) else PatternRegistration
    today, kinds = way.corner_errors, KINDS[options.kinds]
    if options.displaced:
        kinds = tuple(map(with_displaced_colors, kinds))
    if options.keep and options.keep.exists():
        seen = pickle.loads(options.keep.read_bytes())
    else:
        seeds = range(options.first, options.first + options.images)
        with in_use(way, NEUTRAL):
            seen = [look(kind, seed, rolled(seed), one.name) for one in families for seed in seeds for kind in kinds]
    if options.keep:
        options.keep.write_bytes(pickle.dumps(seen))
    rows = [r for one in seen for r in corners_of(one)]
    stated = {"today": today} if options.report else {"today": today, "fitted": fit(rows, today)}
    for name, errors in stated.items():
        print(f"\n{name}: {errors}, 2 log likelihood {2 * log_likelihood(rows, errors):.0f}\n")
        print_corners(rows, errors)
    if not options.report:
        found = stated.pop("fitted")
        stated |= {f"{factor:g}": found._replace(growth=factor * found.growth) for factor in ENLARGEMENTS}
    print_poses(seen, stated)


if __name__ == "__main__":
    main()
