"""Kinds of cameras, each a distribution of imaging chains; some are for tuning, others for reported results.

No kind is a particular product.  Each represents a type of sensor and image processing that changes the edges and
colors of a landmark.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lmkit.simulation.mosaic import PATTERNS
from lmkit.simulation.photograph import Development, ImagingChain, Lens, Light, Sensor, Shadow

Range = tuple[float, float]
BALANCE_LIMITS_K = (2500.0, 8000.0)


@dataclass(frozen=True)
class CameraKind:
    """A kind of camera; values are drawn uniformly from a range, names with equal probability.

    Attributes:
        name: name of the kind.
        demosaics: methods of interpolation; empty for a sensor with three colors in every pixel.
        tones: tone curves.
        blur_px, corner_blur_px, lateral_color: of the lens.
        color_shift_px: length of the lens's color shift, in any direction.
        full_well: electrons at full scale, drawn log-uniformly.
        saturation, contrast, denoise, sharpen, sharpen_px: of the image processing.
        jpeg_quality: of the file; None for lossless ones.
        chroma: color sampling of the file.
    """

    name: str
    demosaics: tuple[str, ...]
    tones: tuple[str, ...]
    blur_px: Range = (0.4, 0.9)
    corner_blur_px: Range = (0.0, 0.0)
    lateral_color: Range = (0.0, 0.0)
    color_shift_px: Range = (0.0, 0.0)
    full_well: Range = (3000.0, 15000.0)
    saturation: Range = (1.0, 1.0)
    contrast: Range = (1.0, 1.0)
    denoise: Range = (0.0, 0.0)
    sharpen: Range = (0.0, 0.0)
    sharpen_px: Range = (1.0, 1.0)
    jpeg_quality: tuple[int, int] | None = None
    chroma: str = "420"

    def draw(self, rng: np.random.Generator) -> ImagingChain:
        """One camera of this kind in ordinary light, in focus and without motion."""
        lens = Lens(
            blur_px=float(rng.uniform(*self.blur_px)),
            corner_blur_px=float(rng.uniform(*self.corner_blur_px)),
            lateral_color=float(rng.uniform(*self.lateral_color)),
        )
        full_well = float(np.exp(rng.uniform(*np.log(self.full_well))))
        sensor = Sensor(full_well, read_noise=float(rng.uniform(2, 10)))
        if self.demosaics:
            pattern, how = str(rng.choice(list(PATTERNS))), str(rng.choice(self.demosaics))
            sensor = replace(sensor, bayer=True, pattern=pattern, demosaic=how)
        development = Development(
            tone=str(rng.choice(self.tones)),
            saturation=float(rng.uniform(*self.saturation)),
            contrast=float(rng.uniform(*self.contrast)),
            denoise=float(rng.uniform(*self.denoise)),
            sharpen=float(rng.uniform(*self.sharpen)),
            sharpen_px=float(rng.uniform(*self.sharpen_px)),
            jpeg_quality=None if self.jpeg_quality is None else int(rng.integers(*self.jpeg_quality)),
            chroma=self.chroma,
        )
        light = Light(brightness=float(rng.uniform(0.3, 0.9)))
        if any(self.color_shift_px):
            length, way = rng.uniform(*self.color_shift_px), rng.uniform(0, 2 * np.pi)
            lens = replace(lens, color_shift_px=(float(length * np.cos(way)), float(length * np.sin(way))))
        return ImagingChain(lens, light, sensor, development)


INDUSTRIAL = CameraKind("industrial", ("bilinear", "malvar"), ("srgb", "gamma"))
THREE_CHIP = CameraKind("three_chip", (), ("gamma", "srgb"), full_well=(1500, 8000))
WEBCAM = CameraKind(
    "webcam",
    ("bilinear",),
    ("rec709", "srgb"),
    corner_blur_px=(0.0, 1.2),
    lateral_color=(-4e-4, 4e-4),
    full_well=(1500, 6000),
    saturation=(0.6, 1.1),
    denoise=(0.0, 0.8),
    sharpen=(0.2, 2.0),
    sharpen_px=(0.8, 1.5),
    jpeg_quality=(55, 92),
)
PHONE = CameraKind(
    "phone",
    ("malvar",),
    ("filmic", "srgb"),
    saturation=(0.8, 1.3),
    contrast=(1.0, 1.25),
    denoise=(0.1, 0.7),
    sharpen=(0.3, 1.8),
    sharpen_px=(0.6, 1.2),
    jpeg_quality=(80, 96),
)
DASHCAM = CameraKind(
    "dashcam",
    ("edge_aware",),
    ("rec709",),
    corner_blur_px=(0.3, 1.5),
    lateral_color=(-8e-4, 8e-4),
    saturation=(0.7, 1.2),
    contrast=(1.0, 1.3),
    denoise=(0.0, 0.6),
    sharpen=(0.4, 1.8),
    sharpen_px=(0.7, 1.3),
    jpeg_quality=(65, 90),
)
DOORBELL = CameraKind(
    "doorbell",
    ("malvar", "edge_aware"),
    ("filmic", "gamma"),
    blur_px=(0.6, 1.1),
    full_well=(1500, 4000),
    contrast=(1.1, 1.3),
    denoise=(0.4, 0.8),
    sharpen=(0.0, 0.8),
    jpeg_quality=(70, 90),
)
TRAINING_KINDS = (INDUSTRIAL, THREE_CHIP, WEBCAM, WEBCAM, PHONE, PHONE)  # listed twice: twice as likely
HELD_OUT_KINDS = (DASHCAM, DOORBELL)


def draw_chain(
    rng: np.random.Generator,
    kinds: Sequence[CameraKind],
    trouble: float = 0.5,
    image_size: tuple[int, int] | None = None,
) -> ImagingChain:
    """A camera of one of the kinds, with random disturbances of light and motion.

    Args:
        trouble: probability of each disturbance: motion, defocus, dim light, light of another color, uneven light, a
            veil, a hard shadow.
        image_size: of the camera, for shadows; None: no shadows.
    """
    chain = kinds[int(rng.integers(len(kinds)))].draw(rng)
    motion, defocus, dim, warm, uneven, veiled, shaded = rng.random(7) < trouble
    lens, light, development = chain.lens, chain.light, chain.development
    if motion:
        way = rng.normal(0, 1.5, 2)
        lens = replace(lens, motion_px=(float(way[0]), float(way[1])))
    if defocus:
        lens = replace(lens, defocus_px=float(rng.uniform(0.3, 2.5)))
    if dim:
        light = replace(light, brightness=float(np.exp(rng.uniform(np.log(0.04), np.log(0.3)))))
    if warm:
        color_k = float(rng.uniform(2500, 8000))
        assumed_k = float(np.clip(color_k * rng.uniform(0.75, 1.3), *BALANCE_LIMITS_K))
        light, development = replace(light, temperature_k=color_k), replace(development, balanced_for_k=assumed_k)
    if uneven:
        slope = rng.uniform(-0.5, 0.5, 2)
        light = replace(light, gradient=(float(slope[0]), float(slope[1])))
    if veiled:
        light = replace(light, veil=float(rng.uniform(0.0, 0.08)))
    if shaded and image_size is not None:
        x, y = (float(rng.uniform(0.2, 0.8) * length) for length in image_size)
        light = replace(light, shadow=Shadow((x, y), float(rng.uniform(0, 360)), float(rng.uniform(1.5, 7))))
    return ImagingChain(lens, light, chain.sensor, development)
