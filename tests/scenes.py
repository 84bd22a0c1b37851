"""Printed landmarks put into real photographs: rasterized by a foreign renderer, warped, blurred, noised.

Nothing here comes from lmkit's own imaging model: the print is a PDF drawn by pypdfium2 or
pdftoppm, the image is a real photograph, the warp is OpenCV's on an oversampled grid.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import cv2
import numpy as np
import pypdfium2

from lmkit.generation.pdf import pages_to_pdf
from lmkit.generation.sheet import compose_landmark_page
from lmkit.io.template import load_template
from lmkit.model.landmark import LM8

DPI = 150
OVERSAMPLE = 4
MM = DPI / 25.4
LINEAR = (np.arange(256, dtype=np.float32) / 255) ** 2.2


@lru_cache(maxsize=1)
def all_codes_pdf() -> bytes:
    template = load_template("a4")
    return pages_to_pdf([compose_landmark_page(LM8, code, 180.0, template) for code in range(256)], "all codes")


@lru_cache(maxsize=1)
def _all_codes() -> pypdfium2.PdfDocument:
    return pypdfium2.PdfDocument(all_codes_pdf())


@lru_cache(maxsize=16)  # 6.5 MB each
def sheet_by_pdfium(code: int) -> np.ndarray:
    """(H,W,3) BGR of the whole A4 sheet at 150 dpi."""
    return _all_codes()[code].render(scale=DPI / 72).to_numpy()


def to_linear(image: np.ndarray) -> np.ndarray:
    """Linear light, float32, of uint8 code values of the same shape."""
    return cv2.LUT(image, LINEAR)


def to_code_values(linear: np.ndarray) -> np.ndarray:
    return np.round(np.clip(linear, 0, 1) ** (1 / 2.2) * 255).astype(np.uint8)


def tilted_square(center, side_px: float, tilt_deg: float, rng: np.random.Generator) -> np.ndarray:
    """(4,2) corners of a square tilted about a random axis, seen in perspective from five sides away."""
    axis, roll = rng.uniform(0, 2 * np.pi, 2)
    t = np.deg2rad(tilt_deg)
    a = np.array([np.cos(axis), np.sin(axis), 0])
    K = np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
    tilt = np.eye(3) + np.sin(t) * K + (1 - np.cos(t)) * K @ K
    roll = 0.4 * np.sin(roll)
    turn = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
    square = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])
    points = square @ (tilt @ turn).T
    return np.asarray(center) + side_px * points[:, :2] * 5 / (5 + points[:, 2:])


def paste_landmark(
    photograph: np.ndarray,
    code: int,
    center,
    side_px: float,
    tilt_deg: float,
    rng: np.random.Generator,
    blur_px: float = 0.7,
    noise: float = 2.0,
    sheet: Callable[[int], np.ndarray] = sheet_by_pdfium,
) -> tuple[np.ndarray, np.ndarray]:
    """The photograph with the sheet in it, and the (4,2) true outer corners of its red border."""
    corners = tilted_square(center, side_px, tilt_deg, rng)
    face = np.array(load_template("a4").centre_mm) + 90.0 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return put_sheet(photograph, to_linear(sheet(code)), face, corners, rng, blur_px, noise), corners


def put_sheet(photograph, paper, face_mm, corners, rng, blur_px, noise, light=0.8):
    """Warp linear-light ``paper`` so that its points ``face_mm`` land on ``corners`` of the photograph."""
    S = OVERSAMPLE
    low = np.maximum(np.floor(corners.min(axis=0) - 0.6 * np.ptp(corners, axis=0)).astype(int), 0)
    high = np.minimum(
        np.ceil(corners.max(axis=0) + 1.0 * np.ptp(corners, axis=0)).astype(int), photograph.shape[1::-1]
    )
    width, height = high - low
    # Texture pixel k covers [k, k+1) of the paper; window pixel k at S-fold covers [k, k+1) / S.
    source = (face_mm * MM - 0.5).astype(np.float32)
    target = ((corners - low + 0.5) * S - 0.5).astype(np.float32)
    shrink = max(1, int(180 * MM / (np.ptp(corners, axis=0).min() * S) / 1.5))
    if shrink > 1:
        paper = cv2.resize(paper, None, fx=1 / shrink, fy=1 / shrink, interpolation=cv2.INTER_AREA)
        scale = np.array(paper.shape[1::-1]) / np.array([210, 297]) / MM
        source = ((face_mm * MM) * scale - 0.5).astype(np.float32)
    H = cv2.getPerspectiveTransform(source, target)
    size = (int(width * S), int(height * S))
    layer = cv2.warpPerspective(light * paper, H, size, flags=cv2.INTER_LINEAR)
    alpha = cv2.warpPerspective(np.ones(paper.shape[:2], np.float32), H, size, flags=cv2.INTER_LINEAR)
    window = to_linear(photograph[low[1] : high[1], low[0] : high[0]])
    behind = cv2.resize(window, size, interpolation=cv2.INTER_LINEAR)
    mixed = cv2.blendLinear(layer, behind, alpha, 1 - alpha)
    mixed = cv2.GaussianBlur(mixed, (0, 0), blur_px * S)
    pixels = cv2.resize(mixed, (int(width), int(height)), interpolation=cv2.INTER_AREA)
    values = to_code_values(pixels).astype(np.float32) + rng.normal(0, noise, pixels.shape)
    result = photograph.copy()
    covered = cv2.resize(alpha, (int(width), int(height)), interpolation=cv2.INTER_AREA) > 0
    covered = cv2.dilate(covered.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    result[low[1] : high[1], low[0] : high[0]][covered] = np.clip(np.round(values), 0, 255).astype(np.uint8)[covered]
    return result
