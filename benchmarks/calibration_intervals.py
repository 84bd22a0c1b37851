"""Stated intervals of a stereo calibration on uncertain data: how often do 95 % intervals hold the truth?

    uv run python benchmarks/calibration_intervals.py [--n 60] [--seed 4000] [--pairs 15] [--lenses prior]

Simulated corners of a 9 x 6 board in a known rig, fitted from the truth (so that only the intervals are judged).
With ``--lenses`` both cameras' intrinsics are known beforehand, with errors: "exact" keeps them as they are although
they are off, as ``--intrinsics`` does; "prior" fits them with the deviations that their errors were drawn from, as
``--intrinsics-sigma 2px`` does; "stated" draws the errors of a good calibration of the same rig, which are
correlated, and takes its covariance of each camera, twice, as ``--intrinsics-sigma stated`` does with one file of
two cameras; "sigmas" the same of a file without correlations.

Kinds: good views; "partial": half of the board's columns, as a hand or the image's edge leaves them; "one distance":
all boards within 5 % of one distance and 12 deg of head-on; "correlated": the corners of one image share a smooth
shift (a random quadratic field of 0.15 px beside independent 0.08 px); "uncertain": all three.
"""

from __future__ import annotations

import argparse
import functools
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import cv2
import numpy as np
from scipy.linalg import block_diag

from lmkit.calibration.board_equations import POSE
from lmkit.calibration.bundle_adjustment import FitOptions, Solution, StereoProblem
from lmkit.calibration.intrinsics import (
    KnownIntrinsics,
    intrinsics_vector,
    sigma_and_correlation,
    sigma_of_pixels,
    stated_covariance,
    with_intrinsics,
)
from lmkit.geometry.rotations import rotation_log
from lmkit.model.board import BoardSpec
from lmkit.model.observation import PairView
from lmkit.simulation.scene import make_rig

BOARD = BoardSpec("chessboard", 9, 6, 25.0)
KINDS = ("good", "partial", "one distance", "correlated", "uncertain")
INDEPENDENT_PX, SMOOTH_PX = 0.08, 0.15
KNOWN_PX = 2.0
Z95 = 1.96
NAMES = ("focal length", "principal point", "rotation", "baseline")


def board_pose(flat: bool, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """(R, t) of T_left_board."""
    middle = BOARD.object_points.mean(axis=0)
    tilt, distance = (12.0, rng.uniform(0.475, 0.525)) if flat else (40.0, rng.uniform(0.3, 0.7))
    R = cv2.Rodrigues(np.deg2rad(rng.uniform(-tilt, tilt, 3)))[0] @ np.diag([1.0, -1.0, -1.0])
    at = np.array([*(rng.uniform(-0.3, 0.3, 2) * distance * [1, 0.7]), distance])
    return R, at - R @ middle


def shifts(kind: str, pixels: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(N,2) errors of one image's corners."""
    errors = rng.normal(0, INDEPENDENT_PX, pixels.shape)
    if kind in ("correlated", "uncertain"):
        x, y = ((pixels - pixels.mean(axis=0)) / np.ptp(pixels, axis=0).max() * 2).T
        terms = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
        field = terms @ rng.normal(0, 1, (6, 2))
        errors += SMOOTH_PX * field / np.sqrt(np.mean(field**2))
    return errors


def views(kind: str, count: int, rng: np.random.Generator) -> tuple[list[PairView], np.ndarray, np.ndarray]:
    """Pairs with their true board poses."""
    rig, result, rotations, translations = make_rig(), [], [], []
    while len(result) < count:
        R, t = board_pose(kind in ("one distance", "uncertain"), rng)
        ids = np.arange(len(BOARD.object_points))
        if kind in ("partial", "uncertain"):
            column = ids % 9
            ids = ids[column < 5] if rng.random() < 0.5 else ids[column > 3]
        left = BOARD.object_points[ids] @ R.T + t
        right = left @ rig.T_right_left.R.T + rig.T_right_left.t
        seen = []
        for camera, points in ((rig.left, left), (rig.right, right)):
            exact = camera.project(points)
            inside = ((exact > 0) & (exact < np.array(camera.image_size) - 1)).all(axis=1)
            seen.append((ids[inside], (exact + shifts(kind, exact, rng))[inside]))
        if min(len(which) for which, _ in seen) < 12:
            continue
        result.append(PairView(f"{len(result):02d}", *seen[0], *seen[1]))
        rotations.append(R)
        translations.append(t)
    return result, np.array(rotations), np.array(translations)


@functools.cache
def good_covariance() -> np.ndarray:
    """(K,K) covariance of both cameras' intrinsics after a calibration from good views."""
    rig = make_rig()
    pairs, R, t = views("good", 15, np.random.default_rng(77))
    truth = Solution(rig.left, rig.right, rig.T_right_left.R, rig.T_right_left.t, np.zeros(2), R, t)
    count = len(intrinsics_vector(rig.left)) + len(intrinsics_vector(rig.right))
    return StereoProblem(BOARD.object_points, pairs).solve(truth, FitOptions()).covariance[:count, :count]


def known_lenses(lenses: str, rng: np.random.Generator) -> KnownIntrinsics:
    """Intrinsics of both cameras as they are known beforehand, errors and deviations."""
    rig = make_rig()
    true = np.concatenate([intrinsics_vector(rig.left), intrinsics_vector(rig.right)])
    if lenses in ("stated", "sigmas"):
        covariance = good_covariance()
        count = len(intrinsics_vector(rig.left))
        parts = [sigma_and_correlation(covariance[k, k]) for k in (slice(count), slice(count, None))]
        known = [stated_covariance(sigma, both if lenses == "stated" else None, 2) for sigma, both in parts]
        return KnownIntrinsics(rng.multivariate_normal(true, covariance), block_diag(*known))
    sigma = np.concatenate([sigma_of_pixels(camera, KNOWN_PX) for camera in (rig.left, rig.right)])
    return KnownIntrinsics(rng.normal(true, sigma), np.diag(sigma**2))


def examine(job: tuple[str, int, int, str]) -> tuple[str, list[tuple[str, float, float]]]:
    """(kind, [(which, error, stated standard deviation)])."""
    kind, count, seed, lenses = job
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    rig = make_rig()
    pairs, R, t = views(kind, count, rng)
    truth = Solution(rig.left, rig.right, rig.T_right_left.R, rig.T_right_left.t, np.zeros(2), R, t)
    options = FitOptions()
    if lenses:
        known = known_lenses(lenses, rng)
        options = FitOptions(intrinsics=False) if lenses == "exact" else FitOptions(known=known)
        own = len(intrinsics_vector(rig.left))
        left, right = with_intrinsics(rig.left, known.mean[:own]), with_intrinsics(rig.right, known.mean[own:])
        truth = replace(truth, left=left, right=right)
    s = StereoProblem(BOARD.object_points, pairs).solve(truth, options)
    sigma = np.sqrt(np.diag(s.covariance))
    nl, nr = len(intrinsics_vector(s.left)), len(intrinsics_vector(s.right))
    answers = []
    for start, found, true in ((0, s.left, rig.left), (nl, s.right, rig.right)):
        error = intrinsics_vector(found) - intrinsics_vector(true)
        answers += [("focal length", error[k], sigma[start + k]) for k in (0, 1)]
        answers += [("principal point", error[k], sigma[start + k]) for k in (2, 3)]
    turn = rotation_log(s.R @ rig.T_right_left.R.T)
    answers += [("rotation", turn[k], sigma[nl + nr + k]) for k in range(3)]
    way = s.t / np.linalg.norm(s.t)
    relation = s.covariance[nl + nr + 3 : nl + nr + POSE, nl + nr + 3 : nl + nr + POSE]
    off = np.linalg.norm(s.t) - np.linalg.norm(rig.T_right_left.t)
    return kind, [*answers, ("baseline", off, np.sqrt(way @ relation @ way))]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=60)
    parser.add_argument("--seed", type=int, default=4000)
    parser.add_argument("--pairs", type=int, default=15)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--lenses", choices=("exact", "prior", "stated", "sigmas"), default="")
    options = parser.parse_args()
    jobs = [(kind, options.pairs, options.seed + k, options.lenses) for kind in KINDS for k in range(options.n)]
    with ProcessPoolExecutor(options.workers) as pool:
        answers = list(pool.map(examine, jobs, chunksize=4))
    names = NAMES if options.lenses != "exact" else NAMES[2:]
    print(f"| views | rigs | {' | '.join(names)} | worst error in stated sigmas |")
    print("|---|---|" + "---|" * (len(names) + 1))
    for kind in KINDS:
        some = [entry for name, entries in answers if name == kind for entry in entries]
        answer = []
        for which in names:
            ratios = np.array([abs(error) / sigma for name, error, sigma in some if name == which])
            answer.append(f"{np.mean(ratios < Z95):.1%} (n = {len(ratios)})")
        worst = max(abs(error) / sigma for which, error, sigma in some if which in names)
        print(f"| {kind} | {options.n} | {' | '.join(answer)} | {worst:.1f} |")


if __name__ == "__main__":
    main()
