"""Measurement of a printed square marker: black and white in cells where the drawing has only this color."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from lmkit.arrays import BoolArray, ByteArray, FloatArray
from lmkit.detection.pixel_sampling import mean_side
from lmkit.detection.tag_registration import TagCandidate
from lmkit.geometry.homography import homography_from_points
from lmkit.model.square_marker import SquareMarkerFamily
from lmkit.verification.flat_print import (
    CELLS,
    LEAST_CELLS,
    bow_and_blur,
    brightness,
    contrast_of,
    glare_share,
    light_at,
    margin_share,
    points_of_plane,
    pure_cells,
    unevenness_of,
    white_everywhere,
)

LEAST_SPREAD_MM = 1.1  # of a nominal print: least blur that is assumed
INNER = 0.5  # share of a cell, around its center, for its brightness
LIT_ALIKE = 0.75  # least brightness of the margin over the white cells for the margin to count as paper


@dataclass(frozen=True)
class TagPrintMeasures:
    """Measurements of one square marker in one image; None if blur leaves too few black or white cells.

    Attributes:
        side_px: mean side in the image.
        modulation: least distance of a cell from the mean of black and white, 0..1; negative on the wrong side.
        contrast: 1 - brightness of black over the brightness of the white around it.
        unevenness: scatter of the black over the contrast, without the light's gradient and the image's grain.
        margin_share: share of the white margin, one cell wide, that is white.
        glare_share: share of the black cells that shine like white.
        bow: root mean square of the border's distance from straight, over the side.
        blur: standard deviation of the edge's point spread, over the side.
    """

    side_px: float
    modulation: float
    contrast: float | None
    unevenness: float | None
    margin_share: float | None
    glare_share: float | None
    bow: float
    blur: float


def measure_tag(image: ByteArray, candidate: TagCandidate) -> TagPrintMeasures:
    """Measure a square marker that was read.

    Args:
        image: (H,W,3) BGR, 8 bit, black on white, with some room around the marker.
    """
    family, decoding = candidate.family, candidate.decoding
    H = homography_from_points(family.corners_mm, candidate.corners)
    side_px = mean_side(candidate.corners)
    bow, blur = bow_and_blur(image, H, family.half_mm)
    signs = np.where(decoding.expected, 1.0, -1.0)
    modulation = float((2 * (np.clip(decoding.cells, 0, 1) - 0.5) * signs).min())
    points = points_of_plane(family.half_mm + family.margin_mm)
    colors = light_at(image, H, points, side_px)
    darkness = _drawn(family, decoding.code, max(LEAST_SPREAD_MM, 1.15 * blur * family.side_mm))
    on_face = np.abs(points).max(axis=1) < family.half_mm
    white, black = pure_cells(1 - darkness, on_face), pure_cells(darkness, on_face)
    if min(int(white.sum()), int(black.sum())) < LEAST_CELLS:
        return TagPrintMeasures(side_px, modulation, None, None, None, None, bow, blur)
    relative = colors / white_everywhere(points, colors, white | _lit_margin(colors, darkness, on_face, white))
    return TagPrintMeasures(
        side_px=side_px,
        modulation=_modulation(relative, points, family, decoding.code),
        contrast=contrast_of(relative, black),
        unevenness=unevenness_of(relative, points, (black,)),
        margin_share=margin_share(relative, points, family.half_mm, family.margin_mm),
        glare_share=glare_share(relative, (black,)),
        bow=bow,
        blur=blur,
    )


def _modulation(relative: FloatArray, points: FloatArray, family: SquareMarkerFamily, code: int) -> float:
    """Least distance of the center of a cell, border included, from the midpoint between black and white."""
    at = np.clip((points * [1, -1] + family.half_mm) / family.cell_mm, 0, family.cells - 0.01)
    is_inner = (np.abs(at % 1 - 0.5).max(axis=1) < INNER / 2) & (np.abs(points).max(axis=1) < family.half_mm)
    column, row = at[is_inner].astype(int).T
    number = row * family.cells + column
    light = np.bincount(number, brightness(relative[is_inner])) / np.bincount(number)
    is_white = family.darkness(code).ravel() < 0.5
    white, black = np.median(light[is_white]), np.median(light[~is_white])
    signs = np.where(is_white, 1.0, -1.0)
    return float(np.minimum(signs * (2 * light - white - black) / max(white - black, 1e-6), 1).min())


def _drawn(family: SquareMarkerFamily, code: int, spread_mm: float) -> FloatArray:
    """(CELLS^2,) darkness of marker and margin, with the blur of the print."""
    cells = np.pad(family.darkness(code), family.margin_cells).astype(np.float32)
    large = cv2.resize(cells, (CELLS, CELLS), interpolation=cv2.INTER_NEAREST)
    sigma = spread_mm / (2 * (family.half_mm + family.margin_mm)) * CELLS
    return cv2.GaussianBlur(large, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE).ravel().astype(np.float64)


def _lit_margin(colors: FloatArray, darkness: FloatArray, on_face: BoolArray, white: BoolArray) -> BoolArray:
    """Cells of the margin that look like paper: with the white cells they enclose the border, and give its light."""
    light = brightness(colors)
    return pure_cells(1 - darkness, ~on_face) & (light > LIT_ALIKE * np.median(light[white]))
