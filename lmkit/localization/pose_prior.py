"""Prior knowledge about the pose of a camera."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.kernels.reprojection import prior_residuals


@dataclass(frozen=True)
class PosePrior:
    """A heading from a gyro or compass, the level floor of a robot on wheels; None where nothing is known.

    Attributes:
        heading_rad, heading_sigma: where the camera's optical axis points, seen from above, from the map's x
            toward its y.
        height_m, height_sigma: of the camera.
        down: (3,) the map's -z axis in the camera, as the camera is mounted: (0, 1, 0) when it looks level.
        tilt_sigma: rad, of floor and mounting.
    """

    heading_rad: float | None = None
    heading_sigma: float = math.radians(2.0)
    height_m: float | None = None
    height_sigma: float = 0.005
    down: tuple[float, float, float] | None = None
    tilt_sigma: float = math.radians(0.3)

    @cached_property
    def numbers(self) -> tuple[float, ...]:
        """The prior as the kernels take it; NaN where nothing is known."""
        unknown = math.nan
        down = (unknown,) * 3 if self.down is None else tuple(np.array(self.down) / np.linalg.norm(self.down))
        heading = unknown if self.heading_rad is None else self.heading_rad
        height = unknown if self.height_m is None else self.height_m
        return (heading, self.heading_sigma, height, self.height_sigma, *map(float, down), self.tilt_sigma)

    def residuals(self, R: FloatArray, p: FloatArray) -> FloatArray:
        """(H,K) known minus actual, in standard deviations, of T_map_camera: R (H,3,3), p (H,3)."""
        return prior_residuals(self.numbers, R, p)
