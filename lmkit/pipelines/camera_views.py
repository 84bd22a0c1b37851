"""Images of a calibration board by one camera -> its corners; of a video the sharp, still and new frames."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from lmkit.arrays import ByteArray
from lmkit.calibration.capture_guide import CaptureGuide
from lmkit.detection.boards import detect_board
from lmkit.io.image_groups import are_files
from lmkit.io.image_sources import frame_count, frames, list_images
from lmkit.io.images import read_image
from lmkit.model.board import BoardSpec
from lmkit.model.observation import BoardObservation, PairView
from lmkit.parallel import map_in_processes
from lmkit.pipelines.board_views import SPEC_CHECK_IMAGES, checked_board, require_same_size

VIDEO_CHECK_FRAMES = 20  # of a video, looked at for another board than the one specified


@dataclass(frozen=True)
class CameraViews:
    """The corners of all images that show the board.

    Attributes:
        views: (name, corners) of those images.
        rejected: (image, reason) of the others; of a video frames that were passed over are not listed.
        image_size: (width, height).
        board: as specified, or with the other ChArUco layout if that is what the images show.
    """

    views: tuple[tuple[str, BoardObservation], ...]
    rejected: tuple[tuple[str, str], ...]
    image_size: tuple[int, int]
    board: BoardSpec


def find_board_images(
    source: str, board: BoardSpec, on_image: Callable[[int, int], None] = lambda done, total: None
) -> CameraViews:
    """Find the board in a folder, glob or video of one camera.

    Args:
        on_image: called after every image how many are done, of how many (0: unknown).

    Raises:
        InputError: no images, images of different sizes, an unreadable image, or another board than specified.
    """
    if not are_files([source]):
        return _in_video(source, board, on_image)
    files = list_images(source)
    board = checked_board([read_image(file) for file in files[:SPEC_CHECK_IMAGES]], board)
    views, rejected = [], []
    size: tuple[int, int] | None = None
    with closing(map_in_processes(partial(_look, board=board), files)) as looked:
        for done, (file, (here, seen)) in enumerate(zip(files, looked, strict=True), start=1):
            size = size or here
            require_same_size(str(file), here, size)
            on_image(done, len(files))
            if seen is None:
                rejected.append((file.stem, "board not found"))
            else:
                views.append((file.stem, seen))
    assert size is not None
    return CameraViews(tuple(views), tuple(rejected), size, board)


def _in_video(source: str, board: BoardSpec, on_image: Callable[[int, int], None]) -> CameraViews:
    total = frame_count([source]) or 0
    size: tuple[int, int] | None = None
    guide: CaptureGuide | None = None
    checked: list[ByteArray] | None = []  # frames to tell the board by; None once that is done
    kept: list[tuple[str, BoardObservation]] = []
    for done, frame in enumerate(frames([source]), start=1):
        image = frame.pixels
        here = image.shape[1], image.shape[0]
        size = size or here
        require_same_size(frame.name, here, size)
        guide = guide or CaptureGuide(board.object_points, size)
        seen = detect_board(image, board)
        if checked is not None:
            checked.append(image)
            if seen is not None or len(checked) == VIDEO_CHECK_FRAMES:
                board, checked = checked_board(checked[-1:], board), None
                seen = detect_board(image, board)
        name = f"frame {done - 1}"
        if guide.judge(None if seen is None else _alone(name, seen)).kept and seen is not None:
            kept.append((name, seen))
        on_image(done, total)
    assert size is not None
    return CameraViews(tuple(kept), (), size, board)


def _alone(name: str, seen: BoardObservation) -> PairView:
    none = np.zeros(0, dtype=np.int64)
    return PairView(name, seen.ids, seen.image_points, none, np.zeros((0, 2)), seen.noise_px)


def _look(file: Path, board: BoardSpec) -> tuple[tuple[int, int], BoardObservation | None]:
    """(width, height) of an image, and the board in it."""
    image = read_image(file)
    return (image.shape[1], image.shape[0]), detect_board(image, board)
