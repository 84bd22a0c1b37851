"""What is known of a camera's pose before it has seen anything."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.geometry.rotations import turns

STEP = 1e-6


@dataclass(frozen=True)
class PosePrior:
    """A heading from a gyro or compass, the level floor of a robot on wheels; None where nothing is known.

    Attributes:
        heading_rad, heading_sigma: where the camera's optical axis points, seen from above, from the map's x
            towards its y.
        height_m, height_sigma: of the camera.
        down: (3,) the map's -z axis in the camera, as the camera is mounted: (0, 1, 0) when it looks level.
        tilt_sigma: rad, by which the floor and the mounting may lean.
    """

    heading_rad: float | None = None
    heading_sigma: float = math.radians(2.0)
    height_m: float | None = None
    height_sigma: float = 0.005
    down: tuple[float, float, float] | None = None
    tilt_sigma: float = math.radians(0.3)

    def residuals(self, R: FloatArray, p: FloatArray) -> FloatArray:
        """(H,K) known minus actual, in standard deviations, of T_map_camera: R (H,3,3), p (H,3)."""
        columns: list[FloatArray] = []
        if self.heading_rad is not None:
            off = self.heading_rad - np.arctan2(R[:, 1, 2], R[:, 0, 2])
            columns.append(np.arctan2(np.sin(off), np.cos(off)) / self.heading_sigma)
        if self.height_m is not None:
            columns.append((self.height_m - p[:, 2]) / self.height_sigma)
        if self.down is not None:
            # The map's down as the pose has it, in the map: its x and y are what it leans.
            leaning = R @ (np.array(self.down) / np.linalg.norm(self.down))
            columns += [-leaning[:, 0] / self.tilt_sigma, -leaning[:, 1] / self.tilt_sigma]
            # Upside down it would not lean either.
            columns.append(np.where(leaning[:, 2] > 0, math.pi / self.tilt_sigma, 0.0))
        return np.column_stack(columns) if columns else np.zeros((len(R), 0))

    def jacobian(self, R: FloatArray, p: FloatArray) -> FloatArray:
        """(H,K,6) of the actual values with a shift and a turn in the map, in standard deviations; by differences."""
        here = self.residuals(R, p)
        J = np.zeros((*here.shape, 6))
        for k in range(6):
            step = np.zeros((1, 6))
            step[0, k] = STEP
            J[:, :, k] = (here - self.residuals(turns(step[:, 3:]) @ R, p + step[:, :3])) / STEP
        return J
