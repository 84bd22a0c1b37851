"""Rotations: matrices, rotation vectors and quaternions."""

from __future__ import annotations

import math

import numpy as np

from lmkit.arrays import FloatArray

ROUNDING, NEARLY = 1e-15, 1e-8  # off a rotation, of lengths and angles


def is_rotation(R: FloatArray, tolerance: float = 1e-6) -> bool:
    """True where the rows of R (3,3) are orthonormal and right-handed, to the tolerance.

    In plain numbers: every pose is checked, and numpy takes ten times as long for so few.
    """
    (a, b, c), (d, e, f), (g, h, i) = R.tolist()
    return bool(
        abs(a * a + b * b + c * c - 1) <= tolerance
        and abs(d * d + e * e + f * f - 1) <= tolerance
        and abs(g * g + h * h + i * i - 1) <= tolerance
        and abs(a * d + b * e + c * f) <= tolerance
        and abs(a * g + b * h + c * i) <= tolerance
        and abs(d * g + e * h + f * i) <= tolerance
        and a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) > 0
    )


def skew(v: FloatArray) -> FloatArray:
    """(...,3,3) matrices with ``skew(v) @ w == cross(v, w)``, of vectors (...,3)."""
    if v.ndim == 1:
        x, y, z = v.tolist()
        return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    W = np.zeros((*v.shape, 3))
    W[..., 0, 1], W[..., 0, 2], W[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return np.asarray(W - W.swapaxes(-1, -2))


def rotation_exp(rvec: FloatArray) -> FloatArray:
    """(...,3,3) rotations of rotation vectors (...,3), rad (Rodrigues' formula)."""
    if rvec.ndim == 1:
        return _exp_of_one(rvec)
    angle = np.sqrt((rvec**2).sum(axis=-1))[..., None, None]
    W = skew(rvec)
    small = angle < 1e-8
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 1.0, np.sin(safe) / safe)
    b = np.where(small, 0.5, (1 - np.cos(safe)) / safe**2)
    return np.asarray(np.eye(3) + a * W + b * (W @ W))


def _exp_of_one(rvec: FloatArray) -> FloatArray:
    """(3,3) in plain numbers: numpy takes several times as long for so few."""
    x, y, z = rvec.tolist()
    squared = x * x + y * y + z * z
    angle = math.sqrt(squared)
    a, b = (1.0, 0.5) if angle < 1e-8 else (math.sin(angle) / angle, (1 - math.cos(angle)) / squared)
    return np.array(
        [
            [1 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y],
            [b * x * y + a * z, 1 - b * (x * x + z * z), b * y * z - a * x],
            [b * x * z - a * y, b * y * z + a * x, 1 - b * (x * x + y * y)],
        ]
    )


def rotation_log(R: FloatArray) -> FloatArray:
    """(...,3) rotation vectors of rotations (...,3,3), the inverse of :func:`rotation_exp`; angles in 0..pi."""
    if R.ndim == 2:
        return _log_of_one(R)
    flat = R.reshape(-1, 3, 3)
    axis = np.stack(
        [flat[:, 2, 1] - flat[:, 1, 2], flat[:, 0, 2] - flat[:, 2, 0], flat[:, 1, 0] - flat[:, 0, 1]], axis=1
    )
    sine, cosine = np.sqrt((axis**2).sum(axis=1)) / 2, (np.trace(flat, axis1=1, axis2=2) - 1) / 2
    scale = np.where(sine < 1e-12, 1.0, np.arctan2(sine, cosine) / np.maximum(sine, 1e-12))
    logs = scale[:, None] * axis / 2
    # Beyond a quarter turn the sine decreases, and the quaternion gives the axis more accurately.
    for k in np.flatnonzero(cosine <= 0).tolist():
        logs[k] = _log_of_one(flat[k])
    return np.asarray(logs.reshape(R.shape[:-1]))


def _log_of_one(R: FloatArray) -> FloatArray:
    """(3,) in plain numbers."""
    (a, b, c), (d, e, f), (g, h, i) = R.tolist()
    x, y, z, cosine = (h - f) / 2, (c - g) / 2, (d - b) / 2, (a + e + i - 1) / 2
    if cosine > 0:
        sine = math.sqrt(x * x + y * y + z * z)
        scale = 1.0 if sine < 1e-12 else math.atan2(sine, cosine) / sine
        return np.array([scale * x, scale * y, scale * z])
    q = matrix_to_quaternion(R)
    length = float(np.linalg.norm(q[:3]))
    return np.asarray(q[:3] * (2 * np.arctan2(length, q[3]) / length))


def rotation_angle(R: FloatArray) -> float:
    """Angle of a rotation, rad, 0..pi."""
    return float(np.linalg.norm(rotation_log(R)))


def quaternion_to_matrix(q: FloatArray) -> FloatArray:
    """(...,3,3) rotations of quaternions (...,4) x y z w, normalized here."""
    x, y, z, w = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    rows = [
        *(1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        *(2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        *(2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    ]
    return np.stack(rows, axis=-1).reshape(*np.shape(q)[:-1], 3, 3)


def matrix_to_quaternion(R: FloatArray) -> FloatArray:
    """(4,) unit quaternion x y z w with w >= 0, by the largest of the four (Shepperd 1978)."""
    trace = np.trace(R)
    squares = np.array([1 + 2 * R[0, 0] - trace, 1 + 2 * R[1, 1] - trace, 1 + 2 * R[2, 2] - trace, 1 + trace])
    # Row k of this symmetric matrix is 4 q_k q.
    products = np.array(
        [
            [squares[0], R[0, 1] + R[1, 0], R[0, 2] + R[2, 0], R[2, 1] - R[1, 2]],
            [R[0, 1] + R[1, 0], squares[1], R[1, 2] + R[2, 1], R[0, 2] - R[2, 0]],
            [R[0, 2] + R[2, 0], R[1, 2] + R[2, 1], squares[2], R[1, 0] - R[0, 1]],
            [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], squares[3]],
        ]
    )
    q = products[int(np.argmax(squares))]
    q = q / np.linalg.norm(q)
    return np.asarray(-q if q[3] < 0 else q)


def orthonormal(R: FloatArray) -> FloatArray:
    """The rotation (3,3) nearest to an almost-rotation, so that long chains do not drift."""
    if is_rotation(R, ROUNDING):
        return R
    if is_rotation(R, NEARLY):
        # A step of Newton's for the polar factor: what is left of the error is its square.
        return np.asarray(1.5 * R - 0.5 * R @ (R.T @ R))
    U, _, Vt = np.linalg.svd(R)
    return np.asarray(U @ Vt)
