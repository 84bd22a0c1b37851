"""Axes of an inertial sensor, recognized from gravity: an accelerometer at rest measures 1 g upward (REP 145)."""

from __future__ import annotations

import numpy as np

from lmkit.arrays import FloatArray

ALONG = float(np.cos(np.deg2rad(20.0)))  # between an axis and the vertical
LEAST_STEADY = 0.6  # length of the mean over the mean length: less, and nothing points up
AXES = ("x", "y", "z")


def upward_rates(rates_radps: FloatArray, accelerations: FloatArray) -> tuple[FloatArray, str | None]:
    """(N,) rates about the vertical, positive to the left, and a sentence where that is not the sensor's z axis.

    Args:
        rates_radps: (N,3) about the sensor's axes.
        accelerations: (N,3) in any unit; not finite or zero where nothing was measured, and then z is up.
    """
    up, sentence = upward_axis(accelerations)
    return about(up, rates_radps), sentence


def upward_axis(accelerations: FloatArray) -> tuple[FloatArray, str | None]:
    """(3,) upward unit vector in the sensor's axes, one of them where one is upright, and a sentence unless it is z.

    Args:
        accelerations: (N,3) as for `upward_rates`.
    """
    up = _up(accelerations)
    if up is None or up[2] > ALONG:
        return np.array([0.0, 0.0, 1.0]), None
    axis = int(np.argmax(np.abs(up)))
    if abs(up[axis]) <= ALONG:
        tilt_deg = np.rad2deg(np.arccos(up[2]))
        text = f"the IMU's z axis is {tilt_deg:.0f} deg off the vertical (by gravity): the rate is about the vertical"
        return up, text
    sign = -1.0 if up[axis] < 0 else 1.0
    name = f"{'minus ' if sign < 0 else ''}{AXES[axis]}"
    known = {"minus y": " (axes of an optical frame)", "minus z": " (z down, as aircraft have it)"}.get(name, "")
    text = f"the IMU's {name} axis points up{known}, according to gravity: the rate is about that axis"
    return sign * np.eye(3)[axis], text


def about(up: FloatArray, rates_radps: FloatArray) -> FloatArray:
    """(...,) rates about an axis (3,); axes that do not contribute may be NaN."""
    used = np.flatnonzero(up)
    return np.asarray(rates_radps[..., used] @ up[used])


def _up(accelerations: FloatArray) -> FloatArray | None:
    """(3,) unit vector against gravity; None if the accelerations do not determine it."""
    lengths = np.linalg.norm(accelerations, axis=1)
    measured = accelerations[np.isfinite(lengths) & (lengths > 0)]
    if not len(measured):
        return None
    mean = measured.mean(axis=0)
    length = float(np.linalg.norm(mean))
    steady = length > LEAST_STEADY * float(np.linalg.norm(measured, axis=1).mean())
    return mean / length if steady else None
