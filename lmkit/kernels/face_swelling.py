"""How much too large faces seem, along their width and along their height: the part of observations in the equations.

Two numbers of a recording, px, shared unknowns after the cameras' and before the landmarks'
(`mapping/face_swelling.py`): corners stand so far outside their places, in all images alike.
"""

from __future__ import annotations

import ctypes
from functools import lru_cache
from typing import Any

import numpy as np

from lmkit.kernels.landmark_bundle import Array, Bundle, BundleStruct, Sums, SumsStruct, derivatives
from lmkit.kernels.load import address, contiguous, function

SIZE = 2  # unknowns: px along the width and along the height


def outward(bundle: Bundle) -> Array:
    """(S,8,2) how the rays of corners change if they stand 1 px farther out along the face's width and height."""
    kernels = _kernels()
    if kernels is None:
        return outward_numpy(bundle)
    shifts = np.empty((len(bundle.at), 8, SIZE))
    kernels[0](bundle.struct, address(shifts))
    return shifts


def outward_numpy(bundle: Bundle) -> Array:
    """Definition of :func:`outward`."""
    a, b, c, d = (bundle.by_ray[..., i, j] for i in (0, 1) for j in (0, 1))
    x, y = bundle.rays[..., 0], bundle.rays[..., 1]
    pixels = np.stack([a * x + b * y, c * x + d * y], axis=-1)
    determinant = a * d - b * c
    shifts = np.empty((len(x), 4, 2, SIZE))
    # Corners start at the top left and run with the clock.
    for k, signs in enumerate(((-1, 1, 1, -1), (-1, -1, 1, 1))):
        way = np.tensordot(np.array(signs, dtype=float), pixels, axes=(0, 1))
        u, v = (way / np.sqrt((way**2).sum(axis=1, keepdims=True))).T[:, :, None] * np.array(signs, dtype=float)
        shifts[..., 0, k] = (d * u - b * v) / determinant
        shifts[..., 1, k] = (a * v - c * u) / determinant
    # A face without width or height has no outside.
    return np.nan_to_num(shifts.reshape(-1, 8, SIZE), posinf=0.0, neginf=0.0)


def add_swelling_equations(bundle: Bundle, weights: Array, sums: Sums) -> None:
    """Add what observations say of the swelling to ``sums``, whose last unknowns before the landmarks it is.

    Args:
        weights: (S,) of the observations; those of weight zero do not count.
        sums: of the unknowns without the swelling; they are added to in place.

    Raises:
        ValueError: a shape differs.
    """
    weights = contiguous(weights, (len(bundle.at),))
    sums.require(bundle)
    if sums.own < SIZE:
        raise ValueError(f"{sums.own} shared unknowns, expected {SIZE} of the swelling among them")
    kernels = _kernels()
    if kernels is None:
        add_swelling_equations_numpy(bundle, weights, sums)
    else:
        kernels[1](bundle.struct, address(weights), sums.struct())


def add_swelling_equations_numpy(bundle: Bundle, weights: Array, sums: Sums) -> None:
    """Definition of :func:`add_swelling_equations`."""
    first = sums.own - SIZE
    errors, by_pose, by_landmark = derivatives(bundle)
    # Those that do not count may be beyond all measure.
    G = np.where((weights > 0)[:, None, None], bundle.whitener @ outward_numpy(bundle), 0.0)
    weighed = G.transpose(0, 2, 1) * weights[:, None, None]
    by_ray = weighed @ bundle.whitener
    rows = slice(first, sums.own)
    pulls = (by_ray @ by_pose).transpose(0, 2, 1)
    np.add.at(sums.border[:, :, rows], bundle.at, pulls)
    others = np.zeros((len(sums.corner), SIZE))
    if sums.place is not None:
        on_landmarks = others[sums.own :].reshape(-1, 6, SIZE)
        np.add.at(on_landmarks, bundle.of, (by_ray @ by_landmark).transpose(0, 2, 1))
    if sums.camera is not None:
        # A camera that has moved in the rig sees what it would see had the rig moved the other way.
        turned = (bundle.R_camera[bundle.mount] @ bundle.R[bundle.at].transpose(0, 2, 1))[:, None]
        on_cameras = -(turned @ pulls.reshape(-1, 2, 3, SIZE)).reshape(-1, 6, SIZE)
        for number in range((first - sums.cameras) // 6):
            others[sums.cameras + 6 * number :][:6] += on_cameras[sums.camera == number + 1].sum(axis=0)
    sums.corner[:, rows] += others
    sums.corner[rows] += others.T
    sums.corner[rows, rows] += (weighed @ G).sum(axis=0)
    sums.shared_gradient[rows] += (by_ray @ errors[..., None]).sum(axis=0)[:, 0]


@lru_cache(maxsize=1)
def _kernels() -> tuple[Any, Any] | None:
    bundle, pointer = ctypes.POINTER(BundleStruct), ctypes.c_void_p
    shifts = function("lmkit_outward", bundle, pointer)
    equations = function("lmkit_swelling_equations", bundle, pointer, ctypes.POINTER(SumsStruct))
    return None if shifts is None else (shifts, equations)
