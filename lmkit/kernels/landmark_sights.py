"""Views of many landmarks from many poses: sides in pixels, and the information of their corners."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.lens import Lens, _LensStruct, project
from lmkit.kernels.load import address, addresses, contiguous, function

Array = NDArray[np.floating[Any]]
Ints = NDArray[np.int64]


class _CameraStruct(ctypes.Structure):
    _fields_ = (
        ("lens", ctypes.POINTER(_LensStruct)),
        ("R", ctypes.c_double * 9),
        ("t", ctypes.c_double * 3),
        *((name, ctypes.c_double) for name in ("width", "height", "edge", "nearest")),
    )


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera of a rig.

    Attributes:
        lens: its intrinsics.
        R, t: x_camera = R x_rig + t.
        size: (width, height), pixels.
        edge: share of the image's tangent beyond which the distortion folds back.
        nearest_m: least depth.
    """

    lens: Lens
    R: Array
    t: Array
    size: tuple[int, int]
    edge: float
    nearest_m: float
    struct: _CameraStruct = field(init=False, repr=False)

    def __post_init__(self) -> None:
        numbers = (ctypes.c_double * 9)(*self.R.ravel()), (ctypes.c_double * 3)(*self.t)
        struct = _CameraStruct(ctypes.pointer(self.lens.struct), *numbers, *self.size, self.edge, self.nearest_m)
        object.__setattr__(self, "struct", struct)


@dataclass(frozen=True, eq=False)
class Pairs:
    """N pairs of a rig pose and a landmark.

    Attributes:
        at, of: (N,) numbers of poses and landmarks.
        R, p: (H,3,3), (H,3) T_map_rig.
        corners: (L,4,3) in the map.
    """

    at: Ints
    of: Ints
    R: Array
    p: Array
    corners: Array

    def __post_init__(self) -> None:
        """Make the arrays contiguous.

        Raises:
            ValueError: a shape differs, or a number is out of range.
        """
        count = len(self.at)
        shapes = {"R": (-1, 3, 3), "p": (len(self.R), 3), "corners": (-1, 4, 3)}
        for name, shape in shapes.items():
            object.__setattr__(self, name, contiguous(getattr(self, name), shape))
        for name, most in (("at", len(self.R)), ("of", len(self.corners))):
            numbers = contiguous(getattr(self, name), (count,), np.int64)
            if count and not 0 <= numbers.min() <= numbers.max() < most:
                raise ValueError(f"{name} has numbers outside 0..{most - 1}")
            object.__setattr__(self, name, numbers)

    def addresses(self) -> list[int | None]:
        return addresses(self.at, self.of, self.R, self.p, self.corners)


def faced_landmarks(
    R: Array, p: Array, centers: Array, normals: Array, reach: Array, limits: tuple[float, float, float]
) -> NDArray[np.bool_]:
    """(H,L) True if a landmark is near enough, faces the camera and is in front of it.

    Args:
        R, p: (H,3,3), (H,3) T_map_camera.
        centers, normals: (L,3) of landmarks in the map; ``reach``: (L,) meters within which they are read.
        limits: least cosine of the tilt, least depth (m), largest sideways distance over depth.

    Raises:
        ValueError: a shape differs.
    """
    R = contiguous(R, (-1, 3, 3))
    p = contiguous(p, (len(R), 3))
    centers = contiguous(centers, (-1, 3))
    normals, reach = contiguous(normals, centers.shape), contiguous(reach, centers.shape[:1])
    kernels = _kernels()
    if kernels is None:
        return faced_landmarks_numpy(R, p, centers, normals, reach, limits)
    faced = np.empty((len(R), len(centers)), dtype=np.bool_)
    kernels[0](*faced.shape, *addresses(R, p, centers, normals, reach), *limits, address(faced))
    return faced


def faced_landmarks_numpy(
    R: Array, p: Array, centers: Array, normals: Array, reach: Array, limits: tuple[float, float, float]
) -> NDArray[np.bool_]:
    """Definition of :func:`faced_landmarks`."""
    steepest, nearest, widest = limits
    way = centers[None] - p[:, None]
    distance = np.linalg.norm(way, axis=2)
    facing = -np.einsum("plk,lk->pl", way, normals) / np.maximum(distance, 1e-9)
    ahead, aside = np.einsum("plk,pk->pl", way, R[:, :, 2]), np.einsum("plk,pk->pl", way, R[:, :, 0])
    return np.asarray((distance < reach) & (facing > steepest) & (ahead > nearest) & (np.abs(aside) < widest * ahead))


def seen_sides(camera: Camera, pairs: Pairs) -> Array:
    """(N,) mean side in pixels; 0 unless all corners are in the image."""
    kernels = _kernels()
    if kernels is None:
        return seen_sides_numpy(camera, pairs)
    sides = np.empty(len(pairs.at))
    kernels[1](camera.struct, len(pairs.at), *pairs.addresses(), address(sides))
    return sides


def seen_sides_numpy(camera: Camera, pairs: Pairs) -> Array:
    """Definition of :func:`seen_sides`."""
    whole, pixels, _ = _views(camera, pairs)
    side = np.linalg.norm(pixels - np.roll(pixels, 1, axis=1), axis=2).mean(axis=1)
    return np.where(whole, side, 0.0)


def add_information(camera: Camera, pairs: Pairs, weights: Array, information: Array) -> None:
    """Add J' J times ``weights`` (N,) to ``information`` (N,6,6), in place, for pairs with all corners in the image.

    J are derivatives of the corners' pixels by a shift and a rotation of the rig about the map's axes.

    Raises:
        ValueError: a shape or kind differs.
    """
    weights = contiguous(weights, (len(pairs.at),))
    if information.shape != (len(pairs.at), 6, 6) or contiguous(information, (-1, 6, 6)) is not information:
        raise ValueError(f"information of shape {information.shape} is no contiguous ({len(pairs.at)}, 6, 6) array")
    kernels = _kernels()
    if kernels is None:
        return add_information_numpy(camera, pairs, weights, information)
    kernels[2](camera.struct, len(pairs.at), *pairs.addresses(), address(weights), address(information))
    return None


def add_information_numpy(camera: Camera, pairs: Pairs, weights: Array, information: Array) -> None:
    """Definition of :func:`add_information`."""
    whole, _, by_point = _views(camera, pairs)
    offset = pairs.corners[pairs.of] - pairs.p[pairs.at, None]
    G = by_point @ (camera.R @ pairs.R[pairs.at].transpose(0, 2, 1))[:, None]
    J = np.concatenate([-G, np.cross(G, offset[:, :, None])], axis=3).reshape(-1, 8, 6)
    weights = np.where(whole & (weights > 0), weights, 0.0)
    information += weights[:, None, None] * (J.transpose(0, 2, 1) @ J)


def _views(camera: Camera, pairs: Pairs) -> tuple[NDArray[np.bool_], Array, Array]:
    """(N,) all corners in the image, their pixels (N,4,2), and derivatives with points in the camera (N,4,2,3)."""
    into = camera.R @ pairs.R[pairs.at].transpose(0, 2, 1)
    flat = ((pairs.corners[pairs.of] - pairs.p[pairs.at, None]) @ into.transpose(0, 2, 1) + camera.t).reshape(-1, 3)
    limit = camera.edge * np.array(camera.size) / camera.lens.K[[0, 1], [0, 1]]
    sane = (flat[:, 2] > camera.nearest_m) & (np.abs(flat[:, :2]) < limit * flat[:, 2:]).all(axis=1)
    flat = np.where(sane[:, None], flat, np.array([0.0, 0.0, 1.0]))
    rays, depth = flat[:, :2] / flat[:, 2:], flat[:, 2, None, None]
    pixels, J = project(camera.lens, rays)
    inside = ((pixels > -0.5) & (pixels < np.array(camera.size) - 0.5)).all(axis=1)
    by_point = np.concatenate([J, -(J @ rays[:, :, None])], axis=2) / depth
    whole = np.asarray((sane & inside).reshape(-1, 4).all(axis=1))
    return whole, pixels.reshape(-1, 4, 2), by_point.reshape(-1, 4, 2, 3)


@lru_cache(maxsize=1)
def _kernels() -> tuple[Any, Any, Any] | None:
    camera, pointer, count, number = ctypes.POINTER(_CameraStruct), ctypes.c_void_p, ctypes.c_int64, ctypes.c_double
    faced = function("lmkit_faced_landmarks", count, count, *[pointer] * 5, number, number, number, pointer)
    sides = function("lmkit_seen_sides", camera, count, *[pointer] * 6)
    add = function("lmkit_add_information", camera, count, *[pointer] * 7)
    return None if faced is None else (faced, sides, add)
