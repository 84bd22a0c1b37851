"""A simulated planar laser scanner: rays against walls, poles and clutter, with noise and missing echoes.

Beams have a width: a beam on two surfaces measures one of them, or sometimes a range between both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lmkit.arrays import BoolArray, FloatArray
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.scan import LaserScan, ScannerMount

SUBRAYS = 5  # across a beam
MIXED = 0.2  # share of beams on two surfaces whose range lies between both
BACKGROUND, REFLECTOR = 100.0, 1000.0  # intensities


@dataclass(frozen=True)
class ScannerModel:
    """Properties of a scanner.

    Attributes:
        step_rad: from beam to beam.
        view_rad: field of view, centered ahead.
        range_m: standard deviation of a range.
        farthest_m: largest range with an echo.
        beam_rad: width of a beam; None: half a step.
        lost: share of missing echoes.
    """

    step_rad: float = math.radians(0.5)
    view_rad: float = 2 * math.pi
    range_m: float = 0.01
    farthest_m: float = 25.0
    beam_rad: float | None = None
    lost: float = 0.002


@dataclass(frozen=True, eq=False)
class ScannedScene:
    """Everything that a scanner can see.

    Attributes:
        walls: (W,2,2) ends of segments, meters in the map.
        poles: (P,3) centers and radii.
        clutter: (C,3) centers and radii of other round objects: legs of chairs, tables and people.
        bright: whether poles are reflectors.
    """

    walls: FloatArray
    poles: FloatArray
    clutter: FloatArray
    bright: bool = False

    @classmethod
    def of(cls, landmarks: LandmarkMap, walls: FloatArray, clutter: FloatArray | None = None) -> ScannedScene:
        """The poles of a map among walls and clutter."""
        poles = np.array([[*m.T_map_landmark.t[:2], m.size_m / 2] for m in landmarks]).reshape(-1, 3)
        return cls(walls, poles, np.zeros((0, 3)) if clutter is None else clutter)

    def scan(
        self,
        state: FloatArray,
        model: ScannerModel,
        rng: np.random.Generator,
        mount: ScannerMount | None = None,
        time_s: float = 0.0,
    ) -> LaserScan:
        """Measurement of a scanner on a stationary robot at (3,) x, y (m), heading (rad)."""
        mount = mount or ScannerMount()
        c, s = math.cos(state[2]), math.sin(state[2])
        origin = np.array([state[0] + c * mount.x_m - s * mount.y_m, state[1] + s * mount.x_m + c * mount.y_m])
        beams = round(model.view_rad / model.step_rad)
        closed = abs(beams * model.step_rad - 2 * math.pi) < model.step_rad / 2
        beams += not closed
        start = -math.pi if closed else -model.step_rad * (beams - 1) / 2
        width = model.step_rad / 2 if model.beam_rad is None else model.beam_rad
        angles = start + model.step_rad * np.arange(beams)
        spread = width * ((np.arange(SUBRAYS) + 0.5) / SUBRAYS - 0.5)
        rays = state[2] + mount.yaw_rad + angles[:, None] + spread
        ranges, is_pole = self._cast(origin, rays.ravel())
        near = ranges.reshape(beams, SUBRAYS)
        chosen = rng.integers(SUBRAYS, size=beams)
        rows = np.arange(beams)
        other = near[rows, rng.integers(SUBRAYS, size=beams)]
        first = near[rows, chosen]
        mixed = (rng.uniform(size=beams) < MIXED) & np.isfinite(other) & np.isfinite(first)
        share = rng.uniform(size=beams)
        between = np.where(mixed, share, 0.0) * np.where(mixed, other - np.where(mixed, first, 0.0), 0.0)
        measured = first + between + model.range_m * rng.normal(size=beams)
        gone = (rng.uniform(size=beams) < model.lost) | ~(measured < model.farthest_m)
        bright = np.logical_and(is_pole.reshape(beams, SUBRAYS)[rows, chosen], self.bright)
        intensities = np.where(bright, REFLECTOR, BACKGROUND) * rng.uniform(0.8, 1.2, beams)
        return LaserScan(time_s, start, model.step_rad, np.where(gone, np.nan, measured), intensities)

    def _cast(self, origin: FloatArray, angles: FloatArray) -> tuple[FloatArray, BoolArray]:
        """(R,) distance of the nearest surface along each ray, inf if there is none; and whether it is a pole."""
        along = np.column_stack([np.cos(angles), np.sin(angles)])
        walls = _to_segments(origin, along, self.walls)
        clutter, poles = (_to_circles(origin, along, circles) for circles in (self.clutter, self.poles))
        other = np.minimum(walls, clutter)
        return np.minimum(other, poles), poles < other


def _to_segments(origin: FloatArray, along: FloatArray, segments: FloatArray) -> FloatArray:
    nearest = np.full(len(along), np.inf)
    for a, b in segments:
        edge, off = b - a, a - origin
        with np.errstate(divide="ignore", invalid="ignore"):
            cross = along[:, 0] * edge[1] - along[:, 1] * edge[0]
            distance = (off[0] * edge[1] - off[1] * edge[0]) / cross
            share = (off[0] * along[:, 1] - off[1] * along[:, 0]) / cross
        hit = (distance > 0) & (share >= 0) & (share <= 1)
        nearest = np.where(hit & (distance < nearest), distance, nearest)
    return nearest


def _to_circles(origin: FloatArray, along: FloatArray, circles: FloatArray) -> FloatArray:
    nearest = np.full(len(along), np.inf)
    for x, y, radius in circles:
        off = np.array([x, y]) - origin
        ahead = along @ off
        depth = radius**2 - (off @ off - ahead**2)
        hit = (depth > 0) & (ahead > 0)
        distance = ahead - np.sqrt(np.maximum(depth, 0.0))
        nearest = np.where(hit & (distance < nearest), distance, nearest)
    return nearest


def room_walls(size_m: tuple[float, float], corner: tuple[float, float] = (0.0, 0.0)) -> FloatArray:
    """(4,2,2) walls of a rectangular room from its lower left corner."""
    low, high = np.array(corner), np.array(corner) + size_m
    corners = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def scatter_clutter(
    rng: np.random.Generator,
    tables: int,
    size_m: tuple[float, float],
    corner: tuple[float, float] = (0.0, 0.0),
    leg_radius_m: tuple[float, float] = (0.015, 0.06),
) -> FloatArray:
    """(4 T, 3) legs of tables and chairs: centers and radii, four per table, some as thick as a pole."""
    legs = []
    for _ in range(tables):
        center = np.array(corner) + rng.uniform(0.08, 0.92, 2) * size_m
        turn, half = rng.uniform(0, math.pi), rng.uniform(0.2, 0.6, 2)
        c, s = math.cos(turn), math.sin(turn)
        radius = rng.uniform(*leg_radius_m)
        for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
            off = np.array([a * half[0], b * half[1]])
            legs.append([center[0] + c * off[0] - s * off[1], center[1] + s * off[0] + c * off[1], radius])
    return np.array(legs).reshape(-1, 3)
