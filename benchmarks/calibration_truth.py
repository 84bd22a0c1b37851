"""Calibration against known truth: rendered boards, and whether the intervals cover.

    uv run python benchmarks/calibration_truth.py ../shared/data/boards [--seeds 100]

The first table calibrates rendered images whose rig is known.  The second simulates corners of boards in a known
rig (no images: 20 views, 0.1 px of noise, one image in ten three times as noisy) and counts how often the 95 %
interval of every parameter holds the truth, over seeds that each have another noise and other views.
"""

from __future__ import annotations

import argparse
import json
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

from lmkit.calibration.intrinsics import intrinsics_vector
from lmkit.calibration.stereo import StereoCalibration, calibrate_stereo
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.pose import Pose
from lmkit.geometry.rotations import rotation_log
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.model.board import BoardSpec
from lmkit.model.observation import PairView
from lmkit.pipelines.board_views import find_board_pairs
from lmkit.simulation.scene import board_poses, make_rig

BOARD = BoardSpec.parse("chessboard:9x6:30mm")
SPECS = {"chessboard": "chessboard:9x6:30mm", "charuco": "charuco:8x6:30mm:22mm:DICT_5X5_100"}
NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
NOISE_PX = 0.1


def rendered(folder: Path) -> None:
    """The first table."""
    print(
        "| set | pairs | focal lengths, worst | principal point, worst | baseline | rotation | largest error | rows |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for case in sorted(p for p in folder.iterdir() if p.is_dir()):
        truth = json.loads((case / "truth.json").read_text())
        rig = _rig(truth["rig"])
        spec = BoardSpec.parse(SPECS[truth["board"]])
        files = [
            (left, left.with_name(left.name.replace("_L", "_R"))) for left in sorted((case / "images").glob("*_L.*"))
        ]
        found = find_board_pairs(files, spec)
        result = calibrate_stereo(found.views, found.board, found.image_size, rejected=found.rejected)
        focal, center = 0.0, 0.0
        for made, true in ((result.rig.left, rig.left), (result.rig.right, rig.right)):
            focal = max(focal, *(abs(made.K[k, k] / true.K[k, k] - 1) for k in (0, 1)))
            center = max(center, *(abs(made.K[k, 2] - true.K[k, 2]) for k in (0, 1)))
        turned = np.rad2deg(np.linalg.norm(rotation_log(result.rig.T_right_left.R @ rig.T_right_left.R.T)))
        worst = max(map(abs, standardized(result, rig).values()))
        print(
            f"| {case.name} | {len(result.used)} of {len(files)} | {100 * focal:.3f} % | {center:.2f} px "
            f"| {1000 * (result.rig.baseline_m - rig.baseline_m):+.3f} mm | {turned:.4f} deg "
            f"| {worst:.1f} sigma | {result.held_out_epipolar_px:.3f} px |"
        )


def _rig(rig: dict) -> StereoRig:
    left, right = (CameraModel(tuple(rig["size"]), rig[side]["K"], rig[side]["dist"]) for side in ("left", "right"))
    return StereoRig(left, right, Pose("right", "left", np.array(rig["R"]), np.array(rig["t"])))


def simulated(seed: int, count: int = 20) -> tuple[StereoCalibration, StereoRig]:
    """A calibration of simulated corners, and the truth."""
    rig = make_rig()
    rng = np.random.default_rng(seed)
    ids = np.arange(len(BOARD.object_points))
    views = []
    for k, pose in enumerate(board_poses(seed, rig, BOARD, count)):
        in_left = pose.apply(BOARD.object_points)
        in_right = in_left @ rig.T_right_left.R.T + rig.T_right_left.t
        noise = NOISE_PX * (3.0 if k % 10 == 9 else 1.0)
        pixels = [
            camera.project(points) + rng.normal(0, noise, (len(points), 2))
            for camera, points in ((rig.left, in_left), (rig.right, in_right))
        ]
        views.append(PairView(f"{k:02d}", ids, pixels[0], ids, pixels[1], noise, noise))
    return calibrate_stereo(views, BOARD, rig.left.image_size), rig


def deviations(seed: int) -> dict[str, float]:
    """Error over stated standard deviation, of every parameter; none where another model was chosen."""
    result, truth = simulated(seed)
    return standardized(result, truth) if result.rig.left.model == "pinhole" else {}


def standardized(result: StereoCalibration, truth: StereoRig) -> dict[str, float]:
    """Error over stated standard deviation, of every parameter."""
    made = result.rig
    assert made.intrinsics_sigma is not None
    assert made.covariance is not None
    z = {}
    cameras = (("left", made.left, truth.left), ("right", made.right, truth.right))
    for (side, own, true), sigma in zip(cameras, made.intrinsics_sigma, strict=True):
        want = intrinsics_vector(true)
        want = np.pad(want, (0, len(NAMES) - len(want)))
        z |= {f"{side} {n}": v for n, v in zip(NAMES, (intrinsics_vector(own) - want) / sigma, strict=True)}
    off = np.concatenate(
        [
            made.T_right_left.t - truth.T_right_left.t,
            rotation_log(made.T_right_left.R @ truth.T_right_left.R.T),
        ]
    )
    names = ("shift x", "shift y", "shift z", "turn x", "turn y", "turn z")
    z |= dict(zip(names, off / np.sqrt(np.diag(made.covariance)), strict=True))
    z["baseline"] = (made.baseline_m - truth.baseline_m) / result.baseline_sigma_m
    return z


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seeds", type=int, default=100)
    arguments = parser.parse_args()
    rendered(arguments.folder)
    views = list(simulated(0, 30)[0].used)
    start = time.perf_counter()
    calibrate_stereo(views, BOARD, (640, 480))
    took = time.perf_counter() - start
    print(f"\nFit of {len(views)} pairs of 640 x 480, model choice and folds included: {took:.1f} s")
    with ProcessPoolExecutor() as pool:
        results = list(pool.map(deviations, range(arguments.seeds)))
    kept = [z for z in results if z]
    print(f"\n{len(kept)} of {len(results)} seeds chose pinhole, as simulated")
    print("\n| parameter | inside the 95 % interval | spread of error / sigma |")
    print("|---|---|---|")
    inside = []
    for name in kept[0]:
        values = np.array([z[name] for z in kept])
        inside.append(np.abs(values) < 1.96)
        print(f"| {name} | {100 * inside[-1].mean():.0f} % | {values.std():.2f} |")
    print(f"| all | {100 * np.mean(inside):.1f} % | |")


if __name__ == "__main__":
    main()
