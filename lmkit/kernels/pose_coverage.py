"""Expected errors of poses on a floor from information on the camera's pose, scored against a requirement."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.load import addresses, contiguous, function

Array = NDArray[np.floating[Any]]
Ints = NDArray[np.int64]
HELD = 1 - 1e-9  # least score of a place that meets the requirement
MOST_HEADINGS = 256


class _CoverageStruct(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_int64) for name in ("headings", "enough", "asked")),
        *((name, ctypes.c_void_p) for name in ("information", "scores", "held", "in_view", "arms")),
        ("known", ctypes.c_double * 6),
        *((name, ctypes.c_double) for name in ("error_m", "heading_rad", "blind_m")),
    )


@dataclass(frozen=True, eq=False)
class Coverage:
    """Information at N places in H headings each, and the requirement; the arrays change.

    Attributes:
        information: (N*H,6,6) on the camera's pose in the map (shift m, turn rad).
        in_view: (N*H,) landmarks in view.
        arms: (N*H,3) from the base to the camera, in the map.
        known: (6,) information on the camera's pose that is there without landmarks, on the diagonal.
        headings: H, at most 256.
        enough: number of headings of a place that must meet the requirement.
        error_m, heading_rad, asked: the requirement: errors of position and heading, landmarks in view.
        blind_m: error at which a pose has no value.
        scores: (N*H,) 1 where the demand holds; half for landmarks in view, half for the errors.
        held: (N,) mean of the best ``enough`` scores of a place.
    """

    information: Array
    in_view: Ints
    arms: Array
    known: Array
    headings: int
    enough: int
    asked: int
    error_m: float
    heading_rad: float
    blind_m: float
    scores: Array = field(init=False)
    held: Array = field(init=False)
    struct: _CoverageStruct = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Make the arrays contiguous, and score all poses.

        Raises:
            ValueError: a shape differs, or there are too many headings.
        """
        count = len(self.information)
        if not 1 <= self.enough <= self.headings <= MOST_HEADINGS or count % self.headings:
            raise ValueError(f"{count} poses in {self.headings} headings, {self.enough} of which are enough")
        object.__setattr__(self, "information", contiguous(self.information, (count, 6, 6)))
        object.__setattr__(self, "in_view", contiguous(self.in_view, (count,), np.int64))
        object.__setattr__(self, "arms", contiguous(self.arms, (count, 3)))
        object.__setattr__(self, "scores", pose_scores(self, np.arange(count), self.information, self.in_view))
        object.__setattr__(self, "held", means_of_best(self, self.scores))
        numbers = (ctypes.c_double * 6)(*contiguous(self.known, (6,)))
        arrays = addresses(self.information, self.scores, self.held, self.in_view, self.arms)
        demand = self.error_m, self.heading_rad, self.blind_m
        struct = _CoverageStruct(self.headings, self.enough, self.asked, *arrays, numbers, *demand)
        object.__setattr__(self, "struct", struct)


def planar_covariances(information: Array, arms: Array, known: Array) -> Array:
    """(P,3,3) covariances of the base's x, y (m) and heading (rad).

    Args:
        information: (P,6,6) on the camera's pose in the map; ``known``: (6,) what is added to its diagonal.
        arms: (P,3) from the base to the camera, in the map.

    Raises:
        ValueError: a shape differs.
    """
    information = contiguous(information, (-1, 6, 6))
    arms, known = contiguous(arms, (len(information), 3)), contiguous(known, (6,))
    kernels = _kernels()
    if kernels is None:
        return planar_covariances_numpy(information, arms, known)
    covariances = np.empty((len(information), 3, 3))
    if kernels[0](len(information), *addresses(information, arms, known, covariances)):
        return planar_covariances_numpy(information, arms, known)  # one is not positive definite
    return covariances


def planar_covariances_numpy(information: Array, arms: Array, known: Array) -> Array:
    """Definition of :func:`planar_covariances`."""
    # The base is behind the camera: p_base = p_camera - R(heading) t.
    J = np.zeros((len(information), 3, 6))
    J[:, 0, 0] = J[:, 1, 1] = J[:, 2, 5] = 1.0
    J[:, 0, 4], J[:, 0, 5] = -arms[:, 2], arms[:, 1]
    J[:, 1, 3], J[:, 1, 5] = arms[:, 2], -arms[:, 0]
    return np.asarray(J @ np.linalg.inv(information + np.diag(known)) @ J.transpose(0, 2, 1))


def pose_scores(coverage: Coverage, rows: Ints, information: Array, in_view: Ints) -> Array:
    """(R,) scores of poses with given information (R,6,6) and numbers of landmarks in view (R,)."""
    C = planar_covariances_numpy(information, coverage.arms[rows], coverage.known)
    errors, turns = np.sqrt(C[:, 0, 0] + C[:, 1, 1]), np.sqrt(C[:, 2, 2])
    worst = np.maximum(errors / coverage.error_m, turns / coverage.heading_rad)
    near = 1 - np.log(np.maximum(worst, 1.0)) / np.log(coverage.blind_m / coverage.error_m)
    asked = coverage.asked
    seen = np.minimum(in_view, asked) / asked if asked else np.ones(len(in_view))
    return np.asarray((seen + near.clip(0, 1)) / 2)


def means_of_best(coverage: Coverage, scores: Array) -> Array:
    """(N,) mean of the best ``enough`` scores of each place."""
    best = np.sort(scores.reshape(-1, coverage.headings), axis=1)[:, coverage.headings - coverage.enough :]
    return np.asarray(best[:, ::-1].mean(axis=1))


def change_coverage(
    coverage: Coverage, rows: Ints, information: Array, shown: NDArray[np.bool_], sign: int, apply: bool
) -> tuple[float, int]:
    """Effect of an added (1) or removed (-1) landmark: the sum of ``held``, and the number of places that hold.

    Args:
        rows: (R,) poses that may read it, in rising order.
        information: (R,6,6) the information that it adds there; ``shown``: (R,) whether it counts as in view.
        apply: change the coverage, in place.

    Raises:
        ValueError: a shape differs, or a row is out of range or order.
    """
    rows = contiguous(rows, (-1,), np.int64)
    count = len(rows)
    information, shown = contiguous(information, (count, 6, 6)), contiguous(shown, (count,), np.bool_)
    if count and (not 0 <= rows[0] <= rows[-1] < len(coverage.scores) or (rows[1:] <= rows[:-1]).any()):
        raise ValueError("rows are out of range or not in rising order")
    kernels = _kernels()
    if kernels is None:
        return change_coverage_numpy(coverage, rows, information, shown, sign, apply)
    gain, newly = ctypes.c_double(), ctypes.c_int64()
    kernels[1](coverage.struct, count, *addresses(rows, information, shown), sign, apply, gain, newly)
    return gain.value, newly.value


def change_coverage_numpy(
    coverage: Coverage, rows: Ints, information: Array, shown: NDArray[np.bool_], sign: int, apply: bool
) -> tuple[float, int]:
    """Definition of :func:`change_coverage`."""
    information, in_view = coverage.information[rows] + sign * information, coverage.in_view[rows] + sign * shown
    scores = pose_scores(coverage, rows, information, in_view)
    places = np.unique(rows // coverage.headings)
    changed = coverage.scores.reshape(-1, coverage.headings)[places]
    changed[np.searchsorted(places, rows // coverage.headings), rows % coverage.headings] = scores
    before, after = coverage.held[places], means_of_best(coverage, changed)
    if apply:
        coverage.information[rows], coverage.in_view[rows] = information, in_view
        coverage.scores[rows], coverage.held[places] = scores, after
    return float((after - before).sum()), int((after >= HELD).sum()) - int((before >= HELD).sum())


@lru_cache(maxsize=1)
def _kernels() -> tuple[Any, Any] | None:
    pointer, count = ctypes.c_void_p, ctypes.c_int64
    covariances = function("lmkit_planar_covariances", count, *[pointer] * 4)
    change = function(
        "lmkit_change_coverage", ctypes.POINTER(_CoverageStruct), count, pointer, pointer, pointer, count, count,
        ctypes.POINTER(ctypes.c_double), ctypes.POINTER(ctypes.c_int64),
    )  # fmt: skip
    return None if covariances is None else (covariances, change)
