"""Apparent enlargement of each face, along its width and its height: the terms of observations in the equations.

Two numbers per landmark, px (`mapping/face_swelling.py`): displacement of its corners outward from their places,
equal in all images of a recording.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.landmark_bundle import Array, Bundle, BundleStruct, derivatives
from lmkit.kernels.load import address, addresses, contiguous, function

SIZE = 2  # unknowns: px along the width and along the height

_SUMS = ("border", "landmarks", "cameras", "corner", "gradient")


class FaceStruct(ctypes.Structure):
    """`Faces` of face_swelling.c."""

    _fields_ = (
        ("unknown", ctypes.c_int64),
        *((name, ctypes.c_void_p) for name in ("place", "camera", *_SUMS)),
    )


@dataclass(frozen=True, eq=False)
class FaceSums:
    """Normal equations of faces, sums that are added to: contiguous arrays of 64-bit floats.

    Attributes:
        place: (S,) block of every observation: of its rig pose and landmark.
        camera: (S,) number of its camera; None: the cameras are where the rig has them.
        border: (B,6,2) between rig poses and faces.
        landmarks: (L,6,2) between a landmark's pose and its face.
        cameras: (L,C,6,2) between faces and the C unknown cameras, which are those from number 1 on.
        corner, gradient: (L,2,2), (L,2) of the faces.
    """

    place: NDArray[np.int64]
    camera: NDArray[np.int64] | None
    border: Array
    landmarks: Array
    cameras: Array
    corner: Array
    gradient: Array

    @classmethod
    def zeros(
        cls, place: NDArray[np.int64], camera: NDArray[np.int64] | None, blocks: int, landmarks: int, unknown: int
    ) -> FaceSums:
        """Equations without information, for numbers of blocks, landmarks and unknown cameras."""
        shapes = ((blocks, 6), (landmarks, 6), (landmarks, unknown, 6), (landmarks, SIZE), (landmarks,))
        return cls(place, camera if unknown else None, *(np.zeros((*shape, SIZE)) for shape in shapes))

    def struct(self) -> FaceStruct:
        """Addresses of the arrays; keep the arrays alive while the kernel runs."""
        arrays = addresses(self.place, self.camera, *(getattr(self, name) for name in _SUMS))
        return FaceStruct(self.cameras.shape[1], *arrays)

    def require(self, bundle: Bundle) -> None:
        """Raises:
        ValueError: a shape or a kind differs, or a number is out of range.
        """
        S, L, C = len(bundle.at), len(bundle.p_landmark), self.cameras.shape[1]
        shapes = ((len(self.border), 6, SIZE), (L, 6, SIZE), (L, C, 6, SIZE), (L, SIZE, SIZE), (L, SIZE))
        arrays = [getattr(self, name) for name in _SUMS]
        if [array.shape for array in arrays] != list(shapes):
            raise ValueError(f"sums of shapes {[array.shape for array in arrays]}, expected {shapes}")
        if not all(array.flags.c_contiguous and array.dtype == np.float64 for array in arrays):
            raise ValueError("sums are not contiguous 64-bit floats")
        for numbers, count in ((self.place, len(self.border)), (self.camera, 1 + C)):
            if numbers is None:
                continue
            if numbers.shape != (S,) or numbers.dtype != np.int64 or not numbers.flags.c_contiguous:
                raise ValueError(f"numbers of shape {numbers.shape}, expected {(S,)}")
            if S and not 0 <= numbers.min() <= numbers.max() < count:
                raise ValueError(f"numbers outside 0..{count - 1}")


def outward(bundle: Bundle) -> Array:
    """(S,8,2) change of the corners' rays by a displacement of 1 px outward along the face's width and height."""
    kernels = _kernels()
    if kernels is None:
        return outward_numpy(bundle)
    shifts = np.empty((len(bundle.at), 8, SIZE))
    kernels[0](bundle.struct, address(shifts))
    return shifts


def outward_numpy(bundle: Bundle) -> Array:
    """Definition of :func:`outward`."""
    return _outward(bundle.rays, bundle.by_ray)


def _outward(rays: Array, by_ray: Array) -> Array:
    """(S,8,2) `outward` along the directions between corners at ``rays`` (S,4,2)."""
    a, b, c, d = (by_ray[..., i, j] for i in (0, 1) for j in (0, 1))
    x, y = rays[..., 0], rays[..., 1]
    pixels = np.stack([a * x + b * y, c * x + d * y], axis=-1)
    determinant = a * d - b * c
    shifts = np.empty((len(x), 4, 2, SIZE))
    # Corners start at the top left and run clockwise.
    for k, signs in enumerate(((-1, 1, 1, -1), (-1, -1, 1, 1))):
        way = np.tensordot(np.array(signs, dtype=float), pixels, axes=(0, 1))
        u, v = (way / np.sqrt((way**2).sum(axis=1, keepdims=True))).T[:, :, None] * np.array(signs, dtype=float)
        shifts[..., 0, k] = (d * u - b * v) / determinant
        shifts[..., 1, k] = (a * v - c * u) / determinant
    # A face without width or height has no outward direction.
    return np.nan_to_num(shifts.reshape(-1, 8, SIZE), posinf=0.0, neginf=0.0)


def add_face_equations(bundle: Bundle, weights: Array, faces: FaceSums) -> None:
    """Add the terms of observations to ``faces``, in place.

    Args:
        weights: (S,) of the observations; those of weight zero do not count.

    Raises:
        ValueError: a shape differs.
    """
    weights = contiguous(weights, (len(bundle.at),))
    faces.require(bundle)
    kernels = _kernels()
    if kernels is None:
        add_face_equations_numpy(bundle, weights, faces)
    else:
        kernels[1](bundle.struct, address(weights), faces.struct())


def add_face_equations_numpy(bundle: Bundle, weights: Array, faces: FaceSums) -> None:
    """Definition of :func:`add_face_equations`."""
    errors, by_pose, by_landmark = derivatives(bundle)
    # Expected corners: directions between observed ones have errors correlated with theirs, which look like swelling.
    shifts = _outward(bundle.rays - errors.reshape(-1, 4, 2), bundle.by_ray)
    # Unused observations may have extreme values.
    G = np.where((weights > 0)[:, None, None], bundle.whitener @ shifts, 0.0)
    weighed = G.transpose(0, 2, 1) * weights[:, None, None]
    by_ray = weighed @ bundle.whitener
    pulls = (by_ray @ by_pose).transpose(0, 2, 1)
    np.add.at(faces.border, faces.place, pulls)
    np.add.at(faces.landmarks, bundle.of, (by_ray @ by_landmark).transpose(0, 2, 1))
    np.add.at(faces.corner, bundle.of, weighed @ G)
    np.add.at(faces.gradient, bundle.of, (by_ray @ errors[..., None])[..., 0])
    if faces.camera is not None:
        # A motion of a camera in the rig is equivalent to the opposite motion of the rig.
        turned = (bundle.R_camera[bundle.mount] @ bundle.R[bundle.at].transpose(0, 2, 1))[:, None]
        on_cameras = -(turned @ pulls.reshape(-1, 2, 3, SIZE)).reshape(-1, 6, SIZE)
        moved = faces.camera > 0
        np.add.at(faces.cameras, (bundle.of[moved], faces.camera[moved] - 1), on_cameras[moved])


@lru_cache(maxsize=1)
def _kernels() -> tuple[Any, Any] | None:
    bundle, pointer = ctypes.POINTER(BundleStruct), ctypes.c_void_p
    shifts = function("lmkit_outward", bundle, pointer)
    equations = function("lmkit_face_equations", bundle, pointer, ctypes.POINTER(FaceStruct))
    return None if shifts is None else (shifts, equations)
