"""Where `lmkit locate` puts the camera in rendered rooms, and whether its covariance can be trusted.

    uv run --extra benchmark python benchmarks/locate.py ../shared/data/rooms

The true map and rig are given; codes that hang twice in a room are left out of its map.  The table
runs over `LocateOptions.corner_floor_px`, the share of the corners' error that detection does not
know of.
"""

import json
import multiprocessing
import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from functools import lru_cache, partial
from pathlib import Path

import cv2
import numpy as np
from scipy.stats import chi2

from lmkit.detect.landmarks import detect_landmarks
from lmkit.detect.options import DetectOptions
from lmkit.locate.rig import LocateOptions, locate_rig
from lmkit.model.camera import CameraModel
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.model.pose import Pose, rotation_log
from lmkit.model.stereo_rig import StereoRig

FLOORS_PX = (0.0, 0.05, LocateOptions().corner_floor_px, 0.15)
LEVELS = (0.5, 0.9, 0.95, 0.99)


@lru_cache(maxsize=1)
def read_truth(folder: Path) -> dict:
    return json.loads((folder / "truth.json").read_text())


def true_rig(truth: dict) -> StereoRig:
    rig = truth["rig"]
    left, right = (
        CameraModel((640, 480), np.array(rig[eye]["K"]), np.array([*rig[eye]["dist"], 0.0]))
        for eye in ("left", "right")
    )
    return StereoRig(left, right, Pose("right", "left", np.array(rig["R"]), np.array(rig["t"]).ravel()))


def true_map(truth: dict, room: int) -> LandmarkMap:
    hung = truth["maps"][str(room)]
    hung = hung if isinstance(hung, list) else hung["landmarks"]
    times = Counter(landmark["id"] for landmark in hung)
    mapped = []
    for landmark in (landmark for landmark in hung if times[landmark["id"]] == 1):
        place = landmark["T_world_landmark"]
        if isinstance(place, dict):
            R, t = np.array(place["R"]), np.array(place["t"]).ravel()
        else:
            R, t = np.array(place)[:3, :3], np.array(place)[:3, 3]
        mapped.append(MappedLandmark(landmark["id"], "lm8", 0.18, Pose("map", "landmark", R, t)))
    return LandmarkMap(mapped)


def locate(folder: Path, index: int) -> list[tuple[str, float, float, float]]:
    """For each floor: status, position error (m), and position's and rotation's squared normalised error."""
    cv2.setNumThreads(1)
    truth = read_truth(folder)
    pair, rig = truth["pairs"][index], true_rig(truth)
    seen = [
        detect_landmarks(cv2.imread(str(folder / "images" / picture["image"])), DetectOptions(camera=eye))
        for picture, eye in zip(pair["images"], (rig.left, rig.right), strict=True)
    ]
    world = pair["T_world_left"]
    T = Pose.from_quaternion("map", "camera", world["position"], world["quaternion_xyzw"])
    answers = []
    for floor_px in FLOORS_PX:
        estimate = locate_rig(*seen, rig, true_map(truth, pair["room"]), LocateOptions(corner_floor_px=floor_px))
        if estimate.status != "ok":
            answers.append((estimate.status, np.nan, np.nan, np.nan))
            continue
        off = estimate.T_map_camera.t - T.t
        turn = rotation_log(estimate.T_map_camera.R @ T.R.T)
        C = estimate.covariance
        nees = off @ np.linalg.solve(C[:3, :3], off), turn @ np.linalg.solve(C[3:, 3:], turn)
        answers.append(("ok", float(np.linalg.norm(off)), float(nees[0]), float(nees[1])))
    return answers


def main(rooms: Path) -> None:
    folder = rooms / "landmark"
    pairs = range(len(read_truth(folder)["pairs"]))
    with ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn")) as pool:
        answers = list(pool.map(partial(locate, folder), pairs, chunksize=4))
    print(
        "| floor, px | located | position error at 50 / 75 / 90 / 95 %, cm | NEES / 3, place, turn | truth inside |"
    )
    print("|---|---|---|---|---|")
    for k, floor_px in enumerate(FLOORS_PX):
        found = [answer[k] for answer in answers]
        good = np.array(
            [[error, position, rotation] for status, error, position, rotation in found if status == "ok"]
        )
        errors = " / ".join(f"{100 * e:.2f}" for e in np.percentile(good[:, 0], [50, 75, 90, 95]))
        nees = ", ".join(f"{good[:, j].mean() / 3:.2f}" for j in (1, 2))
        inside = " ".join(f"{(good[:, 1] < chi2.ppf(level, 3)).mean():.2f} of {level}," for level in LEVELS)
        print(f"| {floor_px:g} | {len(good)} of {len(found)} | {errors} | {nees} | {inside.rstrip(',')} |")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
