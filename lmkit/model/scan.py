"""One revolution of a planar laser scanner, and the poles found in it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from lmkit.arrays import FloatArray, frozen
from lmkit.geometry.planar import wrap_heading

POLE = "pole"  # family of poles and cylindrical reflectors in a map; ``size_m`` is the diameter


@dataclass(frozen=True, eq=False)
class LaserScan:
    """Ranges in a plane, beam by beam.

    Attributes:
        time_s: of the first beam, seconds.
        start_rad: direction of the first beam in the scanner's frame, positive to the left.
        step_rad: from one beam to the next; negative for scanners that rotate clockwise.
        ranges_m: (N,) meters; NaN where nothing came back.
        intensities: (N,) brightness of the echo in the scanner's own units, if it gives any.
        beam_s: time from one beam to the next, seconds.
    """

    time_s: float
    start_rad: float
    step_rad: float
    ranges_m: FloatArray
    intensities: FloatArray | None = None
    beam_s: float = 0.0

    def __post_init__(self) -> None:
        ranges = np.array(self.ranges_m, dtype=np.float64).reshape(-1)
        ranges[~(np.isfinite(ranges) & (ranges > 0))] = np.nan
        ranges.setflags(write=False)
        object.__setattr__(self, "ranges_m", ranges)
        if self.intensities is not None:
            object.__setattr__(self, "intensities", frozen(self.intensities, (len(ranges),), "intensities"))

    @property
    def angles_rad(self) -> FloatArray:
        """(N,) direction of every beam."""
        return self.start_rad + self.step_rad * np.arange(len(self.ranges_m))

    @property
    def end_s(self) -> float:
        """Time of the last beam, seconds."""
        return self.time_s + self.beam_s * max(len(self.ranges_m) - 1, 0)

    @property
    def is_closed(self) -> bool:
        """The last beam is the neighbor of the first one: the scanner looks all around."""
        return abs(abs(self.step_rad) * len(self.ranges_m) - 2 * math.pi) < 1.5 * abs(self.step_rad)

    def beam_at(self, angle_rad: float) -> int | None:
        """Index of the beam nearest to a direction; None outside the field of view."""
        turn = math.copysign(2 * math.pi, self.step_rad)
        beam = round(math.fmod(angle_rad - self.start_rad, 2 * math.pi) / self.step_rad)
        if beam < 0:
            beam += round(turn / self.step_rad)
        return beam if beam < len(self.ranges_m) else None


@dataclass(frozen=True)
class ScannerMount:
    """Place of the scanner on the robot: meters forward and left of the base, rad from its x toward its y."""

    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0


@dataclass(frozen=True, eq=False)
class ScannedPole:
    """Center of a pole as one scan shows it.

    Attributes:
        range_m, bearing_rad: of the center.
        covariance: (2,2) of range (m) and bearing (rad).
        radius_m: that the fit assumed.
        beams: number of beams on it.
        place: number of the object in the scan; fits of other radii to the same object share it.
        time_s: of its middle beam, seconds.
    """

    range_m: float
    bearing_rad: float
    covariance: FloatArray
    radius_m: float
    beams: int
    place: int
    time_s: float

    @property
    def point(self) -> FloatArray:
        """(2,) the center, meters forward and left."""
        return self.range_m * np.array([math.cos(self.bearing_rad), math.sin(self.bearing_rad)])

    def carried(self, motion: FloatArray) -> ScannedPole:
        """The pole as seen after a motion of the observer: (3,) forward, left (m) and rotation (rad)."""
        c, s = math.cos(motion[2]), math.sin(motion[2])
        x, y = self.point - motion[:2]
        point = np.array([c * x + s * y, -s * x + c * y])
        return replace(self, range_m=float(np.hypot(*point)), bearing_rad=math.atan2(point[1], point[0]))

    def seen_from_base(self, mount: ScannerMount) -> ScannedPole:
        """The pole in the frame of the robot that carries the scanner."""
        angle = self.bearing_rad + mount.yaw_rad
        point = np.array([mount.x_m, mount.y_m]) + self.range_m * np.array([math.cos(angle), math.sin(angle)])
        distance = float(np.hypot(*point))
        bearing = wrap_heading(math.atan2(point[1], point[0]))
        # Both are polar coordinates of one point: a rotation by the difference of the lines of sight, and scales.
        c, s = math.cos(angle - bearing), math.sin(angle - bearing)
        J = np.array([[c, -s * self.range_m], [s / distance, c * self.range_m / distance]])
        return replace(self, range_m=distance, bearing_rad=bearing, covariance=J @ self.covariance @ J.T)
