"""Noise of range and bearing readings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lmkit.arrays import FloatArray
from lmkit.model.observation import RangeBearing

# Errors of readings of one landmark within this time are correlated (place, light and view change slowly): they count
# as one. On MRCLAM set 6, errors are correlated for ten seconds and more; treated as independent, they make the
# covariance of a smoothed recording ten times too small.
RELATED_S = 40.0


@dataclass(frozen=True)
class ReadingNoise:
    """Standard deviations of the sensor's readings, and the outlier threshold.

    Attributes:
        range_m, range_share: standard deviation of a range: a fixed part, and a share of the range.
        bearing_rad: of a bearing.
        common_bearing_rad: of a common error of all bearings of a frame (mounting, time): it cannot be
            observed in one frame, and is added to the heading's standard deviation.
        outlier_sigma: a reading with a larger residual is an outlier.
        related_s: errors of readings of one landmark within this time are correlated, and count as one.
        range_scale: of a common factor of all ranges of a recording, such as an error of the focal length
            or of the landmarks' size; it is estimated from a recording, and not observable in one frame.
    """

    range_m: float = 0.02
    # For a camera that infers distance from a landmark's size: directions are far more accurate.
    range_share: float = 0.04
    bearing_rad: float = math.radians(0.4)
    common_bearing_rad: float = math.radians(0.5)
    outlier_sigma: float = 4.0
    related_s: float = RELATED_S
    range_scale: float = 0.02

    def sigmas(self, readings: Sequence[RangeBearing]) -> tuple[FloatArray, FloatArray]:
        """(N,), (N,) of ranges (m) and bearings (rad): stated by each reading, or the sensor's default."""
        ranges = self.range_sigma(np.array([np.nan if r.range_m is None else r.range_m for r in readings]))
        stated = [r.range_sigma_m for r in readings]
        bearings = [self.bearing_rad if r.bearing_sigma_rad is None else r.bearing_sigma_rad for r in readings]
        given = np.array([np.nan if value is None else value for value in stated], dtype=np.float64)
        return np.where(np.isfinite(given), given, ranges), np.array(bearings, dtype=np.float64)

    def range_sigma(self, range_m: FloatArray) -> FloatArray:
        """Standard deviations of ranges, meters."""
        return np.asarray(np.hypot(self.range_m, self.range_share * range_m))


# A camera on a moving robot; larger than for a robot that stands still.
DRIVE_NOISE = ReadingNoise(0.14, 0.042, math.radians(0.56), math.radians(0.42))
# Poles in a laser scan state their own standard deviations; errors of map and motion are correlated for a short time.
SCAN_NOISE = ReadingNoise(0.01, 0.002, math.radians(0.2), math.radians(0.05), related_s=0.5, range_scale=0.001)
