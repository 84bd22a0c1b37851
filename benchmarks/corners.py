"""Whether the covariance that `lmkit detect` states for corners is that of their errors, by the size of the landmark.

    uv run --extra benchmark python benchmarks/corners.py [ROOMS_OR_DRIVE...]

Simulated images (two and three landmarks, 1 to 5 m, 0 to 50 deg, 12 pairs a situation), and the folders named, with
their true maps, rigs and poses.  NEES / 8 is one where stated and true errors agree; beside it with the floor that
`lmkit locate` adds for lenses and paper.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import chain, pairwise, product
from pathlib import Path

import cv2
import numpy as np
from accuracy import Situation, bound
from locate import read_truth, true_map, true_pose, true_rig

from lmkit.detection.config import DetectOptions
from lmkit.detection.detector import detect_landmarks
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.pose import Pose
from lmkit.geometry.rotations import rotation_exp
from lmkit.localization.correspondences import CORNER_FLOOR_PX
from lmkit.model.landmark_map import LandmarkMap
from lmkit.simulation.photograph import ImagingChain, Lens, Light, Sensor, photograph
from lmkit.simulation.scene import landmark_sheet, studio

SIDES_PX = (12, 16, 20, 25, 32, 45, 70, 300)
ANOTHER_PX = 8.0  # further off it is no corner error but another landmark


@dataclass(frozen=True)
class Corner:
    """One landmark in one image."""

    side_px: float
    error: np.ndarray
    covariance: np.ndarray


def compare(photo: np.ndarray, camera: CameraModel, T_camera_map: Pose, landmarks: LandmarkMap) -> list[Corner]:
    corners = []
    for o in detect_landmarks(photo, DetectOptions(camera=camera)):
        landmark = landmarks.find(o.id)
        if landmark is None:
            continue
        true = camera.project(T_camera_map.apply(landmark.corners_map))
        error = (o.corners - true).ravel()
        if np.abs(error).max() < ANOTHER_PX:
            side = np.linalg.norm(np.roll(true, -1, axis=0) - true, axis=1).mean()
            corners.append(Corner(float(side), error, o.covariance))
    return corners


def simulated(job: tuple[Situation, int]) -> list[Corner]:
    s, draws = job
    cv2.setNumThreads(1)
    rng = np.random.default_rng([s.count, int(10 * s.distance_m), int(s.angle_deg)])
    scene, corners = studio([landmark_sheet(landmark) for landmark in s.landmarks]), []
    for _ in range(draws if bound(s) is not None else 0):
        turn = rotation_exp(np.deg2rad(rng.uniform(-1, 1, 3)))
        T = Pose("map", "camera", turn @ s.station.R, s.station.t + rng.uniform(-0.03, 0.03, 3))
        light = Light(float(rng.uniform(0.3, 0.9)), temperature_k=float(rng.uniform(3500, 6500)))
        chain = ImagingChain(Lens(float(rng.uniform(0.5, 0.9))), light, Sensor(6000.0, 8.0, bayer=True))
        photo = photograph(scene, s.rig.left, T, chain, rng)
        corners += compare(photo, s.rig.left, T.inverse(), LandmarkMap(s.landmarks))
    return corners


def rendered(job: tuple[Path, int]) -> list[Corner]:
    folder, index = job
    cv2.setNumThreads(1)
    truth = read_truth(folder)
    pair, rig = truth["pairs"][index], true_rig(truth)
    T_left_map = true_pose(pair).inverse()
    corners = []
    for photo, which, to_camera in zip(
        pair["images"], (rig.left, rig.right), (Pose.identity("camera", "camera"), rig.T_right_left), strict=True
    ):
        T = Pose("camera", "camera", to_camera.R, to_camera.t) @ T_left_map
        image = cv2.imread(str(folder / "images" / photo["image"]))
        corners += compare(image, which, T, true_map(truth, pair["room"]))
    return corners


def table(corners: Sequence[Corner], name: str) -> None:
    print(f"\n| {name}, side px | landmarks | error rms, px | middle, px | NEES / 8 | with the floor |")
    print("|---|---|---|---|---|---|")
    for low, high in pairwise(SIDES_PX):
        here = [c for c in corners if low <= c.side_px < high]
        if not here:
            continue
        errors = np.array([c.error for c in here])
        nees = [
            np.mean([c.error @ np.linalg.solve(c.covariance + floor**2 * np.eye(8), c.error) / 8 for c in here])
            for floor in (0.0, CORNER_FLOOR_PX)
        ]
        rms, middle = np.sqrt(np.mean(errors**2)), np.median(np.abs(errors))
        print(f"| {low} to {high} | {len(here)} | {rms:.3f} | {middle:.3f} | {nees[0]:.2f} | {nees[1]:.2f} |")


def main(folders: Sequence[Path]) -> None:
    situations = product((2, 3), (1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0), (0.0, 30.0, 50.0))
    with ProcessPoolExecutor() as pool:
        jobs = [(Situation(*s), 12) for s in situations]
        table(list(chain.from_iterable(pool.map(simulated, jobs))), "simulated")
        for folder in folders:
            pairs = len(read_truth(folder)["pairs"])
            seen = pool.map(rendered, [(folder, k) for k in range(pairs)])
            table(list(chain.from_iterable(seen)), folder.name)


if __name__ == "__main__":
    main([Path(name) for name in sys.argv[1:]])
