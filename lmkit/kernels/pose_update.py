"""Update of a filter's state with the corners of landmarks, as Gauss-Newton (Bell and Cathey 1993).

The prediction of the state and the observations are fitted together; the worst landmark is dropped, one after
another, until the remaining ones fit.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.load import addresses, contiguous, function
from lmkit.kernels.reprojection import (
    NO_PRIOR,
    Corners,
    _CornersStruct,
    corner_chi2_numpy,
    pose_equations_numpy,
    turns,
)

Array = NDArray[np.floating[Any]]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]

LEAN = 3  # additional unknowns of a robot on a floor: height, roll, pitch
MOST = 12  # largest number of unknowns, including these


class _UpdateStruct(ctypes.Structure):
    _fields_ = (("converged", ctypes.c_double), ("limit", ctypes.c_double), ("iterations", ctypes.c_int64))


@dataclass(frozen=True)
class Update:
    """Settings of an update.

    Attributes:
        converged: the last step has a smaller square, in standard deviations.
        limit: chi2 of an observation's eight coordinates beyond which it does not fit.
        iterations: largest number of iterations.
    """

    converged: float
    limit: float
    iterations: int
    struct: _UpdateStruct = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "struct", _UpdateStruct(self.converged, self.limit, self.iterations))


class Updated(NamedTuple):
    """N states after an update.

    Attributes:
        used: (S,) the observations that fit, both cameras' of a landmark together.
        state: (N,) on a floor; empty in space.
        R, p: (3,3), (3,) the pose T_map_rig.
        covariance: (N,N) of the states.
        left: (N,N) share of the error before that is left.
        by_pull: (N,6) derivatives of the states with pulls on the pose.
        cost: chi2 of corners and prediction together.
    """

    used: Flags
    state: Array
    R: Array
    p: Array
    covariance: Array
    left: Array
    by_pull: Array
    cost: float


def update_space(corners: Corners, of: Ints, before: Array, R: Array, p: Array, update: Update) -> Updated:
    """Update of the pose T_map_rig; its six states are a shift and a rotation about the map's axes.

    Args:
        of: (S,) which landmark each observation is of.
        before: (6,6) covariance of the pose R (3,3), p (3,) foretold.

    Raises:
        ValueError: a shape differs.
        numpy.linalg.LinAlgError: something is not determined at all, or ``before`` is no covariance.
    """
    S = len(corners)
    of, before = contiguous(of, (S,), np.int64), contiguous(before, (6, 6))
    R, p = contiguous(R, (3, 3)).copy(), contiguous(p, (3,)).copy()
    kernels = _kernels()
    if kernels is None:
        return update_space_numpy(corners, of, before, R, p, update)
    used, covariance, left, numbers = np.ones(S, np.bool_), np.empty((6, 6)), np.empty((6, 6)), np.empty((2, S))
    cost = ctypes.c_double()
    at = addresses(of, before, used, R, p, covariance, left, *numbers)
    if kernels[0](corners.struct, update.struct, *at[:7], cost, *at[7:]):
        raise np.linalg.LinAlgError("the pose is not determined")
    return Updated(used, np.empty(0), R, p, covariance, left, covariance, cost.value)


def update_space_numpy(corners: Corners, of: Ints, before: Array, R: Array, p: Array, update: Update) -> Updated:
    """Definition of :func:`update_space`."""
    known = _information(before)

    def fit(used: Flags) -> tuple[Array, Array, Array, Array]:
        there, at, normal = R, p, known
        for _ in range(update.iterations):
            N, g, _ = pose_equations_numpy(corners, NO_PRIOR, there[None], at[None], used[None])
            normal = N[0] + known
            step = np.linalg.solve(normal, g[0] + known @ _off(R, p, there, at))
            there, at = turns(step[None, 3:])[0] @ there, at + step[:3]
            if step @ normal @ step < update.converged:
                break
        return there, at, normal, _off(R, p, there, at)

    used, (there, at, normal, off), chi2 = _believed(corners, of, fit, lambda fitted: fitted[:2], update.limit)
    covariance = np.linalg.inv(normal)
    cost = float(chi2[used].sum() + off @ known @ off)
    return Updated(used, np.empty(0), there, at, covariance, covariance @ known, covariance, cost)


def update_planar(
    corners: Corners,
    of: Ints,
    before: Array,
    lean: Array,
    R_base: Array,
    t_base: Array,
    state: Array,
    update: Update,
) -> Updated:
    """Update of the state of a robot on a level floor: x, y, heading, and further states.

    Height, roll and pitch at this time are fitted together with the state.

    Args:
        of: (S,) which landmark each observation is of.
        before: (N,N) covariance of the state foretold (N,), N at most 9.
        lean: (3,) information of lift, roll and pitch, which are zero as far as is known.
        R_base, t_base: (3,3), (3,) of the camera on the base.

    Raises:
        ValueError: a shape differs.
        numpy.linalg.LinAlgError: something is not determined at all, or ``before`` is no covariance.
    """
    S, size = len(corners), len(state)
    if not 3 <= size <= MOST - LEAN:
        raise ValueError(f"a state of {size} numbers, expected 3 to {MOST - LEAN}")
    of, before, lean = contiguous(of, (S,), np.int64), contiguous(before, (size, size)), contiguous(lean, (LEAN,))
    R_base, t_base, state = contiguous(R_base, (3, 3)), contiguous(t_base, (3,)), contiguous(state, (size,)).copy()
    kernels = _kernels()
    if kernels is None:
        return update_planar_numpy(corners, of, before, lean, R_base, t_base, state, update)
    used, R, p, cost = np.ones(S, np.bool_), np.empty((3, 3)), np.empty(3), ctypes.c_double()
    numbers = np.empty((2, S))
    covariance, left, by_pull = np.empty((size, size)), np.empty((size, size)), np.empty((size, 6))
    inputs, outputs = (of, before, lean, R_base, t_base), (used, state, R, p, covariance, left, by_pull)
    at = addresses(*inputs, *outputs, *numbers)
    if kernels[1](corners.struct, update.struct, at[0], size, *at[1:12], cost, *at[12:]):
        raise np.linalg.LinAlgError("the state is not determined")
    return Updated(used, state, R, p, covariance, left, by_pull, cost.value)


def update_planar_numpy(
    corners: Corners,
    of: Ints,
    before: Array,
    lean: Array,
    R_base: Array,
    t_base: Array,
    state: Array,
    update: Update,
) -> Updated:
    """Definition of :func:`update_planar`."""
    size = len(state)
    start = np.append(state, np.zeros(LEAN))
    known = np.diag(np.append(np.zeros(size), lean))
    known[:size, :size] = _information(before)

    def fit(used: Flags) -> tuple[Array, Array]:
        there, normal = start, known
        for _ in range(update.iterations):
            R, p = _camera_at(there, R_base, t_base)
            N, g, _ = pose_equations_numpy(corners, NO_PRIOR, R[None], p[None], used[None])
            J = _camera_by_state(there, t_base)
            normal = known + J.T @ N[0] @ J
            step = np.linalg.solve(normal, known @ (start - there) + J.T @ g[0])
            there = there + step
            if step @ normal @ step < update.converged:
                break
        return there, normal

    used, (there, normal), chi2 = _believed(
        corners, of, fit, lambda fitted: _camera_at(fitted[0], R_base, t_base), update.limit
    )
    off = there - start
    R, p = _camera_at(there, R_base, t_base)
    # The block of the inverse is the covariance of the state, with the lean marginalized.
    inverse = np.linalg.inv(normal)[:size]
    by_pull = inverse @ _camera_by_state(there, t_base).T
    cost = float(chi2[used].sum() + off @ known @ off)
    return Updated(used, there[:size], R, p, inverse[:, :size], inverse @ known[:, :size], by_pull, cost)


def _information(covariance: Array) -> Array:
    """The inverse of a covariance.

    Raises:
        numpy.linalg.LinAlgError: it is not positive definite.
    """
    np.linalg.cholesky(covariance)
    return np.linalg.inv(covariance)


def _believed(
    corners: Corners,
    of: Ints,
    fit: Callable[[Flags], Any],
    pose_of: Callable[[Any], tuple[Array, Array]],
    limit: float,
) -> tuple[Flags, Any, Array]:
    """The observations that fit together (S,), their fit, and the chi2 (S,) of all."""
    used = np.ones(len(corners), dtype=bool)
    while True:
        fitted = fit(used)
        R, p = pose_of(fitted)
        chi2 = corner_chi2_numpy(corners, R[None], p[None])[0][0]
        if not used.any() or chi2[used].max() < limit:
            return used, fitted, chi2
        worst = int(np.argmax(np.where(used, chi2, -1.0)))
        # All cameras' observations of a landmark are used or dropped together.
        used = used & (of != of[worst])


def _off(R_to: Array, p_to: Array, R: Array, p: Array) -> Array:
    """(6,) from a pose to another one."""
    turned = R_to @ R.T
    w = np.array([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]]) / 2
    s, c = np.sqrt(w @ w), (np.trace(turned) - 1) / 2
    return np.concatenate([p_to - p, w * (np.arctan2(s, c) / s if s > 1e-10 else 1.0)])


def _heading(state: Array) -> Array:
    c, s = math.cos(state[2]), math.sin(state[2])
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _camera_at(state: Array, R_base: Array, t_base: Array) -> tuple[Array, Array]:
    """T_map_camera for a state."""
    lift, x, y = state[-LEAN:].tolist()
    angle = math.hypot(x, y)
    a, b = (1.0, 0.5) if angle < 1e-8 else (math.sin(angle) / angle, (1 - math.cos(angle)) / angle**2)
    lean = np.array([[1 - b * y * y, b * x * y, a * y], [b * x * y, 1 - b * x * x, -a * x], [-a * y, a * x, 0.0]])
    lean[2, 2] = 1 - b * angle**2
    turn = lean @ _heading(state)
    return turn @ R_base, np.array([state[0], state[1], lift]) + turn @ t_base


def _camera_by_state(state: Array, t_base: Array) -> Array:
    """(6,N) derivatives of the camera's pose with the state."""
    x, y, z = (_heading(state) @ t_base).tolist()
    J = np.zeros((6, len(state)))
    # x, y, heading of the base.
    J[0, 0] = J[1, 1] = J[5, 2] = 1.0
    J[0, 2], J[1, 2] = -y, x
    # The robot leans about the floor, not about the camera.
    J[:, -LEAN:] = [[0, 0, z], [0, -z, 0], [1, y, -x], [0, 1, 0], [0, 0, 1], [0, 0, 0]]
    return J


@lru_cache(maxsize=1)
def _kernels() -> tuple[Any, Any] | None:
    corners, update, pointer = ctypes.POINTER(_CornersStruct), ctypes.POINTER(_UpdateStruct), ctypes.c_void_p
    number = ctypes.POINTER(ctypes.c_double)
    space = function("lmkit_update_space", corners, update, *[pointer] * 7, number, pointer, pointer)
    planar = function(
        "lmkit_update_planar", corners, update, pointer, ctypes.c_int64, *[pointer] * 11, number, pointer, pointer
    )
    return None if space is None else (space, planar)
