"""Errors of landmarks and of square tags in the same places, with steps of the camera switched off one by one.

    uv run --extra benchmark python benchmarks/camera_steps.py
        [--images 5] [--first 64100] [--kinds phone ...] [--pairs]

Simulated by six kinds of cameras: scenes of up to 20 flat markers of 14 to 60 px before even gray, or, with
``--pairs``, the stereo pairs of `pose_intervals.py`.  Everything is drawn once for each family and exposed with each
set of steps; the noise has the same seed.  Only what both families read with all sets of steps counts.

Tables of scenes: errors of corners (px, rms of the four distances), and of the camera's place by one marker alone
(percent of the distance, camera given, to first order).  Tables of pairs: errors of the places that `lmkit locate`
finds.  Intervals are 95 %, over scenes or pairs.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from camera_scenes import Shown, draw_photograph
from planar import SIDE_M, SIZE, camera
from pose_intervals import Seen, Taken, draw, rng_of

from lmkit.arrays import FloatArray
from lmkit.detection.config import DetectOptions
from lmkit.detection.detector import detect_landmarks
from lmkit.localization.correspondences import CORNER_FLOOR_PX
from lmkit.model.families import families_named
from lmkit.model.observation import Detection
from lmkit.simulation.cameras import DASHCAM, DOORBELL, INDUSTRIAL, PHONE, THREE_CHIP, WEBCAM, CameraKind
from lmkit.simulation.photograph import ImagingChain, expose
from lmkit.simulation.render import render

KINDS = {kind.name: kind for kind in (INDUSTRIAL, THREE_CHIP, WEBCAM, PHONE, DASHCAM, DOORBELL)}
FAMILIES = ("lm8", "tag36h11")
GRAY = np.full((SIZE[1], SIZE[0], 3), 0.3, dtype=np.float32)
DRAWN_PX, CELLS = (14.0, 60.0), (5, 4)
SIDES_PX, TILTS_DEG = (14, 20, 30, 60), (0, 20, 45, 75)
ANOTHER_PX, DRAWS = 3.0, 2000
Step = Callable[[ImagingChain], ImagingChain]
Found = tuple[dict[int, Detection], dict[int, Detection]]  # by code, in the left and in the right image


def _developed(**fields: Any) -> Step:
    return lambda chain: replace(chain, development=replace(chain.development, **fields))


def _without_mosaic(chain: ImagingChain) -> ImagingChain:
    return replace(chain, sensor=replace(chain.sensor, bayer=False))


_NO_JPEG, _NO_SMOOTHING, _NO_SHARPENING = (
    _developed(jpeg_quality=None),
    _developed(denoise=0.0),
    _developed(sharpen=0.0),
)
_NO_TONE = _developed(tone="srgb", contrast=1.0, saturation=1.0)
# What is left out.
STEPS: dict[str, tuple[Step, ...]] = {
    "nothing": (),
    "mosaic": (_without_mosaic,),
    "JPEG's halved color": (_developed(chroma="444"),),
    "JPEG": (_NO_JPEG,),
    "noise reduction": (_NO_SMOOTHING,),
    "JPEG, noise reduction": (_NO_JPEG, _NO_SMOOTHING),
    "mosaic, JPEG, noise reduction": (_without_mosaic, _NO_JPEG, _NO_SMOOTHING),
    "these, sharpening, tone": (_without_mosaic, _NO_JPEG, _NO_SMOOTHING, _NO_SHARPENING, _NO_TONE),
}


def without(steps: tuple[Step, ...], chain: ImagingChain) -> ImagingChain:
    for step in steps:
        chain = step(chain)
    return chain


@dataclass(frozen=True)
class Marker:
    """A marker in an image; errors by family and steps left out.

    Attributes:
        scene: number of the image.
        corners_px: rms distance of the corners from their places.
        place: error of the camera's place by it alone, percent of the distance.
    """

    kind: str
    scene: int
    side_px: float
    tilt_deg: float
    corners_px: dict[tuple[str, str], float]
    place: dict[tuple[str, str], float]


@dataclass(frozen=True)
class Pair:
    """Errors of a pair's place (mm), by family and steps left out."""

    kind: str
    place: dict[tuple[str, str], float]


def markers_of(kind: CameraKind, seed: int) -> list[Marker]:
    """Markers of a scene that are read of both families with every set of steps left out."""
    found: dict[tuple[str, str], list[Detection | None]] = {}
    shown: list[Shown] = []
    for family in FAMILIES:
        for name, steps in STEPS.items():
            image, shown, _ = draw_photograph(
                [seed],
                GRAY,
                [kind],
                DRAWN_PX,
                family=family,
                look_alikes=0.0,
                hidden=0.0,
                bowed=0.0,
                cells=CELLS,
                change=partial(without, steps),
            )
            seen = detect_landmarks(image, DetectOptions(families_named(family), camera=camera()))
            found[family, name] = [_nearest(seen, one) for one in shown]
    markers = []
    for k, one in enumerate(shown):
        here = {key: reads[k] for key, reads in found.items()}
        read = {key: seen for key, seen in here.items() if seen is not None}
        if len(read) == len(here):
            off = {key: _rms(seen.corners - one.corners) for key, seen in read.items()}
            place = {key: place_error(one, seen) for key, seen in read.items()}
            markers.append(Marker(kind.name, seed, one.side_px, one.tilt_deg, off, place))
    return markers


def _nearest(seen: list[Detection], one: Shown) -> Detection | None:
    return next((d for d in seen if np.abs(d.corners - one.corners).max() < ANOTHER_PX), None)


def _rms(error: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))


def place_error(one: Shown, seen: Detection) -> float:
    """Error of the camera's place in the marker's frame by these corners, percent of the distance, to first order."""
    T, K = one.T_camera_marker, camera().K
    assert seen.covariance is not None
    half = SIDE_M / 2 * np.array([(-1, 1), (1, 1), (1, -1), (-1, -1)])
    rows = []
    for corner in np.column_stack([half, np.zeros(4)]):
        x, y, z = T.apply(corner[None])[0]
        by_point = np.array([[K[0, 0] / z, 0, -K[0, 0] * x / z**2], [0, K[1, 1] / z, -K[1, 1] * y / z**2]])
        a, b, c = T.R @ corner  # a turn w about the marker's middle moves the corner by w x (a, b, c)
        rows.append(np.hstack([by_point, by_point @ np.array([[0, c, -b], [-c, 0, a], [b, -a, 0]])]))
    J, error = np.vstack(rows), (seen.corners - one.corners).ravel()
    weights = np.linalg.inv(seen.covariance + CORNER_FLOOR_PX**2 * np.eye(8))
    move = np.linalg.solve(J.T @ weights @ J, J.T @ weights @ error)
    off = move[:3] + np.cross(T.t, move[3:])
    return float(100 * np.linalg.norm(off) / np.linalg.norm(T.t))


def read_pair(taken: Taken, seed: int, family: str) -> dict[str, Found]:
    """Detections of a family in both images with every set of steps left out."""
    found: dict[str, list[dict[int, Detection]]] = {name: [] for name in STEPS}
    for side, (one, at) in enumerate(taken.cameras):
        radiance = render(taken.scene, one, at)
        for name, steps in STEPS.items():
            image = expose(radiance, without(steps, taken.chain), np.random.default_rng([79, seed, side]))
            seen = detect_landmarks(image, DetectOptions(families_named(family), camera=one))
            found[name].append({detection.code: detection for detection in seen})
    return {name: (left, right) for name, (left, right) in found.items()}


def pair_of(kind: CameraKind, seed: int) -> Pair | None:
    """Errors of the places found from what is always read; None where one of them is not located."""
    taken = {family: draw(rng_of(kind, seed), kind, family=family) for family in FAMILIES}
    found = {family: read_pair(one, seed, family) for family, one in taken.items()}
    sides = [[by_name[name][side] for by_name in found.values() for name in STEPS] for side in (0, 1)]
    left, right = (sorted(set.intersection(*map(set, reads))) for reads in sides)
    off = {}
    for family, by_name in found.items():
        s, T = taken[family].situation, taken[family].T_map_left
        for name, (on_left, on_right) in by_name.items():
            seen = ([on_left[code] for code in left], [on_right[code] for code in right])
            off[family, name] = Seen(kind.name, s, T, seen).located.error_mm
    return Pair(kind.name, off) if np.isfinite(list(off.values())).all() else None


def print_markers(markers: list[Marker], title: str) -> None:
    """Medians of corners, 90 % of places, and the mean factors from square tags to landmarks."""
    scenes = list(dict.fromkeys((marker.kind, marker.scene) for marker in markers))
    rows = [[k for k, m in enumerate(markers) if (m.kind, m.scene) == scene] for scene in scenes]
    chance = np.random.default_rng(0)
    drawn = [np.concatenate([rows[k] for k in chance.integers(len(rows), size=len(rows))]) for _ in range(DRAWS)]
    print(
        f"\n| {title}, {len(markers)} markers, without | lm8, px | tag36h11 | factor | lm8, place, 90 % | tag36h11 "
        "| factor |"
    )
    print("|---|---|---|---|---|---|---|")
    for name in STEPS:
        cells = []
        for field, level in (("corners_px", 50), ("place", 90)):
            own, tags = (np.array([getattr(m, field)[family, name] for m in markers]) for family in FAMILIES)
            cells += [f"{np.percentile(off, level):.{3 if level == 50 else 1}f}" for off in (own, tags)]
            logs = np.log(own / tags)
            cells.append(_interval(np.exp(logs.mean()), np.exp([logs[k].mean() for k in drawn]), 2))
        print(f"| {name} | " + " | ".join(cells) + " |")


def print_pairs(pairs: list[Pair], title: str) -> None:
    """Errors at 50 and 90 %, and the mean factor from square tags to landmarks."""
    drawn = np.random.default_rng(0).integers(len(pairs), size=(DRAWS, len(pairs)))
    print(
        f"\n| {title}, {len(pairs)} pairs, without | lm8, 50 % | tag36h11 | lm8, 90 % | tag36h11 "
        "| lm8 - tag36h11 | factor |"
    )
    print("|---|---|---|---|---|---|---|")
    for name in STEPS:
        own, tags = (np.array([pair.place[family, name] for pair in pairs]) for family in FAMILIES)
        at_90 = [np.percentile(off[drawn], 90, axis=1) for off in (own, tags)]
        ends = [np.percentile(off, 90) for off in (own, tags)]
        logs = np.log(own / tags)
        cells = [f"{np.median(off):.1f}" for off in (own, tags)]
        cells += [_interval(end, off, 1) for end, off in zip(ends, at_90, strict=True)]
        cells.append(_interval(ends[0] - ends[1], at_90[0] - at_90[1], 1))
        cells.append(_interval(np.exp(logs.mean()), np.exp(logs[drawn].mean(axis=1)), 2))
        print(f"| {name} | " + " | ".join(cells) + " |")


def _interval(value: float, drawn: FloatArray, digits: int) -> str:
    low, high = np.percentile(drawn, [2.5, 97.5])
    return f"{value:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, default=5, help="scenes or pairs by each kind of camera")
    parser.add_argument("--first", type=int, default=64100, help="seed")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS), help="of cameras")
    parser.add_argument("--pairs", action="store_true", help="stereo pairs in place of scenes")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    jobs = [(KINDS[name], options.first + k) for k in range(options.images) for name in options.kinds]
    if options.pairs:
        pairs = [pair for job in jobs if (pair := pair_of(*job)) is not None]
        print_pairs(pairs, "all")
        return
    markers = [marker for job in jobs for marker in markers_of(*job)]
    print_markers(markers, "all")
    for name in options.kinds:
        print_markers([m for m in markers if m.kind == name], name)
    for low, high in pairwise(SIDES_PX):
        print_markers([m for m in markers if low <= m.side_px < high], f"side {low} to {high} px")
    for low, high in pairwise(TILTS_DEG):
        print_markers([m for m in markers if low <= m.tilt_deg < high], f"tilt {low} to {high} deg")


if __name__ == "__main__":
    main()
