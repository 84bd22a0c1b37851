"""Accuracy of `lmkit locate` in simulation, expected, stated and reached: the tables of docs/accuracy.md.

    uv run python benchmarks/accuracy.py [--draws 1000] [--plot docs/accuracy.svg] [--images 200]

Simulated corners (no images): landmarks of 18 cm on a wall 0.8 m apart, 640 x 480, f = 460 px, cameras 12 cm apart,
every corner off by 0.15 px (standard deviation; what the detector shows in rendered rooms).  Bound: the Cramer-Rao
bound, the inverse of the information at the true pose.

``--images N``: the same situations photographed N times (simulated images, `lmkit/simulation/photograph.py`), each
from a place moved by up to 3 cm and 1 deg so that pixels fall elsewhere, and read by `lmkit detect`: the detector's
own corners with the covariance that it states.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import cv2
import numpy as np
from scipy.stats import chi2

from lmkit.detection.config import DetectOptions
from lmkit.detection.detector import detect_landmarks
from lmkit.geometry.pose import Pose
from lmkit.geometry.pose_array import PoseArray
from lmkit.geometry.rotations import rotation_exp, rotation_log
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.localization.absolute_pose import LocateOptions, locate_camera, locate_rig
from lmkit.localization.correspondences import Correspondences
from lmkit.model.estimate import PoseEstimate
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap, MappedLandmark, wall_pose
from lmkit.model.observation import Detection
from lmkit.simulation.photograph import ImagingChain, Lens, Light, Sensor, photograph
from lmkit.simulation.scene import landmark_sheet, looking, make_rig, studio

NOISE_PX = 0.15
APART_M = 0.8
PLACES = ((0.0, 1.3), (-APART_M, 1.1), (APART_M, 1.5))


@dataclass(frozen=True)
class Situation:
    """Camera and its place before the wall (y = 0)."""

    count: int
    distance_m: float
    angle_deg: float = 0.0
    mono: bool = False
    focal_px: float = 460.0
    baseline_m: float = 0.12
    apart_m: float = APART_M
    family: str = "lm8"

    @property
    def rig(self) -> StereoRig:
        return make_rig(focal_px=self.focal_px, baseline_m=self.baseline_m)

    @property
    def landmarks(self) -> list[MappedLandmark]:
        scale = self.apart_m / APART_M
        return [
            MappedLandmark(LandmarkId(self.family, 10 + k), 0.18, wall_pose([x * scale, 0.0, z], np.pi / 2))
            for k, (x, z) in enumerate(PLACES[: self.count])
        ]

    @property
    def station(self) -> Pose:
        angle = np.deg2rad(self.angle_deg)
        place = np.array([self.distance_m * np.sin(angle), self.distance_m * np.cos(angle), 1.3])
        return looking(place, -np.pi / 2 - angle, 0.0)


def see(s: Situation, rng: np.random.Generator | None) -> list[list[Detection]]:
    rig, T = s.rig, s.station.inverse()
    cameras = []
    for camera, R, t in (
        (rig.left, np.eye(3), np.zeros(3)),
        (rig.right, rig.T_right_left.R, rig.T_right_left.t),
    )[: 1 if s.mono else 2]:
        seen = []
        for landmark in s.landmarks:
            corners = camera.project(T.apply(landmark.corners_map) @ R.T + t)
            if camera.contains(corners).all():
                noise = 0.0 if rng is None else rng.normal(0, NOISE_PX, (4, 2))
                seen.append(Detection(landmark.id, corners + noise, 0.99, 50.0, covariance=NOISE_PX**2 * np.eye(8)))
        cameras.append(seen)
    return cameras


def locate(s: Situation, cameras: Sequence[list[Detection]], options: LocateOptions) -> PoseEstimate:
    landmarks = LandmarkMap(s.landmarks)
    if s.mono:
        return locate_camera(cameras[0], s.rig.left, landmarks, options)
    return locate_rig(cameras, s.rig, landmarks, options)


def bound(s: Situation) -> np.ndarray | None:
    """(6,6) the Cramer-Rao bound, or None where not all landmarks are in view."""
    cameras = see(s, None)
    if any(len(seen) < s.count for seen in cameras):
        return None
    rig, T = s.rig, s.station
    placed = [
        (cameras[0], rig.left, np.eye(3), np.zeros(3)),
        *([] if s.mono else [(cameras[1], rig.right, rig.T_right_left.R, rig.T_right_left.t)]),
    ]
    seen = Correspondences(placed, LandmarkMap(s.landmarks), 0.0)
    normal = seen.equations(
        PoseArray("map", "left", T.R[None], T.t[None]), np.ones((1, len(seen)), dtype=bool), None
    )[0][0]
    return np.linalg.inv(normal)


def sigmas(s: Situation) -> str:
    """Position, mm (three axes together), and heading, deg, of the bound."""
    C = bound(s)
    if C is None:
        return "out of view"
    return f"{1000 * np.sqrt(np.trace(C[:3, :3])):.1f} mm, {np.rad2deg(np.sqrt(C[5, 5])):.2f} deg"


def study(job: tuple[Situation, int]) -> tuple[Situation, float, float, float] | None:
    """Share called ok, mean NEES / 6 and error over the bound, of those called ok."""
    s, draws = job
    C = bound(s)
    if C is None:
        return None
    rng = np.random.default_rng(7)
    squared, errors = [], []
    for _ in range(draws):
        estimate = locate(s, see(s, rng), LocateOptions(corner_floor_px=0.0))
        if estimate.status != "ok":
            continue
        off = np.concatenate(
            [estimate.T_map_camera.t - s.station.t, rotation_log(estimate.T_map_camera.R @ s.station.R.T)]
        )
        squared.append(off @ np.linalg.solve(estimate.covariance, off))
        errors.append(off)
    if len(errors) < draws / 20:
        return s, len(errors) / draws, np.nan, np.nan
    rmse = np.sqrt(np.mean(np.sum(np.array(errors)[:, :3] ** 2, axis=1)))
    return s, len(errors) / draws, float(np.mean(squared)) / 6, float(rmse / np.sqrt(np.trace(C[:3, :3])))


def study_images(job: tuple[Situation, int]) -> tuple[Situation, float, float, float] | None:
    """Share called ok, mean NEES / 6 and median position error (mm) of those called ok."""
    s, draws = job
    if bound(s) is None:
        return None
    cv2.setNumThreads(1)
    rng = np.random.default_rng(11)
    scene, squared, errors = studio([landmark_sheet(landmark) for landmark in s.landmarks]), [], []
    for _ in range(draws):
        moved = rng.uniform(-0.03, 0.03, 3)
        turn = rotation_exp(np.deg2rad(rng.uniform(-1, 1, 3)))
        T = Pose("map", "camera", turn @ s.station.R, s.station.t + moved)
        light = Light(float(rng.uniform(0.3, 0.9)), temperature_k=float(rng.uniform(3500, 6500)))
        chain = ImagingChain(Lens(float(rng.uniform(0.5, 0.9))), light, Sensor(6000.0, 8.0, bayer=True))
        cameras = []
        for camera, T_camera_left in (
            (s.rig.left, Pose.identity("camera", "camera")),
            (s.rig.right, Pose("camera", "camera", s.rig.T_right_left.R, s.rig.T_right_left.t)),
        ):
            image = photograph(scene, camera, T @ T_camera_left.inverse(), chain, rng)
            cameras.append(detect_landmarks(image, DetectOptions(camera=camera)))
        estimate = locate(s, cameras, LocateOptions())
        if estimate.status != "ok":
            continue
        off = np.concatenate([estimate.T_map_camera.t - T.t, rotation_log(estimate.T_map_camera.R @ T.R.T)])
        squared.append(off @ np.linalg.solve(estimate.covariance, off))
        errors.append(np.linalg.norm(off[:3]))
    if len(errors) < draws / 20:
        return s, len(errors) / draws, np.nan, np.nan
    return s, len(errors) / draws, float(np.mean(squared)) / 6, 1000 * float(np.median(errors))


def tables() -> None:
    distances = (1.0, 2.0, 3.0, 4.0, 6.0)
    head = "".join(f" {d:g} m |" for d in distances)

    def row(name: str, **fields: float) -> None:
        print(f"| {name} |" + "".join(f" {sigmas(Situation(distance_m=d, **fields))} |" for d in distances))

    print(f"| landmarks |{head}\n|---|" + "---|" * len(distances))
    for count in (1, 2, 3):
        row(f"{count}, stereo", count=count)
    for count in (1, 2, 3):
        row(f"{count}, one camera", count=count, mono=True)
    row("2, 1.6 m apart", count=2, apart_m=1.6)
    print(f"\n| what differs |{head}\n|---|" + "---|" * len(distances))
    row("2 landmarks, head-on", count=2)
    row("seen at 30 deg", count=2, angle_deg=30)
    row("seen at 60 deg", count=2, angle_deg=60)
    row("cameras 6 cm apart", count=2, baseline_m=0.06)
    row("cameras 24 cm apart", count=2, baseline_m=0.24)
    row("f = 300 px (wider)", count=2, focal_px=300)
    row("f = 900 px (narrower)", count=2, focal_px=900)


def plot(results: list[tuple[Situation, float, float, float]], draws: int, path: Path) -> None:
    """NEES / 6 over distance, a line per situation, and the 95 % band of an honest covariance."""
    low, high = chi2.ppf([0.025, 0.975], 6 * draws) / (6 * draws)
    width, height, left, top = 720, 400, 70, 30
    colors = {1: "#2f6fde", 2: "#e8833a", 3: "#1a7f37"}

    def at(x: float, y: float) -> tuple[float, float]:
        return left + (x - 0.5) / 6 * (width - left - 30), top + (1.5 - y) / 1.0 * (height - top - 60)

    x0, y1 = at(0.5, low)
    x1, y0 = at(6.5, high)
    parts = [
        f"<rect x='{x0}' y='{y0}' width='{x1 - x0}' height='{y1 - y0}' fill='#1a7f37' fill-opacity='.15'/>",
        f"<path d='M{x0} {at(0, 1)[1]}H{x1}' stroke='#888' stroke-dasharray='4 4'/>",
    ]
    for y in (0.5, 0.75, 1.0, 1.25, 1.5):
        parts.append(f"<text x='{left - 10}' y='{at(0, y)[1] + 4}' text-anchor='end'>{y:g}</text>")
    for d in range(1, 7):
        parts.append(f"<text x='{at(d, 0)[0]}' y='{height - 38}' text-anchor='middle'>{d} m</text>")
    for count, angle in product((1, 2, 3), (0.0, 50.0)):
        line = [(s.distance_m, nees) for s, _, nees, _ in results if (s.count, s.angle_deg) == (count, angle)]
        points = [at(d, float(np.clip(nees, 0.5, 1.5))) for d, nees in line if np.isfinite(nees)]
        dash = "" if angle == 0 else " stroke-dasharray='6 4'"
        path_d = "L".join(f"{x:.1f} {y:.1f}" for x, y in points)
        parts.append(f"<path d='M{path_d}' fill='none' stroke='{colors[count]}' stroke-width='2'{dash}/>")
        parts += [f"<circle cx='{x:.1f}' cy='{y:.1f}' r='3.5' fill='{colors[count]}'/>" for x, y in points]
    x = float(left)
    for text, color in (("1 landmark", colors[1]), ("2", colors[2]), ("3", colors[3])):
        parts.append(f"<text x='{x}' y='{height - 10}' fill='{color}'>{text}</text>")
        x += 30 + 8 * len(text)
    parts.append(f"<text x='{x}' y='{height - 10}'>solid: head-on, dashed: at 50 deg; green: 95 % band</text>")
    parts.append(f"<text x='{left}' y='18'>mean NEES / 6 of poses called ok, {draws} draws each; 1 is honest</text>")
    path.write_text(
        f"<svg xmlns='http://www.w3.org/2000/svg' width='{width}' height='{height}' viewBox='0 0 {width} {height}' "
        f"font-family='sans-serif' font-size='14'><rect width='{width}' height='{height}' fill='#fff'/>"
        + "".join(parts)
        + "</svg>\n"
    )


def images(draws: int) -> None:
    jobs = [
        (Situation(count, float(d), angle), draws)
        for count, angle, d in product((1, 2, 3), (0.0, 50.0), (1, 2, 3, 4, 6))
    ]
    with ProcessPoolExecutor() as pool:
        results = [result for result in pool.map(study_images, jobs) if result is not None]
    low, high = chi2.ppf([0.025, 0.975], 6 * draws) / (6 * draws)
    print(f"\n95 % band of NEES / 6 over {draws} pairs of images: {low:.3f} to {high:.3f}\n")
    print("| landmarks | angle | distance | called ok | NEES / 6 | median error |\n|---|---|---|---|---|---|")
    for s, share, nees, error in results:
        where = f"| {s.count} | {s.angle_deg:g} deg | {s.distance_m:g} m |"
        print(f"{where} {100 * share:.0f} % | {nees:.2f} | {error:.1f} mm |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=1000)
    parser.add_argument("--plot", type=Path)
    parser.add_argument("--images", type=int, default=0)
    arguments = parser.parse_args()
    if arguments.images:
        images(arguments.images)
        return
    tables()
    jobs = [
        (Situation(count, float(d), angle), arguments.draws)
        for count, angle, d in product((1, 2, 3), (0.0, 50.0), (1, 2, 3, 4, 6))
    ]
    with ProcessPoolExecutor() as pool:
        results = [result for result in pool.map(study, jobs) if result is not None]
    low, high = chi2.ppf([0.025, 0.975], 6 * arguments.draws) / (6 * arguments.draws)
    print(f"\n95 % band of NEES / 6 over {arguments.draws} draws: {low:.3f} to {high:.3f}\n")
    print("| landmarks | angle | distance | called ok | NEES / 6 | error over the bound |\n|---|---|---|---|---|---|")
    for s, share, nees, efficiency in results:
        where = f"| {s.count} | {s.angle_deg:g} deg | {s.distance_m:g} m |"
        print(f"{where} {100 * share:.0f} % | {nees:.2f} | {efficiency:.2f} |")
    if arguments.plot is not None:
        plot(results, arguments.draws, arguments.plot)


if __name__ == "__main__":
    main()
