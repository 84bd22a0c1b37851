"""SolvedRecording: a recording after bundle adjustment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from lmkit.arrays import FloatArray
from lmkit.mapping.bundle_adjustment import BundleProblem
from lmkit.mapping.initialization import Start


@dataclass(frozen=True, eq=False)
class SolvedRecording:
    """A recording after bundle adjustment.

    Attributes:
        start: frames and landmarks that take part.
        problem: the observations, and the unknowns at their optimum.
        undecided: (6,6) to add to the covariance of landmarks whose pose is ambiguous, by row.
        frames: number of given frames.
        odometry: names of the estimated odometry errors.
    """

    start: Start
    problem: BundleProblem
    undecided: Mapping[int, FloatArray]
    frames: int
    odometry: tuple[str, ...] = ()
