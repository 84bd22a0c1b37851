"""Sub-pixel registration: the whole pattern fitted to the picture's own pixels, in linear light.

Gauss-Newton over the four corners, the point spread (three numbers, so motion blur too) and, where
the lens is not known, one radial bend about the picture's centre.  The inks are eliminated
(variable projection), so white, red and blue are whatever the light makes them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.detection.hypotheses import RIDGE, all_hypotheses, solve_inks
from lmkit.detection.linear_image import LinearImage, rebend, unbend
from lmkit.detection.pattern_model import INKS, LandmarkPattern
from lmkit.detection.pixel_sampling import PixelSamples, Registration, mean_side, value_variance
from lmkit.geometry.homography import homographies_from_points, homography_from_points
from lmkit.model.landmark import LandmarkFamily

PIXEL_VARIANCE = 1 / 12  # of a box one pixel wide
MIN_SPREAD = 0.04  # px^2, for pictures sharper than any lens, such as rasterised pages
BEND_PRIOR = 0.12  # standard deviation of the radial bend, relative at half the picture's width
# What demosaicing, sharpening and JPEG do that no part of the model knows, per coordinate, whatever the landmark.
MODEL_ERROR_PX = 0.035
# The mosaic errs along edges, and few pixels of edge do not even that out: the variance that the residuals show is
# too small by 1 + (this / side)^2.  From simulated pictures with sides of 16 to 100 px (benchmarks/corners.py), most
# of them upright, where all of an edge meets the same colours; turned ones err less.  Without a mosaic, errors and
# residuals both fall to a fifth.  Lenses and paper come on top (`CORNER_FLOOR_PX`).
FEW_EDGES_PX = 27.0
BLEED_PRIOR = 0.1  # standard deviation of the bleed
SHADING_PRIOR = 0.05  # standard deviation of the relative change of light over half the side
MAX_SHADING = 0.6
MAX_BEND = 0.3
MAX_BLEED = 1.0


@dataclass(frozen=True)
class CodeHypothesis:
    """What is assumed about gaps and triangle while registering.

    Attributes:
        open_gaps: gap positions of the quad's frame that are open.
        quarter: quarter turn of the triangle, clockwise.
    """

    open_gaps: tuple[int, ...]
    quarter: int

    @classmethod
    def of(cls, family: LandmarkFamily, code: int, quarter: int) -> CodeHypothesis:
        """This code in this quarter turn."""
        selection = all_hypotheses(family).selections[quarter * family.code_count + code]
        return cls(tuple(int(k) for k in np.flatnonzero(selection[-family.gap_count :, 2])), quarter)


@dataclass(frozen=True)
class _Linearised:
    """A registration's error and its slopes.

    Attributes:
        error: sum of squared residuals over their expected variance, per value, priors included.
        normal, gradient: (15,15) J'WJ and (15,) J'Wr; parameters: corners, spread, bend, shading, bleed.
    """

    error: float
    normal: FloatArray
    gradient: FloatArray


class PatternRegistration:
    """Gauss-Newton on one landmark; holds the family and the picture."""

    def __init__(self, picture: LinearImage, family: LandmarkFamily) -> None:
        self.picture = picture
        self.family = family
        self.pattern = LandmarkPattern(family)

    def register(
        self,
        start: Registration,
        pixels: PixelSamples,
        reading: CodeHypothesis,
        iterations: int,
        fit_bend: bool = False,
        to_px: float = 0.01,
    ) -> Registration:
        """Improve a registration; never returns a worse one than ``start`` on these pixels.

        Ends after ``iterations`` steps, or when no corner moved more than ``to_px``.
        """
        here = self._linearise(start, pixels, reading, fit_bend)
        current = replace(start, weighted_error=here.error)
        damping = 1e-3
        for _ in range(iterations):
            for _ in range(4):
                step = -np.linalg.solve(here.normal + damping * np.diag(np.diag(here.normal)), here.gradient)
                # No corner moves further than a quarter of the side at once.
                limit = 0.25 * mean_side(current.corners)
                step *= min(1.0, limit / max(np.abs(step[:8]).max(), 1e-9))
                trial = _moved(current, step)
                if _is_sane(trial.corners):
                    there = self._linearise(trial, pixels, reading, fit_bend)
                    if there.error < here.error:
                        break
                damping *= 10
            else:
                break
            gain = 1 - there.error / here.error
            here, current = there, replace(trial, weighted_error=there.error)
            damping = max(damping * 0.1, 1e-6)
            if np.abs(step[:8]).max() < to_px or gain < 1e-5:
                break
        return current

    def robust_weights(
        self, registration: Registration, pixels: PixelSamples, reading: CodeHypothesis
    ) -> PixelSamples:
        """The same pixels with more variance where the model fails: what hides or reflects there.

        Cauchy weights on the scatter of all pixels; a pole or a hand over one side then no longer
        drags the corners along.
        """
        variance = value_variance(pixels.values, pixels.light, self.picture.noise)
        off = pixels.values - self.drawn(registration, pixels, reading)
        misfit = np.sqrt(np.mean(off**2, axis=1) / variance)
        scale = 2.5 * max(float(np.median(misfit)), 1e-6)
        return replace(
            pixels,
            variance=variance * (1 + (misfit / scale) ** 2),
            prior_weight=float(np.median(misfit**2)) / 0.79,
        )

    def with_covariance(
        self, registration: Registration, pixels: PixelSamples, reading: CodeHypothesis, fit_bend: bool
    ) -> Registration:
        """The same registration with the covariance of its corners.

        The residuals' own scatter sets the scale; neighbouring pixels share their errors
        (demosaicing, JPEG), so they count as ``CORRELATED_PIXELS`` times fewer.
        """
        here = self._linearise(registration, pixels, reading, fit_bend)
        known = [*range(8), 11]
        covariance = np.linalg.inv(here.normal)[np.ix_(known, known)] * (here.error * CORRELATED_PIXELS)
        return replace(registration, weighted_error=here.error, covariance=covariance)

    def picture_corners(self, registration: Registration) -> tuple[FloatArray, FloatArray]:
        """(4,2) corners in the picture as delivered, bend and all, and their (8,8) covariance."""
        assert registration.covariance is not None
        centre, half_width = self.picture.centre, self.picture.half_width

        def seen(corners: FloatArray, bend: float) -> FloatArray:
            return self.picture.distorted(rebend(corners, bend, centre, half_width))

        corners = seen(registration.corners, registration.bend)
        delta = 1e-4
        J = np.zeros((8, 9))
        for k, step in enumerate(np.eye(8) * delta):
            J[:, k] = (seen(registration.corners + step.reshape(4, 2), registration.bend) - corners).ravel() / delta
        J[:, 8] = (seen(registration.corners, registration.bend + delta) - corners).ravel() / delta
        too_small = 1 + (FEW_EDGES_PX / mean_side(corners)) ** 2
        return corners, too_small * (J @ registration.covariance @ J.T) + MODEL_ERROR_PX**2 * np.eye(8)

    def points_and_spread(
        self, registration: Registration, at: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(N,2) positions in the landmark's plane, (N,3) point spread there, (N,2,2) d plane / d pixel."""
        H = homography_from_points(self.family.corners_mm, registration.corners)
        inverse = np.linalg.inv(H)
        flat = unbend(at, registration.bend, self.picture.centre, self.picture.half_width)
        h = flat @ inverse[:, :2].T + inverse[:, 2]
        points = h[:, :2] / h[:, 2:]
        A = (inverse[None, :2, :2] - points[:, :, None] * inverse[None, 2:, :2]) / h[:, 2, None, None]
        return points, _spread_in_plane(A, registration.spread), A

    def design(self, registration: Registration, pixels: PixelSamples, reading: CodeHypothesis) -> FloatArray:
        """(N,4) ink coverage at the pixels."""
        points, spread, _ = self.points_and_spread(registration, pixels.at)
        (inks,) = self.pattern.inks(points, spread, reading.open_gaps, reading.quarter)
        return np.asarray(inks * self.light(registration, points)[:, None])

    def _inks(self, registration: Registration, design: FloatArray, pixels: PixelSamples) -> FloatArray:
        """(4,3) the inks at their best."""
        inks = solve_inks(design, pixels.values, 1 / pixels.variance)
        if registration.bleed == 0.0:
            return inks
        unbled = pixels.values - registration.bleed * blending(design[None], inks)[0]
        return solve_inks(design, unbled, 1 / pixels.variance)

    def drawn(self, registration: Registration, pixels: PixelSamples, reading: CodeHypothesis) -> FloatArray:
        """(N,3) what the pixels would be."""
        design = self.design(registration, pixels, reading)
        inks = self._inks(registration, design, pixels)
        return np.asarray(design @ inks + registration.bleed * blending(design[None], inks)[0])

    def light(self, registration: Registration, points: FloatArray) -> FloatArray:
        """(N,) relative light at points of the landmark's plane."""
        return np.asarray(np.maximum(1 + points / self.family.half_mm @ registration.shading, 0.1))

    def _linearise(
        self, registration: Registration, pixels: PixelSamples, reading: CodeHypothesis, fit_bend: bool
    ) -> _Linearised:
        n = len(pixels.at)
        points, spread, A = self.points_and_spread(registration, pixels.at)
        light = self.light(registration, points)[:, None]
        jets = self.pattern.inks(points, spread, reading.open_gaps, reading.quarter, slopes=True) * light
        design = jets[0]
        root = 1 / np.sqrt(pixels.variance)
        inks = self._inks(registration, design, pixels)
        blends = blending(jets, inks)
        # (6,N,3) colours and their slopes in the plane.
        drawn = jets @ inks + registration.bleed * blends
        residual = (pixels.values - drawn[0]) * root[:, None]

        # (N,3) d model / d unbent pixel.
        by_pixel = [drawn[1] * A[:, 0, x, None] + drawn[2] * A[:, 1, x, None] for x in (0, 1)]
        moves = self._moves(registration, points)  # (8,2,N)
        J = np.zeros((PARAMETERS, n, 3))
        # At a fixed pixel the pattern moves the other way.
        J[:8] = moves[:, 0, :, None] * by_pixel[0] + moves[:, 1, :, None] * by_pixel[1]
        for k, unit in enumerate(np.eye(3)):
            by_unit = _spread_in_plane(A, unit - PIXEL_VARIANCE * np.array([1, 0, 1]))
            J[8 + k] = -sum(drawn[3 + m] * by_unit[:, m, None] for m in range(3))
        if fit_bend:
            offset = pixels.at - self.picture.centre
            radial = offset * (np.sum(offset**2, axis=1, keepdims=True) / self.picture.half_width**2)
            J[11] = -(by_pixel[0] * radial[:, :1] + by_pixel[1] * radial[:, 1:])
        lit = drawn[0] / light
        J[12:14] = -lit * (points.T[:, :, None] / self.family.half_mm)
        J[14] = -blends[0]
        J *= root[:, None]
        flat = J.reshape(PARAMETERS, n * 3)
        # Variable projection (Kaufman 1975): take out what the inks could explain.
        weighted = design * root[:, None]
        gram = weighted.T @ weighted
        gram += RIDGE * np.trace(gram) / INKS * np.eye(INKS)
        seen = np.linalg.solve(np.linalg.cholesky(gram), (weighted.T @ J).transpose(1, 0, 2).reshape(INKS, -1))
        by_inks = seen.reshape(INKS, PARAMETERS, 3).transpose(1, 0, 2).reshape(PARAMETERS, -1)
        normal = flat @ flat.T - by_inks @ by_inks.T
        gradient = flat @ residual.ravel()
        if fit_bend:
            normal[11, 11] += pixels.prior_weight / BEND_PRIOR**2
            gradient[11] += pixels.prior_weight * registration.bend / BEND_PRIOR**2
        else:
            normal[11, 11] = 1e12
        normal[12:14, 12:14] += pixels.prior_weight * np.eye(2) / SHADING_PRIOR**2
        gradient[12:14] += pixels.prior_weight * registration.shading / SHADING_PRIOR**2
        normal[14, 14] += pixels.prior_weight / BLEED_PRIOR**2
        gradient[14] += pixels.prior_weight * registration.bleed / BLEED_PRIOR**2
        normal[8:11, 8:11] += 1e-3 * np.eye(3)
        normal[:8, :8] += 1e-6 * np.eye(8)
        prior = (registration.bend / BEND_PRIOR) ** 2 + (registration.bleed / BLEED_PRIOR) ** 2
        prior += np.sum((registration.shading / SHADING_PRIOR) ** 2)
        error = float((np.sum(residual**2) + pixels.prior_weight * prior) / residual.size)
        return _Linearised(error, normal, gradient)

    def _moves(self, registration: Registration, points: FloatArray) -> FloatArray:
        """(8,2,N) how a point of the pattern moves in the picture with every corner coordinate."""
        delta = 1e-3
        corners = registration.corners
        changed = corners + delta * np.eye(8).reshape(8, 4, 2)
        H = homographies_from_points(self.family.corners_mm, np.concatenate([corners[None], changed]))
        h = H @ np.vstack([points.T, np.ones(len(points))])
        at = h[:, :2] / h[:, 2:]
        return np.asarray((at[1:] - at[:1]) / delta)


PARAMETERS = 15  # corners, spread, bend, shading, bleed


def blending(jets: FloatArray, inks: FloatArray) -> FloatArray:
    """(...,N,3) where inks blend: the variance of the light within a pixel's view, over the white's.

    If the picture's tone curve is not the one that was undone, a blend of two inks does not have
    the mean of their values.  To second order it is off by half the curve's second derivative times
    this, whatever the curve: white bleeds over dark, or dark over white, and the square shrinks or
    grows.

    Args:
        jets: (J,N,4) coverage by the inks and, behind it, its slopes.
        inks: (4,3) linear-light BGR.
    """
    white = np.maximum(inks[0], 1e-3)
    mean, square = jets @ inks, jets @ inks**2
    spread = square - mean[:1] * np.where(np.arange(len(jets))[:, None, None] == 0, 1.0, 2.0) * mean
    return np.asarray(spread / white)


CORRELATED_PIXELS = 3.0


def _spread_in_plane(A: FloatArray, spread: FloatArray) -> FloatArray:
    """(N,3) point spread in the landmark's plane, mm^2, from (3,) px^2 and (N,2,2) d plane / d pixel."""
    xx, xy, yy = spread[0] + PIXEL_VARIANCE, spread[1], spread[2] + PIXEL_VARIANCE
    a, b, c, d = A[:, 0, 0], A[:, 0, 1], A[:, 1, 0], A[:, 1, 1]
    sxx = a * a * xx + 2 * a * b * xy + b * b * yy
    sxy = a * c * xx + (a * d + b * c) * xy + b * d * yy
    syy = c * c * xx + 2 * c * d * xy + d * d * yy
    return np.column_stack([sxx, sxy, syy])


def _moved(registration: Registration, step: FloatArray) -> Registration:
    return replace(
        registration,
        corners=registration.corners + step[:8].reshape(4, 2),
        spread=_positive(registration.spread + step[8:11]),
        bend=float(np.clip(registration.bend + step[11], -MAX_BEND, MAX_BEND)),
        shading=np.clip(registration.shading + step[12:14], -MAX_SHADING, MAX_SHADING),
        bleed=float(np.clip(registration.bleed + step[14], -MAX_BLEED, MAX_BLEED)),
    )


def _positive(spread: FloatArray) -> FloatArray:
    """The nearest allowed point spread: eigenvalues from MIN_SPREAD to (8 px)^2."""
    values, vectors = np.linalg.eigh(np.array([[spread[0], spread[1]], [spread[1], spread[2]]]))
    S = vectors @ np.diag(np.clip(values, MIN_SPREAD, 64.0)) @ vectors.T
    return np.array([S[0, 0], S[0, 1], S[1, 1]])


def _is_sane(corners: FloatArray) -> bool:
    """Convex, clockwise, and not collapsed."""
    edges = np.roll(corners, -1, axis=0) - corners
    following = np.roll(edges, -1, axis=0)
    turn = edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0]
    lengths = np.linalg.norm(edges, axis=1)
    return bool((turn > 0.02 * lengths * np.roll(lengths, -1)).all() and lengths.min() > 2)
