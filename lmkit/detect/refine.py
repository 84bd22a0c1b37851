"""Sub-pixel registration: the whole pattern fitted to the picture's own pixels, in linear light.

Gauss-Newton over the four corners, the point spread (three numbers, so motion blur too) and, where
the lens is not known, one radial bend about the picture's centre.  The inks are eliminated
(variable projection), so white, red and blue are whatever the light makes them.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from lmkit.arrays import Float32Array, FloatArray
from lmkit.detect.decode import all_hypotheses, solve_inks
from lmkit.detect.pattern import LandmarkPattern
from lmkit.model.homography import homographies_from_points, homography_from_points, transform_points
from lmkit.model.landmark import LandmarkFamily

PIXEL_VARIANCE = 1 / 12  # of a box one pixel wide
MIN_SPREAD = 0.04  # px^2, for pictures sharper than any lens, such as rasterised pages
MAX_PIXELS = 1500
EDGE_BAND_PX = 3.0
BEND_PRIOR = 0.12  # standard deviation of the radial bend, relative at half the picture's width
SHADING_PRIOR = 0.2  # standard deviation of the relative change of light over half the side
MAX_SHADING = 0.6
STEP_MM = 0.02
SPREAD_STEP = 0.03  # px^2, below MIN_SPREAD so that a stepped spread stays a covariance
MAX_BEND = 0.3


@dataclass(frozen=True)
class Picture:
    """What registration needs of a picture.

    Attributes:
        linear: (H,W,3) BGR in linear light, 0..1.
        noise: standard deviation of the picture's noise in code values over 255.
    """

    linear: Float32Array
    noise: float

    def shrunk(self, factor: int) -> Picture:
        """The picture ``factor`` times smaller, averaged in linear light."""
        height, width = (length // factor for length in self.linear.shape[:2])
        whole = self.linear[: height * factor, : width * factor]
        small = cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)
        return Picture(np.asarray(small, dtype=np.float32), self.noise / factor)

    @property
    def centre(self) -> FloatArray:
        """(2,) the middle of the picture, px."""
        height, width = self.linear.shape[:2]
        return np.array([(width - 1) / 2, (height - 1) / 2])

    @property
    def half_width(self) -> float:
        """Half of the picture's width, px."""
        return float(self.linear.shape[1] / 2)


@dataclass(frozen=True)
class Registration:
    """Where the pattern lies and how it is blurred.

    Attributes:
        corners: (4,2) px of the picture freed of its bend.
        spread: (3,) covariance of the point spread, xx xy yy, px^2.
        bend: radial bend, see :func:`unbend`.
        shading: (2,) relative change of the light from the middle to the right and the upper edge.
        weighted_error: sum of squared residuals over their expected variance, per value.
        covariance: (9,9) of corners and bend, or None before the last step.
    """

    corners: FloatArray
    spread: FloatArray
    bend: float = 0.0
    shading: FloatArray = field(default_factory=lambda: np.zeros(2))
    weighted_error: float = np.inf
    covariance: FloatArray | None = None


@dataclass(frozen=True)
class Pixels:
    """The pixels that a registration looks at.

    Attributes:
        at: (N,2) positions, px.
        values: (N,3) BGR in linear light.
        variance: (N,) expected variance of a value, up to a common factor.
        prior_weight: that factor, so that priors weigh as they should against the values.
    """

    at: FloatArray
    values: FloatArray
    variance: FloatArray
    prior_weight: float = 10.0


def unbend(at: FloatArray, bend: float, centre: FloatArray, half_width: float) -> FloatArray:
    """Pixels freed of a radial bend: ``c + (x - c) (1 + bend r^2)``, r = 1 at half the width."""
    offset = at - centre
    r2 = np.sum(offset**2, axis=-1, keepdims=True) / half_width**2
    return np.asarray(centre + offset * (1 + bend * r2))


def rebend(at: FloatArray, bend: float, centre: FloatArray, half_width: float) -> FloatArray:
    """The inverse of :func:`unbend`, where it has one (r up to where a barrel bend folds over)."""
    offset = at - centre
    target = np.linalg.norm(offset, axis=-1, keepdims=True) / half_width
    fold = 1 / np.sqrt(3 * -bend) if bend < 0 else np.inf
    r = np.minimum(target, fold)
    for _ in range(8):
        slope = np.maximum(1 + 3 * bend * r**2, 0.05)
        r = np.clip(r - (r + bend * r**3 - target) / slope, 0, fold)
    return np.asarray(centre + offset * (r / np.maximum(target, 1e-12)))


def take_pixels(picture: Picture, registration: Registration, family: LandmarkFamily) -> Pixels | None:
    """The pixels of the face and the inner part of its margin, thinned where there are many.

    None when too little of the landmark lies inside the picture.
    """
    H = homography_from_points(family.corners_mm, registration.corners)
    reach = family.half_mm + 0.7 * family.margin_mm
    outline = transform_points(H, family.corners_mm * (reach / family.half_mm))
    outline = rebend(outline, registration.bend, picture.centre, picture.half_width)
    height, width = picture.linear.shape[:2]
    if not (np.abs(outline) < 10 * max(height, width)).all():
        return None
    x0, y0 = np.maximum(np.floor(outline.min(axis=0)).astype(int), 0)
    x1, y1 = np.minimum(np.ceil(outline.max(axis=0)).astype(int) + 1, [width, height])
    if x1 - x0 < 6 or y1 - y0 < 6:
        return None
    y, x = np.mgrid[y0:y1, x0:x1]
    at = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
    plane = transform_points(np.linalg.inv(H), unbend(at, registration.bend, picture.centre, picture.half_width))
    inside = (np.abs(plane) < reach).all(axis=1)
    at = at[inside]
    if len(at) < 40:
        return None
    if len(at) > MAX_PIXELS:
        at = at[_informative(plane[inside], _side(registration.corners) / family.side_mm, family)]
    values = picture.linear[at[:, 1].astype(int), at[:, 0].astype(int)].astype(np.float64)
    return Pixels(at, values, value_variance(values, picture.noise))


def _informative(plane: FloatArray, px_per_mm: float, family: LandmarkFamily) -> FloatArray:
    """Indices of MAX_PIXELS of the points: four of five near an edge of the drawing, where the position shows."""
    square = np.abs(plane).max(axis=1)
    radius = np.hypot(plane[:, 0], plane[:, 1])
    edges = [np.abs(square - half) for half in (family.half_mm, family.ground_half_mm)]
    edges += [np.abs(radius - r) for ring in family.rings for r in (ring.inner_mm, ring.outer_mm)]
    near = np.min(edges, axis=0) * px_per_mm < EDGE_BAND_PX
    chosen = []
    for indices, count in ((np.flatnonzero(near), 4 * MAX_PIXELS // 5), (np.flatnonzero(~near), MAX_PIXELS // 5)):
        # A fixed low-discrepancy choice: repeatable, and without the comb of a regular stride.
        golden = np.modf(np.arange(len(indices)) * 0.6180339887498949)[0]
        chosen.append(indices[golden < count / max(len(indices), 1)])
    return np.sort(np.concatenate(chosen))


def value_variance(values: FloatArray, noise: float) -> FloatArray:
    """(N,) expected variance of linear-light values: noise of the code values through the tone curve.

    A floor stands for what no model of tone and print explains, 1 % of the brightest value.
    """
    bright = values.mean(axis=1)
    # d linear / d code of a 2.2 gamma.
    slope = 2.2 * np.maximum(bright, 1e-3) ** (1 - 1 / 2.2)
    return np.asarray((slope * noise) ** 2 + (0.015 * np.percentile(bright, 95)) ** 2 + 1e-8)


@dataclass(frozen=True)
class Reading:
    """What is assumed about gaps and triangle while registering.

    Attributes:
        open_share: (G,) per gap position of the quad's frame: 1 gap, 0 none.
        quarter: quarter turn of the triangle, clockwise.
    """

    open_share: FloatArray
    quarter: int

    @classmethod
    def of(cls, family: LandmarkFamily, code: int, quarter: int) -> Reading:
        """This code in this quarter turn."""
        selection = all_hypotheses(family).selections[quarter * family.code_count + code]
        return cls(selection[-family.gap_count :, 2].copy(), quarter)

    def inks(self, pattern: LandmarkPattern, points: FloatArray, spread: FloatArray) -> FloatArray:
        """(N,4) coverage by the four inks."""
        used = [int(k) for k in np.flatnonzero(self.open_share)]
        # Single precision: 1e-7 of a coverage, and the normal distribution in half the time.
        single = (points.astype(np.float32), spread.astype(np.float32))
        cover = pattern.coverage(*single, [self.quarter], used)
        return cover.inks(self.open_share, self.quarter).astype(np.float64)


class Registrar:
    """Gauss-Newton on one landmark; holds the family and the picture."""

    def __init__(self, picture: Picture, family: LandmarkFamily) -> None:
        self.picture = picture
        self.family = family
        self.pattern = LandmarkPattern(family)

    def register(
        self,
        start: Registration,
        pixels: Pixels,
        reading: Reading,
        iterations: int,
        fit_bend: bool = False,
    ) -> Registration:
        """Improve a registration; never returns a worse one than ``start`` on these pixels."""
        current = replace(start, weighted_error=self._error(start, pixels, reading))
        damping = 1e-3
        for _ in range(iterations):
            normal, gradient = self._normal_equations(current, pixels, reading, fit_bend)
            improved = False
            for _ in range(4):
                step = -np.linalg.solve(normal + damping * np.diag(np.diag(normal)), gradient)
                # No corner moves further than a quarter of the side at once.
                limit = 0.25 * _side(current.corners)
                step *= min(1.0, limit / max(np.abs(step[:8]).max(), 1e-9))
                trial = _moved(current, step)
                if _is_sane(trial.corners):
                    error = self._error(trial, pixels, reading)
                    if error < current.weighted_error:
                        improved = True
                        break
                damping *= 10
            if not improved:
                break
            gain = 1 - error / current.weighted_error
            current = replace(trial, weighted_error=error)
            damping = max(damping * 0.1, 1e-6)
            if np.abs(step[:8]).max() < 0.003 or gain < 1e-5:
                break
        return current

    def discounted(self, registration: Registration, pixels: Pixels, reading: Reading) -> Pixels:
        """The same pixels with more variance where the model fails: what hides or reflects there.

        Cauchy weights on the scatter of all pixels; a pole or a hand over one side then no longer
        drags the corners along.
        """
        design = self.design(registration, pixels, reading)
        variance = value_variance(pixels.values, self.picture.noise)
        inks = solve_inks(design, pixels.values, 1 / pixels.variance)
        misfit = np.sqrt(np.mean((pixels.values - design @ inks) ** 2, axis=1) / variance)
        scale = 2.5 * max(float(np.median(misfit)), 1e-6)
        return replace(
            pixels,
            variance=variance * (1 + (misfit / scale) ** 2),
            prior_weight=float(np.median(misfit**2)) / 0.79,
        )

    def with_covariance(
        self, registration: Registration, pixels: Pixels, reading: Reading, fit_bend: bool
    ) -> Registration:
        """The same registration with the covariance of its corners.

        The residuals' own scatter sets the scale; neighbouring pixels share their errors
        (demosaicing, JPEG), so they count as ``CORRELATED_PIXELS`` times fewer.
        """
        normal, _ = self._normal_equations(registration, pixels, reading, fit_bend)
        error = self._error(registration, pixels, reading)
        known = [*range(8), 11]
        covariance = np.linalg.inv(normal)[np.ix_(known, known)] * (error * CORRELATED_PIXELS)
        return replace(registration, weighted_error=error, covariance=covariance)

    def picture_corners(self, registration: Registration) -> tuple[FloatArray, FloatArray]:
        """(4,2) corners in the picture as delivered, bend and all, and their (8,8) covariance."""
        assert registration.covariance is not None
        centre, half_width = self.picture.centre, self.picture.half_width
        corners = rebend(registration.corners, registration.bend, centre, half_width)
        delta = 1e-4
        J = np.zeros((8, 9))
        for k, step in enumerate(np.eye(8) * delta):
            moved = rebend(registration.corners + step.reshape(4, 2), registration.bend, centre, half_width)
            J[:, k] = (moved - corners).ravel() / delta
        moved = rebend(registration.corners, registration.bend + delta, centre, half_width)
        J[:, 8] = (moved - corners).ravel() / delta
        return corners, J @ registration.covariance @ J.T

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

    def design(self, registration: Registration, pixels: Pixels, reading: Reading) -> FloatArray:
        """(N,4) ink coverage at the pixels."""
        points, spread, _ = self.points_and_spread(registration, pixels.at)
        return reading.inks(self.pattern, points, spread) * self.light(registration, points)[:, None]

    def light(self, registration: Registration, points: FloatArray) -> FloatArray:
        """(N,) relative light at points of the landmark's plane."""
        return np.asarray(np.maximum(1 + points / self.family.half_mm @ registration.shading, 0.1))

    def _error(self, registration: Registration, pixels: Pixels, reading: Reading) -> float:
        design = self.design(registration, pixels, reading)
        inks = solve_inks(design, pixels.values, 1 / pixels.variance)
        squared = (pixels.values - design @ inks) ** 2 / pixels.variance[:, None]
        prior = (registration.bend / BEND_PRIOR) ** 2 + np.sum((registration.shading / SHADING_PRIOR) ** 2)
        return float((squared.sum() + pixels.prior_weight * prior) / squared.size)

    def _normal_equations(
        self, registration: Registration, pixels: Pixels, reading: Reading, fit_bend: bool
    ) -> tuple[FloatArray, FloatArray]:
        """J'WJ (14,14) and J'Wr (14,); parameters: corners, spread, bend, shading."""
        n = len(pixels.at)
        points, spread, A = self.points_and_spread(registration, pixels.at)
        shift = np.eye(2) * STEP_MM
        spreads = [_spread_in_plane(A, registration.spread + e) for e in np.eye(3) * SPREAD_STEP]
        stacked = self._stacked_inks(
            reading,
            [points, points + shift[0], points + shift[1], points, points, points],
            [spread, spread, spread, *spreads],
        )
        light = self.light(registration, points)[:, None]
        stacked = stacked * light
        design = stacked[0]
        root = 1 / np.sqrt(pixels.variance)
        inks = solve_inks(design, pixels.values, root**2)
        residual = (pixels.values - design @ inks) * root[:, None]

        by_plane = (stacked[1:3] - design) @ inks / STEP_MM  # (2,N,3)
        # (2,N,3) d model / d unbent pixel.
        by_pixel = [by_plane[0] * A[:, 0, x, None] + by_plane[1] * A[:, 1, x, None] for x in (0, 1)]
        moves = self._moves(registration, points)  # (N,8,2)
        J = np.zeros((n, 3, 14))
        # At a fixed pixel the pattern moves the other way.
        J[:, :, :8] = by_pixel[0][:, :, None] * moves[:, None, :, 0] + by_pixel[1][:, :, None] * moves[:, None, :, 1]
        for k in range(3):
            J[:, :, 8 + k] = -((stacked[3 + k] - design) @ inks) / SPREAD_STEP
        if fit_bend:
            offset = pixels.at - self.picture.centre
            radial = offset * (np.sum(offset**2, axis=1, keepdims=True) / self.picture.half_width**2)
            J[:, :, 11] = -(by_pixel[0] * radial[:, :1] + by_pixel[1] * radial[:, 1:])
        lit = (design @ inks) / light
        J[:, :, 12:] = -lit[:, :, None] * points[:, None, :] / self.family.half_mm
        J *= root[:, None, None]
        # Variable projection (Kaufman 1975): take out what the inks could explain.
        Q, _ = np.linalg.qr(design * root[:, None])
        flat = J.reshape(n, 42)
        rows = (flat - Q @ (Q.T @ flat)).reshape(n * 3, 14)
        normal = rows.T @ rows
        gradient = rows.T @ residual.ravel()
        if fit_bend:
            normal[11, 11] += pixels.prior_weight / BEND_PRIOR**2
            gradient[11] += pixels.prior_weight * registration.bend / BEND_PRIOR**2
        else:
            normal[11, 11] = 1e12
        normal[12:, 12:] += pixels.prior_weight * np.eye(2) / SHADING_PRIOR**2
        gradient[12:] += pixels.prior_weight * registration.shading / SHADING_PRIOR**2
        normal[8:11, 8:11] += 1e-3 * np.eye(3)
        normal[:8, :8] += 1e-6 * np.eye(8)
        return normal, gradient

    def _stacked_inks(self, reading: Reading, points: list[FloatArray], spreads: list[FloatArray]) -> FloatArray:
        n = len(points[0])
        inks = reading.inks(self.pattern, np.concatenate(points), np.concatenate(spreads))
        return inks.reshape(len(points), n, -1)

    def _moves(self, registration: Registration, points: FloatArray) -> FloatArray:
        """(N,8,2) how a point of the pattern moves in the picture with every corner coordinate."""
        delta = 1e-3
        corners = registration.corners
        changed = corners + delta * np.eye(8).reshape(8, 4, 2)
        H = homographies_from_points(self.family.corners_mm, np.concatenate([corners[None], changed]))
        h = np.einsum("kij,nj->nki", H, np.column_stack([points, np.ones(len(points))]))
        at = h[:, :, :2] / h[:, :, 2:]
        return np.asarray((at[:, 1:] - at[:, :1]) / delta)


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
        shading=np.clip(registration.shading + step[12:], -MAX_SHADING, MAX_SHADING),
    )


def _positive(spread: FloatArray) -> FloatArray:
    """The nearest allowed point spread: eigenvalues from MIN_SPREAD to (8 px)^2."""
    values, vectors = np.linalg.eigh(np.array([[spread[0], spread[1]], [spread[1], spread[2]]]))
    S = vectors @ np.diag(np.clip(values, MIN_SPREAD, 64.0)) @ vectors.T
    return np.array([S[0, 0], S[0, 1], S[1, 1]])


def _side(corners: FloatArray) -> float:
    return float(np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).mean())


def _is_sane(corners: FloatArray) -> bool:
    """Convex, clockwise, and not collapsed."""
    edges = np.roll(corners, -1, axis=0) - corners
    following = np.roll(edges, -1, axis=0)
    turn = edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0]
    lengths = np.linalg.norm(edges, axis=1)
    return bool((turn > 0.02 * lengths * np.roll(lengths, -1)).all() and lengths.min() > 2)
