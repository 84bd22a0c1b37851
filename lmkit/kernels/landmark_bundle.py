"""Normal equations of rig poses and landmark poses from all observations of a recording (bundle adjustment).

Unknowns are those of a chain with a border (`optim/block_chain.py`): six numbers per rig pose, and, shared, six per
landmark; each a shift and a rotation about the map's axes.  Cameras of the rig may also be unknown: six numbers each,
a shift and a rotation in its own frame.  Observations are down-weighted by Cauchy's loss.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.load import address, addresses, contiguous, function
from lmkit.kernels.reprojection import NEAREST_M, NOWHERE

Array = NDArray[np.floating[Any]]

_ARRAYS = ("rays", "by_ray", "whitener", "R_camera", "t_camera", "R", "p", "R_landmark", "p_landmark", "arms")


_SUMS = ("diagonal", "gradient", "border", "blocks", "corner", "shared_gradient")


class BundleStruct(ctypes.Structure):
    """`Bundle` of landmark_bundle.h."""

    _fields_ = (
        ("count", ctypes.c_int64),
        *((name, ctypes.c_void_p) for name in ("at", "of", "mount", *_ARRAYS)),
        ("nearest", ctypes.c_double),
        ("nowhere", ctypes.c_double),
    )


class SumsStruct(ctypes.Structure):
    """`Sums` of landmark_bundle.h."""

    _fields_ = (
        *((name, ctypes.c_int64) for name in ("shared", "own", "cameras")),
        *((name, ctypes.c_void_p) for name in ("place", "camera", *_SUMS)),
    )


@dataclass(frozen=True, eq=False)
class Bundle:
    """S observations of L landmarks from N rig poses, and all poses.

    Attributes:
        at, of, mount: (S,) rig poses, landmarks and mounted cameras, by number.
        rays: (S,4,2) observed corners as x/z, y/z.
        by_ray: (S,4,2,2) derivatives of pixels with rays.
        whitener: (S,8,8) from errors of rays to standard deviations.
        R_camera, t_camera: (K,3,3), (K,3) of mounted cameras: x_camera = R_camera x_rig + t_camera.
        R, p: (N,3,3), (N,3) T_map_rig.
        R_landmark, p_landmark: (L,3,3), (L,3) T_map_landmark.
        arms: (L,4,3) corners in the landmark's own frame.
    """

    at: NDArray[np.int64]
    of: NDArray[np.int64]
    mount: NDArray[np.int64]
    rays: Array
    by_ray: Array
    whitener: Array
    R_camera: Array
    t_camera: Array
    R: Array
    p: Array
    R_landmark: Array
    p_landmark: Array
    arms: Array
    struct: BundleStruct = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Make the arrays contiguous.

        Raises:
            ValueError: a shape differs, or a number of a pose or landmark is out of range.
        """
        S, N, L, K = len(self.at), len(self.p), len(self.p_landmark), len(self.t_camera)
        shapes: list[tuple[int, ...]] = [(S, 4, 2), (S, 4, 2, 2), (S, 8, 8), (K, 3, 3), (K, 3)]
        shapes += [(N, 3, 3), (N, 3), (L, 3, 3), (L, 3), (L, 4, 3)]
        struct = BundleStruct(S, nearest=NEAREST_M, nowhere=NOWHERE)
        for name, count in (("at", N), ("of", L), ("mount", K)):
            numbers = contiguous(getattr(self, name), (S,), np.int64)
            if S and not 0 <= numbers.min() <= numbers.max() < count:
                raise ValueError(f"{name} has numbers outside 0..{count - 1}")
            object.__setattr__(self, name, numbers)
            setattr(struct, name, address(numbers))
        for name, shape in zip(_ARRAYS, shapes, strict=True):
            array = contiguous(getattr(self, name), shape)
            object.__setattr__(self, name, array)
            setattr(struct, name, address(array))
        object.__setattr__(self, "struct", struct)


@dataclass(frozen=True, eq=False)
class Sums:
    """Sums that are added to, contiguous arrays of 64-bit floats.

    Attributes:
        diagonal, gradient: (N,6,6), (N,6) of the rig poses.
        border: (N,6,own) between rig poses and the shared unknowns before the landmarks.
        blocks: (B,6,6) between rig poses and landmarks, those that there are.
        corner, shared_gradient: (m,m), (m,) of the shared unknowns; landmark k has those from own + 6 k.
        own: first shared unknown of the landmarks.
        place: (S,) block of every observation; None: landmarks do not move.
        camera: (S,) number of its camera; None: the cameras are where the rig has them.
        cameras: first shared unknown of camera 1; camera 0 has none.
    """

    diagonal: Array
    gradient: Array
    border: Array
    blocks: Array
    corner: Array
    shared_gradient: Array
    own: int
    place: NDArray[np.int64] | None = None
    camera: NDArray[np.int64] | None = None
    cameras: int = 0

    def struct(self) -> SumsStruct:
        """Addresses of the arrays; keep the arrays alive while the kernel runs."""
        arrays = addresses(self.place, self.camera, *(getattr(self, name) for name in _SUMS))
        return SumsStruct(len(self.shared_gradient), self.own, self.cameras, *arrays)

    def require(self, bundle: Bundle) -> None:
        """Raises:
        ValueError: a shape or a kind differs, or a number is out of range.
        """
        S, N, m = len(bundle.at), len(bundle.p), len(self.shared_gradient)
        shapes = ((N, 6, 6), (N, 6), (N, 6, self.own), (len(self.blocks), 6, 6), (m, m), (m,))
        arrays = [getattr(self, name) for name in _SUMS]
        moving = self.place is not None
        if [array.shape for array in arrays] != list(shapes) or m < self.own + 6 * moving * len(bundle.p_landmark):
            raise ValueError(f"sums of shapes {[array.shape for array in arrays]}, expected {shapes}")
        if not all(array.flags.c_contiguous and array.dtype == np.float64 for array in arrays):
            raise ValueError("sums are not contiguous 64-bit floats")
        for numbers, count in ((self.place, len(self.blocks)), (self.camera, 1 + (self.own - self.cameras) // 6)):
            if numbers is None:
                continue
            if numbers.shape != (S,) or numbers.dtype != np.int64 or not numbers.flags.c_contiguous:
                raise ValueError(f"numbers of shape {numbers.shape}, expected {(S,)}")
            if S and not 0 <= numbers.min() <= numbers.max() < count:
                raise ValueError(f"numbers outside 0..{count - 1}")


def bundle_chi2(bundle: Bundle) -> tuple[Array, Array]:
    """(S,) squared errors in standard deviations, and in pixels, summed over the eight coordinates."""
    kernels = _kernels()
    if kernels is None:
        return bundle_chi2_numpy(bundle)
    chi2, pixels = np.empty((2, len(bundle.at)))
    kernels[0](bundle.struct, address(chi2), address(pixels))
    return chi2, pixels


def bundle_chi2_numpy(bundle: Bundle) -> tuple[Array, Array]:
    """Definition of :func:`bundle_chi2`."""
    errors = derivatives(bundle)[0]
    pixels = (bundle.by_ray @ errors.reshape(-1, 4, 2, 1))[..., 0]
    return (_whitened(bundle, errors) ** 2).sum(axis=1), (pixels**2).sum(axis=(1, 2))


def add_bundle_equations(
    bundle: Bundle, used: NDArray[np.bool_], cauchy: float, sums: Sums, noise: float = 1.0
) -> float:
    """Add normal equations of the used observations (S,) to ``sums``, in place; returns their cost.

    Args:
        cauchy: standard deviations at which the loss halves its weight, of the root mean square of eight coordinates.
        noise: factor of the observations' variances.

    Raises:
        ValueError: a shape differs.
    """
    used = contiguous(used, (len(bundle.at),), np.bool_)
    sums.require(bundle)
    kernels = _kernels()
    if kernels is None:
        return add_bundle_equations_numpy(bundle, used, cauchy, sums, noise)
    cost = ctypes.c_double()
    kernels[1](bundle.struct, address(used), cauchy, noise, sums.struct(), cost)
    return cost.value


def add_bundle_equations_numpy(
    bundle: Bundle, used: NDArray[np.bool_], cauchy: float, sums: Sums, noise: float = 1.0
) -> float:
    """Definition of :func:`add_bundle_equations`."""
    errors, by_pose, by_landmark = derivatives(bundle)
    r = _whitened(bundle, errors)[used] / np.sqrt(noise)
    squared = (r**2).sum(axis=1) / (8 * cauchy**2)
    root = np.sqrt(1 / (1 + squared))[:, None]
    at = bundle.at[used]
    W = bundle.whitener[used] * root[:, :, None] / np.sqrt(noise)
    J, r = W @ by_pose[used], (r * root)[:, :, None]
    Jt = J.transpose(0, 2, 1)
    np.add.at(sums.diagonal, at, Jt @ J)
    np.add.at(sums.gradient, at, (Jt @ r)[:, :, 0])
    shared: list[tuple[Array, NDArray[np.int64]]] = []
    if sums.place is not None:
        K, columns = W @ by_landmark[used], sums.own + 6 * bundle.of[used][:, None] + np.arange(6)
        np.add.at(sums.blocks, sums.place[used], Jt @ K)
        shared.append((K, columns))
    if sums.camera is not None:
        R = bundle.R_camera[bundle.mount[used]] @ bundle.R[at].transpose(0, 2, 1)
        # A motion of a camera in the rig is equivalent to the opposite motion of the rig.
        back = -R.transpose(0, 2, 1) * (sums.camera[used] > 0)[:, None, None]
        C = np.concatenate([J[..., :3] @ back, J[..., 3:] @ back], axis=2)
        columns = sums.cameras + 6 * np.maximum(sums.camera[used] - 1, 0)[:, None] + np.arange(6)
        if sums.own >= sums.cameras + 6:
            np.add.at(sums.border, (at[:, None, None], np.arange(6)[:, None], columns[:, None]), Jt @ C)
            shared.append((C, columns))
    for K, rows in shared:
        Kt = K.transpose(0, 2, 1)
        np.add.at(sums.shared_gradient, rows, (Kt @ r)[:, :, 0])
        for other, columns in shared:
            np.add.at(sums.corner, (rows[:, :, None], columns[:, None]), Kt @ other)
    return float(8 * cauchy**2 * np.log1p(squared).sum())


def whitened_errors(bundle: Bundle) -> Array:
    """(S,8) errors of the observed corners in standard deviations."""
    return _whitened(bundle, errors_of_rays(bundle))


def errors_of_rays(bundle: Bundle) -> Array:
    """(S,8) observed minus expected rays; a large constant for corners behind a camera."""
    return _ray_errors(bundle)[0]


def _whitened(bundle: Bundle, errors: Array) -> Array:
    return np.asarray((bundle.whitener @ errors[:, :, None])[:, :, 0])


def derivatives(bundle: Bundle) -> tuple[Array, Array, Array]:
    """Errors of rays (S,8), and derivatives of the expected rays (S,8,6) with the rig and with the landmark."""
    errors, expected, depth, offset, arms, R_camera_map = _ray_errors(bundle)
    across, along = R_camera_map[:, None, :2], R_camera_map[:, None, 2:]
    by_point = (across - expected[..., None] * along) / depth[..., None]  # (S,4,2,3)
    by_pose = np.concatenate([-by_point, np.cross(by_point, offset[:, :, None])], axis=-1).reshape(-1, 8, 6)
    by_landmark = np.concatenate([by_point, -np.cross(by_point, arms[:, :, None])], axis=-1).reshape(-1, 8, 6)
    return errors, by_pose, by_landmark


def _ray_errors(bundle: Bundle) -> tuple[Array, ...]:
    """Errors of rays (S,8); rays expected, depths, corners from the rig and from the center, and R_camera_map."""
    arms = bundle.arms[bundle.of] @ bundle.R_landmark[bundle.of].transpose(0, 2, 1)
    offset = bundle.p_landmark[bundle.of][:, None] + arms - bundle.p[bundle.at][:, None]
    R_camera_map = bundle.R_camera[bundle.mount] @ bundle.R[bundle.at].transpose(0, 2, 1)
    seen = offset @ R_camera_map.transpose(0, 2, 1) + bundle.t_camera[bundle.mount][:, None]
    depth = np.maximum(seen[..., 2:], NEAREST_M)
    expected = seen[..., :2] / depth
    errors = (bundle.rays - expected).reshape(-1, 8)
    errors[(seen[..., 2] < NEAREST_M).any(axis=1)] = NOWHERE
    return errors, expected, depth, offset, arms, R_camera_map


@lru_cache(maxsize=1)
def _kernels() -> tuple[Any, Any] | None:
    bundle, pointer, number = ctypes.POINTER(BundleStruct), ctypes.c_void_p, ctypes.c_double
    chi2 = function("lmkit_bundle_chi2", bundle, pointer, pointer)
    equations = function(
        "lmkit_bundle_equations", bundle, pointer, number, number, ctypes.POINTER(SumsStruct), ctypes.POINTER(number)
    )
    return None if chi2 is None else (chi2, equations)
