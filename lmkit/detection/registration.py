"""Sub-pixel registration: the whole pattern fitted to the image's own pixels, in linear light.

Gauss-Newton over the four corners, the point spread (three numbers, so motion blur too) and, where
the lens is not known, one radial distortion about the image's center.  The inks are eliminated
(variable projection), so white, red and blue may have any color that the light gives them.
"""

from __future__ import annotations

import math

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.detection.decoding import CORRELATED_PIXELS, Decoding, decode_square, decoding_of, tables_of
from lmkit.detection.hypotheses import RIDGE
from lmkit.detection.linear_image import LinearImage
from lmkit.detection.pixel_sampling import DISTORTION, PixelSamples, mean_side, sample_pixels
from lmkit.detection.shadows import NORMALS, ShadowEdge
from lmkit.kernels.grid_pattern import GridDrawing
from lmkit.kernels.landmark_fit import CornerErrors, Fitted, LightEdge
from lmkit.kernels.mosaic import MosaicRules
from lmkit.kernels.pattern import Drawing
from lmkit.kernels.plane import STATE, View, displaced_numpy, distorted_numpy
from lmkit.kernels.registration import Hypothesis, Limits, Mosaic, Priors, Steps, register, robust_weights
from lmkit.kernels.shadow_edge import shadow_edge
from lmkit.model.families import MarkerFamily
from lmkit.model.landmark import LandmarkFamily

MIN_SPREAD = 0.04  # px^2, for images sharper than any lens, such as rasterized pages
DISTORTION_PRIOR = 0.12  # standard deviation of the radial distortion, relative at half the image's width
# Corner errors that residuals do not show.  The mosaic causes errors along edges, which do not average out over few
# pixels of edge: the variance is too small by the factor 1 + aligned (few_edges / side)^2, where `aligned` measures
# the alignment of the sides with rows and columns (`aligned_with_mosaic`).  Residuals have two parts: noise, which
# averages out over many pixels, and effects of sharpening, noise reduction, tone and JPEG at edges, which do not.
# The larger the corner error sigma expected from residuals, the larger is the second part: the variance is growth
# min(sigma / full, 1) times as large.  Edges move together: a landmark seems wider or higher, by stretch sigma over
# its eight coordinates.  The constants were fitted by likelihood on simulated cameras of four kinds
# (`benchmarks/corner_covariance.py`; decision 36), and growth was multiplied by 1.5: then 95 % of the poses by a kind
# that is left out of the fit are inside.  Errors of lenses and paper are added (`CORNER_FLOOR_PX`).
CORNER_ERRORS = CornerErrors(least=0.0036, few_edges=30.0, mosaic=2.0, growth=1.85, full=0.064, stretch=0.84)
# Standard deviation of the mixed-pixel bias.  With a larger one, color processing of cameras would shift edges
# (decision 39).
MIXED_PIXEL_PRIOR = 0.02
SHADING_PRIOR = 0.05  # standard deviation of the relative change of light over half the side
COLOR_SHIFT_PRIOR = 0.2  # standard deviation of the way from green to red and from blue to green, px
SHADOW_ROOM_PX = 8  # around the pixels in use, since the fit still moves
LIMITS = Limits(least_spread=MIN_SPREAD, most_spread=64.0, distortion=0.3, shading=0.6, bias=1.0)


class DrawingFit:
    """The fit of one drawing to the image: its state and its pixels.

    Attributes:
        state: (15,) corners (px, without distortion), point spread, distortion, shading, mixed-pixel bias; see
            :mod:`lmkit.kernels.registration`.
        samples: pixels in use, with the weights of the last registration.
        drawing: the fitted drawing.
        hypothesis: the parts of it that are drawn.
        channel_repeats: number of channels with the same light: 3 in gray images.
        mixed_pixel_prior: standard deviation of the mixed-pixel bias.
        corner_errors: model of corner errors that residuals do not show.
    """

    samples: PixelSamples
    mixed_pixel_prior = MIXED_PIXEL_PRIOR
    corner_errors = CORNER_ERRORS

    def __init__(
        self,
        image: LinearImage,
        family: MarkerFamily,
        drawing: Drawing | GridDrawing,
        corners: FloatArray,
        spread_px2: float,
    ) -> None:
        self.image = image
        self.outline = family
        self.drawing: Drawing | GridDrawing = drawing
        self.hypothesis = Hypothesis(0, 0)
        self.channel_repeats: float = 1
        self.view = View(np.round(corners.mean(axis=0)), image.center, image.half_width, family.half_mm)
        self.state: FloatArray = np.zeros(STATE)
        self.state[:8] = corners.ravel()
        self.state[8] = self.state[10] = spread_px2

    @property
    def corners(self) -> FloatArray:
        """(4,2) px of the image without distortion."""
        return self.state[:8].reshape(4, 2)

    @property
    def blur_px(self) -> float:
        """Standard deviation of the point spread, px: the geometric mean of its axes."""
        return blur_of(self.state)

    def sample(self, at_most: int, near_edges: bool) -> bool:
        """Sample pixels at the current state; False if too little of the pattern is inside the image."""
        taken = sample_pixels(self.image, self.view, self.state, self.outline, at_most, near_edges)
        if taken is not None:
            self.samples = taken
        return taken is not None

    def discount(self) -> FloatArray:
        """Down-weight pixels that the model does not fit, such as occlusions and reflections.

        Cauchy weights on the scatter of all pixels; a pole or a hand over one side then no longer
        drags the corners along.

        Returns:
            (3,N) predicted pixels.
        """
        weights = robust_weights(
            self.drawing, self.view, self.samples.plain, self._priors, self.state, self.hypothesis
        )
        self.samples.variance, self.samples.prior_weight = weights.variance, weights.prior_weight
        return weights.drawn

    def sharpen_shadow(self, at_most: int) -> None:
        """Fit the shadow's straight edge, now that the drawing is known, to this number of pixels, and remove it."""
        found = self.edge_of_light(at_most)
        if found is not None:
            self.remove_shadow(found)

    def edge_of_light(self, at_most: int) -> LightEdge | None:
        """The straight edge between two lights on the pattern; None if too little of it is inside the image."""
        if not self.sample(at_most, near_edges=False):
            return None
        bright = np.maximum(self.discount().mean(axis=0), 1e-3).astype(np.float64)
        light = np.maximum(self.samples.values.mean(axis=0), 1e-3) / bright * self.samples.light
        at = self.image.distorted(self.samples.at.T + self.view.origin)
        return LightEdge(shadow_edge(at, np.log(light), bright**2, NORMALS), at.min(axis=0), at.max(axis=0))

    def remove_shadow(self, found: LightEdge) -> None:
        """Divide the image by the light before and behind an edge, around the pattern."""
        (left, top), (right, bottom), (width, height) = found.low, found.high, self.image.size
        x0, y0 = (max(math.floor(least) - SHADOW_ROOM_PX, 0) for least in (left, top))
        x1, y1 = (
            min(math.ceil(most) + 1 + SHADOW_ROOM_PX, size) for most, size in ((right, width), (bottom, height))
        )
        light = ShadowEdge.of(found.split).light((x0, y0, x1, y1))
        self.image = self.image.renormalized((x0, y0, x1, y1), light)

    def register(self, steps: Steps, mosaic: MosaicRules | None = None) -> None:
        """Gauss-Newton steps that never increase the error, with down-weighted outliers and mosaic errors."""
        found = register(
            self.drawing,
            self.view,
            self.samples.plain,
            self._priors,
            LIMITS,
            self.state,
            self.hypothesis,
            steps,
            None if mosaic is None else Mosaic(self.samples.cells, mosaic),
        )
        self.state, self._normal, self._error = found.state, found.normal, found.error
        self.samples.variance, self.samples.prior_weight = found.variance, found.prior_weight

    @property
    def last_error(self) -> float:
        """Mean squared residual of the last :meth:`register`, priors included, over its expected variance."""
        return self._error

    def image_corners(self, fit_distortion: bool) -> tuple[FloatArray, FloatArray]:
        """(4,2) corners in the image as delivered, distortion and all, and their (8,8) covariance.

        They are those of the last :meth:`register`.  The residuals' own scatter sets the scale; neighboring pixels
        share their errors (demosaicing, JPEG), so they count as ``CORRELATED_PIXELS`` times fewer.
        """
        inverse = np.linalg.inv(self._normal)
        corners, J = self._seen_corners(fit_distortion)
        covariance = J @ inverse[:12, :12] @ J.T
        errors = self.corner_errors
        few_edges = aligned_with_mosaic(corners, errors.mosaic) * (errors.few_edges / mean_side(corners)) ** 2
        covariance *= self._error * CORRELATED_PIXELS * self.channel_repeats * (1 + few_edges)
        return corners, with_processing(corners, covariance, errors)

    def _seen_corners(self, fit_distortion: bool) -> tuple[FloatArray, FloatArray]:
        """(4,2) corners in the image, and (8,12) their slopes with the beginning of the state."""
        J = np.eye(8, DISTORTION + 1)
        distortion = float(self.state[DISTORTION])
        if self.image.camera is None and not fit_distortion and distortion == 0.0:
            return self.corners.copy(), J
        if self.image.camera is not None:
            delta = 1e-4
            steps = np.vstack([np.zeros(8), delta * np.eye(8)]).reshape(-1, 4, 2)
            seen = self.image.distorted((self.corners + steps).reshape(-1, 2)).reshape(-1, 8)
            J[:, :8] = (seen[1:] - seen[0]).T / delta
            return seen[0].reshape(4, 2), J
        corners = distorted_numpy(self.view, distortion, self.corners)
        _, by_distortion, by_seen = displaced_numpy(self.view, distortion, corners - self.view.origin)
        by_flat = np.linalg.inv(np.eye(2) + by_seen)  # d seen / d flat
        for k in range(4):
            rows = slice(2 * k, 2 * k + 2)
            J[rows, rows] = by_flat[k]
            J[rows, DISTORTION] = -by_flat[k] @ by_distortion[k]
        return corners, J

    @property
    def _priors(self) -> Priors:
        weight = self.samples.prior_weight
        return Priors(RIDGE, DISTORTION_PRIOR, SHADING_PRIOR, self.mixed_pixel_prior, weight, COLOR_SHIFT_PRIOR)


def with_processing(corners: FloatArray, scatter: FloatArray, errors: CornerErrors) -> FloatArray:
    """(8,8) covariance of (4,2) corners from the one that residuals let expect: with the camera's processing."""
    variance = float(np.trace(scatter)) / 8
    full = min(np.sqrt(variance) / errors.full, 1.0)
    grown = scatter + errors.stretch**2 * variance * stretches_of(corners)
    return np.asarray(errors.growth * full * grown + errors.least**2 * np.eye(8))


def stretches_of(corners: FloatArray) -> FloatArray:
    """(8,8) outer products of the moves that make (4,2) corners wider and higher; their trace is 2."""
    x, y = (corners - corners.mean(axis=0)).T
    zero = np.zeros(4)
    moves = np.array([np.column_stack(move).ravel() for move in ((x, zero), (zero, y))])
    return np.asarray(2 * moves.T @ moves / (x @ x + y @ y))


def blur_of(state: FloatArray) -> float:
    """Standard deviation of a state's point spread, px: the geometric mean of its axes."""
    xx, xy, yy = state[8:11].tolist()
    return float(max(xx * yy - xy * xy, 1e-6) ** 0.25)


class PatternRegistration(DrawingFit):
    """The fit of one landmark's pattern, and its decoding.

    Attributes:
        decoding: of the last :meth:`decode`.
        robust_decoding: of the last :meth:`decode_robust`.
    """

    decoding: Decoding
    robust_decoding: Decoding

    def __init__(self, image: LinearImage, family: LandmarkFamily, corners: FloatArray, spread_px2: float) -> None:
        self.family = family
        self.tables = tables_of(family)
        super().__init__(image, family, self.tables.drawing, corners, spread_px2)
        self._seen: tuple[FloatArray, FloatArray] | None = None  # corners and covariance of a compiled fit

    def image_corners(self, fit_distortion: bool) -> tuple[FloatArray, FloatArray]:
        """(4,2) corners in the image as delivered and their (8,8) covariance, after :meth:`take_over` its own."""
        return super().image_corners(fit_distortion) if self._seen is None else self._seen

    def decode(self) -> Decoding:
        """Score every code in every quarter turn, pixels weighted by the image's noise alone.

        With robust weights from the last decoding, that decoding would confirm itself.
        """
        return self._believe(decode_square(self.tables, self.view, self.state, self.samples.plain))

    def decode_robust(self) -> Decoding:
        """A copy with robust weights; :attr:`decoding` stays."""
        self.robust_decoding = decode_square(self.tables, self.view, self.state, self.samples.weighted)
        return self.robust_decoding

    def take_over(self, found: Fitted) -> None:
        """Continue from the result of a compiled fit, without its pixels."""
        self.state, self._normal, self._error = found.state, found.normal, found.error
        self._seen = found.corners, found.covariance
        self._believe(decoding_of(self.tables, found.plain, found.pixels))
        self.robust_decoding = decoding_of(self.tables, found.robust, found.pixels)

    def _believe(self, decoding: Decoding) -> Decoding:
        self.decoding = decoding
        open_gaps = int(self.tables.words.masks[decoding.quarter, decoding.code])
        self.hypothesis = Hypothesis(open_gaps, decoding.quarter)
        return decoding


def registration_at(image: LinearImage, family: LandmarkFamily, state: FloatArray) -> PatternRegistration:
    """The fit of a landmark's pattern in a (15,) state."""
    fit = PatternRegistration(image, family, state[:8].reshape(4, 2), 1.0)
    fit.state = state
    return fit


def aligned_with_mosaic(corners: FloatArray, period_px: float = CORNER_ERRORS.mosaic) -> float:
    """Alignment of the sides of (4,2) corners with rows and columns of pixels: 1 if aligned, toward 0 if not.

    The phase of the color mosaic runs through one period on every `period_px` that a side moves across the rows or
    columns it follows; the error of the side's place is the mean over those phases.
    """
    points = corners.tolist()
    sides = zip(points, points[1:] + points[:1], strict=True)
    moved = [min(abs(x - u), abs(y - v)) for (x, y), (u, v) in sides]
    return float(sum(1 / (1 + (far / period_px) ** 2) for far in moved) / 4)
