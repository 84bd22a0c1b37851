"""Intersections of an image's rays with a textured panel, and their colors.

Single precision, and each operation is rounded as in numpy: a seed gives the same image on every machine.
"""

from __future__ import annotations

import ctypes
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmkit.kernels.load import address, addresses, contiguous, function

Float32Array = NDArray[np.float32]
Flags = NDArray[np.bool_]
Window = tuple[slice, slice]

NEAREST_M = 0.05
CURL_STEPS = 3


def meet_panel(
    rays: Float32Array,
    depth: Float32Array,
    window: Window,
    R: NDArray[Any],
    origin: NDArray[Any],
    size_m: tuple[float, float],
    curl_m: float,
) -> tuple[Float32Array, Float32Array, Float32Array, Flags]:
    """Intersections of the h x w rays in a window: u, v on the panel, depth, and visibility; all (h,w).

    Args:
        rays: (H,W,2) x/z, y/z in the camera; ``depth``: (H,W) of what is seen so far.
        window: rows and columns, without steps.
        R, origin: (3,3) x_camera = R x_panel + t, and (3,) the camera's place in the panel's frame.
        size_m: (width, height); ``curl_m``: how far the middle stands out of the panel's plane.

    Raises:
        ValueError: a shape differs.
    """
    rays, depth = contiguous(rays, (-1, -1, 2), np.float32), contiguous(depth, rays.shape[:2], np.float32)
    R, origin = contiguous(R, (3, 3), np.float32), contiguous(origin, (3,), np.float32)
    kernels = _kernels()
    if kernels is None:
        return meet_panel_numpy(rays, depth, window, R, origin, size_m, curl_m)
    shape, offset = _place(window, depth)
    u, v, distance = np.empty((3, *shape), dtype=np.float32)
    hit = np.empty(shape, dtype=np.bool_)
    half = size_m[0] / 2, size_m[1] / 2
    kernels[0](
        *shape, depth.shape[1], address(rays) + 8 * offset, address(depth) + 4 * offset, *addresses(R, origin),
        curl_m, size_m[0], *half, *addresses(u, v, distance, hit),
    )  # fmt: skip
    return u, v, distance, hit


def meet_panel_numpy(
    rays: Float32Array,
    depth: Float32Array,
    window: Window,
    R: NDArray[Any],
    origin: NDArray[Any],
    size_m: tuple[float, float],
    curl_m: float,
) -> tuple[Float32Array, Float32Array, Float32Array, Flags]:
    """Definition of :func:`meet_panel`."""
    R, origin = np.asarray(R, dtype=np.float32), np.asarray(origin, dtype=np.float32)
    (x, y), width = np.moveaxis(rays[window], 2, 0), np.float32(size_m[0])
    dx, dy, dz = (R[0, k] * x + R[1, k] * y + R[2, k] for k in range(3))
    with np.errstate(all="ignore"):
        distance = (np.float32(0) - origin[2]) / dz
        u = origin[0] + distance * dx
        for _ in range(CURL_STEPS if curl_m else 0):
            lift = np.float32(curl_m) * np.clip(1 - (2 * u / width) ** 2, -1, 1)
            distance = (lift - origin[2]) / dz
            u = origin[0] + distance * dx
        v = origin[1] + distance * dy
        hit = (distance > np.float32(NEAREST_M)) & (distance < depth[window])
        hit &= (np.abs(u) < np.float32(size_m[0] / 2)) & (np.abs(v) < np.float32(size_m[1] / 2))
    return u, v, distance, hit


def paint_panel(
    image: Float32Array, depth: Float32Array, window: Window, hit: Flags, color: Float32Array, distance: Float32Array
) -> None:
    """Put ``color`` (h,w,3) and ``distance`` (h,w) where ``hit`` into a window of image (H,W,3) and depth, in place.

    Raises:
        ValueError: a shape or kind differs.
    """
    if not all(array.flags.c_contiguous and array.dtype == np.float32 for array in (image, depth)):
        raise ValueError("image and depth are not contiguous arrays of single precision")
    shape, offset = _place(window, depth)
    hit, distance = contiguous(hit, shape, np.bool_), contiguous(distance, shape, np.float32)
    color = contiguous(color, (*shape, 3), np.float32)
    if image.shape != (*depth.shape, 3):
        raise ValueError(f"an image of shape {image.shape}, expected {(*depth.shape, 3)}")
    kernels = _kernels()
    if kernels is None:
        return paint_panel_numpy(image, depth, window, hit, color, distance)
    arrays = addresses(hit, color, distance)
    kernels[1](*shape, depth.shape[1], *arrays, address(image) + 12 * offset, address(depth) + 4 * offset)
    return None


def paint_panel_numpy(
    image: Float32Array, depth: Float32Array, window: Window, hit: Flags, color: Float32Array, distance: Float32Array
) -> None:
    """Definition of :func:`paint_panel`."""
    image[window][hit] = color[hit]
    depth[window][hit] = distance[hit]


def box_mean(image: Float32Array, size: int) -> Float32Array:
    """(H,W,3) means over boxes of ``size`` x ``size`` pixels of an (H size, W size, 3) image.

    Raises:
        ValueError: the sides are not multiples of the size.
    """
    image = contiguous(image, (-1, -1, 3), np.float32)
    height, width = image.shape[0] // size, image.shape[1] // size
    if image.shape[:2] != (height * size, width * size):
        raise ValueError(f"an image of shape {image.shape} does not divide into boxes of {size}")
    kernels = _kernels()
    if kernels is None:
        return box_mean_numpy(image, size)
    mean = np.empty((height, width, 3), dtype=np.float32)
    kernels[2](height, width, size, *addresses(image, mean))
    return mean


def box_mean_numpy(image: Float32Array, size: int) -> Float32Array:
    """Definition of :func:`box_mean`."""
    boxes = image.reshape(image.shape[0] // size, size, image.shape[1] // size, size, 3)
    return np.asarray(boxes.mean(axis=(1, 3)), dtype=np.float32)


def _place(window: Window, depth: Float32Array) -> tuple[tuple[int, int], int]:
    """Height and width of a window, and the number of its first pixel."""
    (top, bottom, one), (left, right, another) = (s.indices(n) for s, n in zip(window, depth.shape, strict=True))
    if one != 1 or another != 1:
        raise ValueError("a window with steps")
    return (max(bottom - top, 0), max(right - left, 0)), top * depth.shape[1] + left


@lru_cache(maxsize=1)
def _kernels() -> tuple[Any, Any, Any] | None:
    pointer, count, number = ctypes.c_void_p, ctypes.c_int64, ctypes.c_float
    meet = function("lmkit_meet_panel", count, count, count, *[pointer] * 4, *[number] * 4, *[pointer] * 4)
    paint = function("lmkit_paint_panel", count, count, count, *[pointer] * 5)
    mean = function("lmkit_box_mean", count, count, count, pointer, pointer)
    return None if meet is None else (meet, paint, mean)
