"""Calibrators of one camera side by side: the same corners, the same five folds, scored on images held out.

    uv run python benchmarks/mono_calibration.py SETS [--stereo ../shared/data/stereo] [--only NAME ...] [--mrcal]

SETS holds clones of public repositories, each in a folder ``owner+name``; those that are missing are listed and
skipped. With ``--stereo`` the left cameras of the stereo sets are taken, too. lmkit finds the corners once, in all
images; every calibrator fits the corners of four folds of five, and the images of the fifth are scored: the board's
pose is fitted to each of them by least squares through OpenCV's projection, and the distances are taken. Two scores:
for a flat board, as OpenCV fits it, and with the board's bow (two numbers, common to the images of a fold) free.

- cv2 5, cv2 8, cv2 fisheye: calibrateCamera (plain, CALIB_RATIONAL_MODEL) and fisheye.calibrate.
- lmkit pinhole, rational, fisheye, and lmkit auto, which chooses by folds of its own within the training images.
- mrcal 5, mrcal 8: mrcal-calibrate-cameras (LENSMODEL_OPENCV5, LENSMODEL_OPENCV8); with --mrcal, where installed.
- mrcal itself publishes the corners of a full-frame fisheye lens within its result; they are read from there.
"""

from __future__ import annotations

import argparse
import ast
import base64
import io
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from scipy.optimize import least_squares

from lmkit.calibration.initialization import board_poses
from lmkit.calibration.mono import calibrate_camera
from lmkit.errors import LmkitError
from lmkit.geometry.camera import CameraModel
from lmkit.model.board import BoardSpec
from lmkit.model.observation import BoardObservation
from lmkit.pipelines.camera_views import find_board_images

FOLDS = 5
CONVERGED = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-9)
Views = Sequence[tuple[str, BoardObservation]]
Calibrator = Callable[[Views, BoardSpec, tuple[int, int]], CameraModel]


@dataclass(frozen=True)
class Source:
    """Images of one camera: repository (or folder of the stereo sets), files, board as lmkit names it."""

    name: str
    repository: str
    images: str
    board: str


PHOTON = "test-resources/calibrationSquaresImg"
LIFECAM = f"{PHOTON}/lifecam/2024-01-02_lifecam_1280"
SOURCES = (
    Source("gloworm 1280x720", "PhotonVision/photonvision", f"{PHOTON}/gloworm/1280_720_1", "chessboard:8x6:25mm"),
    Source("gloworm 1920x1080", "PhotonVision/photonvision", f"{PHOTON}/gloworm/1920_1080_1", "chessboard:8x6:25mm"),
    Source("lifecam", "PhotonVision/photonvision", LIFECAM, "chessboard:10x10:15mm"),
    Source("piCam 640x480", "PhotonVision/photonvision", f"{PHOTON}/piCam/640_480_1", "chessboard:7x7:25mm"),
    Source("piCam 1920x1080", "PhotonVision/photonvision", f"{PHOTON}/piCam/1920_1080_1", "chessboard:7x7:25mm"),
    Source("gopro wide", "udacity/CarND-Camera-Calibration", "calibration_wide/*.jpg", "chessboard:8x6:25mm"),
    Source("webcam wide", "Jackson-coder/calibrate", "0*.jpg", "chessboard:11x8:25mm"),
    Source("lifecam hd3000", "Iranaphor/cam_calibration", "test_images/*/*.jpg", "chessboard:9x6:25mm"),
    Source("side by side, left", "thaytan/stereo-calibration", "calib_imgs/1/left*.jpg", "chessboard:9x6:24.23mm"),
    Source("endoscope", "NTU-Mecatron/camera_calibration_cpp", "image/*", "chessboard:15x10:25mm"),
    Source("curved ChArUco", "DodoMels/Cam_calibration", "01/*.png", "charuco:8x12:20mm:10mm:DICT_6X6_250"),
)
STEREO = (
    Source("opencv_bouguet", "", "opencv_bouguet/left", "chessboard:9x6:30mm"),
    Source("aliyasin", "", "aliyasin/left", "chessboard:9x6:25mm"),
    Source("stereopi", "", "stereopi/left", "chessboard:9x6:25mm"),
    Source("ricsar", "", "ricsar/left", "chessboard:9x6:24mm"),
    Source("caliscope_charuco_02", "", "caliscope_charuco_02/left", "charuco:4x5:54mm:40.5mm:DICT_4X4_1000"),
    Source("sourishg_fisheye", "", "sourishg_fisheye/left", "chessboard:9x6:24.23mm"),
)
TOUR = "doc/data/figueroa-overpass-looking-S"
MRCAL_TOUR = Source(
    "mrcal tour",
    "dkogan/mrcal",
    f"{TOUR}/opencv8-0.cameramodel",
    "chessboard:10x10:77mm",
)


@dataclass(frozen=True)
class Case:
    """The corners of one set."""

    name: str
    board: BoardSpec
    size: tuple[int, int]
    views: Views


def load(source: Source, folder: Path) -> Case:
    """Find the corners of a set, or read those that mrcal publishes."""
    where = folder / source.images
    if source is MRCAL_TOUR:
        return _published_corners(source, where)
    found = find_board_images(str(where), BoardSpec.parse(source.board))
    return Case(source.name, found.board, found.image_size, found.views)


def _published_corners(source: Source, file: Path) -> Case:
    """The observations that mrcal keeps in its result; those that it had rejected (weight below 0) are left out."""
    model = _cameramodel(file.read_text())
    packed = np.load(io.BytesIO(base64.b85decode(model["optimization_inputs"])), allow_pickle=True)
    views = []
    for k, seen in enumerate(packed["observations_board"]):
        flat = seen.reshape(-1, 3)
        ids = np.flatnonzero(flat[:, 2] > 0)
        views.append((f"{k:03d}", BoardObservation(ids, flat[ids, :2])))
    width, height = model["imagersize"]
    return Case(source.name, BoardSpec.parse(source.board), (int(width), int(height)), views)


def _cameramodel(text: str) -> dict:
    """mrcal's text file, which is a Python dictionary."""
    body = "\n".join(line for line in text.splitlines() if not line.lstrip().startswith("#"))
    return ast.literal_eval(body.strip())


def lmkit(views: Views, board: BoardSpec, size: tuple[int, int], model: str) -> CameraModel:
    return calibrate_camera(views, board, size, model).rig.left


def opencv(views: Views, board: BoardSpec, size: tuple[int, int], flags: int) -> CameraModel:
    objects, pixels = _lists(views, board)
    _, K, D, _, _ = cv2.calibrateCamera(objects, pixels, size, None, None, flags=flags, criteria=CONVERGED)
    D = D.ravel()
    return CameraModel(size, K, D[:8] if flags else D[:5], "rational" if flags else "pinhole")


def opencv_fisheye(views: Views, board: BoardSpec, size: tuple[int, int]) -> CameraModel:
    objects, pixels = _lists(views, board)
    home = cv2.fisheye if hasattr(cv2.fisheye, "CALIB_FIX_SKEW") else cv2  # OpenCV 4, OpenCV 5
    flags = home.CALIB_RECOMPUTE_EXTRINSIC | home.CALIB_FIX_SKEW
    _, K, D, _, _ = cv2.fisheye.calibrate(
        [o.reshape(1, -1, 3).astype(np.float64) for o in objects],
        [p.reshape(1, -1, 2).astype(np.float64) for p in pixels],
        size,
        np.eye(3),
        np.zeros(4),
        flags=flags,
        criteria=CONVERGED,
    )
    return CameraModel(size, K, D.ravel(), "fisheye")


def _lists(views: Views, board: BoardSpec) -> tuple[list[np.ndarray], list[np.ndarray]]:
    points = board.object_points.astype(np.float32)
    return [points[v.ids] for _, v in views], [v.image_points.astype(np.float32) for _, v in views]


def mrcal(views: Views, board: BoardSpec, size: tuple[int, int], coefficients: int) -> CameraModel:
    """mrcal-calibrate-cameras, with its own outlier rejection and board bow."""
    columns, rows = board.inner_corners
    objects, pixels = _lists(views, board)
    focal = float(cv2.initCameraMatrix2D(objects, pixels, size)[0, 0])
    with tempfile.TemporaryDirectory() as folder:
        lines = ["# filename x y weight"]
        for k, (_, view) in enumerate(views):
            at = dict(zip(view.ids.tolist(), view.image_points, strict=True))
            for i in range(columns * rows):
                x, y = at.get(i, (-1.0, -1.0))
                lines.append(f"image-{k:04d}.png {x:.6f} {y:.6f} {1 if i in at else '-'}")
        (Path(folder) / "corners.vnl").write_text("\n".join(lines) + "\n")
        command = ["mrcal-calibrate-cameras", "--corners-cache", "corners.vnl", "--focal", f"{focal:.1f}"]
        command += ["--lensmodel", f"LENSMODEL_OPENCV{coefficients}", "--object-spacing", f"{board.square_mm / 1000}"]
        command += ["--object-width-n", str(columns), "--object-height-n", str(rows)]
        command += ["--imagersize", str(size[0]), str(size[1]), "image-*.png"]
        subprocess.run(command, cwd=folder, check=True, capture_output=True)
        n = _cameramodel((Path(folder) / "camera-0.cameramodel").read_text())["intrinsics"]
    K = np.array([[n[0], 0, n[2]], [0, n[1], n[3]], [0, 0, 1.0]])
    return CameraModel(size, K, np.array(n[4:]), "rational" if coefficients == 8 else "pinhole")


RECIPES: dict[str, Calibrator] = {
    "cv2 5": partial(opencv, flags=0),
    "cv2 8": partial(opencv, flags=cv2.CALIB_RATIONAL_MODEL),
    "cv2 fisheye": opencv_fisheye,
    "mrcal 5": partial(mrcal, coefficients=5),
    "mrcal 8": partial(mrcal, coefficients=8),
    "lmkit pinhole": partial(lmkit, model="pinhole"),
    "lmkit rational": partial(lmkit, model="rational"),
    "lmkit fisheye": partial(lmkit, model="fisheye"),
    "lmkit auto": partial(lmkit, model="auto"),
}


def score(case: Case, calibrate: Calibrator) -> tuple[float, float]:
    """Mean distance of held-out corners from their projections, px: board flat, and bow free."""
    flat, bowed = [], []
    for fold in range(FOLDS):
        camera = calibrate([v for i, v in enumerate(case.views) if i % FOLDS != fold], case.board, case.size)
        unseen = [seen for i, (_, seen) in enumerate(case.views) if i % FOLDS == fold]
        poses = [_place(camera, case.board, seen) for seen in unseen]
        flat += [
            np.linalg.norm(_off(pose, camera, case.board, seen), axis=1)
            for pose, seen in zip(poses, unseen, strict=True)
        ]
        bowed += _with_bow(camera, case.board, unseen, poses)
    return float(np.mean(np.concatenate(flat))), float(np.mean(np.concatenate(bowed)))


def _place(camera: CameraModel, board: BoardSpec, seen: BoardObservation) -> np.ndarray:
    """(6,) rotation vector and shift of the board that leave the least squares."""
    starts = board_poses(camera, board.object_points[seen.ids], seen.image_points)
    fits = [
        least_squares(
            lambda x: _off(x, camera, board, seen).ravel(),
            np.concatenate([cv2.Rodrigues(R)[0].ravel(), t]),
            x_scale="jac",
        )
        for R, t, *_ in starts[:2]
    ]
    return min(fits, key=lambda fit: fit.cost).x


def _off(x: np.ndarray, camera: CameraModel, board: BoardSpec, seen: BoardObservation, bow: np.ndarray | None = None):
    """(N,2) distance of the corners from their projections."""
    points = board.object_points[seen.ids].copy()
    if bow is not None:
        middle, half = board.object_points[:, :2].mean(axis=0), np.ptp(board.object_points[:, :2], axis=0) / 2
        points[:, 2] += (1 - ((points[:, :2] - middle) / half) ** 2) @ bow
    if camera.model == "fisheye":
        made = cv2.fisheye.projectPoints(points[:, None], x[:3], x[3:], camera.K, camera.distortion)[0]
    else:
        made = cv2.projectPoints(points, x[:3], x[3:], camera.K, camera.distortion)[0]
    return made.reshape(-1, 2) - seen.image_points


def _with_bow(
    camera: CameraModel, board: BoardSpec, unseen: Sequence[BoardObservation], poses: Sequence[np.ndarray]
) -> list[np.ndarray]:
    """Distances with the bow that suits these images best, from poses for a flat board."""

    def off(x: np.ndarray) -> list[np.ndarray]:
        return [_off(x[2 + 6 * k : 8 + 6 * k], camera, board, seen, x[:2]) for k, seen in enumerate(unseen)]

    count = sum(2 * len(seen.ids) for seen in unseen)
    pattern, row = np.zeros((count, 2 + 6 * len(unseen)), dtype=int), 0
    pattern[:, :2] = 1
    for k, seen in enumerate(unseen):
        pattern[row : row + 2 * len(seen.ids), 2 + 6 * k : 8 + 6 * k] = 1
        row += 2 * len(seen.ids)
    start = np.concatenate([np.zeros(2), *poses])
    fit = least_squares(
        lambda x: np.concatenate([part.ravel() for part in off(x)]), start, jac_sparsity=pattern, x_scale="jac"
    )
    return [np.linalg.norm(part, axis=1) for part in off(fit.x)]


def _row(task: tuple[Case, str]) -> str:
    case, recipe = task
    try:
        flat, bowed = score(case, RECIPES[recipe])
    except (LmkitError, cv2.error, ValueError, IndexError, subprocess.CalledProcessError) as error:
        return f"fails: {str(error).strip().splitlines()[-1][:60]}"
    return f"{flat:.3f} / {bowed:.3f}"


def main() -> None:
    """Print the table: mean distance on held-out images, px, board flat / bow free."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--stereo", type=Path, default=None)
    parser.add_argument("--only", nargs="*", default=None)
    parser.add_argument("--mrcal", action="store_true")
    options = parser.parse_args()
    sources = [(s, options.folder / s.repository.replace("/", "+")) for s in (*SOURCES, MRCAL_TOUR)]
    sources += [] if options.stereo is None else [(s, options.stereo) for s in STEREO]
    recipes = [name for name in RECIPES if options.mrcal or not name.startswith("mrcal")]
    print(f"| set | images | size | {' | '.join(recipes)} |")
    print("|---" * (3 + len(recipes)) + "|")
    with ProcessPoolExecutor(1) as pool:
        for source, folder in sources:
            if options.only is not None and source.name not in options.only:
                continue
            if not folder.is_dir():
                print(f"skipped: {source.name}; git clone https://github.com/{source.repository} {folder}")
                continue
            case = load(source, folder)
            cells = pool.map(_row, [(case, recipe) for recipe in recipes])
            size = f"{case.size[0]} x {case.size[1]}"
            print(f"| {source.name} | {len(case.views)} | {size} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
