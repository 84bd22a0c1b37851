"""How errors of landmarks' places and of corners pull on a pose that is fitted to those corners."""

from __future__ import annotations

import ctypes
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.load import addresses, contiguous, function
from lmkit.kernels.reprojection import Corners, _CornersStruct, _errors

Array = NDArray[np.floating[Any]]
Flags = NDArray[np.bool_]


def error_pulls(corners: Corners, R: Array, p: Array, used: Flags) -> tuple[Array, Array]:
    """Pulls of errors on a pose R (3,3), p (3,): H'W by what they do to the whitened corners, in standard deviations.

    H and K are the derivatives of whitened corners with the pose and with the landmark's error; W is the weight that
    corners keep once that error is eliminated, (1 + K K')^-1, so that H'W K = H'K (1 + K'K)^-1.

    Args:
        used: (S,) the observations that count.

    Returns:
        (S,6,6) of the error of each observation's landmark, the same for all observations of it, zero where it is
        certain; and (S,6,8) of its own eight errors.  All are zero where the observation is not used.

    Raises:
        ValueError: a shape differs.
        numpy.linalg.LinAlgError: something is not a number.
    """
    S = len(corners)
    R, p, used = contiguous(R, (3, 3)), contiguous(p, (3,)), contiguous(used, (S,), np.bool_)
    kernel = _kernel()
    if kernel is None:
        return error_pulls_numpy(corners, R, p, used)
    pulls, own = np.empty((S, 6, 6)), np.empty((S, 6, 8))
    if kernel(corners.struct, *addresses(R, p, used, pulls, own)):
        raise np.linalg.LinAlgError("the errors of a landmark are not numbers")
    return pulls, own


def error_pulls_numpy(corners: Corners, R: Array, p: Array, used: Flags) -> tuple[Array, Array]:
    """Definition of :func:`error_pulls`."""
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
    return function("lmkit_error_pulls", ctypes.POINTER(_CornersStruct), *[ctypes.c_void_p] * 5)
