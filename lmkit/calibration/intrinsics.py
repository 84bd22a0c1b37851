"""Intrinsics of a camera as one vector, and their prior."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.geometry.camera import CameraModel

# Prior standard deviation of the displacement by one coefficient at the image corner, over the distance
# from the center: wide enough for any lens, but it keeps coefficients that cancel
# each other (Claus and Fitzgibbon 2005 on rational models) from diverging together.
RADIAL_PRIOR = 0.3
TANGENTIAL_PRIOR = 0.05
LEAST_PX, LEAST_COEFFICIENT = 1e-3, 1e-6  # smallest standard deviations of a known lens
LEAST_EIGENVALUE = 1e-10  # of a correlation matrix


@dataclass(frozen=True, eq=False)
class KnownIntrinsics:
    """Intrinsics known beforehand: (K,) values and (K,K) covariance of the left, then the right camera.

    Order as in :func:`intrinsics_vector`.
    """

    mean: FloatArray
    covariance: FloatArray

    @property
    def root(self) -> FloatArray:
        """(K,K) W with ``W.T @ W`` the inverse of the covariance."""
        sigma, correlation = sigma_and_correlation(self.covariance)
        values, vectors = np.linalg.eigh(correlation)
        return np.asarray((vectors / np.sqrt(np.maximum(values, LEAST_EIGENVALUE))).T / sigma)


def intrinsics_vector(camera: CameraModel) -> FloatArray:
    """fx fy cx cy, then the distortion."""
    K = camera.K
    return np.concatenate([[K[0, 0], K[1, 1], K[0, 2], K[1, 2]], camera.distortion])


def with_intrinsics(camera: CameraModel, vector: FloatArray) -> CameraModel:
    """The camera with other intrinsics, see :func:`intrinsics_vector`."""
    K = np.array([[vector[0], 0, vector[2]], [0, vector[1], vector[3]], [0, 0, 1.0]])
    return CameraModel(camera.image_size, K, vector[4:], camera.model)


def distortion_effect(camera: CameraModel) -> tuple[FloatArray, float]:
    """(D,) displacement by each coefficient of 1 at the image's corner, over the corner's distance; that distance."""
    width, height = camera.image_size
    reach = float(np.hypot(width / camera.K[0, 0], height / camera.K[1, 1])) / 2
    lens, count = camera.lens, len(camera.distortion)
    effect = (np.arctan(reach) if lens.is_equidistant else reach) ** np.array(lens.powers[:count])
    return np.asarray(effect), reach


def intrinsics_prior(camera: CameraModel) -> FloatArray:
    """(4+D,) 1 / prior standard deviation of every intrinsic parameter; 0 without a prior."""
    effect, _ = distortion_effect(camera)
    names = camera.lens.coefficients[: len(camera.distortion)]
    tangential = np.array([name.startswith("p") for name in names], dtype=bool)
    sigma = np.where(tangential, TANGENTIAL_PRIOR, RADIAL_PRIOR)
    return np.concatenate([np.zeros(4), effect / sigma])


def sigma_of_pixels(camera: CameraModel, pixels: float) -> FloatArray:
    """(4+D,) standard deviations for errors of this size of focal lengths, principal point and coefficients."""
    effect, reach = distortion_effect(camera)
    focal = float(np.sqrt(camera.K[0, 0] * camera.K[1, 1]))
    return np.concatenate([np.full(4, pixels), pixels / (focal * reach * effect)])


def sigma_and_correlation(covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(K,) standard deviations and (K,K) correlations; zero correlation for a zero standard deviation."""
    sigma = np.sqrt(np.diag(covariance))
    scale = np.where(sigma > 0, sigma, 1.0)
    correlation = covariance / np.outer(scale, scale)
    np.fill_diagonal(correlation, 1.0)
    return sigma, correlation


def stated_covariance(sigma: FloatArray, correlation: FloatArray | None, together: int = 1) -> FloatArray:
    """(4+D,4+D) covariance of the intrinsics of a file; parameters fixed by its calibration get small variances.

    If the file has no correlations, the variances are multiplied by the number of fitted parameters:
    n times the diagonal is never less than a covariance of n numbers, whatever their correlations. For the same
    reason the covariances of cameras that were fitted together are multiplied by their count.

    Args:
        together: count of cameras that were fitted together, and whose correlations with each other are not known.
    """
    fitted = sigma > 0
    least = np.where(np.arange(len(sigma)) < 4, LEAST_PX, LEAST_COEFFICIENT)
    held = np.maximum(sigma, least)
    if correlation is None:
        return np.diag(held**2 * np.where(fitted, together * fitted.sum(), 1))
    return np.asarray(together * np.outer(held, held) * correlation)
