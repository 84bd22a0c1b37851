"""Errors common to several images in an update of a filter's state: effect on the state, and propagation.

`tracking/lasting_errors.py` derives the formulas.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.load import addresses, contiguous, function
from lmkit.kernels.reprojection import Corners, _CornersStruct, _errors

Array = NDArray[np.floating[Any]]
Flags = NDArray[np.bool_]
Ints = NDArray[np.int64]

MOST = 12  # states


@dataclass(frozen=True, eq=False)
class Shared:
    """Record of the errors common to images, for N states.

    Attributes:
        excess: (N,N) to be added to the covariance of the states.
        places: (L,N,6) covariances of the states with the errors of landmarks' places, in standard deviations.
        pixels: (C,4,2) px, corners of the observations of the last image.
        corners: (C,N,16) covariances of the states with the errors of those corners, in standard deviations: eight of
            the detector, eight of the lens.
    """

    excess: Array
    places: Array
    pixels: Array
    corners: Array


@dataclass(frozen=True, eq=False)
class Image:
    """An image, and the earlier images that share errors with its observations.

    Attributes:
        numbers: (S,) which of the L places each observation's landmark has; -1 where it is certain.
        rows: (S,) which observation of the last image was of the same landmark by the same camera; -1 for none.
        pixels: (S,4,2) px, its corners.
        lens_shares: (S,) share of the corners' variance that is of the lens.
        places: number of places known by now.
    """

    numbers: Ints
    rows: Ints
    pixels: Array
    lens_shares: Array
    places: int


def lasting_errors(
    corners: Corners,
    R: Array,
    p: Array,
    used: Flags,
    left: Array,
    by_pull: Array,
    image: Image,
    per_px: tuple[float, float],
    before: Shared,
) -> Shared:
    """The record after an update of N states with an image.

    Args:
        R, p: (3,3), (3,) the pose T_map_rig after the update.
        used: (S,) the observations that count.
        left: (N,N) share of the error before that is left.
        by_pull: (N,6) derivatives of the states with pulls on the pose.
        per_px: logarithm of the remaining share of the detector's and of the lens's errors per pixel of corner
            motion.

    Returns:
        As many corners as observations, all zero where they are not used.

    Raises:
        ValueError: a shape differs, a number is out of range, or more than 12 states.
        numpy.linalg.LinAlgError: a value is not a number.
    """
    S, N = len(corners), len(left)
    if N > MOST:
        raise ValueError(f"{N} states, expected up to {MOST}")
    kernel = _kernel()
    if kernel is None:
        return lasting_errors_numpy(corners, R, p, used, left, by_pull, image, per_px, before)
    known, last = len(before.places), len(before.pixels)
    if S and (image.numbers.max() >= image.places or image.rows.max() >= last or known > image.places):
        raise ValueError(f"numbers beyond {image.places} places, or rows beyond {last}")
    inputs = (
        contiguous(R, (3, 3)), contiguous(p, (3,)), contiguous(used, (S,), np.bool_), contiguous(left, (N, N)),
        contiguous(by_pull, (N, 6)), contiguous(image.numbers, (S,), np.int64),
        contiguous(image.rows, (S,), np.int64), contiguous(image.pixels, (S, 4, 2)),
        contiguous(image.lens_shares, (S,)), contiguous(before.excess, (N, N)),
        contiguous(before.places, (known, N, 6)), contiguous(before.pixels, (last, 4, 2)),
        contiguous(before.corners, (last, N, 16)),
    )  # fmt: skip
    outputs, scratch = (np.empty((N, N)), np.empty((image.places, N, 6)), np.empty((S, N, 16))), np.empty((S, 84))
    at = addresses(*inputs, *outputs, scratch)
    if kernel(corners.struct, *at[:3], N, *at[3:9], (ctypes.c_double * 2)(*per_px), known, *at[9:13], image.places,
              *at[13:]):  # fmt: skip
        raise np.linalg.LinAlgError("the errors of a landmark are not numbers")
    return Shared(outputs[0], outputs[1], inputs[7], outputs[2])


def lasting_errors_numpy(
    corners: Corners,
    R: Array,
    p: Array,
    used: Flags,
    left: Array,
    by_pull: Array,
    image: Image,
    per_px: tuple[float, float],
    before: Shared,
) -> Shared:
    """Definition of :func:`lasting_errors`."""
    N = len(left)
    pulls, own = error_pulls(corners, R, p, used)
    excess = left @ before.excess @ left.T
    places = np.zeros((image.places, N, 6))
    places[: len(before.places)] = left @ before.places
    # The position of a landmark counts once for all cameras.
    counted = np.flatnonzero(used & (image.numbers >= 0))
    numbers, first = np.unique(image.numbers[counted], return_index=True)
    D = by_pull @ pulls[counted[first]]
    excess += _in_common(places[numbers], D)
    places[numbers] += D
    lens = np.sqrt(image.lens_shares)[:, None, None]
    moved = by_pull @ own
    new = np.concatenate([np.sqrt(1 - lens**2) * moved, lens * moved], axis=2)
    again = np.flatnonzero(used & (image.rows >= 0))
    steps = image.pixels[again] - before.pixels[image.rows[again]]
    way = np.sqrt((steps * steps).sum(axis=(1, 2)) / 4)
    alike = np.exp(way[:, None] * np.array(per_px)).repeat(8, axis=1)
    X = alike[:, None] * (left @ before.corners[image.rows[again]])
    excess += _in_common(X, new[again])
    new[again] += X
    return Shared(excess, places, image.pixels, new)


def _in_common(X: Array, D: Array) -> Array:
    """(N,N) sum of X D' + D X': cross covariances X (K,N,E) of states and errors, effects D (K,N,E) of errors."""
    shared = np.einsum("kie,kje->ij", X, D)
    return np.asarray(shared + shared.T)


def error_pulls(corners: Corners, R: Array, p: Array, used: Flags) -> tuple[Array, Array]:
    """Effect of errors on a pose R (3,3), p (3,): H'W times their effect on whitened corners, in standard deviations.

    H and K are the derivatives of whitened corners with the pose and with the landmark's error; W is the weight that
    corners after elimination of this error, (1 + K K')^-1, so that H'W K = H'K (1 + K'K)^-1.

    Returns:
        (S,6,6) of the error of each observation's landmark, the same for all observations of it, zero where it is
        certain; and (S,6,8) of its own eight errors.  All are zero where the observation is not used.
    """
    _, _, H, K = _errors(corners, R[None], p[None])
    own = np.where(used[:, None, None], H[0].transpose(0, 2, 1), 0.0)
    groups, pulls = np.asarray(corners.group), np.zeros((len(corners), 6, 6))
    for number in np.unique(groups[used & (groups >= 0)]).tolist() if K is not None else ():
        assert K is not None
        group = np.flatnonzero(used & (groups == number))
        by_error, by_pose = K[0, group].reshape(-1, 6), H[0, group].reshape(-1, 6)
        pulls[group] = np.linalg.solve(np.eye(6) + by_error.T @ by_error, by_error.T @ by_pose).T
        own[group] -= pulls[group] @ K[0, group].transpose(0, 2, 1)
    return pulls, own


@lru_cache(maxsize=1)
def _kernel() -> Any:
    pointer, count = ctypes.c_void_p, ctypes.c_int64
    return function(
        "lmkit_lasting_errors", ctypes.POINTER(_CornersStruct), *[pointer] * 3, count, *[pointer] * 7, count,
        *[pointer] * 4, count, *[pointer] * 4,
    )  # fmt: skip
