"""Images of a board by several cameras -> a calibrated rig: every camera's corners, and the views that two share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import combinations
from pathlib import Path

from lmkit.calibration.mono import calibrate_camera
from lmkit.calibration.several_cameras import RigCalibration, calibrate_rig
from lmkit.io.image_groups import list_groups
from lmkit.model.board import BoardSpec
from lmkit.model.observation import BoardObservation, PairView
from lmkit.pipelines.board_views import pair_view
from lmkit.pipelines.camera_views import find_board_images


def calibrate_sources(
    sources: Sequence[str],
    board: BoardSpec,
    model: str = "auto",
    on_image: Callable[[int, int], None] = lambda done, total: None,
) -> RigCalibration:
    """Calibrate a rig of three or more cameras from folders or globs, whose images belong together by sorted name.

    Args:
        sources: one per camera; the board need not be in every image.
        on_image: told after every image how many are done, of how many.

    Raises:
        InputError: not as many images of every camera, too few views of a camera or of a pair of cameras.
    """
    groups = list_groups(sources)
    seen: list[dict[int, BoardObservation]] = []
    cameras = []
    for k, source in enumerate(sources):
        done = k * len(groups)
        found = find_board_images(source, board, partial(_count_on, on_image, done, len(sources) * len(groups)))
        board = found.board
        number = {files[k].stem: row for row, files in enumerate(groups)}
        seen.append({number[name]: corners for name, corners in found.views})
        cameras.append(calibrate_camera(found.views, board, found.image_size, model, found.rejected))
    pairs: dict[tuple[int, int], list[PairView]] = {}
    for a, b in combinations(range(len(sources)), 2):
        views = [
            pair_view(groups[row][a].stem, seen[a][row], seen[b][row], board)
            for row in sorted(seen[a].keys() & seen[b].keys())
        ]
        pairs[a, b] = [view for view in views if isinstance(view, PairView)]
    return calibrate_rig(_names(sources), cameras, pairs, board)


def _count_on(on_image: Callable[[int, int], None], before: int, total: int, done: int, _: int) -> None:
    on_image(before + done, total)


def _names(sources: Sequence[str]) -> list[str]:
    """Names of the folders, or cam0, cam1, ... where two are alike."""
    names = [Path(source).stem for source in sources]
    return names if len(set(names)) == len(names) and all(names) else [f"cam{k}" for k in range(len(names))]
