"""Measurement of a printed ring landmark: white, red and blue in cells where the drawing has only this color."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lmkit.arrays import BoolArray, ByteArray, FloatArray
from lmkit.detection.pattern_model import LandmarkPattern
from lmkit.detection.register_and_decode import Candidate
from lmkit.geometry.homography import homography_from_points
from lmkit.model.palette import BLUE, RED, srgb_to_linear
from lmkit.verification.flat_print import (
    LEAST_CELLS,
    bow_and_blur,
    contrast_of,
    glare_share,
    light_at,
    margin_share,
    points_of_plane,
    pure_cells,
    unevenness_of,
    white_everywhere,
)

# Linear sRGB to CIE XYZ (IEC 61966-2-1).
RGB_TO_XYZ = np.array(
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]],
)


@dataclass(frozen=True)
class PrintMeasures:
    """Measurements of one landmark in one image; None if blur leaves too few cells of one ink.

    Attributes:
        side_px: mean side in the image.
        modulation: least distance of a gap from the midpoint between ring and ground, 0..1.
        red_contrast, blue_contrast: 1 - brightness of the ink over the brightness of the white around it.
        red_distance, blue_distance: CIEDE2000 between the ink relative to its white and the ink in the file.
        unevenness: scatter of the inks over the contrast, without the light's gradient and the image's grain.
        margin_share: share of the white margin that is white.
        glare_share: share of the inked cells that shine like white.
        bow: root mean square of the border's distance from straight, over the side.
        blur: standard deviation of the edge's point spread, over the side.
    """

    side_px: float
    modulation: float
    red_contrast: float | None
    blue_contrast: float | None
    red_distance: float | None
    blue_distance: float | None
    unevenness: float | None
    margin_share: float | None
    glare_share: float | None
    bow: float
    blur: float


def measure_print(image: ByteArray, candidate: Candidate) -> PrintMeasures:
    """Measure a landmark that was read.

    Args:
        image: (H,W,3) BGR, 8 bit, with some room around the landmark.
    """
    family = candidate.family
    reach = family.half_mm + family.margin_mm
    H = homography_from_points(family.corners_mm, candidate.corners)
    points = points_of_plane(reach)
    side_px = float(np.linalg.norm(np.roll(candidate.corners, -1, axis=0) - candidate.corners, axis=1).mean())
    bow, blur = bow_and_blur(image, H, family.half_mm)

    colors = light_at(image, H, points, side_px)
    # Cells surrounded by one ink within the radius of the blur.
    variance = (max(1.2, 1.3 * blur * family.side_mm)) ** 2
    gaps = np.flatnonzero(family.gaps(candidate.decoding.code)).tolist()
    covariances = np.tile([variance, 0.0, variance], (len(points), 1))
    (inks,) = LandmarkPattern(family).inks(points, covariances, gaps, 0)
    on_face = np.abs(points).max(axis=1) < family.half_mm
    modulation = float(2 * np.abs(candidate.decoding.parts[2:] - 0.5).min())
    white, red, blue = (pure_cells(inks[:, k], on_face) for k in range(3))
    if min(int(ink.sum()) for ink in (white, red, blue)) < LEAST_CELLS:
        return PrintMeasures(side_px, modulation, None, None, None, None, None, None, None, bow, blur)
    relative = colors / white_everywhere(points, colors, white)
    return PrintMeasures(
        side_px=side_px,
        modulation=modulation,
        red_contrast=contrast_of(relative, red),
        blue_contrast=contrast_of(relative, blue),
        red_distance=_distance(relative, red, RED),
        blue_distance=_distance(relative, blue, BLUE),
        unevenness=unevenness_of(relative, points, (red, blue)),
        margin_share=margin_share(relative, points, family.half_mm, family.margin_mm),
        glare_share=glare_share(relative, (red, blue)),
        bow=bow,
        blur=blur,
    )


def _distance(relative: FloatArray, ink: BoolArray, rgb: tuple[int, int, int]) -> float:
    """CIEDE2000 between the median color, with its white as D65, and the color in the file."""
    from skimage.color import deltaE_ciede2000, xyz2lab

    seen = np.median(relative[ink], axis=0)
    wanted = srgb_to_linear(np.array(rgb) / 255)
    a, b = (xyz2lab((RGB_TO_XYZ @ color)[None, None])[0, 0] for color in (np.clip(seen, 0, 1), wanted))
    return float(deltaE_ciede2000(a, b))
