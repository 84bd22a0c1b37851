"""The image for registration: linear light, its noise, and its lens, known or estimated.

A known lens is undone exactly; for an unknown one a single radial distortion about the image's center
is fitted, landmark by landmark.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any

import cv2
import numpy as np

from lmkit.arrays import ByteArray, Float32Array, FloatArray
from lmkit.detection.shadows import white_within
from lmkit.geometry.camera import CameraModel
from lmkit.kernels.landmark_fit import LandmarkFit
from lmkit.kernels.lens import Lens
from lmkit.kernels.noise import noise
from lmkit.kernels.pixel_sampling import Source
from lmkit.kernels.screening import Pyramid
from lmkit.kernels.workspace import Loans
from lmkit.model.palette import SRGB_TO_LINEAR

Box = tuple[int, int, int, int]  # x0, y0, x1, y1, px; the last two not included
LEAST_LEVEL_PX = 24  # no level of the pyramid is smaller
LEAST_ERROR = 1 / 255  # twice this value gives a few more readings, and more wrong codes
# Clearing a box, or writing levels again, takes less time than new pages of memory.
_BLANKS, _LEVELS = Loans(2), Loans(2)


@dataclass(frozen=True)
class LinearImage:
    """Data of an image for registration.

    Attributes:
        source: code values, and their divisor if it is shadow-normalized; not undistorted.
        noise: standard deviation of the image's noise in code values over 255.
        camera: the calibrated camera of the image, if known.
        is_inverted: values are 1 minus the light, so that white on black is registered as black on white.
        fits: compiled fits, by family and settings; filled when first needed.
    """

    source: Source
    noise: float
    camera: CameraModel | None = None
    is_inverted: bool = False
    fits: dict[Any, LandmarkFit] = field(default_factory=dict, init=False, repr=False, compare=False)

    @classmethod
    def of(
        cls, image: ByteArray, camera: CameraModel | None = None, noise_of_part: float | None = None
    ) -> LinearImage:
        """From (H,W,3) BGR, 8 bit; the noise is estimated where that of a part is not known."""
        deviation = noise(image) / 255 if noise_of_part is None else noise_of_part
        return cls(Source.of(image, SRGB_TO_LINEAR), deviation, camera)

    @property
    def straight_source(self) -> Source:
        """The source with its lens undone; the shift of all pixels takes 20 ms, and images without squares need none.

        Raises:
            ValueError: the camera's images have another size.
        """
        if self.camera is None:
            return self.source
        return Source.of(*self.source[:3], _lens_shift(_LensKey(self.camera)))

    @property
    def pixel_error(self) -> float:
        """Standard deviation that pixels are weighted by, over 255.

        The noise, but not less than `LEAST_ERROR`: where a camera or a file smoothed the noise away, or an image was
        enlarged, errors of demosaicing, sharpening and print remain, and edges would all look like outliers.
        """
        return max(self.noise, LEAST_ERROR)

    @property
    def inverted(self) -> LinearImage:
        """The image with black and white swapped: light l becomes 1 - l, which blur and shading leave linear."""
        source = Source.of(255 - self.source.image, 1 - self.source.linear[::-1])
        return LinearImage(source, self.noise, self.camera, not self.is_inverted)

    @property
    def white(self) -> Float32Array | None:
        """(H,W) the local white by which values are divided; None without shadow normalization."""
        return self.source.white

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, px."""
        height, width = self.source.image.shape[:2]
        return width, height

    def shadow_normalized(self, box: Box, window: int) -> LinearImage:
        """The image, shadow-normalized in a box, see :mod:`lmkit.detection.shadows`."""
        return self.renormalized(box, white_within(self.pyramid.levels, self._within(box), window))

    def renormalized(self, box: Box, light: Float32Array) -> LinearImage:
        """The original image divided by this light in a box x0, y0, x1, y1."""
        width, height = self.size
        x0, y0, x1, y1 = self._within(box)
        # Where it is 0 nothing is divided.
        white = _BLANKS.lend((height, width), np.float32, (slice(y0, y1), slice(x0, x1)))
        white[y0:y1, x0:x1] = light
        return replace(self, source=self.source._replace(white=white))

    def _within(self, box: Box) -> Box:
        width, height = self.size
        return max(box[0], 0), max(box[1], 0), min(box[2], width), min(box[3], height)

    @cached_property
    def pyramid(self) -> Pyramid:
        """The image and its halvings, averaged in code values."""
        levels = [self.source.image]
        # A last row or column without a partner is left out: shares of pixels take ten times as long.
        shapes = _halved_shapes(*levels[0].shape[:2])
        # One loan for all, whose arrays keep it.
        rest = _LEVELS.lend((3 * sum(down * across for down, across in shapes),), np.uint8)
        for down, across in shapes:
            halved, rest = rest[: 3 * down * across].reshape(down, across, 3), rest[3 * down * across :]
            cv2.resize(levels[-1][: 2 * down, : 2 * across], (across, down), dst=halved, interpolation=cv2.INTER_AREA)
            levels.append(halved)
        return Pyramid(tuple(levels), self.source.linear)

    def halved(self, times: int) -> LinearImage:
        """The image after a number of halvings, without its lens."""
        level = min(times, len(self.pyramid.levels) - 1)
        source = Source.of(self.pyramid.levels[level], self.source.linear)
        return LinearImage(source, self.noise / 2**level, is_inverted=self.is_inverted)

    def straightened(self, at: FloatArray) -> FloatArray:
        """(N,2) undistorted pixels; unchanged if the lens is not known."""
        if self.camera is None:
            return at
        return _straightened(self.camera, at)

    def distorted(self, flat: FloatArray) -> FloatArray:
        """The inverse of :meth:`straightened`."""
        if self.camera is None:
            return flat
        rays = (flat - self.camera.K[:2, 2]) @ np.linalg.inv(self.camera.K[:2, :2]).T
        return self.camera.project(np.column_stack([rays, np.ones(len(rays))]))

    @property
    def lens(self) -> Lens | None:
        """The camera's lens; None where it is not known."""
        return None if self.camera is None else _lens(_LensKey(self.camera))

    @property
    def skew(self) -> float:
        """Skew of the camera matrix, px; lenses leave it out."""
        return 0.0 if self.camera is None else float(self.camera.K[0, 1])

    @property
    def center(self) -> FloatArray:
        """(2,) the center of the image, px."""
        width, height = self.size
        return np.array([(width - 1) / 2, (height - 1) / 2])

    @property
    def half_width(self) -> float:
        """Half of the image's width, px."""
        return self.size[0] / 2


@lru_cache(maxsize=16)
def _halved_shapes(height: int, width: int) -> list[tuple[int, int]]:
    """Rows and columns of an image's halvings."""
    shapes: list[tuple[int, int]] = []
    while min(height, width) > 2 * LEAST_LEVEL_PX and len(shapes) < 7:
        height, width = height // 2, width // 2
        shapes.append((height, width))
    return shapes


def _straightened(camera: CameraModel, at: FloatArray) -> FloatArray:
    return np.asarray(camera.unproject(at) @ camera.K[:2, :2].T + camera.K[:2, 2])


class _LensKey:
    """A camera that compares by its numbers, so that its map is computed once."""

    def __init__(self, camera: CameraModel) -> None:
        self.camera = camera
        self.numbers = (camera.image_size, camera.model, camera.K.tobytes(), camera.distortion.tobytes())

    def __hash__(self) -> int:
        return hash(self.numbers)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _LensKey) and self.numbers == other.numbers


@lru_cache(maxsize=4)
def _lens(key: _LensKey) -> Lens:
    return Lens(key.camera.K, key.camera.distortion, key.camera.lens.is_equidistant)


@lru_cache(maxsize=4)
def _lens_shift(key: _LensKey) -> Float32Array:
    """(H,W,2) from every pixel to its undistorted position, px."""
    width, height = key.camera.image_size
    x, y = np.arange(float(width)), np.arange(float(height))
    K = key.camera.K
    rays = key.camera.unproject_grid(x, y)
    shift = np.empty(rays.shape, dtype=np.float32)
    for axis, own in enumerate((x, y[:, None])):
        shift[:, :, axis] = rays[:, :, 0] * K[axis, 0] + rays[:, :, 1] * K[axis, 1] + K[axis, 2] - own
    return shift
