"""Causes for which ranges and bearings contradict the map: units, sign of the bearings, or another map.

Each cause is undone in turn, and the frames with most landmarks are located again.  The cause after which they agree
is named.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from lmkit.localization.range_bearing import locate_planar
from lmkit.localization.range_bearing_noise import ReadingNoise
from lmkit.localization.rig_contradiction import Cause
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.observation import RangeBearing
from lmkit.model.scan import POLE
from lmkit.units import unit_of_ratio

ANOTHER_MAP = "another_map"  # code of a contradiction whose cause is not certain
FRAMES = 20  # that are tested
FREE = 2  # landmarks of a frame that agree with nearly everything, also if all bearings are mirrored
LEAST_LANDMARKS = FREE + 1  # in a frame
AGREES, CONTRADICTS = 0.6, 0.5  # shares of the readings that poses explain
OFF_SCALE, ALIKE = 0.12, 0.15  # logarithms of ratios: from 1, and among each other

BEHIND = 0.8  # share of landmarks read from behind: of one wall, mirrored bearings agree with a place behind it
BEARING_SIGN = Cause("bearing_sign", "bearings have the other sign: write them positive to the left, in radians")

Frame = Sequence[RangeBearing]


def find_readings_cause(frames: Sequence[Frame], landmarks: LandmarkMap, noise: ReadingNoise) -> Cause | None:
    """Cause of the contradiction, or None if the readings agree with the map, or have too few landmarks.

    Args:
        frames: readings by frame.
    """
    mapped = [[r for r in seen if r.id in landmarks] for seen in frames]
    some = sorted(mapped, key=lambda seen: len({r.id for r in seen}), reverse=True)[:FRAMES]
    some = [seen for seen in some if len({r.id for r in seen}) >= LEAST_LANDMARKS]
    if not some:
        return None
    if _share(some, landmarks, noise, FREE) > CONTRADICTS:
        mirrored = [[_turned(r, -1.0) for r in seen] for seen in some]
        is_mirrored = _from_behind(some, landmarks, noise) > BEHIND and (
            _share(mirrored, landmarks, noise, FREE) > AGREES
            and _from_behind(mirrored, landmarks, noise) < 1 - BEHIND
        )
        return BEARING_SIGN if is_mirrored else None
    for cause, change in _variants(some, landmarks):
        if _share([[change(r) for r in seen] for seen in some], landmarks, noise, FREE) > AGREES:
            return cause
    if _share(some, landmarks, noise) > CONTRADICTS:
        return None  # single landmarks that were moved
    return Cause(
        ANOTHER_MAP,
        "the landmarks read are in the map, but at other places: it is the map of another place, they were moved, "
        "or the map has other axes or units",
    )


def _share(frames: Sequence[Frame], landmarks: LandmarkMap, noise: ReadingNoise, free: int = 0) -> float:
    """Share of the landmarks read that the frames' poses explain, beyond the first ``free`` of each frame."""
    read = sum(len({r.id for r in seen}) - free for seen in frames)
    explained = [len(locate_planar(seen, landmarks, noise).inliers) - free for seen in frames]
    return sum(max(count, 0) for count in explained) / read


def _from_behind(frames: Sequence[Frame], landmarks: LandmarkMap, noise: ReadingNoise) -> float:
    """Share of the landmarks with a face that are read from behind; 0 if none has a face."""
    sides = []
    for seen in frames:
        estimate = locate_planar(seen, landmarks, noise)
        if estimate.pose is not None:
            place = np.array([estimate.pose.x_m, estimate.pose.y_m])
            faces = [m.T_map_landmark for m in landmarks if m.id in estimate.inliers and m.family != POLE]
            sides += [bool(T.R[:2, 2] @ (place - T.t[:2]) < 0) for T in faces]
    return float(np.mean(sides)) if sides else 0.0


def _variants(
    frames: Sequence[Frame], landmarks: LandmarkMap
) -> Iterator[tuple[Cause, Callable[[RangeBearing], RangeBearing]]]:
    """Causes, and for each a function that undoes it in a reading."""
    ratio = _ratio(frames, landmarks)
    if ratio is not None and abs(np.log(ratio)) > OFF_SCALE:
        unit = unit_of_ratio(ratio) or unit_of_ratio(1 / ratio)
        text = f"ranges are {ratio:.3g} times as long as in the map: check the units of ranges and map{unit}"
        yield Cause("range_unit", text), lambda r: _scaled(r, 1 / ratio)
    yield BEARING_SIGN, lambda r: _turned(r, -1.0)
    for sign in (1.0, -1.0):
        text = "bearings are in degrees" + ("" if sign > 0 else ", of the other sign")
        yield (
            Cause("bearing_unit", f"{text}: write radians, positive to the left"),
            lambda r, factor=float(np.deg2rad(sign)): _turned(r, factor),  # type: ignore[misc]
        )


def _turned(reading: RangeBearing, factor: float) -> RangeBearing:
    bearing = reading.bearing_rad
    return replace(reading, bearing_rad=None if bearing is None else factor * bearing)


def _scaled(reading: RangeBearing, factor: float) -> RangeBearing:
    return replace(reading, range_m=None if reading.range_m is None else factor * reading.range_m)


def _ratio(frames: Sequence[Frame], landmarks: LandmarkMap) -> float | None:
    """Ratio of distances between landmarks, by readings over map; None if the ratios differ."""
    logs = []
    for seen in frames:
        full = [
            (r.range_m * np.exp(1j * r.bearing_rad), m.T_map_landmark.t[:2])
            for r in seen
            if r.range_m is not None and r.bearing_rad is not None and (m := landmarks.find(r.id)) is not None
        ]
        for (a, place_a), (b, place_b) in combinations(full[:8], 2):
            apart, known = abs(a - b), float(np.linalg.norm(place_a - place_b))
            if apart > 0 and known > 0:
                logs.append(float(np.log(apart / known)))
    if len(logs) < LEAST_LANDMARKS:
        return None
    low, middle, high = np.percentile(logs, [25, 50, 75])
    return float(np.exp(middle)) if high - low < 2 * ALIKE else None
