"""The poses allowed by the corners of several landmarks, and the covariance of one of them.

Every landmark alone gives two poses (square_pose.py).  Each is fitted to its own landmark, then to all landmarks
near their projections; poses that are still different are refined on the landmarks that they explain.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.load import address, addresses, contiguous, function
from lmkit.kernels.reprojection import (
    Corners,
    _CornersStruct,
    _prior,
    corner_chi2_numpy,
    pose_equations_numpy,
    prior_residuals,
    refine_poses_numpy,
    turns,
)
from lmkit.kernels.square_pose import square_poses_numpy

Array = NDArray[np.floating[Any]]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

# A pose is finished when the predicted decrease of chi2 is smaller (a hundredth of a standard deviation), or when
# steps must be damped more than this.
CONVERGED, MOST_DAMPING = 1e-4, 1e6


class _SearchStruct(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_double) for name in ("gate_share", "limit", "listed_below", "least_trace")),
        *((name, ctypes.c_double) for name in ("same_place_squared", "converged", "most_damping")),
        *((name, ctypes.c_int64) for name in ("towards_near", "to_the_end", "rounds")),
    )


@dataclass(frozen=True)
class Search:
    """Settings of the search.

    Attributes:
        gate_share: corners within this share of the landmark's side are near.
        limit: chi2 of an observation's eight coordinates below which it is explained.
        listed_below: log likelihood ratio to the best pose beyond which a pose is dropped.
        same_turn_rad, same_place_m: poses with smaller differences are the same.
        towards_near, to_the_end: iterations of the first fit and of the last ones.
        rounds: number of times that the explained observations are chosen again.
    """

    gate_share: float
    limit: float
    listed_below: float
    same_turn_rad: float
    same_place_m: float
    towards_near: int
    to_the_end: int
    rounds: int = 3
    struct: _SearchStruct = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        struct = _SearchStruct(
            self.gate_share, self.limit, self.listed_below, self.least_trace, self.same_place_m**2, CONVERGED,
            MOST_DAMPING, self.towards_near, self.to_the_end, self.rounds,
        )  # fmt: skip
        object.__setattr__(self, "struct", struct)

    @property
    def least_trace(self) -> float:
        """Trace of the rotation between two poses above which they are the same."""
        return float(1 + 2 * np.cos(self.same_turn_rad))


def search_poses(
    corners: Corners, of: Ints, side_px: Array, prior: tuple[float, ...], search: Search
) -> tuple[Array, Array, Array, Array]:
    """Different poses, the likeliest first: R (K,3,3), p (K,3), chi2 of every observation (K,S), and costs (K,).

    Args:
        corners: S observations of square landmarks.
        of: (S,) which landmark each is of.
        side_px: (S,) sides in the image.
        prior: as of :func:`lmkit.kernels.reprojection.pose_equations`.

    Returns:
        K is 0 if no landmark has a pose.  Costs are negative log likelihoods.

    Raises:
        ValueError: a shape differs.
    """
    S = len(corners)
    of, side_px = contiguous(of, (S,), np.int64), contiguous(side_px, (S,))
    kernels = _kernels()
    if kernels is None:
        return search_poses_numpy(corners, of, side_px, prior, search)
    H = 2 * S
    # One array for all: R, p, cost, and chi2 and pixel errors of every observation.
    numbers = np.empty(H * (13 + 2 * S))
    R, p, cost, chi2, pixels = np.split(numbers, [9 * H, 12 * H, 13 * H, (13 + S) * H])
    flags, slots = np.empty((2, H * S), dtype=np.bool_), np.empty((2, H), dtype=np.int64)
    count = ctypes.c_int64()
    kernels[0](
        corners.struct, _prior(prior), search.struct, *addresses(of, side_px, R, p, chi2, pixels, cost),
        *addresses(*flags, *slots), count,
    )  # fmt: skip
    rows = slots[1, : count.value]
    return R.reshape(H, 3, 3)[rows], p.reshape(H, 3)[rows], chi2.reshape(H, S)[rows], cost[rows]


def search_poses_numpy(
    corners: Corners, of: Ints, side_px: Array, prior: tuple[float, ...], search: Search
) -> tuple[Array, Array, Array, Array]:
    """Definition of :func:`search_poses`."""
    R, p, own = _hypotheses(corners, of, side_px)
    if not len(R):
        return R, p, np.zeros((0, len(corners))), np.zeros(0)
    gate_px = search.gate_share * side_px
    near = (of == own[:, None]) | (np.sqrt(corner_chi2_numpy(corners, R, p)[1] / 8) < gate_px)
    R, p = refine_poses_numpy(corners, prior, R, p, near, search.towards_near, CONVERGED, MOST_DAMPING)
    # Landmarks far from their projections will not be explained by any refinement of the pose.
    chi2, pixels = corner_chi2_numpy(corners, R, p)
    near |= (np.sqrt(pixels / 8) < gate_px) | (chi2 < search.limit)
    least = (~near).sum(axis=1) * search.limit / 2
    cost = _costs(prior, R, p, chi2, search)
    hopeful = np.flatnonzero(least < cost.min() + search.listed_below)
    rows = hopeful[_distinct(R[hopeful], p[hopeful], cost[hopeful], search)]
    R, p, chi2, cost = R[rows], p[rows], chi2[rows], cost[rows]
    used: Flags | None = None
    for _ in range(search.rounds):
        inliers = chi2 < search.limit
        # A pose that explains no landmark stays at the fit of its best landmark.
        nothing = ~np.asarray(inliers.any(axis=1, keepdims=True))
        inliers |= nothing & (chi2 == chi2.min(axis=1, keepdims=True))
        if used is not None and (inliers == used).all():
            break
        used = inliers
        R, p = refine_poses_numpy(corners, prior, R, p, used, search.to_the_end, CONVERGED, MOST_DAMPING)
        chi2 = corner_chi2_numpy(corners, R, p)[0]
        cost = _costs(prior, R, p, chi2, search)
    rows = _distinct(R, p, cost, search)
    return R[rows], p[rows], chi2[rows], cost[rows]


def _hypotheses(corners: Corners, of: Ints, side_px: Array) -> tuple[Array, Array, Ints]:
    """Both poses of every landmark: R (H,3,3), p (H,3), and its number (H,)."""
    best: dict[int, int] = {}
    for row, which in enumerate(of.tolist()):
        # The camera in which the landmark is larger.
        if which not in best or side_px[row] > side_px[best[which]]:
            best[which] = row
    rows = list(best.values())
    P = corners.points[rows]
    size = np.linalg.norm(P[:, 1] - P[:, 0], axis=1)
    x, y = ((P[:, a] - P[:, b]) / size[:, None] for a, b in ((1, 0), (0, 3)))
    R_map, t_map = np.stack([x, y, np.cross(x, y)], axis=2)[:, None], P.mean(axis=1)[:, None]
    R_landmark, t_landmark, _ = square_poses_numpy(corners.rays[rows], size)
    # x_camera = R x_landmark + t, and x_camera = R_camera x_rig + t_camera.
    back = corners.R_camera[rows].transpose(0, 2, 1)[:, None]
    t_rig = back @ (t_landmark - corners.t_camera[rows][:, None])[..., None]
    R = R_map @ (back @ R_landmark).swapaxes(-1, -2)
    p = t_map - (R @ t_rig)[..., 0]
    finite = np.isfinite(p).all(axis=2).ravel()
    own = np.repeat(of[rows], 2)[finite]
    return R.reshape(-1, 3, 3)[finite], p.reshape(-1, 3)[finite], own


def _costs(prior: tuple[float, ...], R: Array, p: Array, chi2: Array, search: Search) -> Array:
    """(H,) negative log likelihoods; an unexplained observation costs as much as one at the limit."""
    known = (prior_residuals(prior, R, p) ** 2).sum(axis=1)
    return np.asarray((np.minimum(chi2, search.limit).sum(axis=1) + known) / 2)


def _distinct(R: Array, p: Array, cost: Array, search: Search) -> Ints:
    """Rows sorted by cost, without poses equal to a better one."""
    flat = R.reshape(-1, 9)
    turned = search.least_trace > flat @ flat.T
    apart = turned | (((p[:, None] - p) ** 2).sum(axis=2) > search.same_place_m**2)
    kept: list[int] = []
    for k in np.argsort(cost, kind="stable").tolist():
        if apart[k, kept].all():
            kept.append(k)
    return np.array(kept, dtype=np.int64)


def pose_covariance(corners: Corners, prior: tuple[float, ...], R: Array, p: Array, used: Flags) -> Array:
    """(6,6) covariance of the pose R (3,3), p (3,), from the used observations (S,).

    A landmark seen head-on determines its tilt poorly, and linearization at an inaccurate estimate makes the
    covariance too small.  The covariance is therefore averaged over the pose and two poses one standard deviation
    away along the least known direction.

    Raises:
        ValueError: a shape differs.
        numpy.linalg.LinAlgError: the pose is not determined.
    """
    R, p = contiguous(R, (3, 3)), contiguous(p, (3,))
    used = contiguous(used, (len(corners),), np.bool_)
    kernels = _kernels()
    covariance = np.empty((6, 6))
    if kernels is None or kernels[1](
        corners.struct, _prior(prior), address(R), address(p), address(used), address(covariance)
    ):
        return pose_covariance_numpy(corners, prior, R, p, used)
    return covariance


def pose_covariance_numpy(corners: Corners, prior: tuple[float, ...], R: Array, p: Array, used: Flags) -> Array:
    """Definition of :func:`pose_covariance`."""
    here = np.linalg.inv(pose_equations_numpy(corners, prior, R[None], p[None], used[None])[0][0])
    values, vectors = np.linalg.eigh(here)
    step = np.array([[-1.0], [1.0]]) * np.sqrt(max(values[-1], 0.0)) * vectors[:, -1]
    around = turns(step[:, 3:]) @ R, p + step[:, :3]
    there = np.linalg.inv(pose_equations_numpy(corners, prior, *around, np.repeat(used[None], 2, axis=0))[0])
    return np.asarray((here + there[0] + there[1]) / 3)


@lru_cache(maxsize=1)
def _kernels() -> tuple[Any, Any] | None:
    corners, pointer, search = ctypes.POINTER(_CornersStruct), ctypes.c_void_p, ctypes.POINTER(_SearchStruct)
    find = function("lmkit_search_poses", corners, pointer, search, *[pointer] * 11, ctypes.POINTER(ctypes.c_int64))
    covariance = function("lmkit_pose_covariance", corners, *[pointer] * 5)
    return None if find is None else (find, covariance)
