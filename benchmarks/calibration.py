"""Calibrators side by side: five folds, the same in all, scored on pairs held out.

    uv run --extra benchmark python benchmarks/calibration.py ../shared/data/stereo [--sets NAME ...] [--mrcal]

Every set is a folder with `left/`, `right/` and `board.json`.  Each calibrator gets the corners that its own recipe
asks for, and is scored by the mean |dy| after OpenCV's rectification of the pairs of the fold left out, on two kinds
of corners: those of findChessboardCornersSB, and lmkit's fused ones.  A calibrator has an
advantage on the kind of corners that it was fitted to, so both are shown.

- sample: OpenCV's stereo_calib sample (cornerSubPix 11, same focal length, no tangential part).
- SB, fixed: findChessboardCornersSB, calibrateCamera for each camera, then stereoCalibrate with CALIB_FIX_INTRINSIC.
- SB, joint: the same, intrinsics refined by stereoCalibrate.
- mrcal: mrcal-calibrate-cameras 2.2 (LENSMODEL_OPENCV5) on lmkit's fused corners; only with --mrcal, where installed.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from lmkit.calibration.stereo import calibrate_stereo
from lmkit.detection.boards import same_orientation
from lmkit.errors import LmkitError
from lmkit.geometry.camera import CameraModel
from lmkit.geometry.pose import Pose
from lmkit.geometry.rectification import epipolar_errors
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.model.board import BoardSpec
from lmkit.model.observation import BoardObservation, PairView
from lmkit.pipelines.board_views import find_board_pairs

FOLDS = 5
SB_FLAGS = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
KINDS = ("classic", "SB", "fused")
Calibrator = Callable[[Sequence[PairView], BoardSpec, tuple[int, int]], StereoRig]


@dataclass(frozen=True)
class Case:
    """A set of pairs: the corners of every kind, by pair name."""

    name: str
    board: BoardSpec
    size: tuple[int, int]
    corners: dict[str, dict[str, PairView]]


def load(folder: Path) -> Case:
    """Read a set, and find its corners in every way."""
    about = json.loads((folder / "board.json").read_text())
    if about["board"] == "charuco":
        columns, rows = about["squares"]
        spec = f"charuco:{columns}x{rows}:{about['square_mm']}mm:{about['marker_mm']}mm:{about['dictionary']}"
    else:
        columns, rows = about["inner_corners"]
        spec = f"chessboard:{columns}x{rows}:{about['square_mm']}mm"
    board = BoardSpec.parse(spec)
    left, right = (sorted((folder / side).iterdir()) for side in ("left", "right"))
    pairs = find_board_pairs(list(zip(left, right, strict=True)), board)
    corners = {"fused": {view.name: view for view in pairs.views}}
    if board.kind == "chessboard":
        files = list(zip(left, right, strict=True))
        corners["SB"] = _pairs(files, lambda gray: _sb(gray, board))
        corners["classic"] = _pairs(files, lambda gray: _classic(gray, board))
    return Case(folder.name, board, pairs.image_size, corners)


def _pairs(files: list[tuple[Path, Path]], find: Callable[[np.ndarray], np.ndarray | None]) -> dict[str, PairView]:
    views = {}
    for left, right in files:
        seen = [find(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)) for path in (left, right)]
        if seen[0] is None or seen[1] is None:
            continue
        ids = np.arange(len(seen[0]))
        one, other = (BoardObservation(ids, points) for points in seen)
        views[left.stem] = PairView(left.stem, ids, seen[0], ids, same_orientation(one, other).image_points)
    return views


def _sb(gray: np.ndarray, board: BoardSpec) -> np.ndarray | None:
    found, corners = cv2.findChessboardCornersSB(gray, board.inner_corners, flags=SB_FLAGS)
    return corners.reshape(-1, 2).astype(np.float64) if found else None


def _classic(gray: np.ndarray, board: BoardSpec) -> np.ndarray | None:
    for scale in (1, 2):
        larger = gray if scale == 1 else cv2.resize(gray, None, fx=2, fy=2, interpolation=cv2.INTER_LINEAR_EXACT)
        flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
        found, corners = cv2.findChessboardCorners(larger, board.inner_corners, flags=flags)
        if found:
            corners = np.ascontiguousarray(corners / scale, dtype=np.float32)
            cv2.cornerSubPix(gray, corners, (11, 11), (-1, -1), (3, 30, 0.01))
            return corners.reshape(-1, 2).astype(np.float64)
    return None


def opencv_sample(views: Sequence[PairView], board: BoardSpec, size: tuple[int, int]) -> StereoRig:
    """The flags of OpenCV's stereo_calib sample."""
    objects, left, right = _opencv_lists(views, board)
    start = [cv2.initCameraMatrix2D(objects, points, size, 0) for points in (left, right)]
    flags = (
        cv2.CALIB_FIX_ASPECT_RATIO
        | cv2.CALIB_ZERO_TANGENT_DIST
        | cv2.CALIB_USE_INTRINSIC_GUESS
        | cv2.CALIB_SAME_FOCAL_LENGTH
        | cv2.CALIB_RATIONAL_MODEL
        | cv2.CALIB_FIX_K3
        | cv2.CALIB_FIX_K4
        | cv2.CALIB_FIX_K5
    )
    found = cv2.stereoCalibrate(
        objects, left, right, start[0], np.zeros(8), start[1], np.zeros(8), size, flags=flags, criteria=(3, 100, 1e-5)
    )
    return _opencv_rig(found[1:7], size, "rational")


def opencv_fixed(views: Sequence[PairView], board: BoardSpec, size: tuple[int, int]) -> StereoRig:
    """Each camera on its own, then only their relation."""
    return _opencv_two_steps(views, board, size, cv2.CALIB_FIX_INTRINSIC)


def opencv_joint(views: Sequence[PairView], board: BoardSpec, size: tuple[int, int]) -> StereoRig:
    """Each camera on its own, then everything together."""
    return _opencv_two_steps(views, board, size, cv2.CALIB_USE_INTRINSIC_GUESS)


def _opencv_two_steps(views: Sequence[PairView], board: BoardSpec, size: tuple[int, int], flags: int) -> StereoRig:
    objects, left, right = _opencv_lists(views, board)
    _, K1, D1, _, _ = cv2.calibrateCamera(objects, left, size, None, None)
    _, K2, D2, _, _ = cv2.calibrateCamera(objects, right, size, None, None)
    found = cv2.stereoCalibrate(objects, left, right, K1, D1, K2, D2, size, flags=flags, criteria=(3, 100, 1e-6))
    return _opencv_rig(found[1:7], size, "pinhole")


def _opencv_lists(
    views: Sequence[PairView], board: BoardSpec
) -> tuple[list[np.ndarray], list[np.ndarray], list[np.ndarray]]:
    objects, left, right = [], [], []
    for view in views:
        ids, a, b = np.intersect1d(view.ids_left, view.ids_right, return_indices=True)
        objects.append(board.object_points[ids].astype(np.float32))
        left.append(view.left[a].astype(np.float32))
        right.append(view.right[b].astype(np.float32))
    return objects, left, right


def _opencv_rig(found: Sequence[np.ndarray], size: tuple[int, int], model: str) -> StereoRig:
    """A rig of K1, D1, K2, D2, R, T as stereoCalibrate gives them."""
    K1, D1, K2, D2, R, T = found
    count = 8 if model == "rational" else 5
    sides = [CameraModel(size, K, np.ravel(D)[:count], model) for K, D in ((K1, D1), (K2, D2))]
    return StereoRig(sides[0], sides[1], Pose("right", "left", R, np.ravel(T)))


def lmkit(views: Sequence[PairView], board: BoardSpec, size: tuple[int, int]) -> StereoRig:
    """Calibration as `lmkit calibrate` does it."""
    return calibrate_stereo(views, board, size).rig


def mrcal(views: Sequence[PairView], board: BoardSpec, size: tuple[int, int]) -> StereoRig:
    """mrcal-calibrate-cameras with the OpenCV lens of five coefficients and its own outlier rejection."""
    columns, rows = board.inner_corners
    with tempfile.TemporaryDirectory() as folder:
        lines = ["# filename x y weight"]
        for k, view in enumerate(views):
            for side, ids, points in (("left", view.ids_left, view.left), ("right", view.ids_right, view.right)):
                at = {int(i): p for i, p in zip(ids, points, strict=True)}
                for i in range(columns * rows):
                    x, y = at.get(i, (-1.0, -1.0))
                    lines.append(f"{side}-{k:04d}.png {x:.6f} {y:.6f} {1 if i in at else '-'}")
        (Path(folder) / "corners.vnl").write_text("\n".join(lines) + "\n")
        objects, left, _ = _opencv_lists(views, board)
        focal = float(cv2.initCameraMatrix2D(objects, left, size)[0, 0])
        command = ["mrcal-calibrate-cameras", "--corners-cache", "corners.vnl", "--lensmodel", "LENSMODEL_OPENCV5"]
        command += ["--focal", f"{focal:.1f}", "--object-spacing", f"{board.square_mm / 1000}"]
        command += ["--object-width-n", str(columns), "--object-height-n", str(rows)]
        command += ["--imagersize", str(size[0]), str(size[1]), "left-*.png", "right-*.png"]
        subprocess.run(command, cwd=folder, check=True, capture_output=True)
        cameras = [_read_cameramodel((Path(folder) / f"camera-{k}.cameramodel").read_text()) for k in (0, 1)]
    (left_numbers, left_pose), (right_numbers, right_pose) = cameras
    sides = [
        CameraModel(size, np.array([[n[0], 0, n[2]], [0, n[1], n[3]], [0, 0, 1.0]]), n[4:9])
        for n in (left_numbers, right_numbers)
    ]
    T_left, T_right = (
        Pose.from_rvec(side, "ref", rt[:3], rt[3:]) for side, rt in (("left", left_pose), ("right", right_pose))
    )
    return StereoRig(sides[0], sides[1], T_right @ T_left.inverse())


def _read_cameramodel(text: str) -> tuple[np.ndarray, np.ndarray]:
    """Intrinsics and rt_cam_ref of mrcal's text file, which is a Python dictionary."""
    import ast

    body = "\n".join(line for line in text.splitlines() if not line.lstrip().startswith("#"))
    model = ast.literal_eval(body.strip())
    pose = model.get("extrinsics", model.get("rt_cam_ref"))
    return np.array(model["intrinsics"], dtype=float), np.array(pose, dtype=float)


RECIPES: dict[str, tuple[str, Calibrator]] = {
    "sample": ("classic", opencv_sample),
    "SB, fixed": ("SB", opencv_fixed),
    "SB, joint": ("SB", opencv_joint),
    "lmkit on SB": ("SB", lmkit),
    "lmkit": ("fused", lmkit),
    "mrcal": ("fused", mrcal),
}


def score(case: Case, recipe: str, names: list[str], swapped: int = 0) -> tuple[dict[str, float], float]:
    """Mean |dy| by kind of corners, and the median seconds of a fit.

    Args:
        swapped: so many pairs of right images are swapped in every training set.
    """
    kind, calibrate = RECIPES[recipe]
    errors: dict[str, list[np.ndarray]] = {k: [] for k in case.corners if k != "classic"}
    seconds = []
    for fold in range(FOLDS):
        train = [case.corners[kind].get(n) for i, n in enumerate(names) if i % FOLDS != fold]
        views = [view for view in train if view is not None]
        for k in range(swapped):
            a, b = 3 * k, 3 * k + 1 + len(views) // 2
            views[a], views[b] = (
                replace(views[a], ids_right=views[b].ids_right, right=views[b].right),
                replace(views[b], ids_right=views[a].ids_right, right=views[a].right),
            )
        start = time.perf_counter()
        rig = calibrate(views, case.board, case.size)
        seconds.append(time.perf_counter() - start)
        for test, list_of in errors.items():
            for name in names[fold::FOLDS]:
                view = case.corners[test].get(name)
                if view is not None:
                    _, a, b = np.intersect1d(view.ids_left, view.ids_right, return_indices=True)
                    list_of.append(np.abs(epipolar_errors(rig, view.left[a], view.right[b])))
    return {k: float(np.mean(np.concatenate(e))) for k, e in errors.items() if e}, float(np.median(seconds))


def _row(task: tuple[Case, str, list[str], int]) -> tuple[str, str, dict[str, float] | str, float]:
    case, recipe, names, swapped = task
    try:
        found, seconds = score(case, recipe, names, swapped)
        return case.name, recipe, found, seconds
    except (LmkitError, cv2.error, ValueError, subprocess.CalledProcessError) as error:
        return case.name, recipe, f"fails: {str(error).splitlines()[0][:60]}", 0.0


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--sets", nargs="*", default=None)
    parser.add_argument("--mrcal", action="store_true")
    options = parser.parse_args()
    folders = sorted(p for p in options.folder.iterdir() if (p / "board.json").exists())
    cases = [load(p) for p in folders if options.sets is None or p.name in options.sets]
    recipes = [r for r in RECIPES if r != "mrcal" or (options.mrcal and shutil.which("mrcal-calibrate-cameras"))]
    tasks = []
    for case in cases:
        # Pairs that both detectors find, so that every calibrator and every score sees the same.
        names = sorted(set.intersection(*(set(case.corners[k]) for k in case.corners if k != "classic")))
        tasks += [(case, r, names, 0) for r in recipes if RECIPES[r][0] in case.corners]
        if len(names) >= 13:
            tasks += [(case, r, names, 2) for r in ("SB, joint", "lmkit") if RECIPES[r][0] in case.corners]
    print("| set | pairs | calibrator | pairs swapped | mean dy on SB, px | on fused, px | fit, s |")
    print("|---|---|---|---|---|---|---|")
    with ProcessPoolExecutor(2) as pool:
        for task, (name, recipe, found, seconds) in zip(tasks, pool.map(_row, tasks), strict=True):
            if isinstance(found, str):
                print(f"| {name} | {len(task[2])} | {recipe} | {2 * task[3]} | {found} | | |", flush=True)
                continue
            cells = [f"{found[k]:.4f}" if k in found else "" for k in ("SB", "fused")]
            print(
                f"| {name} | {len(task[2])} | {recipe} | {2 * task[3]} | {cells[0]} | {cells[1]} | {seconds:.1f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
