"""The scale of a photographed print, from an object of known size in its plane: the sheet itself, or a bank card."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter1d

from lmkit.arrays import ByteArray, FloatArray
from lmkit.geometry.homography import homography_from_points, transform_points
from lmkit.io.template import PAPERS_MM
from lmkit.model.palette import SRGB_TO_LINEAR
from lmkit.verification.sheet_edges import is_sheet, sheet_quads

CARD_MM = (85.60, 53.98)  # ISO/IEC 7810, ID-1
REFERENCES_MM = {"bank card": CARD_MM} | {name: size for name, size in PAPERS_MM.items() if "-" not in name}
NEAR = 0.105  # largest relative error of a print's scale; papers of the same shape differ by a factor of 1.41
UNEQUAL = 0.03  # largest difference between its scales in x and y
CROOKED_DEG = 1.0
REACH_PX = 5.0  # on both sides of an outline, to search for its edge
SURE_REACH_PX = 3.0  # for sheets whose edges were found directly
PROFILES = 60  # along each side
NEAR_PX = 0.7  # largest distance from a line
AGREED = 0.5  # share of a side's profiles


@dataclass(frozen=True)
class Reference:
    """Object of known size in the print's plane.

    Attributes:
        name: name of the object.
        stretch: (x, y) true mm for one mm of the landmark's nominal drawing.
    """

    name: str
    stretch: tuple[float, float]


def find_reference(
    image: ByteArray, corners: FloatArray, nominal_mm: float, papers_mm: Sequence[tuple[float, float]] = ()
) -> Reference | None:
    """Look for a sheet or a card around or beside the landmark.

    Args:
        image: (H,W,3) BGR.
        corners: (4,2) of the landmark, px.
        nominal_mm: nominal side of the landmark.
        papers_mm: sizes of sheets from the print's manifest.
    """
    half = nominal_mm / 2
    face = np.array([[-half, half], [half, half], [half, -half], [-half, -half]])
    to_mm = np.linalg.inv(homography_from_points(face, corners))
    side_px = float(np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).mean())
    known = {**REFERENCES_MM, **{f"sheet of {w:g} x {h:g} mm": (w, h) for w, h in papers_mm}}
    outlines = _quads(image, 0.2 * side_px)
    light = SRGB_TO_LINEAR[cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), (3, 3), 0)]
    to_px, sheets = np.linalg.inv(to_mm), [size for name, size in known.items() if name != "bank card"]
    sheets += [(h, w) for w, h in sheets]
    for quad in sheet_quads(light, to_px, half, sheets, NEAR):
        fitted = _fitted(light, quad, SURE_REACH_PX)
        if fitted is not None and is_sheet(light, to_px, half, fitted):
            outlines.append(fitted)
    best: tuple[float, Reference] | None = None
    for quad in outlines:
        mm = transform_points(to_mm, quad)
        for name, (long_mm, short_mm) in known.items():
            found = _match(mm, (short_mm, long_mm)) or _match(mm, (long_mm, short_mm))
            if found is not None and (best is None or found[0] < best[0]):
                best = (found[0], Reference(name, found[1]))
    return None if best is None else best[1]


def _match(mm: FloatArray, size: tuple[float, float]) -> tuple[float, tuple[float, float]] | None:
    """(deviation, stretch) if the quad, in the landmark's mm, is nearly a rectangle of this size; else None."""
    mm = np.roll(mm, -int(np.argmin(mm @ [1.0, -1.0])), axis=0)  # start at the top left
    edges = np.roll(mm, -1, axis=0) - mm
    lengths = np.linalg.norm(edges, axis=1)
    width, height = (lengths[0] + lengths[2]) / 2, (lengths[1] + lengths[3]) / 2
    cosines = np.sum(edges * np.roll(edges, -1, axis=0), axis=1) / (lengths * np.roll(lengths, -1))
    crooked = float(np.degrees(np.abs(np.arcsin(np.clip(cosines, -1, 1))).max()))
    stretch = (float(size[0] / width), float(size[1] / height))
    uneven = abs(lengths[0] / lengths[2] - 1) + abs(lengths[1] / lengths[3] - 1)
    if (
        crooked > CROOKED_DEG
        or uneven > 0.02
        or max(abs(s - 1) for s in stretch) > NEAR
        or abs(stretch[0] / stretch[1] - 1) > UNEQUAL
    ):
        return None
    # If it is rotated relative to the landmark, its sides are not along the landmark's axes.
    turned = float(np.degrees(abs(np.arctan2(edges[0, 1], edges[0, 0]))))
    if turned > 3.0:
        mean = (stretch[0] + stretch[1]) / 2
        stretch = (mean, mean)
    # Of two outlines with common sides, the sheet's has the more equal scales in x and y.
    return crooked + 100 * uneven + 50 * abs(stretch[0] / stretch[1] - 1), stretch


def _quads(image: ByteArray, least_px: float) -> list[FloatArray]:
    """Outlines that are nearly quadrilaterals, brighter or darker than around them, clockwise."""
    found = []
    gray = cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), (3, 3), 0)
    light = SRGB_TO_LINEAR[gray]
    level, bright = cv2.threshold(gray, 0, 255, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    masks = [bright]
    masks += [cv2.inRange(gray, np.array(level * share), np.array(255.0)) for share in (0.6, 0.8, 1.2, 1.5)]
    masks += [cv2.bitwise_not(mask) for mask in masks]
    for mask in masks:
        contours, tree = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
        for contour, parent in zip(contours, tree[0, :, 3] if len(contours) else [], strict=True):
            # Holes are outlines in the other mask.
            if parent >= 0 or len(contour) < 4 * least_px:
                continue
            hull = cv2.convexHull(contour)
            area = cv2.contourArea(hull)
            if len(hull) < 4 or area < least_px**2:
                continue
            quad = cv2.approxPolyN(hull.astype(np.float32), 4, None, -1.0, True)
            if quad is None or quad.shape[1] != 4 or area < 0.985 * cv2.contourArea(quad):
                continue
            found.append(_fitted(light, quad[0].astype(np.float64)))
    return [quad for quad in found if quad is not None]


def _fitted(light: FloatArray, quad: FloatArray, reach: float = REACH_PX) -> FloatArray | None:
    """The quad with its sides moved to the steepest change of linear brightness; None if there is no clear change.

    Each side is the line on which most profiles agree, so the background of a sheet does not shift its edge.
    """
    x, y = quad.T
    if np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) < 0:
        quad = quad[::-1]
    across = np.linspace(-reach, reach, round(8 * reach) + 1)
    shares = np.linspace(0.04, 0.96, PROFILES)
    lines = []
    for a, b in zip(quad, np.roll(quad, -1, axis=0), strict=True):
        along = (b - a) / np.linalg.norm(b - a)
        outward = np.array([along[1], -along[0]])
        starts = a + shares[:, None] * (b - a)
        at = (starts[:, None] + across[None, :, None] * outward).astype(np.float32)
        seen = cv2.remap(light, at[:, :, 0], at[:, :, 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        place, step = _steepest(gaussian_filter1d(seen, 4.0, axis=1), across)
        line = _agreed_line(shares, place, step)
        if line is None:
            return None
        slope, offset = line
        ends = [a + offset * outward, b + (slope + offset) * outward]
        normal = np.array([ends[1][1] - ends[0][1], ends[0][0] - ends[1][0]])
        lines.append((normal, float(normal @ ends[0])))
    corners = []
    for (n1, d1), (n2, d2) in zip([lines[-1], *lines[:-1]], lines, strict=True):
        if abs(np.linalg.det([n1, n2])) < 0.1 * np.linalg.norm(n1) * np.linalg.norm(n2):
            return None
        corners.append(np.linalg.solve([n1, n2], [d1, d2]))
    return np.array(corners)


def _steepest(seen: FloatArray, across: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(place, steepness) of every profile's steepest change, between samples by a parabola."""
    steep = np.abs(np.gradient(seen, axis=1))
    k = np.clip(np.argmax(steep, axis=1), 1, steep.shape[1] - 2)
    rows = np.arange(len(seen))
    before, here, after = (steep[rows, k + d] for d in (-1, 0, 1))
    second = before - 2 * here + after
    shift = np.where(second < 0, 0.5 * (before - after) / np.where(second < 0, second, 1.0), 0.0)
    return across[k] + np.clip(shift, -1, 1) * (across[1] - across[0]), here


def _agreed_line(shares: FloatArray, place: FloatArray, step: FloatArray) -> tuple[float, float] | None:
    """(slope, offset) of the line on which most of the profiles' edges lie, or None if few do."""
    clear = step > 0.25 * np.quantile(step, 0.75)
    i, j = np.triu_indices(len(shares), len(shares) // 3)
    slopes = (place[j] - place[i]) / (shares[j] - shares[i])
    offsets = place[i] - slopes * shares[i]
    near = np.abs(place - slopes[:, None] * shares - offsets[:, None]) < NEAR_PX
    best = int(np.argmax((near & clear).sum(axis=1)))
    kept = near[best] & clear
    for _ in range(3):
        if kept.mean() < AGREED:
            return None
        slope, offset = np.polyfit(shares[kept], place[kept], 1)
        kept = clear & (np.abs(place - slope * shares - offset) < NEAR_PX)
    return float(slope), float(offset)
