"""The whole loop in one folder: print, photograph (simulated), calibrate, locate, compare with the truth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lmkit.calibration.stereo import StereoCalibration, calibrate_stereo
from lmkit.detection.detector import detect_landmarks
from lmkit.generation.board import compose_board_page
from lmkit.generation.pdf import pages_to_pdf
from lmkit.generation.sheet import compose_landmark_page
from lmkit.geometry.planar import wrap_heading
from lmkit.geometry.pose import Pose
from lmkit.geometry.rotations import rotation_angle
from lmkit.io.files import write_file
from lmkit.io.image_groups import list_pairs
from lmkit.io.images import read_image
from lmkit.io.landmark_map import map_to_yaml
from lmkit.io.rig import rig_to_yaml
from lmkit.io.template import load_template
from lmkit.localization.absolute_pose import locate_rig
from lmkit.model.estimate import PoseEstimate
from lmkit.model.landmark import LM8
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.observation import Detection
from lmkit.model.pose_status import PoseStatus
from lmkit.pipelines.board_views import find_board_pairs
from lmkit.reports.calibration import calibration_report
from lmkit.simulation.dataset import BOARD, Dataset, description_files, make_dataset, render_images
from lmkit.visualization.overlay import draw_axes, draw_landmarks, encode_jpeg, encode_png
from lmkit.visualization.plan_view import Found, draw_plan

REPORT_IMAGES = 4

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class StationError:
    """Error of the estimated pose of one stereo pair.

    Attributes:
        ids: landmarks used.
        position_mm, heading_deg, rotation_deg: errors; None without a pose.
    """

    pair: str
    status: str
    ids: tuple[LandmarkId, ...]
    position_mm: float | None
    heading_deg: float | None
    rotation_deg: float | None


@dataclass(frozen=True)
class DemoResult:
    """Result of the demo, with its errors against the truth."""

    calibration: StereoCalibration
    stations: tuple[StationError, ...]
    baseline_error_mm: float


def run_demo(folder: Path, seed: int, pairs: int, boards: int, landmarks: int, progress: Progress) -> DemoResult:
    """Run the loop and write everything into ``folder``.

    Args:
        progress: called with the step's name, the number of finished items and of all items.
    """
    data = make_dataset(seed, pairs, boards, landmarks, LM8)
    _print_sheets(folder, data)
    progress("printing", 1, 1)
    _photograph(folder, data, progress)
    calibration = _calibrate(folder, progress)
    seen = _detect(folder, pairs, progress)
    truth, found = list(data.poses), []
    for index, (left, right) in enumerate(seen):
        found.append(locate_rig((left, right), calibration.rig, data.scene.landmarks))
        _overlay(folder, index, left, found[-1], calibration, data.scene.landmarks)
        progress("locating", index + 1, pairs)
    stations = tuple(_station(k, pose, estimate) for k, (pose, estimate) in enumerate(zip(truth, found, strict=True)))
    write_file(folder / "errors.csv", _errors_csv(stations), force=True)
    title = f"lmkit demo, seed {seed}: {sum(e.T_map_camera is not None for e in found)} of {pairs} pairs located"
    located = [
        Found(
            str(k), e.T_map_camera, None if e.covariance is None else e.covariance[:2, :2], e.status == PoseStatus.OK
        )
        for k, e in enumerate(found)
        if e.T_map_camera is not None
    ]
    plan = draw_plan(data.scene.landmarks, located, truth, data.scene.size_m[:2], title)
    write_file(folder / "plan.png", plan, force=True)
    baseline_error = 1000 * (calibration.rig.baseline_m - data.rig.baseline_m)
    return DemoResult(calibration, stations, baseline_error)


def _print_sheets(folder: Path, data: Dataset) -> None:
    template = load_template("a4")
    codes = sorted(landmark.code for landmark in data.scene.landmarks)
    pages = [compose_landmark_page(LM8, code, LM8.side_mm, template) for code in codes]
    write_file(folder / "prints" / "landmarks.pdf", pages_to_pdf(pages, "lmkit demo landmarks"), force=True)
    board = compose_board_page(BOARD)
    write_file(folder / "prints" / "board.pdf", pages_to_pdf([board], board.title), force=True)


def _photograph(folder: Path, data: Dataset, progress: Progress) -> None:
    total = 2 * (len(data.poses) + len(data.boards))
    for done, (name, image) in enumerate(render_images(data), start=1):
        write_file(folder / name, encode_png(image), force=True)
        progress("photographing", done, total)
    files = description_files(data)
    write_file(folder / "truth.json", files["truth.json"], force=True)
    write_file(folder / "true-rig.yaml", files["rig.yaml"], force=True)
    write_file(folder / "map.yaml", map_to_yaml(data.scene.landmarks), force=True)


def _calibrate(folder: Path, progress: Progress) -> StereoCalibration:
    files = list_pairs(str(folder / "boards" / "left"), str(folder / "boards" / "right"))
    found = find_board_pairs(files, BOARD, lambda done, total: progress("calibrating", done, total))
    result = calibrate_stereo(found.views, BOARD, found.image_size, rejected=found.rejected)
    write_file(folder / "rig.yaml", rig_to_yaml(result.rig), force=True)
    names = [view.name for view in result.used[:REPORT_IMAGES]]
    images = {n: (read_image(found.files[n][0]), read_image(found.files[n][1])) for n in names}
    write_file(folder / "calibration.html", calibration_report(result, BOARD, images), force=True)
    return result


def _detect(folder: Path, pairs: int, progress: Progress) -> list[tuple[list[Detection], list[Detection]]]:
    files = [folder / "drive" / side / f"{k:04d}.png" for k in range(pairs) for side in ("left", "right")]
    seen = []
    # An image takes less time than a worker process to start.
    for done, landmarks in enumerate(map(_detect_file, files), start=1):
        seen.append(landmarks)
        progress("detecting", done, len(files))
    return [(seen[2 * k], seen[2 * k + 1]) for k in range(pairs)]


def _detect_file(path: Path) -> list[Detection]:
    return detect_landmarks(read_image(path))


def _overlay(
    folder: Path,
    index: int,
    seen: Sequence[Detection],
    estimate: PoseEstimate,
    calibration: StereoCalibration,
    landmarks: LandmarkMap,
) -> None:
    name = f"{index:04d}"
    canvas = draw_landmarks(read_image(folder / "drive" / "left" / f"{name}.png"), seen)
    if estimate.T_map_camera is not None:
        T_camera_map = estimate.T_map_camera.inverse()
        tips = np.vstack([np.zeros(3), 0.12 * np.eye(3)])
        for id_ in estimate.inliers:
            landmark = landmarks.find(id_)
            assert landmark is not None
            draw_axes(canvas, calibration.rig.left, (T_camera_map @ landmark.T_map_landmark).apply(tips))
    write_file(folder / "overlays" / f"{name}.jpg", encode_jpeg(canvas), force=True)


def _station(index: int, true: Pose, estimate: PoseEstimate) -> StationError:
    found = estimate.T_map_camera
    if found is None:
        return StationError(f"{index:04d}", estimate.status, (), None, None, None)
    headings = [np.arctan2(pose.R[1, 2], pose.R[0, 2]) for pose in (found, true)]
    turn = wrap_heading(headings[0] - headings[1])
    return StationError(
        f"{index:04d}",
        estimate.status,
        estimate.inliers,
        1000 * float(np.linalg.norm(found.t - true.t)),
        float(np.rad2deg(abs(turn))),
        float(np.rad2deg(rotation_angle(found.R @ true.R.T))),
    )


def _errors_csv(stations: Sequence[StationError]) -> str:
    lines = ["pair,status,codes,position_error_mm,heading_error_deg,rotation_error_deg"]
    for s in stations:
        errors = ["" if v is None else f"{v:.4f}" for v in (s.position_mm, s.heading_deg, s.rotation_deg)]
        lines.append(",".join([s.pair, s.status, " ".join(str(i.code) for i in s.ids), *errors]))
    return "\n".join([*lines, ""])
