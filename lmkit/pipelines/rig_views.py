"""Calibration of a rig of one or more cameras from images of a board."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from lmkit.calibration.initialization import models_by_camera
from lmkit.calibration.mono import calibrate_camera
from lmkit.calibration.sanity_checks import Declared
from lmkit.calibration.several_cameras import RigCalibration, calibrate_rig
from lmkit.detection.boards import same_orientation
from lmkit.io.image_groups import are_files, list_groups
from lmkit.model.board import BoardSpec
from lmkit.model.observation import BoardObservation
from lmkit.pipelines.camera_views import CameraViews, find_board_images, find_board_videos


def calibrate_sources(
    sources: Sequence[str],
    board: BoardSpec,
    model: str = "auto",
    on_image: Callable[[int, int], None] = lambda done, total: None,
) -> RigCalibration:
    """Calibrate a rig of three or more cameras from folders or globs, whose images belong together by
    name, or from videos.

    Args:
        sources: one per camera; the board need not be in every image.
        model: see `calibrate_camera`; separate the models of several cameras by commas.
        on_image: called after every image with the number of finished images and of all images.

    Raises:
        InputError: different numbers of images, or too few views of a camera or of a pair of cameras.
    """
    lenses = models_by_camera(model, len(sources))
    if are_files(sources):
        found, frames = _in_files(sources, board, on_image)
    else:
        found = find_board_videos(sources, board, on_image)
        frames = [{name: name for name, _ in views.views} for views in found]
    board = found[-1].board
    seen: list[dict[str, BoardObservation]] = []
    cameras = []
    for views, lens, frame in zip(found, lenses, frames, strict=True):
        cameras.append(calibrate_camera(views.views, board, views.image_size, lens, views.rejected))
        believed = set(cameras[-1].used)
        # Images without a partner are used for their own camera only.
        seen.append({frame[name]: c for name, c in views.views if name in believed and name in frame})
    if board.kind == "chessboard":
        seen = _oriented(seen, board)
    return calibrate_rig(_names(sources), cameras, seen, board)


def calibrate_source(
    source: str,
    board: BoardSpec,
    model: str = "auto",
    declared: Declared | None = None,
    on_image: Callable[[int, int], None] = lambda done, total: None,
) -> RigCalibration:
    """Calibrate one camera from a folder, glob or video.

    Args:
        declared: see `calibrate_camera`.
        on_image: called after every image with the number of finished images and of all images.

    Returns:
        The rig of this camera, in the form for the report of several cameras.

    Raises:
        InputError: too few images, or no camera explains them.
    """
    found = find_board_images(source, board, on_image)
    camera = calibrate_camera(found.views, found.board, found.image_size, model, found.rejected, declared)
    seen = {name: corners for name, corners in found.views if name in set(camera.used)}
    return replace(calibrate_rig(["camera"], [camera], [seen], found.board), rig=camera.rig)


def _in_files(
    sources: Sequence[str], board: BoardSpec, on_image: Callable[[int, int], None]
) -> tuple[list[CameraViews], list[dict[str, str]]]:
    """The corners in the images of every camera, and the frame name of every image with partners."""
    groups = list_groups(sources)
    found: list[CameraViews] = []
    for k, source in enumerate(sources):
        counter = partial(_count_on, on_image, k * len(groups), len(sources) * len(groups))
        found.append(find_board_images(source, board, counter))
        board = found[-1].board
    # A frame is named by its first image.
    return found, [{files[k].stem: files[0].stem for files in groups} for k in range(len(sources))]


def _oriented(seen: Sequence[dict[str, BoardObservation]], board: BoardSpec) -> list[dict[str, BoardObservation]]:
    """The corners, in every frame in the order of the first camera that sees the board."""
    first: dict[str, BoardObservation] = {}
    for camera in seen:
        first = camera | first
    return [{frame: same_orientation(first[frame], here, board) for frame, here in camera.items()} for camera in seen]


def _count_on(on_image: Callable[[int, int], None], before: int, total: int, done: int, _: int) -> None:
    on_image(before + done, total)


def _names(sources: Sequence[str]) -> list[str]:
    """Names of the folders, or cam0, cam1, ... where two are alike."""
    names = [Path(source).stem for source in sources]
    return names if len(set(names)) == len(names) and all(names) else [f"cam{k}" for k in range(len(names))]
