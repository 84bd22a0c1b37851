"""The picture as registration sees it: linear light, its noise, and its lens, known or guessed.

A known lens is undone exactly; of an unknown one a single radial bend about the picture's centre
is fitted, landmark by landmark.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from lmkit.arrays import ByteArray, Float32Array, FloatArray, IntArray
from lmkit.detection.shadows import local_white
from lmkit.geometry.camera import CameraModel
from lmkit.model.palette import SRGB_TO_LINEAR


@dataclass(frozen=True)
class LinearImage:
    """What registration needs of a picture.

    Attributes:
        linear: (H,W,3) BGR in linear light, 0..1.
        noise: standard deviation of the picture's noise in code values over 255.
        camera: the camera that took it, where its lens is known.
        white: (H,W) the local white that ``linear`` was divided by; None where it was not.
    """

    linear: Float32Array
    noise: float
    camera: CameraModel | None = None
    white: Float32Array | None = None

    @classmethod
    def of(cls, image: ByteArray, camera: CameraModel | None = None) -> LinearImage:
        """From (H,W,3) BGR, 8 bit."""
        return cls(SRGB_TO_LINEAR[image], estimate_noise(image), camera)

    def shadow_normalized(self, window: int) -> LinearImage:
        """The picture with shadows taken out, see `detect.light`."""
        white = local_white(self.linear, window)
        return replace(self, linear=self.linear / white[:, :, None], white=white)

    def renormalized(self, white: Float32Array) -> LinearImage:
        """The picture with another light taken out than the one that was."""
        assert self.white is not None
        return replace(self, linear=self.linear * (self.white / white)[:, :, None], white=white)

    def light_at(self, whole: IntArray) -> FloatArray:
        """(N,) the light that was taken out at pixels (N,2)."""
        if self.white is None:
            return np.ones(len(whole))
        return np.asarray(self.white[whole[:, 1], whole[:, 0]], dtype=np.float64)

    def shrunk(self, factor: int) -> LinearImage:
        """The picture ``factor`` times smaller, averaged in linear light."""
        height, width = (length // factor for length in self.linear.shape[:2])
        whole = self.linear[: height * factor, : width * factor]
        small = cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)
        return LinearImage(np.asarray(small, dtype=np.float32), self.noise / factor)

    def straightened(self, at: FloatArray) -> FloatArray:
        """(N,2) pixels as a lens without distortion would have them; the same where the lens is not known."""
        if self.camera is None:
            return at
        return np.asarray(self.camera.unproject(at) @ self.camera.K[:2, :2].T + self.camera.K[:2, 2])

    def distorted(self, flat: FloatArray) -> FloatArray:
        """The inverse of :meth:`straightened`."""
        if self.camera is None:
            return flat
        rays = (flat - self.camera.K[:2, 2]) @ np.linalg.inv(self.camera.K[:2, :2]).T
        return self.camera.project(np.column_stack([rays, np.ones(len(rays))]))

    @property
    def centre(self) -> FloatArray:
        """(2,) the middle of the picture, px."""
        height, width = self.linear.shape[:2]
        return np.array([(width - 1) / 2, (height - 1) / 2])

    @property
    def half_width(self) -> float:
        """Half of the picture's width, px."""
        return float(self.linear.shape[1] / 2)


def unbend(at: FloatArray, bend: float, centre: FloatArray, half_width: float) -> FloatArray:
    """PixelSamples freed of a radial bend: ``c + (x - c) (1 + bend r^2)``, r = 1 at half the width."""
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


def estimate_noise(image: ByteArray) -> float:
    """Standard deviation of the picture's noise over 255, from its smoothest half (Immerkaer 1996)."""
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], dtype=np.float32)
    response = np.abs(cv2.filter2D(grey, cv2.CV_32F, kernel))
    return float(np.median(response)) / 0.6745 / 6 / 255
