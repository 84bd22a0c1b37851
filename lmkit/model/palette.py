"""The landmark's colors (docs/landmark.md, section 2), and the one sRGB transfer curve."""

from __future__ import annotations

import numpy as np

from lmkit.arrays import Float32Array, FloatArray

Rgb = tuple[int, int, int]

RED: Rgb = (237, 28, 36)
BLUE: Rgb = (0, 84, 166)
WHITE: Rgb = (255, 255, 255)
BLACK: Rgb = (0, 0, 0)


def srgb_to_linear(value: FloatArray) -> FloatArray:
    """sRGB values in 0..1 to linear light in 0..1 (IEC 61966-2-1)."""
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(value: FloatArray) -> FloatArray:
    """Linear light in 0..1 to sRGB values in 0..1; the inverse of :func:`srgb_to_linear`."""
    return np.where(value <= 0.0031308, value * 12.92, 1.055 * np.clip(value, 0, None) ** (1 / 2.4) - 0.055)


# Linear light of the 256 code values, to be indexed with an image.
SRGB_TO_LINEAR: Float32Array = srgb_to_linear(np.arange(256) / 255).astype(np.float32)
