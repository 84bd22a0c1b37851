"""The source paper's method: a planar pose from range and bearing to two landmarks, corrected.

docs/two-landmarks.md derives it and lists what is wrong in print.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lmkit.arrays import FloatArray


@dataclass(frozen=True)
class PlanarPose:
    """Position and heading in the map's plane: meters, rad (from x toward y); None where the heading is unknown."""

    x_m: float
    y_m: float
    heading_rad: float | None


def locate_by_two(
    A: FloatArray,
    B: FloatArray,
    range_a: float,
    range_b: float,
    bearing_a: float,
    bearing_b: float,
    sensor: tuple[float, float] = (0.0, 0.0),
) -> PlanarPose:
    """The robot's pose in closed form.

    The two circles around A and B intersect in two points; the order of the bearings decides which one.

    Args:
        A, B: (2,) landmarks in the map, meters, not the same point.
        range_a, range_b: distances to them, meters.
        bearing_a, bearing_b: directions, rad, positive to the left.
        sensor: where the sensor sits on the robot, meters.

    Raises:
        ValueError: A and B coincide.
    """
    d = float(np.hypot(*(B - A)))
    if d == 0:
        raise ValueError("the two landmarks have the same position")
    u = (B - A) / d
    n = np.array([-u[1], u[0]])
    s = (range_a**2 - range_b**2 + d**2) / (2 * d)
    # With noise the circles may not intersect; their closest points are on the line A B.
    h = math.sqrt(max(range_a**2 - s**2, 0.0))
    L = A + s * u + math.copysign(h, math.sin(bearing_b - bearing_a)) * n
    headings = [math.atan2(*(P - L)[::-1]) - bearing for P, bearing in ((A, bearing_a), (B, bearing_b))]
    heading = math.atan2(sum(map(math.sin, headings)), sum(map(math.cos, headings)))
    c, k = math.cos(heading), math.sin(heading)
    x = float(L[0]) - (c * sensor[0] - k * sensor[1])
    y = float(L[1]) - (k * sensor[0] + c * sensor[1])
    return PlanarPose(x, y, heading)
