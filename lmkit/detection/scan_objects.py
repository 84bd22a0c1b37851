"""Free-standing objects of a laser scan: runs of beams in front of their neighbors.

Breakpoints as in Borges and Aldon, "Line extraction in 2D range images for mobile robotics" (2004): neighbors belong
together unless their ranges differ by more than a surface seen at a grazing angle explains.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lmkit.arrays import BoolArray, FloatArray, IntArray
from lmkit.model.scan import LaserScan

GRAZING_RAD = math.radians(15)  # a surface steeper than that to the beams is split
SIGMAS = 5.0


@dataclass(frozen=True, eq=False)
class ScanObject:
    """Neighboring beams on one object.

    Attributes:
        beams: (K,) their indices, in the order of the scan.
        angles_rad, ranges_m: (K,) directions without jumps, and ranges.
        before_m, after_m: ranges of the beams beside it: inf where nothing came back, NaN outside the field of view.
    """

    beams: IntArray
    angles_rad: FloatArray
    ranges_m: FloatArray
    before_m: float
    after_m: float

    def stands_free(self, margin_m: float) -> bool:
        """Its neighbors on both sides are farther away."""
        first, last = self.ranges_m[0] + margin_m, self.ranges_m[-1] + margin_m
        return bool(self.before_m > first and self.after_m > last)


def scan_objects(scan: LaserScan, sigma_m: float, bright_from: float | None = None) -> list[ScanObject]:
    """Objects in the order of the beams.

    Args:
        sigma_m: standard deviation of a range.
        bright_from: only beams at least that bright count, and every run of them is an object; None: all count.
    """
    ranges = scan.ranges_m
    count = len(ranges)
    if count < 3:
        return []
    if bright_from is not None:
        intensities = np.zeros(count) if scan.intensities is None else scan.intensities
        ranges = np.where(intensities >= bright_from, ranges, np.nan)
    # Single beams without an echo on an object do not divide it.
    bridged = _bridged(ranges, scan, sigma_m)
    joined = _joined(bridged, scan, sigma_m)
    seen = np.isfinite(bridged)
    starts = np.flatnonzero(seen & ~(np.roll(joined, 1) & np.roll(seen, 1)))
    if not scan.is_closed and seen[0] and 0 not in starts:
        starts = np.concatenate([[0], starts])
    return [found for start in starts if (found := _object(int(start), bridged, joined, scan)) is not None]


def _bridged(ranges: FloatArray, scan: LaserScan, sigma_m: float) -> FloatArray:
    """Ranges with single gaps filled where both neighbors are on one object."""
    before, after = np.roll(ranges, 1), np.roll(ranges, -1)
    if not scan.is_closed:
        before[0] = after[-1] = np.nan
    near = np.fmin(before, after)
    gap = np.isnan(ranges) & (np.abs(before - after) < _threshold(near, 2 * scan.step_rad, sigma_m))
    return np.where(gap, (before + after) / 2, ranges)


def _joined(ranges: FloatArray, scan: LaserScan, sigma_m: float) -> BoolArray:
    """(N,) whether a beam belongs to the same object as the next one."""
    after = np.roll(ranges, -1)
    joined = np.abs(after - ranges) < _threshold(np.fmin(ranges, after), scan.step_rad, sigma_m)
    if not scan.is_closed:
        joined[-1] = False
    return np.asarray(joined)


def _threshold(near: FloatArray, step_rad: float, sigma_m: float) -> FloatArray:
    step = abs(step_rad)
    steep = math.sin(step) / math.sin(max(GRAZING_RAD - step, step))
    return np.asarray(near * steep + SIGMAS * math.sqrt(2) * sigma_m)


def _object(start: int, ranges: FloatArray, joined: BoolArray, scan: LaserScan) -> ScanObject | None:
    count = len(ranges)
    run = [start]
    while joined[run[-1] % count] and len(run) < count:
        run.append(run[-1] + 1)
    beams = np.array(run)
    own = scan.ranges_m[beams % count]
    kept = np.isfinite(own)
    if not kept.any():
        return None
    angles = scan.start_rad + scan.step_rad * beams
    return ScanObject(
        beams[kept] % count, angles[kept], own[kept], _beside(scan, run[0] - 1), _beside(scan, run[-1] + 1)
    )


def _beside(scan: LaserScan, beam: int) -> float:
    count = len(scan.ranges_m)
    if not scan.is_closed and not 0 <= beam < count:
        return math.nan
    found = float(scan.ranges_m[beam % count])
    return math.inf if math.isnan(found) else found
