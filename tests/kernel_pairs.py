"""Every kernel beside its numpy definition, with seeded random and hostile arguments.

Run as a program, it calls every kernel once with all of its arguments: what a library built with sanitizers is for.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from lmkit.kernels import load
from lmkit.kernels.reprojection import Corners, reprojection_errors, reprojection_errors_numpy


@dataclass(frozen=True)
class Pair:
    """A kernel's wrapper, the numpy function that defines it, and argument lists for both.

    ``tolerance`` is relative to the largest value of an array: 1e-12 in double, 1e-5 in single precision.
    """

    compiled: Callable[..., Any]
    numpy: Callable[..., Any]
    arguments: Callable[[np.random.Generator], Iterator[tuple[Any, ...]]]
    tolerance: float = 1e-12

    @property
    def name(self) -> str:
        return self.compiled.__name__


def rotations(rng: np.random.Generator, count: int) -> np.ndarray:
    q, _ = np.linalg.qr(rng.normal(size=(count, 3, 3))) if count else (np.zeros((0, 3, 3)), None)
    return q * np.linalg.det(q)[:, None, None] if count else q


def _corners(rng: np.random.Generator, count: int, depth: float) -> Corners:
    centre = rng.normal(size=(count, 1, 3)) + np.array([0, 0, depth])
    arms = 0.1 * rng.normal(size=(count, 4, 3))
    turned = rotations(rng, count) if depth < 3 else np.tile(np.eye(3), (count, 1, 1))
    return Corners.of(
        centre + arms, rng.normal(size=(count, 4, 2)), rng.normal(size=(count, 8, 8)), turned,
        0.1 * rng.normal(size=(count, 3)), arms,
    )  # fmt: skip


def _reprojections(rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    # With a depth of 0 many corners lie behind the camera.
    for poses, sightings, depth in [(1, 1, 4.0), (7, 3, 4.0), (5, 8, 0.0), (0, 3, 4.0), (3, 0, 4.0), (0, 0, 4.0)]:
        R = rotations(rng, poses) if depth < 3 else np.tile(np.eye(3), (poses, 1, 1))
        corners, p = _corners(rng, sightings, depth), 0.1 * rng.normal(size=(poses, 3))
        for by_pose, by_landmark in [(True, True), (True, False), (False, True), (False, False)]:
            yield corners, R, p, by_pose, by_landmark
        yield corners, np.full_like(R, np.nan), p, True, True
        # Arrays in Fortran's order, in single precision, and every other row of a larger one.
        yield corners, np.asfortranarray(R), np.repeat(p, 2, axis=0)[::2], True, True
        yield corners, R.astype(np.float32), p, True, False


PAIRS = [
    Pair(reprojection_errors, reprojection_errors_numpy, _reprojections),
]


def run_all() -> int:
    """Number of calls made."""
    calls = 0
    for pair in PAIRS:
        for arguments in pair.arguments(np.random.default_rng(1)):
            pair.compiled(*arguments)
            calls += 1
    return calls


if __name__ == "__main__":
    assert load.library() is not None, load.describe()
    sys.stdout.write(f"{load.describe()}: {run_all()} calls\n")
