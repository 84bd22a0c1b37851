"""Landmarks and AprilTags (AprilTag 3, locus-tag) in the same rendered rooms: read, wrong, corners, time.

    uv run --extra benchmark python benchmarks/rooms.py ../shared/data/rooms [../shared/data/drive]

lmkit runs with its defaults, with ``--fast``, with the camera's calibration given, and on the AprilTags.  A
recording has landmarks only.

Every scene exists twice, once with lm8 landmarks and once with AprilTag 36h11 of the same size in
the same places (`landmark/` and `tag36h11/`, each with its `truth.json`).  A landmark counts when
its four corners are in the image, it is at least 97 % unhidden, tilted by less than 80 deg and has
a side of at least 15 px.  Intervals are Wilson's, 95 %.
"""

import json
import sys
import time
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from peers import READERS, wilson

from lmkit.detection.config import ACCURATE, FAST, DetectOptions
from lmkit.detection.detector import detect_landmarks
from lmkit.geometry.camera import CameraModel
from lmkit.model.families import families_named

SIDES = (15, 20, 25, 30, 60, 1e9)
TILTS = (0, 30, 60, 80)


def lmkit_readers(truth: dict) -> dict:
    """lmkit's methods of reading, each a function of an image and which camera took it."""
    rig = truth["rig"]
    cameras = {
        side[0].upper(): CameraModel((640, 480), np.array(rig[side]["K"]), np.array([*rig[side]["dist"], 0.0]))
        for side in ("left", "right")
    }
    methods = {
        "lmkit": lambda side: DetectOptions(),
        "lmkit, fast": lambda side: DetectOptions(config=FAST),
        "lmkit, accurate": lambda side: DetectOptions(config=ACCURATE),
        "lmkit, camera given": lambda side: DetectOptions(camera=cameras[side]),
    }
    return {
        name: lambda image, side, way=way: [(d.code, d.corners) for d in detect_landmarks(image, way(side))]
        for name, way in methods.items()
    }


def read_tags(image: np.ndarray) -> list:
    """lmkit on AprilTags, which the rooms show as OpenCV draws them: upside down."""
    found = detect_landmarks(image, DetectOptions(families_named("tag36h11")))
    return [(d.code, np.roll(d.corners, 2, axis=0)) for d in found]


def score(folder: Path, detect) -> dict:
    truth = json.loads((folder / "truth.json").read_text())
    seen, groups, read, wrong, false, errors, seconds = [], [], [], 0, 0, [], []
    for pair in truth["pairs"]:
        for photo in pair["images"]:
            image = cv2.imread(str(folder / "images" / photo["image"]))
            start = time.perf_counter()
            found = detect(image, photo["side"])
            seconds.append(time.perf_counter() - start)
            hits = set()
            for code, corners in found:
                middle = corners.mean(axis=0)
                near = [
                    entry
                    for entry in photo["landmarks"]
                    if np.linalg.norm(np.mean(entry["corners"], axis=0) - middle) < 0.6 * entry["side_px"]
                ]
                if not near:
                    false += 1
                    continue
                entry = min(near, key=lambda e: np.linalg.norm(np.mean(e["corners"], axis=0) - middle))
                if entry["id"] != code:
                    wrong += 1
                    continue
                hits.add(entry["landmark"])
                if is_counted(entry):
                    off = np.linalg.norm(corners - np.array(entry["corners"]), axis=1)
                    errors.append(float(np.sqrt(np.mean(off**2))))
            for entry in photo["landmarks"]:
                if is_counted(entry):
                    seen.append(entry["side_px"])
                    groups.append(groups_of(entry, pair["conditions"]))
                    read.append(entry["landmark"] in hits)
    return {
        "side": np.array(seen),
        "groups": groups,
        "read": np.array(read),
        "wrong": wrong,
        "false": false,
        "error": np.array(errors),
        "ms": 1000 * float(np.median(seconds)),
    }


def groups_of(entry: dict, conditions: dict) -> set[str]:
    """The rows that a landmark belongs to, beside its size."""
    low, high = next((a, b) for a, b in pairwise(TILTS) if a <= entry["tilt_deg"] < b)
    return {f"tilt {low} to {high} deg"} | {
        f"{key}: {conditions[key]}" for key in ("light", "blur") if key in conditions
    }


def is_counted(entry: dict) -> bool:
    return entry["state"] == "full" and entry["tilt_deg"] < 80 and entry["side_px"] >= SIDES[0]


def main(rooms: Path, drive: Path | None) -> None:
    cv2.setNumThreads(1)
    truth = json.loads((rooms / "landmark" / "truth.json").read_text())
    results = {name: score(rooms / "landmark", detect) for name, detect in lmkit_readers(truth).items()}
    results["lmkit on tag36h11"] = score(rooms / "tag36h11", lambda image, side: read_tags(image))
    for name in ("AprilTag 3", "locus-tag"):
        peer = READERS[name].make()
        results[name] = score(rooms / "tag36h11", lambda image, side, peer=peer: peer(image))
    print_table(results, "AprilTag 3")
    if drive is not None:
        truth = json.loads((drive / "truth.json").read_text())
        print(f"\n{drive.name}:\n")
        print_table({name: score(drive, detect) for name, detect in lmkit_readers(truth).items()}, "lmkit")


def print_table(results: dict, timed_by: str) -> None:
    print("| | " + " | ".join(results) + " |\n|---|" + "---|" * len(results))
    for low, high in [(SIDES[0], 1e9), *pairwise(SIDES)]:
        cells = []
        for r in results.values():
            chosen = (r["side"] >= low) & (r["side"] < high)
            hits, n = int(r["read"][chosen].sum()), int(chosen.sum())
            a, b = wilson(hits, max(n, 1))
            cells.append(f"{100 * hits / max(n, 1):.1f} % of {n} ({100 * a:.0f} to {100 * b:.0f})")
        name = f"side {low:g} px and more" if high > 1e8 else f"side {low:g} to {high:g} px"
        print(f"| {name} | " + " | ".join(cells) + " |")
    for group in sorted(set().union(*(found for r in results.values() for found in r["groups"]))):
        cells = []
        for r in results.values():
            hits = [hit for hit, found in zip(r["read"], r["groups"], strict=True) if group in found]
            a, b = wilson(int(sum(hits)), len(hits))
            cells.append(f"{100 * np.mean(hits):.1f} % of {len(hits)} ({100 * a:.0f} to {100 * b:.0f})")
        print(f"| {group} | " + " | ".join(cells) + " |")
    for name, value in (
        ("wrong codes", lambda r: str(r["wrong"])),
        ("false positives", lambda r: str(r["false"])),
        ("corner error, median px", lambda r: f"{np.median(r['error']):.3f}"),
        ("corner error, 90th percentile px", lambda r: f"{np.percentile(r['error'], 90):.3f}"),
        (f"time an image, ratio to {timed_by}", lambda r: f"{r['ms'] / results[timed_by]['ms']:.1f}"),
    ):
        print(f"| {name} | " + " | ".join(value(r) for r in results.values()) + " |")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) > 2 else None)
