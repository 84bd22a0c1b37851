"""A print measured: the landmark laid flat in the image's light, and what its parts look like there.

The landmark is sampled on a grid of its own plane.  What every cell should show is known from the
drawing, so the cells that lie well inside white, red or blue tell the inks, and their scatter the
evenness; the edges of the border tell straightness and sharpness.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from lmkit.arrays import AnyArray, BoolArray, ByteArray, FloatArray
from lmkit.detection.pattern_model import LandmarkPattern
from lmkit.detection.register_and_decode import Candidate
from lmkit.geometry.homography import homography_from_points, transform_points
from lmkit.model.palette import BLUE, RED, SRGB_TO_LINEAR, srgb_to_linear

CELLS = 240  # across face and white margin
PURE = 0.985  # coverage from which a cell shows one ink alone
NEARLY_PURE = 0.9  # this will do where blur leaves fewer than LEAST_CELLS of those
LEAST_CELLS = 400
EDGE_STEPS = 41
EDGE_REACH = 0.045  # of the side, on both sides of the border's outer edge
EDGE_POINTS = 48  # along each side of the border
BEYOND = 1.3  # light outside of the white cells, over that inside
WHITE_ENOUGH = 0.7
GLARE_SHARE = 0.45  # of the way from an ink to white
# Linear sRGB to CIE XYZ (IEC 61966-2-1).
RGB_TO_XYZ = np.array(
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]],
)


@dataclass(frozen=True)
class PrintMeasures:
    """Measurements of one landmark in one image; None where blur leaves too little of an ink alone.

    Attributes:
        side_px: mean side in the image.
        modulation: least distance of a gap from half way between ring and ground, 0..1.
        red_contrast, blue_contrast: 1 - brightness of the ink over that of the white around it.
        red_distance, blue_distance: CIEDE2000 between the ink as seen against its white and the file's.
        unevenness: scatter of the inks over the contrast, light's gradient and the image's grain taken out.
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
    ticks = (np.arange(CELLS) + 0.5) / CELLS * 2 * reach - reach
    x, y = np.meshgrid(ticks, -ticks)
    points = np.column_stack([x.ravel(), y.ravel()])
    side_px = float(np.linalg.norm(np.roll(candidate.corners, -1, axis=0) - candidate.corners, axis=1).mean())
    bow, blur = _edges(image, H, family.half_mm, side_px)

    colors = _sample(image, H, points, side_px)
    # Cells whose surroundings, as far as the blur reaches, are of one ink.
    variance = (max(1.2, 1.3 * blur * family.side_mm)) ** 2
    gaps = np.flatnonzero(family.gaps(candidate.decoding.code)).tolist()
    covariances = np.tile([variance, 0.0, variance], (len(points), 1))
    (inks,) = LandmarkPattern(family).inks(points, covariances, gaps, 0)
    square = np.abs(points).max(axis=1)
    on_face = square < family.half_mm
    margin = (square > family.half_mm + 0.15 * family.margin_mm) & (square < reach - 0.1 * family.margin_mm)
    modulation = float(2 * np.abs(candidate.decoding.parts[2:] - 0.5).min())
    white, red, blue = (_pure(inks[:, k], on_face) for k in range(3))
    if min(int(ink.sum()) for ink in (white, red, blue)) < LEAST_CELLS:
        return PrintMeasures(side_px, modulation, None, None, None, None, None, None, None, bow, blur)
    relative = colors / _light(points, colors, white)
    return PrintMeasures(
        side_px=side_px,
        modulation=modulation,
        red_contrast=_contrast(relative, red),
        blue_contrast=_contrast(relative, blue),
        red_distance=_distance(relative, red, RED),
        blue_distance=_distance(relative, blue, BLUE),
        unevenness=_unevenness(relative, points, (red, blue)),
        margin_share=float((relative[margin].min(axis=1) > WHITE_ENOUGH).mean()),
        glare_share=_glare(relative, red, blue),
        bow=bow,
        blur=blur,
    )


def _sample(image: ByteArray, H: FloatArray, points: FloatArray, side_px: float) -> FloatArray:
    """(N,3) RGB in linear light at points of the landmark's plane, averaged over a cell's width."""
    at = transform_points(H, points).astype(np.float32)
    linear: AnyArray = SRGB_TO_LINEAR[image]
    if (cell_px := side_px / CELLS) > 1.5:
        size = 2 * round(cell_px / 2) + 1
        linear = cv2.blur(linear, (size, size))
    # remap takes images of less than 2^15 rows.
    seen = [cv2.remap(linear, some[:, :1], some[:, 1:], cv2.INTER_LINEAR) for some in np.array_split(at, 8)]
    return np.concatenate(seen).reshape(-1, 3)[:, ::-1].astype(np.float64)


def _pure(coverage: FloatArray, on_face: BoolArray) -> BoolArray:
    """Cells of the face that show one ink alone, or nearly."""
    pure = on_face & (coverage > PURE)
    return pure if pure.sum() >= LEAST_CELLS else np.asarray(on_face & (coverage > NEARLY_PURE))


def _light(points: FloatArray, colors: FloatArray, white: BoolArray) -> FloatArray:
    """(N,3) what white would look like everywhere: a curved surface through the white cells of the face."""
    x, y = points.T / 90
    terms = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    weights = white.astype(np.float64)
    fitted = np.zeros_like(colors)
    for _ in range(4):
        root = np.sqrt(weights)[:, None]
        coefficients = np.linalg.lstsq(terms * root, colors * root, rcond=None)[0]
        fitted = terms @ coefficients
        off = np.abs(colors - fitted).mean(axis=1) / np.maximum(fitted.mean(axis=1), 1e-3)
        # Shine and dirt do not tell the light.
        weights = white / (1 + (off / 0.05) ** 2)
    # Where blur leaves white only in the rings, the surface runs wild beyond them.
    low, high = np.percentile(colors[white], [5, 95], axis=0)
    return np.clip(fitted, np.maximum(low / BEYOND, 1e-3), high * BEYOND)


def _brightness(colors: FloatArray) -> FloatArray:
    return np.asarray(colors @ np.array([0.2126, 0.7152, 0.0722]))


def _contrast(relative: FloatArray, ink: BoolArray) -> float:
    return float(1 - np.median(_brightness(relative[ink])))


def _distance(relative: FloatArray, ink: BoolArray, rgb: tuple[int, int, int]) -> float:
    """CIEDE2000 of the median color, its white taken as D65's, to the file's."""
    from skimage.color import deltaE_ciede2000, xyz2lab

    seen = np.median(relative[ink], axis=0)
    wanted = srgb_to_linear(np.array(rgb) / 255)
    a, b = (xyz2lab((RGB_TO_XYZ @ color)[None, None])[0, 0] for color in (np.clip(seen, 0, 1), wanted))
    return float(deltaE_ciede2000(a, b))


def _unevenness(relative: FloatArray, points: FloatArray, inks: tuple[BoolArray, ...]) -> float:
    """The worse ink's scatter over its contrast, of cells averaged over 3 x 3, fitted light taken out."""
    worst = 0.0
    x, y = points.T / 90
    terms = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    smooth = cv2.blur(_brightness(relative).reshape(CELLS, CELLS), (3, 3)).ravel()
    for ink in inks:
        inner = cv2.erode(ink.reshape(CELLS, CELLS).astype(np.uint8), np.ones((3, 3), np.uint8)).ravel() > 0
        if inner.sum() < 200:
            continue
        coefficients = np.linalg.lstsq(terms[inner], smooth[inner], rcond=None)[0]
        off = smooth[inner] - terms[inner] @ coefficients
        contrast = max(1 - float(np.median(smooth[inner])), 0.05)
        # Between the 2nd and the 98th of a hundred: streaks are few, grain is everywhere.
        low, high = np.percentile(off, [2, 98])
        worst = max(worst, float(high - low) / contrast)
    return worst


def _glare(relative: FloatArray, red: BoolArray, blue: BoolArray) -> float:
    shining = 0
    for ink in (red, blue):
        seen = _brightness(relative[ink])
        middle = float(np.median(seen))
        shining += int((seen > middle + GLARE_SHARE * (1 - middle)).sum())
    return shining / int(red.sum() + blue.sum())


def _edges(image: ByteArray, H: FloatArray, half: float, side_px: float) -> tuple[float, float]:
    """(bow, blur) of the red border's outer edge, over the side; seen in green, where red is dark."""
    along = np.linspace(-0.9, 0.9, EDGE_POINTS) * half
    across = np.linspace(-EDGE_REACH, EDGE_REACH, EDGE_STEPS) * 2 * half
    green = SRGB_TO_LINEAR[image[:, :, 1]]
    places, profiles = [], []
    for normal in ((0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0)):
        n, t = np.array(normal), np.array([normal[1], -normal[0]])
        grid = (half + across)[None, :, None] * n + along[:, None, None] * t
        at = transform_points(H, grid.reshape(-1, 2)).astype(np.float32)
        seen = cv2.remap(green, at[:, :1], at[:, 1:], cv2.INTER_LINEAR).reshape(EDGE_POINTS, EDGE_STEPS)
        dark, bright = np.percentile(seen, 5, axis=1), np.percentile(seen, 95, axis=1)
        fair = bright - dark > 0.4 * np.median(bright - dark)
        step = (seen - dark[:, None]) / np.maximum(bright - dark, 1e-6)[:, None]
        # The edge lies where the area under the step says.
        place = across[-1] - np.clip(step, 0, 1).mean(axis=1) * (across[-1] - across[0])
        place = place - np.median(place[fair])
        slope = np.polyfit(along[fair], place[fair], 1)
        places.append((place - np.polyval(slope, along))[fair])
        profiles.append(np.median(step[fair], axis=0))
    bow = float(np.sqrt(np.mean([np.mean(np.clip(p, -0.05 * half, 0.05 * half) ** 2) for p in places]))) / (2 * half)
    sigmas = []
    for profile in profiles:
        rising = np.maximum.accumulate(profile)
        low, high = (float(np.interp(level, rising, across)) for level in (0.16, 0.84))
        sigmas.append((high - low) / 2)
    return bow, float(np.median(sigmas)) / (2 * half)
