"""Square markers beside their own readers, on the same simulated images in the same run.

    OMP_NUM_THREADS=1 uv run --extra benchmark python benchmarks/tags.py ../shared/data/photos [--n 300]

Up to six 18 cm markers before a real photograph, some partly hidden or on curled paper, and look-alikes (black
frames around other drawings), by many kinds of cameras in many kinds of light (`camera_scenes.py`).  AprilTag 36h11,
ArUco 4x4 and lm8 stand in the same places under the same light.  A marker counts when nothing lies over it.
Corners are root mean squares over four; positions come from the corners by IPPE, for every reader alike.  Time is
the thread's processor time.  Intervals are Wilson's, 95 %.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import peers
from camera_scenes import Shown, draw_photograph
from detection_speed import timed
from peers import wilson
from planar import SIDE_M, background, backgrounds, camera
from scipy.optimize import minimize

from lmkit.detection.config import DetectOptions
from lmkit.detection.detector import detect_landmarks
from lmkit.model.families import families_named
from lmkit.model.landmark import LM8
from lmkit.simulation.cameras import DASHCAM, DOORBELL, INDUSTRIAL, PHONE, THREE_CHIP, WEBCAM
from lmkit.simulation.photograph import ImagingChain

ALL_KINDS = (INDUSTRIAL, THREE_CHIP, WEBCAM, PHONE, DASHCAM, DOORBELL)
SIDES = (10.0, 15.0, 20.0, 25.0, 30.0, 70.0)
TILTS = (0.0, 30.0, 60.0, 75.0)
LITTLE_TILT_DEG = 45.0
ARUCO = "aruco4x4_250"
Found = list[tuple[int, np.ndarray]]
Detect = Callable[[np.ndarray], Found]


def with_lmkit(family: str) -> Detect:
    options = DetectOptions(families_named(family))
    return lambda image: [(d.code, d.corners) for d in detect_landmarks(image, options)]


def with_apriltag() -> Detect:
    import pupil_apriltags

    detector = pupil_apriltags.Detector(families="tag36h11", quad_decimate=1.0, nthreads=1)
    detector.tag_families.clear()  # it would free them before the detector that still reads them

    def detect(image: np.ndarray) -> Found:
        found = detector.detect(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))
        # Its corners start at the lower left and run against the clock; its pixel centers lie at halves.
        return [
            (d.tag_id, d.corners[[3, 2, 1, 0]] - 0.5) for d in found if d.hamming <= 1 and d.decision_margin >= 20
        ]

    return detect


def with_locus() -> Detect:
    find = peers.with_locus()
    # Its corners start where OpenCV draws an AprilTag's.
    return lambda image: [(code, np.roll(corners, 2, axis=0)) for code, corners in find(image)]


def with_aruco(dictionary: int, turned: int) -> Detect:
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(dictionary), parameters)

    def detect(image: np.ndarray) -> Found:
        corners, codes, _ = detector.detectMarkers(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))
        if codes is None:
            return []
        return [(int(i), np.roll(c[0], turned, axis=0)) for i, c in zip(codes.ravel(), corners, strict=True)]

    return detect


# Name: the markers that it is shown, and how to make it.
READERS: dict[str, tuple[str, Callable[[], Detect]]] = {
    "lmkit, tag36h11": ("tag36h11", lambda: with_lmkit("tag36h11")),
    "AprilTag 3, tag36h11": ("tag36h11", with_apriltag),
    "locus-tag, tag36h11": ("tag36h11", with_locus),
    "OpenCV, tag36h11": ("tag36h11", lambda: with_aruco(cv2.aruco.DICT_APRILTAG_36h11, 2)),
    "lmkit, ArUco 4x4": (ARUCO, lambda: with_lmkit(ARUCO)),
    "OpenCV, ArUco 4x4": (ARUCO, lambda: with_aruco(cv2.aruco.DICT_4X4_250, 0)),
    "lmkit, lm8": ("lm8", lambda: with_lmkit("lm8")),
}


def groups_of(one: Shown, chain: ImagingChain) -> list[str]:
    """Rows of the table that a marker belongs to."""
    groups = ["side 15 px and more"] if one.side_px >= 15 else []
    groups += [f"side {a:g} to {b:g} px" for a, b in pairwise(SIDES) if a <= one.side_px < b]
    if one.side_px < 15:
        return groups
    groups += [f"tilt {a:g} to {b:g} deg" for a, b in pairwise(TILTS) if a <= one.tilt_deg < b]
    moved, defocused = np.hypot(*chain.lens.motion_px) > 1, chain.lens.defocus_px > 0.8
    groups += ["motion blur"] * bool(moved) + ["out of focus"] * bool(defocused)
    groups += ["sharp"] * (not moved and not defocused)
    groups += ["dim light"] * (chain.light.brightness < 0.3) + ["hard shadow"] * (chain.light.shadow is not None)
    return groups


def judge(found: Found, shown: list[Shown], chain: ImagingChain) -> dict:
    """Lines of one image and reader: markers with their groups, errors of those read; wrong and false ones."""
    hits: dict[int, np.ndarray] = {}
    wrong = false = 0
    for code, corners in found:
        apart = [np.linalg.norm(corners.mean(axis=0) - s.corners.mean(axis=0)) / s.side_px for s in shown]
        nearest = int(np.argmin(apart)) if apart else -1
        if nearest < 0 or apart[nearest] > 0.6:
            false += 1
        elif shown[nearest].code != code:
            wrong += 1
        else:
            hits[nearest] = corners
    markers = []
    for k, one in enumerate(shown):
        if not one.is_hidden:
            marker = {"groups": groups_of(one, chain), "read": k in hits, "side": one.side_px, "tilt": one.tilt_deg}
            markers.append(marker | (errors_of(hits[k], one) if k in hits else {}))
    return {"markers": markers, "wrong": wrong, "false": false}


def errors_of(corners: np.ndarray, one: Shown) -> dict:
    off = np.linalg.norm(corners - one.corners, axis=1)
    points, seen = LM8.object_points(SIDE_M), np.ascontiguousarray(corners, dtype=np.float64)
    _, _, t = cv2.solvePnP(points, seen, camera().K, None, flags=cv2.SOLVEPNP_IPPE_SQUARE)
    T = one.T_camera_marker
    return {
        "corner_px": float(np.sqrt(np.mean(off**2))),
        "worst_px": float(off.max()),
        "position": float(np.linalg.norm(t.ravel() - T.t) / np.linalg.norm(T.t)),
    }


def run(
    photos: list[Path],
    count: int,
    seed: int,
    names: list[str],
    sides: tuple[float, float] = (10.0, 70.0),
    is_dim: bool = False,
) -> dict[str, list[dict]]:
    detectors = {name: READERS[name][1]() for name in names}
    results: dict[str, list[dict]] = {name: [] for name in names}
    for index in range(count):
        wall, shots = background(photos[index % len(photos)]), {}
        for name in names:
            marker = READERS[name][0]
            if marker not in shots:
                shots[marker] = draw_photograph((seed, index), wall, ALL_KINDS, sides, marker, is_dim=is_dim)
            image, shown, chain = shots[marker]
            seconds, found = timed(lambda name=name, image=image: detectors[name](image))
            results[name].append(judge(found, shown, chain) | {"seconds": seconds})
    return results


def print_table(results: dict[str, list[dict]]) -> None:
    print("| | " + " | ".join(results) + " |\n|---|" + "---|" * len(results))
    markers = {name: [m for line in lines for m in line["markers"]] for name, lines in results.items()}
    order = ["side 15 px and more", *(f"side {a:g} to {b:g} px" for a, b in pairwise(SIDES))]
    order += [f"tilt {a:g} to {b:g} deg" for a, b in pairwise(TILTS)]
    for group in [*order, "sharp", "motion blur", "out of focus", "dim light", "hard shadow"]:
        cells = []
        for some in markers.values():
            read = [m["read"] for m in some if group in m["groups"]]
            low, high = wilson(sum(read), max(len(read), 1))
            share = 100 * sum(read) / max(len(read), 1)
            cells.append(f"{share:.1f} % of {len(read)} ({100 * low:.0f} to {100 * high:.0f})")
        print(f"| {group} | " + " | ".join(cells) + " |")
    for title, key, times, digits in (
        ("corner error, median, px", "corner_px", 1, 3),
        ("worst corner, 95th percentile, px", "worst_px", 1, 2),
        ("position error, median, % of the distance", "position", 100, 2),
    ):
        cells = []
        for some in markers.values():
            values = [m[key] for m in some if m["read"] and m["side"] >= 15]
            value = np.median(values) if key != "worst_px" else np.percentile(values, 95)
            cells.append(f"{times * value:.{digits}f} of {len(values)}")
        print(f"| {title} | " + " | ".join(cells) + " |")
    for title, key in (("wrong codes", "wrong"), ("false positives, look-alikes in view", "false")):
        print(f"| {title} | " + " | ".join(str(sum(r[key] for r in rs)) for rs in results.values()) + " |")
    base = next((name for name in results if name.startswith("AprilTag")), next(iter(results)))
    mean = {name: np.mean([line["seconds"] for line in lines]) for name, lines in results.items()}
    cells = [f"{mean[name] / mean[base]:.2f}" for name in results]
    print(f"| time, ratio to {base} ({1000 * mean[base]:.1f} ms) | " + " | ".join(cells) + " |")


def print_law(results: dict[str, list[dict]]) -> None:
    """Side in cells at which half are read, and how steeply that rises, by maximum likelihood; little tilt only.

    The share that is read of the largest is free, as in `lmkit.model.detector_model`.
    """
    print("\n| | markers | half read at, px a cell | rise over, px | read at best |\n|---|---|---|---|---|")
    for name, lines in results.items():
        family = families_named(READERS[name][0])[0]
        markers = [m for line in lines for m in line["markers"] if m["tilt"] < LITTLE_TILT_DEG]
        side, read = (np.array([m[key] for m in markers]) for key in ("side", "read"))

        def misses(law: np.ndarray, side: np.ndarray = side, read: np.ndarray = read) -> float:
            half, rise, best = law
            share = np.clip(best / (1 + np.exp(-(side - half) / rise)), 1e-6, 1 - 1e-6)
            return float(-np.where(read, np.log(share), np.log(1 - share)).sum())

        half, rise, best = minimize(misses, (15.0, 2.0, 0.97), bounds=((5, 40), (0.3, 10), (0.5, 0.999))).x
        cells = getattr(family, "cells", None)
        each = f"{half / cells:.2f} ({half:.1f} px a side)" if cells else f"{half:.1f} px a side"
        print(f"| {name} | {len(markers)} | {each} | {rise:.2f} | {100 * best:.1f} % |")


def print_photographs(photos: list[Path], names: list[str]) -> None:
    """False positives and time on photographs, as they are and enlarged twice."""
    detectors = {name: READERS[name][1]() for name in names}
    base = next((name for name in names if name.startswith("AprilTag")), names[0])
    for times in (1, 2):
        images = (cv2.resize(cv2.imread(str(p)), None, fx=times, fy=times) for p in photos)
        found, seconds = dict.fromkeys(names, 0), dict.fromkeys(names, 0.0)
        for image in images:
            for name in names:
                took, markers = timed(lambda name=name, image=image: detectors[name](image))
                found[name] += len(markers)
                seconds[name] += took
        what = f"{len(photos)} photographs x {times}"
        ratios = (f"{seconds[name] / seconds[base]:.2f}" for name in names)
        print(f"| false positives, {what} | " + " | ".join(map(str, found.values())) + " |")
        print(f"| time, {what}, ratio to {base} | " + " | ".join(ratios) + " |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("photos", type=Path)
    parser.add_argument("--n", type=int, default=300, help="scenes")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--law", action="store_true", help="smaller markers: size at which half are read")
    parser.add_argument("--dim", action="store_true", help="dim rooms: full scale is 80 to 800 electrons")
    parser.add_argument("--readers", nargs="*", default=list(READERS))
    parser.add_argument("--lines", type=Path, help="write every image as a JSON line")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    photos = backgrounds(options.photos)
    sides = (6.0, 45.0) if options.law else (10.0, 70.0)
    results = run(photos, options.n, options.seed, options.readers, sides, options.dim)
    if options.lines:
        text = (json.dumps({"reader": name} | line) + "\n" for name, lines in results.items() for line in lines)
        options.lines.write_text("".join(text))
    if options.law:
        print_law(results)
        return
    print_table(results)
    if options.dim:
        return
    print_photographs(photos, options.readers)


if __name__ == "__main__":
    main()
