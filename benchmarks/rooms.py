"""Landmarks and AprilTags (AprilTag 3, locus-tag) in the same rendered rooms: read, wrong, corners, time.

    uv run --extra benchmark python benchmarks/rooms.py ../shared/data/rooms

Every scene exists twice, once with lm8 landmarks and once with AprilTag 36h11 of the same size in
the same places (`landmark/` and `tag36h11/`, each with its `truth.json`).  A landmark counts when
its four corners are in the picture, it is at least 97 % unhidden, tilted by less than 80 deg and has
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

SIDES = (15, 20, 25, 30, 60, 1e9)
TILTS = (0, 30, 60, 80)


def score(folder: Path, detect) -> dict:
    truth = json.loads((folder / "truth.json").read_text())
    seen, groups, read, wrong, false, errors, seconds = [], [], [], 0, 0, [], []
    for pair in truth["pairs"]:
        for picture in pair["images"]:
            image = cv2.imread(str(folder / "images" / picture["image"]))
            start = time.perf_counter()
            found = detect(image)
            seconds.append(time.perf_counter() - start)
            hits = set()
            for code, corners in found:
                middle = corners.mean(axis=0)
                near = [
                    entry
                    for entry in picture["landmarks"]
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
            for entry in picture["landmarks"]:
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
    return {f"tilt {low} to {high} deg", f"light: {conditions['light']}", f"blur: {conditions['blur']}"}


def is_counted(entry: dict) -> bool:
    return entry["state"] == "full" and entry["tilt_deg"] < 80 and entry["side_px"] >= SIDES[0]


def main(rooms: Path) -> None:
    cv2.setNumThreads(1)
    folders = {"lmkit": "landmark", "AprilTag 3": "tag36h11", "locus-tag": "tag36h11"}
    results = {name: score(rooms / folder, READERS[name].make()) for name, folder in folders.items()}
    print("| | " + " | ".join(results) + " |\n|---|" + "---|" * len(results))
    for low, high in [(SIDES[0], 1e9), *pairwise(SIDES)]:
        cells = []
        for r in results.values():
            chosen = (r["side"] >= low) & (r["side"] < high)
            hits, n = int(r["read"][chosen].sum()), int(chosen.sum())
            a, b = wilson(hits, n)
            cells.append(f"{100 * hits / n:.1f} % of {n} ({100 * a:.0f} to {100 * b:.0f})")
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
        ("time a picture, ratio to AprilTag", lambda r: f"{r['ms'] / results['AprilTag 3']['ms']:.1f}"),
    ):
        print(f"| {name} | " + " | ".join(value(r) for r in results.values()) + " |")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
