"""Lens models: coefficients of each, and the formulas from rays to pixels and back (OpenCV's).

`LENS_MODELS` has one row per model; calibration, files, reports and the command line read their lists from it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import MappingProxyType

import cv2
import numpy as np

from lmkit.arrays import AnyArray, FloatArray

_CRITERIA = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-12)
_ZERO = np.zeros(3)


@dataclass(frozen=True)
class LensModel:
    """One lens model.

    Attributes:
        name: as in rig files.
        coefficients: names of all coefficients, in OpenCV's order.
        counts: numbers of coefficients that a camera may have; the rest are zero.
        fitted: number of coefficients that calibration fits.
        powers: power of the radius in the term of each coefficient; 0 where it has none.
        is_equidistant: the radius is the angle from the optical axis, not its tangent; kernels/lens.c computes
            both kinds.
        ros_name: ``distortion_model`` of ROS.
        project: (N,1,3) points, K, coefficients -> pixels (N,1,2).
        differentiate: (N,1,3) points, K, coefficients -> pixels (N,2), their derivatives with the point (N,2,3)
            and with fx fy cx cy and the coefficients (N,2,4+D).
        unproject: (N,1,2) pixels, K, coefficients -> x/z, y/z (N,1,2).
        maps: K, coefficients, R, new K, (width, height), type -> maps for ``cv2.remap``.
    """

    name: str
    coefficients: tuple[str, ...]
    counts: tuple[int, ...]
    fitted: int
    powers: tuple[int, ...]
    is_equidistant: bool
    ros_name: str
    project: Callable[[AnyArray, FloatArray, FloatArray], AnyArray]
    differentiate: Callable[[AnyArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray, FloatArray]]
    unproject: Callable[[AnyArray, FloatArray, FloatArray], AnyArray]
    maps: Callable[..., tuple[AnyArray, AnyArray]]


def _project_polynomial(points: AnyArray, K: FloatArray, distortion: FloatArray) -> AnyArray:
    return np.asarray(cv2.projectPoints(points, _ZERO, _ZERO, K, distortion)[0])


def _differentiate_polynomial(
    points: AnyArray, K: FloatArray, distortion: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    pixels, jacobian = cv2.projectPoints(points, _ZERO, _ZERO, K, distortion)
    J = np.asarray(jacobian, dtype=np.float64).reshape(len(points), 2, -1)
    flat = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
    return flat, J[:, :, 3:6], J[:, :, 6 : 10 + len(distortion)]


def _unproject_polynomial(pixels: AnyArray, K: FloatArray, distortion: FloatArray) -> AnyArray:
    """``cv2.undistortPoints`` to full precision; OpenCV 4 has another name for that than OpenCV 5."""
    to_precision = getattr(cv2, "undistortPointsIter", None)
    if to_precision is not None:
        return np.asarray(to_precision(pixels, K, distortion, np.eye(3), np.eye(3), _CRITERIA))
    return np.asarray(cv2.undistortPoints(pixels, K, distortion, criteria=_CRITERIA))


def _project_fisheye(points: AnyArray, K: FloatArray, distortion: FloatArray) -> AnyArray:
    return np.asarray(cv2.fisheye.projectPoints(points, _ZERO, _ZERO, K, distortion)[0])


def _differentiate_fisheye(
    points: AnyArray, K: FloatArray, distortion: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    pixels, jacobian = cv2.fisheye.projectPoints(points, _ZERO, _ZERO, K, distortion)
    J = np.asarray(jacobian, dtype=np.float64).reshape(-1, 2, 15)
    return np.asarray(pixels, dtype=np.float64).reshape(-1, 2), J[:, :, 11:14], J[:, :, :8]


def _unproject_fisheye(pixels: AnyArray, K: FloatArray, distortion: FloatArray) -> AnyArray:
    return np.asarray(cv2.fisheye.undistortPoints(pixels, K, distortion, criteria=_CRITERIA))


_POLYNOMIAL = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "τx", "τy")
_POLYNOMIAL_POWERS = (2, 4, 1, 1, 6, 2, 4, 6, 2, 4, 2, 4, 0, 0)


def _polynomial(name: str, counts: tuple[int, ...], fitted: int, ros_name: str) -> LensModel:
    most = max(counts)
    return LensModel(
        name,
        _POLYNOMIAL[:most],
        counts,
        fitted,
        _POLYNOMIAL_POWERS[:most],
        is_equidistant=False,
        ros_name=ros_name,
        project=_project_polynomial,
        differentiate=_differentiate_polynomial,
        unproject=_unproject_polynomial,
        maps=cv2.initUndistortRectifyMap,
    )


PINHOLE = _polynomial("pinhole", (0, 4, 5), 5, "plumb_bob")
FISHEYE = LensModel(
    "fisheye",
    ("k1", "k2", "k3", "k4"),
    (4,),
    4,
    (2, 4, 6, 8),
    is_equidistant=True,
    ros_name="equidistant",
    project=_project_fisheye,
    differentiate=_differentiate_fisheye,
    unproject=_unproject_fisheye,
    maps=cv2.fisheye.initUndistortRectifyMap,
)
RATIONAL = _polynomial("rational", (8, 12, 14), 8, "rational_polynomial")

# Automatic calibration tries them in this order: a later one must be clearly better on held-out images.
LENS_MODELS: MappingProxyType[str, LensModel] = MappingProxyType(
    {model.name: model for model in (PINHOLE, FISHEYE, RATIONAL)}
)
