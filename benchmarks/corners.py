"""The covariance that `lmkit detect` states for corners, compared with their errors, by the size of the landmark.

    uv run --extra benchmark python benchmarks/corners.py [ROOMS_OR_DRIVE...]

Simulated images (two and three landmarks, 1 to 5 m, 0 to 50 deg, 12 pairs a situation), and the folders named, with
their true maps, rigs and poses; of rooms the folder of one kind of faces.  NEES / 8 is one where stated and true
errors agree; beside it with the floor that `lmkit locate` adds for lenses and paper.

The second table has the offset of the faces of a folder from their truth, in mm of their own plane (medians of
landmarks whose side has 20 px and more, with standard errors), for upright ones and for those that are turned in the
image, and the same NEES with the truth moved by that much.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
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
from lmkit.model.families import ALL_FAMILIES, families_named
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap
from lmkit.simulation.photograph import ImagingChain, Lens, Light, Sensor, photograph
from lmkit.simulation.scene import landmark_sheet, studio

SIDES_PX = (12, 16, 20, 25, 32, 45, 70, 300)
SURE_PX, TURNED_DEG = 20.0, 30.0
ANOTHER_PX = 8.0  # further off it is no corner error but another landmark


@dataclass(frozen=True)
class Corner:
    """One landmark in one image.

    Attributes:
        error: (8,) px; ``covariance``: (8,8) px^2.
        axes: (2,2) columns: a millimeter to the right and up on its face, px.
    """

    side_px: float
    error: np.ndarray
    covariance: np.ndarray
    axes: np.ndarray

    @property
    def move_mm(self) -> np.ndarray:
        """(2,) how far the middle of the corners lies to the right of and above its truth, on the face."""
        return np.linalg.solve(self.axes, self.error.reshape(4, 2).mean(axis=0))

    @property
    def turn_deg(self) -> float:
        """Between its upper edge and the rows of pixels."""
        return float(np.rad2deg(abs(np.arctan2(self.axes[1, 0], self.axes[0, 0]))))

    def against(self, moved_mm: np.ndarray) -> Corner:
        """With its truth moved on the face."""
        return replace(self, error=self.error - np.tile(self.axes @ moved_mm, 4))


def compare(
    photo: np.ndarray, camera: CameraModel, T_camera_map: Pose, landmarks: LandmarkMap, family: str = "lm8"
) -> list[Corner]:
    """Corners against the map, whose landmarks are named as those of lm8 whatever their faces show."""
    corners = []
    for o in detect_landmarks(photo, DetectOptions(families_named(family), camera=camera)):
        landmark = landmarks.find(LandmarkId("lm8", o.code))
        if landmark is None:
            continue
        true = camera.project(T_camera_map.apply(landmark.corners_map))
        if family != "lm8":  # the rooms show tags as OpenCV draws them: upside down
            true = np.roll(true, 2, axis=0)
        error = (o.corners - true).ravel()
        if np.abs(error).max() < ANOTHER_PX:
            side = np.linalg.norm(np.roll(true, -1, axis=0) - true, axis=1).mean()
            a, b, c, d = true
            axes = np.column_stack([b + c - a - d, a + b - c - d]) / (2000 * landmark.size_m)
            corners.append(Corner(float(side), error, o.covariance, axes))
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
        corners += compare(image, which, T, true_map(truth, pair["room"]), family_of(truth))
    return corners


def family_of(truth: dict) -> str:
    faces = str(truth.get("faces"))
    return faces if faces in ALL_FAMILIES else "lm8"


def print_moves(corners: Sequence[Corner], name: str) -> np.ndarray:
    """Print how far faces lie from their truth; (2,) mm, of all."""
    groups: dict[str, Callable[[Corner], bool]] = {
        "all": lambda c: True,
        "upright": lambda c: c.turn_deg < TURNED_DEG,
        "turned": lambda c: c.turn_deg >= TURNED_DEG,
    }
    print(f"\n| {name} | landmarks | to the right, mm | up, mm |\n|---|---|---|---|")
    for group, is_in in groups.items():
        moves = np.array([c.move_mm for c in corners if c.side_px >= SURE_PX and is_in(c)]).reshape(-1, 2)
        if len(moves) > 1:
            middle = np.median(moves, axis=0)
            spread = 1.25 * 1.48 * np.median(np.abs(moves - middle), axis=0) / np.sqrt(len(moves))
            cells = " | ".join(f"{value:+.3f} ± {error:.3f}" for value, error in zip(middle, spread, strict=True))
            print(f"| {group} | {len(moves)} | {cells} |")
    return np.median([c.move_mm for c in corners if c.side_px >= SURE_PX], axis=0)


def table(corners: Sequence[Corner], name: str) -> None:
    print(f"\n| {name}, side px | landmarks | error rms, px | middle, px | NEES / 8 | with the floor |")
    print("|---|---|---|---|---|---|")
    for low, high in [(SIDES_PX[0], SIDES_PX[-1]), *pairwise(SIDES_PX)]:
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
            corners = list(chain.from_iterable(seen))
            table(corners, folder.name)
            move_mm = print_moves(corners, folder.name)
            table([c.against(move_mm) for c in corners], f"{folder.name}, truth moved")


if __name__ == "__main__":
    main([Path(name) for name in sys.argv[1:]])
