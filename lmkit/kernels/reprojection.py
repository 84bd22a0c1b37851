"""Whitened reprojection errors of landmark corners for many poses: chi2, normal equations, Levenberg-Marquardt.

Corners are compared as rays x/z, y/z without distortion; ``whitener`` contains the lens and the corners' covariance.
A pose is T_map_rig: R (3,3) and p (3,), changed by a shift and a rotation about the map's axes (6 numbers, m and
rad).
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.load import address, addresses, contiguous, function

Array = NDArray[np.floating[Any]]
Flags = NDArray[np.bool_]

NEAREST_M = 0.02  # nearer corners, or corners behind the camera, are not visible
NOWHERE = 1e2  # error as x/z of a landmark that is not visible
NO_PRIOR = (float("nan"),) * 8


# Shapes of the arrays of `Corners`, after the number of observations.
SHAPES = (
    ("points", (4, 3)), ("rays", (4, 2)), ("by_ray", (4, 2, 2)), ("whitener", (8, 8)), ("R_camera", (3, 3)),
    ("t_camera", (3,)),
)  # fmt: skip
UNCERTAIN = (("arms", (4, 3)), ("roots", (6, 6)))


class _CornersStruct(ctypes.Structure):
    _fields_ = (
        ("count", ctypes.c_int64),
        *((name, ctypes.c_void_p) for name in ("points", "arms", "R_camera", "t_camera", "rays", "by_ray")),
        *((name, ctypes.c_void_p) for name in ("whitener", "roots", "group", "order")),
        ("nearest", ctypes.c_double),
        ("nowhere", ctypes.c_double),
    )


@dataclass(frozen=True, eq=False)
class Corners:
    """S observed landmarks, independent of the pose.

    Attributes:
        points: (S,4,3) corners in the map, meters.
        rays: (S,4,2) observed corners as x/z, y/z in the camera that saw them.
        by_ray: (S,4,2,2) derivatives of pixels with rays.
        whitener: (S,8,8) from errors of rays to standard deviations.
        R_camera, t_camera: (S,3,3), (S,3): x_camera = R_camera x_rig + t_camera.
        arms: (S,4,3) from the landmark's center to its corners, in the map; needed with ``roots`` only.
        roots: (S,6,6) roots of the landmarks' covariances (shift, turn), or None where all are certain.
        group: (S,) observations of one uncertain landmark share a number; -1 where it is certain.
    """

    points: Array
    rays: Array
    by_ray: Array
    whitener: Array
    R_camera: Array
    t_camera: Array
    arms: Array | None = None
    roots: Array | None = None
    group: NDArray[np.int64] | None = None
    order: NDArray[np.int64] = field(init=False)
    struct: _CornersStruct = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Make the arrays contiguous.

        Raises:
            ValueError: a shape differs, or roots without arms and groups.
        """
        # Set together: single attributes of a frozen class take three times as long.
        count, own = len(self.points), self.__dict__
        if self.roots is not None and (self.arms is None or self.group is None):
            raise ValueError("roots need arms and groups")
        for name, shape in SHAPES if self.roots is None else SHAPES + UNCERTAIN:
            own[name] = contiguous(own[name], (count, *shape))
        if self.group is None:
            own["group"], own["order"] = _ungrouped(count)
        else:
            own["group"] = contiguous(self.group, (count,), np.int64)
            own["order"] = np.argsort(own["group"], kind="stable")
        arms = None if self.roots is None else self.arms
        first = addresses(self.points, arms, self.R_camera, self.t_camera, self.rays, self.by_ray, self.whitener)
        last = addresses(self.roots, own["group"], own["order"])
        own["struct"] = _CornersStruct(count, *first, *last, NEAREST_M, NOWHERE)

    def __len__(self) -> int:
        return len(self.points)


def corner_chi2(corners: Corners, R: Array, p: Array) -> tuple[Array, Array]:
    """(H,S) squared error of each single observation, in standard deviations, summed over its eight coordinates;
    and (H,S) summed squares of its pixel errors.

    A landmark with a corner behind its camera has huge errors.  R is (H,3,3), p (H,3).

    Raises:
        ValueError: a shape differs.
    """
    R, p = _poses(R, p)
    kernels = _kernels()
    if kernels is None:
        return corner_chi2_numpy(corners, R, p)
    chi2, pixels = np.empty((2, len(R), len(corners)))
    kernels[0](corners.struct, len(R), address(R), address(p), address(chi2), address(pixels))
    return chi2, pixels


def corner_chi2_numpy(corners: Corners, R: Array, p: Array) -> tuple[Array, Array]:
    """Definition of :func:`corner_chi2`."""
    errors, r, _, K = _errors(corners, R, p)
    squared = (r**2).sum(axis=2)
    if K is not None:
        # Woodbury: (1 + K K')^-1 = 1 - K (1 + K'K)^-1 K', with K K' from the landmark's error.
        pull = np.einsum("hsik,hsi->hsk", K, r)
        inner = np.eye(6) + K.transpose(0, 1, 3, 2) @ K
        squared = squared - (pull * np.linalg.solve(inner, pull[..., None])[..., 0]).sum(axis=2)
    pixels = (corners.by_ray @ errors.reshape(*errors.shape[:2], 4, 2, 1))[..., 0]
    return squared, (pixels**2).sum(axis=(2, 3))


def pose_equations(
    corners: Corners, prior: tuple[float, ...], R: Array, p: Array, used: Flags
) -> tuple[Array, Array, Array]:
    """Normal matrices (H,6,6), gradients (H,6) and squared errors (H,) of the used observations (H,S) and the prior.

    Args:
        prior: heading (rad, of the rig's z axis in the map's plane) and its sigma, height and its sigma, the map's
            down in the rig (3), and the sigma (rad) of its tilt; NaN if unknown.

    Raises:
        ValueError: a shape differs.
    """
    R, p = _poses(R, p)
    used = contiguous(used, (len(R), len(corners)), np.bool_)
    kernels = _kernels()
    if kernels is None:
        return pose_equations_numpy(corners, prior, R, p, used)
    count = len(R)
    normal, gradient, squared = np.empty((count, 6, 6)), np.empty((count, 6)), np.empty(count)
    kernels[1](
        corners.struct, _prior(prior), count, address(R), address(p), address(used), address(normal),
        address(gradient), address(squared),
    )  # fmt: skip
    return normal, gradient, squared


def pose_equations_numpy(
    corners: Corners, prior: tuple[float, ...], R: Array, p: Array, used: Flags
) -> tuple[Array, Array, Array]:
    """Definition of :func:`pose_equations`."""
    _, r, J, K = _errors(corners, R, p)
    count = len(R)
    r, J = np.where(used[:, :, None], r, 0.0), np.where(used[:, :, None, None], J, 0.0)
    flat, rows = J.reshape(count, 8 * len(corners), 6), r.reshape(count, 8 * len(corners))
    normal, gradient = flat.transpose(0, 2, 1) @ flat, (flat.transpose(0, 2, 1) @ rows[:, :, None])[:, :, 0]
    squared = (rows**2).sum(axis=1)
    groups = np.asarray(corners.group)
    for number in np.unique(groups[groups >= 0]) if K is not None else ():
        # The landmark's own error is eliminated: all of its observations share it.
        group = np.flatnonzero(groups == number)
        assert K is not None
        size = 8 * len(group)
        own = np.where(used[:, group, None, None], K[:, group], 0.0).reshape(count, size, 6)
        Kt = own.transpose(0, 2, 1)
        across, pull = Kt @ J[:, group].reshape(count, size, 6), Kt @ r[:, group].reshape(count, size, 1)
        inner = np.eye(6) + Kt @ Kt.transpose(0, 2, 1)
        share = np.linalg.solve(inner, np.concatenate([across, pull], axis=2))
        normal = normal - across.transpose(0, 2, 1) @ share[:, :, :6]
        gradient = gradient - (across.transpose(0, 2, 1) @ share[:, :, 6:])[:, :, 0]
        squared = squared - (pull * share[:, :, 6:]).sum(axis=(1, 2))
    known, by_pose = prior_residuals(prior, R, p), prior_jacobian(prior, R, p)
    normal = normal + by_pose.transpose(0, 2, 1) @ by_pose
    gradient = gradient + (by_pose.transpose(0, 2, 1) @ known[:, :, None])[:, :, 0]
    return normal, gradient, squared + (known**2).sum(axis=1)


def refine_poses(
    corners: Corners,
    prior: tuple[float, ...],
    R: Array,
    p: Array,
    used: Flags,
    iterations: int,
    converged: float,
    most_damping: float,
) -> tuple[Array, Array]:
    """Levenberg-Marquardt on the used observations (H,S) and the prior, every pose separately: R (H,3,3), p (H,3).

    A pose is finished when the predicted decrease of the squared error is below ``converged``, or when its damping
    exceeds ``most_damping``.

    Raises:
        ValueError: a shape differs.
    """
    R, p = _poses(R, p)
    used = contiguous(used, (len(R), len(corners)), np.bool_)
    kernels = _kernels()
    if kernels is None:
        return refine_poses_numpy(corners, prior, R, p, used, iterations, converged, most_damping)
    R, p = R.copy(), p.copy()
    kernels[2](
        corners.struct, _prior(prior), len(R), address(used), iterations, converged, most_damping, address(R),
        address(p),
    )  # fmt: skip
    return R, p


def refine_poses_numpy(
    corners: Corners,
    prior: tuple[float, ...],
    R: Array,
    p: Array,
    used: Flags,
    iterations: int,
    converged: float,
    most_damping: float,
) -> tuple[Array, Array]:
    """Definition of :func:`refine_poses`."""
    R, p = R.copy(), p.copy()
    damping, running = np.full(len(R), 1e-6), np.ones(len(R), dtype=bool)
    normal, gradient, squared = pose_equations_numpy(corners, prior, R, p, used)
    for _ in range(iterations):
        if not running.any():
            break
        damped = normal + np.eye(6) * (damping[:, None, None] * normal + 1e-9)
        step = np.asarray(np.linalg.solve(damped, gradient[:, :, None])[:, :, 0])
        R_there, p_there = turns(step[:, 3:]) @ R, p + step[:, :3]
        # Predicted gain of the step, before it is tried.
        small = (step * gradient).sum(axis=1) < converged
        there = pose_equations_numpy(corners, prior, R_there, p_there, used)
        better = running & (small | (there[2] < squared))
        R, p = np.where(better[:, None, None], R_there, R), np.where(better[:, None], p_there, p)
        normal = np.where(better[:, None, None], there[0], normal)
        gradient = np.where(better[:, None], there[1], gradient)
        squared = np.where(better, there[2], squared)
        damping = np.where(better, np.maximum(damping / 10, 1e-9), damping * 300)
        running &= ~small & (damping <= most_damping)
    return R, p


def prior_residuals(prior: tuple[float, ...], R: Array, p: Array) -> Array:
    """(H,K) known minus actual, in standard deviations; ``prior`` as in :func:`pose_equations`."""
    heading, heading_sigma, height, height_sigma, *down, tilt_sigma = prior
    columns: list[Array] = []
    if not np.isnan(heading):
        off = heading - np.arctan2(R[:, 1, 2], R[:, 0, 2])
        columns.append(np.arctan2(np.sin(off), np.cos(off)) / heading_sigma)
    if not np.isnan(height):
        columns.append((height - p[:, 2]) / height_sigma)
    if not np.isnan(down[0]):
        # The rig's down direction in the map by this pose: its x and y are the tilt.
        leaning = R @ np.array(down)
        columns += [-leaning[:, 0] / tilt_sigma, -leaning[:, 1] / tilt_sigma]
        # Upside down, x and y would also be zero.
        columns.append(np.where(leaning[:, 2] > 0, np.pi / tilt_sigma, 0.0))
    return np.column_stack(columns) if columns else np.zeros((len(R), 0))


def prior_jacobian(prior: tuple[float, ...], R: Array, p: Array) -> Array:
    """(H,K,6) derivatives of the actual values by a shift and a rotation in the map, in standard deviations."""
    heading, heading_sigma, height, height_sigma, *down, tilt_sigma = prior
    zero, columns = np.zeros(len(R)), []
    if not np.isnan(heading):
        a, b, c = R[:, 0, 2], R[:, 1, 2], R[:, 2, 2]
        flat = np.maximum(a**2 + b**2, 1e-12)
        columns.append(np.stack([zero, zero, zero, -c * a / flat, -c * b / flat, zero + 1], axis=1) / heading_sigma)
    if not np.isnan(height):
        columns.append(np.stack([zero, zero, zero + 1, zero, zero, zero], axis=1) / height_sigma)
    if not np.isnan(down[0]):
        x, y, z = (R @ np.array(down)).T
        columns.append(np.stack([zero, zero, zero, zero, z, -y], axis=1) / tilt_sigma)
        columns.append(np.stack([zero, zero, zero, -z, zero, x], axis=1) / tilt_sigma)
        columns.append(np.zeros((len(R), 6)))
    return np.stack(columns, axis=1) if columns else np.zeros((len(R), 0, 6))


def turns(vectors: NDArray[Any]) -> Array:
    """(H,3,3) rotation matrices of (H,3) rotation vectors (Rodrigues)."""
    angle = np.sqrt((vectors**2).sum(axis=1))[:, None, None]
    x, y, z = vectors.T
    zero = np.zeros(len(vectors))
    W = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    small = angle < 1e-8
    safe = np.where(small, 1.0, angle)
    a, b = np.where(small, 1.0, np.sin(safe) / safe), np.where(small, 0.5, (1 - np.cos(safe)) / safe**2)
    return np.asarray(np.eye(3) + a * W + b * (W @ W))


def _errors(corners: Corners, R: Array, p: Array) -> tuple[Array, Array, Array, Array | None]:
    """Errors of H poses: of rays (H,S,8), whitened ones, and their derivatives (H,S,8,6) with the pose and with the
    standardized error of the landmark (None where all are certain)."""
    offset = corners.points - p[:, None, None]
    R_camera_map = corners.R_camera @ R.transpose(0, 2, 1)[:, None]
    seen = offset @ R_camera_map.swapaxes(-1, -2) + corners.t_camera[:, None]
    depth = np.maximum(seen[..., 2:], NEAREST_M)
    expected = seen[..., :2] / depth
    errors = (corners.rays - expected).reshape(len(R), len(corners), 8)
    errors[(seen[..., 2] < NEAREST_M).any(axis=-1)] = NOWHERE
    residuals = (corners.whitener @ errors[..., None])[..., 0]
    across, along = R_camera_map[..., None, :2, :], R_camera_map[..., None, 2:, :]
    by_point = (across - expected[..., None] * along) / depth[..., None]  # (H,S,4,2,3)
    J = corners.whitener @ _eight(-by_point, np.cross(by_point, offset[..., None, :]))
    K = None
    if corners.roots is not None:
        assert corners.arms is not None
        roots = corners.roots * (np.asarray(corners.group) >= 0)[:, None, None]
        K = corners.whitener @ _eight(by_point, -np.cross(by_point, corners.arms[..., None, :])) @ roots
    return errors, residuals, J, K


def _eight(by_shift: Array, by_turn: Array) -> Array:
    J = np.concatenate([by_shift, by_turn], axis=-1)
    return J.reshape(*J.shape[:-3], 8, 6)


def _poses(R: Array, p: Array) -> tuple[Array, Array]:
    R = contiguous(R, (-1, 3, 3))
    return R, contiguous(p, (len(R), 3))


@lru_cache(maxsize=64)
def _ungrouped(count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Groups and order of observations of certain landmarks."""
    return np.full(count, -1), np.arange(count)


@lru_cache(maxsize=8)
def _prior(prior: tuple[float, ...]) -> Any:
    return (ctypes.c_double * 8)(*prior)


@lru_cache(maxsize=1)
def _kernels() -> tuple[Any, Any, Any] | None:
    corners, pointer, count, number = ctypes.POINTER(_CornersStruct), ctypes.c_void_p, ctypes.c_int64, ctypes.c_double
    chi2 = function("lmkit_corner_chi2", corners, count, *[pointer] * 4)
    equations = function("lmkit_pose_equations", corners, pointer, count, *[pointer] * 6)
    refine = function("lmkit_refine_poses", corners, pointer, count, pointer, count, number, number, pointer, pointer)
    return None if chi2 is None else (chi2, equations, refine)
