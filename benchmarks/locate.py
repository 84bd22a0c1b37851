"""Errors of `lmkit locate` in rendered rooms, and whether its covariance can be trusted.

    uv run --extra benchmark python benchmarks/locate.py ../shared/data/rooms

The true map and rig are given; codes that are mounted twice in a room are left out of its map.  The table runs over
`LocateOptions.corner_floor_px`, the share of the corners' error that detection does not know of.  Below it AprilTag
3 on the corresponding images (same rooms, cameras and noise, with AprilTags), with the pose that a user of OpenCV
would compute: every corner of the left image into `solvePnPRansac`, then Levenberg-Marquardt.

At the end: errors of place at the usual floor beside those that the stated covariances expect, each with the 95 %
interval of as many pairs, and the pairs that are off by most.
"""

import json
import multiprocessing
import sys
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from pathlib import Path

import cv2
import numpy as np
from peers import READERS
from scipy.stats import chi2

from lmkit.detection.config import DetectOptions
from lmkit.detection.detector import detect_landmarks
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.pose import Pose
from lmkit.geometry.rotations import rotation_log
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.localization.absolute_pose import LocateOptions
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark
from lmkit.pipelines.look_again import FrameImage, locate_frame

FLOORS_PX = (0.0, 0.05, LocateOptions().corner_floor_px, 0.15)
LEVELS = (0.5, 0.9, 0.95, 0.99)
FAR_M, DRAWS = 0.012, 2000


@lru_cache(maxsize=1)
def read_truth(folder: Path) -> dict:
    return json.loads((folder / "truth.json").read_text())


def true_rig(truth: dict) -> StereoRig:
    rig = truth["rig"]
    left, right = (
        CameraModel((640, 480), np.array(rig[side]["K"]), np.array([*rig[side]["dist"], 0.0]))
        for side in ("left", "right")
    )
    return StereoRig(left, right, Pose("right", "left", np.array(rig["R"]), np.array(rig["t"]).ravel()))


def true_map(truth: dict, room: int) -> LandmarkMap:
    mounted = truth["maps"][str(room)]
    mounted = mounted if isinstance(mounted, list) else mounted["landmarks"]
    times = Counter(landmark["id"] for landmark in mounted)
    mapped = []
    for landmark in (landmark for landmark in mounted if times[landmark["id"]] == 1):
        place = landmark["T_world_landmark"]
        if isinstance(place, dict):
            R, t = np.array(place["R"]), np.array(place["t"]).ravel()
        else:
            R, t = np.array(place)[:3, :3], np.array(place)[:3, 3]
        mapped.append(MappedLandmark(LandmarkId("lm8", landmark["id"]), 0.18, Pose("map", "landmark", R, t)))
    return LandmarkMap(mapped)


@dataclass(frozen=True, eq=False)
class Place:
    """A located pair at the usual floor: its error (m) and the covariance (3,3) stated for it.

    Attributes:
        landmarks: that were used.
    """

    name: str
    off_m: float
    covariance: np.ndarray
    landmarks: int


def locate(folder: Path, index: int) -> tuple[list[tuple[str, float, float, float, float]], Place | None]:
    """For each floor: status, errors of position (m) and heading (deg), and both parts' squared normalized error."""
    cv2.setNumThreads(1)
    truth = read_truth(folder)
    pair, rig = truth["pairs"][index], true_rig(truth)
    images = [
        FrameImage(cv2.imread(str(folder / "images" / photo["image"])), DetectOptions(camera=side))
        for photo, side in zip(pair["images"], (rig.left, rig.right), strict=True)
    ]
    seen = [detect_landmarks(image.pixels, image.options) for image in images]
    T = true_pose(pair)
    answers, place = [], None
    for floor_px in FLOORS_PX:
        options = LocateOptions(corner_floor_px=floor_px)
        estimate, _ = locate_frame(images, seen, rig, true_map(truth, pair["room"]), options)
        if estimate.status != "ok":
            answers.append((estimate.status, np.nan, np.nan, np.nan, np.nan))
            continue
        off = estimate.T_map_camera.t - T.t
        turn = rotation_log(estimate.T_map_camera.R @ T.R.T)
        C = estimate.covariance
        nees = off @ np.linalg.solve(C[:3, :3], off), turn @ np.linalg.solve(C[3:, 3:], turn)
        off_deg = heading_off_deg(estimate.T_map_camera, T)
        answers.append(("ok", float(np.linalg.norm(off)), float(nees[0]), float(nees[1]), off_deg))
        if floor_px == LocateOptions().corner_floor_px:
            place = Place(pair["pair"], answers[-1][1], C[:3, :3], len(estimate.inliers))
    return answers, place


@cache
def april_tag_reader() -> Callable:
    """One a process."""
    return READERS["AprilTag 3"].make()


def locate_apriltag(folder: Path, index: int) -> tuple[str, float, float]:
    """Status, position error (m) and heading error (deg) of AprilTag's corners in a robust PnP."""
    cv2.setNumThreads(1)
    truth = read_truth(folder)
    pair, rig = truth["pairs"][index], true_rig(truth)
    mapped = true_map(truth, pair["room"])
    image = cv2.imread(str(folder / "images" / pair["images"][0]["image"]))
    seen = [
        (known, corners)
        for code, corners in april_tag_reader()(image)
        if (known := mapped.find(LandmarkId("lm8", code)))
    ]
    if not seen:
        return "no_landmarks", np.nan, np.nan
    points = np.concatenate([known.corners_map for known, _ in seen])
    pixels = np.concatenate([corners for _, corners in seen])
    found, rvec, tvec, inliers = cv2.solvePnPRansac(
        points, pixels, rig.left.K, rig.left.distortion, reprojectionError=3.0, flags=cv2.SOLVEPNP_SQPNP
    )
    if not found:
        return "inconsistent", np.nan, np.nan
    rows = inliers.ravel()
    rvec, tvec = cv2.solvePnPRefineLM(points[rows], pixels[rows], rig.left.K, rig.left.distortion, rvec, tvec)
    T = Pose.from_rvec("camera", "map", rvec, tvec).inverse()
    true = true_pose(pair)
    return "ok", float(np.linalg.norm(T.t - true.t)), heading_off_deg(T, true)


def true_pose(pair: dict) -> Pose:
    world = pair["T_world_left"]
    return Pose.from_quaternion("map", "camera", world["position"], world["quaternion_xyzw"])


def heading_off_deg(T: Pose, true: Pose) -> float:
    """Between the optical axes, seen from above."""
    a, b = (np.arctan2(pose.R[1, 2], pose.R[0, 2]) for pose in (T, true))
    return float(np.rad2deg(abs(np.angle(np.exp(1j * (a - b))))))


def main(rooms: Path) -> None:
    folder = rooms / "landmark"
    pairs = range(len(read_truth(folder)["pairs"]))
    with ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn")) as pool:
        answers = list(pool.map(partial(locate, folder), pairs, chunksize=4))
        peer = list(pool.map(partial(locate_apriltag, rooms / "tag36h11"), pairs, chunksize=4))
    print("| floor, px | located | position, cm | heading, deg | NEES / 3, place, turn | truth inside |")
    print("|---|---|---|---|---|---|")
    for k, floor_px in enumerate(FLOORS_PX):
        found = [answer[k] for answer, _ in answers]
        good = np.array([numbers for status, *numbers in found if status == "ok"])
        nees = ", ".join(f"{good[:, j].mean() / 3:.2f}" for j in (1, 2))
        inside = " ".join(f"{(good[:, 1] < chi2.ppf(level, 3)).mean():.2f} of {level}," for level in LEVELS)
        row = f"| {floor_px:g} | {len(good)} of {len(found)} | {_at_levels(100 * good[:, 0])} |"
        print(f"{row} {_at_levels(good[:, 3])} | {nees} | {inside.rstrip(',')} |")
    good = np.array([numbers for status, *numbers in peer if status == "ok"])
    row = f"| AprilTag 3, PnP | {len(good)} of {len(peer)} | {_at_levels(100 * good[:, 0])} |"
    print(f"{row} {_at_levels(good[:, 1])} | - | - |")
    print_expected([place for _, place in answers if place is not None])


def print_expected(places: list[Place]) -> None:
    """Errors, those that the covariances expect, and the pairs that are off by most."""
    rng = np.random.default_rng(0)
    off = np.array([place.off_m for place in places])
    again = rng.choice(off, (DRAWS, len(off)))
    drawn = [rng.multivariate_normal(np.zeros(3), place.covariance, DRAWS) for place in places]
    expected = np.linalg.norm(drawn, axis=2).T
    print("\n| place, mm | at 50 % | at 90 % | at 95 % |\n|---|---|---|---|")
    for name, value, sets in (("found", off, again), ("expected", expected, expected)):
        cells = []
        for level in (50, 90, 95):
            low, high = 1000 * np.percentile(np.percentile(sets, level, axis=1), [2.5, 97.5])
            cells.append(f"{1000 * np.percentile(value, level):.1f} ({low:.1f} to {high:.1f})")
        print(f"| {name} | " + " | ".join(cells) + " |")
    for place in sorted(places, key=lambda one: -one.off_m):
        if place.off_m > FAR_M:
            sigma = np.sqrt(place.covariance.trace())
            print(
                f"{place.name}: {1000 * place.off_m:.1f} mm, {1000 * sigma:.1f} stated, {place.landmarks} landmarks"
            )


def _at_levels(errors: np.ndarray) -> str:
    """At 50, 75, 90 and 95 %."""
    return " / ".join(f"{error:.2f}" for error in np.percentile(errors, [50, 75, 90, 95]))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
