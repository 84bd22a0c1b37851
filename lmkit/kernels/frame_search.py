"""Poses that the corners of landmarks allow, of many frames in one call (pose_search.py has the search of one)."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.load import addresses, contiguous, function
from lmkit.kernels.pose_search import Search, _SearchStruct, pose_covariance_numpy, search_poses_numpy
from lmkit.kernels.reprojection import NO_PRIOR, Corners, _CornersStruct

Array = NDArray[np.floating[Any]]
Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class FoundPoses:
    """The likeliest poses of F frames with S observations in all, at most K of each.

    Attributes:
        count: (F,) different poses that the search found, which can be more than K.
        R, p: (F,K,3,3), (F,K,3) the likeliest first; NaN beyond the count.
        cost: (F,K) negative log likelihoods; infinite beyond the count.
        chi2: (S,) of every observation at the likeliest pose of its frame; infinite without a pose.
        covariance: (F,6,6) of the likeliest pose from the observations below the limit of the search; NaN if they do
            not determine it.
    """

    count: Ints
    R: Array
    p: Array
    cost: Array
    chi2: Array
    covariance: Array

    @classmethod
    def none(cls, frames: int, most: int, observations: int) -> FoundPoses:
        """Without any pose."""
        return cls(
            np.zeros(frames, dtype=np.int64),
            np.full((frames, most, 3, 3), np.nan),
            np.full((frames, most, 3), np.nan),
            np.full((frames, most), np.inf),
            np.full(observations, np.inf),
            np.full((frames, 6, 6), np.nan),
        )


def search_frames(
    corners: Corners, starts: Ints, of: Ints, side_px: Array, search: Search, most: int = 4
) -> FoundPoses:
    """Search the poses of every frame; see :func:`lmkit.kernels.pose_search.search_poses`.

    Args:
        corners: S observations of certain landmarks, frame after frame.
        starts: (F+1,) first observation of every frame, and S.
        of: (S,) landmark of each observation.
        side_px: (S,) sides in the image.
        most: number of poses to return of each frame.

    Raises:
        ValueError: a shape differs, starts are not in order, or a landmark is uncertain.
    """
    S = len(corners)
    of, side_px = contiguous(of, (S,), np.int64), contiguous(side_px, (S,))
    starts = contiguous(starts, (-1,), np.int64)
    counts = np.diff(starts)
    if len(starts) == 0 or starts[0] != 0 or starts[-1] != S or (counts < 0).any():
        raise ValueError(f"starts of frames that do not divide {S} observations")
    if corners.roots is not None:
        raise ValueError("landmarks are uncertain")
    found = FoundPoses.none(len(counts), most, S)
    kernel = _kernel()
    if kernel is None:
        return search_frames_numpy(corners, starts, of, side_px, search, most)
    largest = int(counts.max(initial=0))
    numbers = np.empty(2 * largest * (13 + 2 * largest))
    flags, slots = np.empty(4 * largest**2, dtype=np.bool_), np.empty(4 * largest, dtype=np.int64)
    kernel(
        corners.struct, search.struct, len(counts), *addresses(starts, of, side_px), most,
        *addresses(numbers, flags, slots, found.R, found.p, found.cost, found.chi2, found.covariance, found.count),
    )  # fmt: skip
    return found


def search_frames_numpy(
    corners: Corners, starts: Ints, of: Ints, side_px: Array, search: Search, most: int = 4
) -> FoundPoses:
    """Definition of :func:`search_frames`."""
    found = FoundPoses.none(len(starts) - 1, most, len(corners))
    for f, (first, end) in enumerate(zip(starts[:-1].tolist(), starts[1:].tolist(), strict=True)):
        rows = slice(first, end)
        own = Corners(*(getattr(corners, name)[rows] for name in _OWN))
        R, p, chi2, cost = search_poses_numpy(own, of[rows], side_px[rows], NO_PRIOR, search)
        found.count[f], kept = len(R), min(len(R), most)
        if not kept:
            continue
        found.R[f, :kept], found.p[f, :kept], found.cost[f, :kept] = R[:kept], p[:kept], cost[:kept]
        found.chi2[rows] = chi2[0]
        used = chi2[0] < search.limit
        if used.any():
            found.covariance[f] = pose_covariance_numpy(own, NO_PRIOR, R[0], p[0], used)
    return found


_OWN = ("points", "rays", "by_ray", "whitener", "R_camera", "t_camera")


@lru_cache(maxsize=1)
def _kernel() -> Any:
    count, pointer = ctypes.c_int64, ctypes.c_void_p
    corners, search = ctypes.POINTER(_CornersStruct), ctypes.POINTER(_SearchStruct)
    return function("lmkit_search_frames", corners, search, count, *[pointer] * 3, count, *[pointer] * 9)
