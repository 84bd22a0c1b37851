"""The color mosaic of a sensor (one color per pixel) and the interpolation of the other colors.

A demosaicer determines the appearance of edges: bilinear interpolation leaves colored fringes, the linear filters of
Malvar, He and Cutler (ICASSP 2004) fewer, and an edge-aware one rounds corners.
"""

from __future__ import annotations

import cv2
import numpy as np

from lmkit.arrays import FloatArray
from lmkit.errors import InputError

# Color (0 red, 1 green, 2 blue) of the four pixels of a cell: top left, top right, bottom left, bottom right.
PATTERNS = {"RGGB": (0, 1, 1, 2), "BGGR": (2, 1, 1, 0), "GRBG": (1, 0, 2, 1), "GBRG": (1, 2, 0, 1)}
DEMOSAICERS = ("bilinear", "malvar", "edge_aware")
# OpenCV names a pattern by the second row's second and third pixel.
_OPENCV = {
    "bilinear": {
        "RGGB": cv2.COLOR_BayerBG2RGB,
        "BGGR": cv2.COLOR_BayerRG2RGB,
        "GRBG": cv2.COLOR_BayerGB2RGB,
        "GBRG": cv2.COLOR_BayerGR2RGB,
    },
    "edge_aware": {
        "RGGB": cv2.COLOR_BayerBG2RGB_EA,
        "BGGR": cv2.COLOR_BayerRG2RGB_EA,
        "GRBG": cv2.COLOR_BayerGB2RGB_EA,
        "GBRG": cv2.COLOR_BayerGR2RGB_EA,
    },
}
# Malvar, He and Cutler: green at a red or blue pixel; red at a green pixel in a red row, in a blue row; red at blue.
_GREEN = np.array([[0, 0, -1, 0, 0], [0, 0, 2, 0, 0], [-1, 2, 4, 2, -1], [0, 0, 2, 0, 0], [0, 0, -1, 0, 0]]) / 8
_ALONG = np.array([[0, 0, 0.5, 0, 0], [0, -1, 0, -1, 0], [-1, 4, 5, 4, -1], [0, -1, 0, -1, 0], [0, 0, 0.5, 0, 0]]) / 8
_ACROSS = (
    np.array([[0, 0, -1.5, 0, 0], [0, 2, 0, 2, 0], [-1.5, 0, 6, 0, -1.5], [0, 2, 0, 2, 0], [0, 0, -1.5, 0, 0]]) / 8
)


def check_mosaic(pattern: str, demosaic: str) -> None:
    """Refuse unknown names.

    Raises:
        InputError: no such pattern or demosaicer.
    """
    for what, name, known in (("pattern", pattern, PATTERNS), ("demosaicer", demosaic, DEMOSAICERS)):
        if name not in known:
            raise InputError("bad_imaging", f"{what} {name!r} is not known", f"known: {', '.join(known)}")


def mosaic_of(image: FloatArray, pattern: str) -> FloatArray:
    """(H,W) mosaic of (H,W,3) RGB: one color per pixel."""
    raw = np.empty(image.shape[:2])
    for k, color in enumerate(PATTERNS[pattern]):
        raw[k // 2 :: 2, k % 2 :: 2] = image[k // 2 :: 2, k % 2 :: 2, color]
    return raw


def demosaic(raw: FloatArray, pattern: str, how: str) -> FloatArray:
    """(H,W,3) RGB from (H,W) values of 0 to 1."""
    if how == "malvar":
        return np.clip(_malvar(raw, pattern), 0, 1)
    counts = np.round(raw * 65535).astype(np.uint16)
    return np.asarray(cv2.cvtColor(counts, _OPENCV[how][pattern]).astype(np.float64) / 65535)


def _malvar(raw: FloatArray, pattern: str) -> FloatArray:
    def filtered(kernel: FloatArray) -> FloatArray:
        return np.asarray(cv2.filter2D(raw, -1, kernel, borderType=cv2.BORDER_REFLECT_101))

    green, along, down, across = map(filtered, (_GREEN, _ALONG, _ALONG.T.copy(), _ACROSS))
    colors = PATTERNS[pattern]
    image = np.empty((*raw.shape, 3))
    for k, color in enumerate(colors):
        here = (slice(k // 2, None, 2), slice(k % 2, None, 2))
        beside = colors[k ^ 1]  # the other color of this row
        image[(*here, color)] = raw[here]
        if color == 1:
            image[(*here, beside)] = along[here]
            image[(*here, 2 - beside)] = down[here]
        else:
            image[(*here, 1)] = green[here]
            image[(*here, 2 - color)] = across[here]
    return image
