"""Corners of a calibration board, camera by camera, in images or in sharp, still, new frames of videos."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from lmkit.arrays import ByteArray
from lmkit.calibration.capture_guide import CaptureGuide
from lmkit.detection.boards import detect_board
from lmkit.io.image_groups import are_files, frame_groups
from lmkit.io.image_sources import frame_count, list_images
from lmkit.io.images import read_image
from lmkit.model.board import BoardSpec
from lmkit.model.observation import BoardObservation, PairView
from lmkit.pipelines.board_views import SPEC_CHECK_IMAGES, checked_board, mapped_for, require_same_size
from lmkit.pipelines.still_frames import StillFrames, still_frames

VIDEO_CHECK_FRAMES = 20  # of a video, searched for another board than specified


@dataclass(frozen=True)
class CameraViews:
    """The corners of all images that show the board.

    Attributes:
        views: (name, corners) of those images.
        rejected: (image, reason) of the others; skipped frames of a video are not listed.
        image_size: (width, height).
        board: as specified, or with the other ChArUco layout if the images show that layout.
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
        on_image: called after every image with the number of finished images and of all images (0: unknown).

    Raises:
        InputError: no images, images of different sizes, an unreadable image, or another board than specified.
    """
    if not are_files([source]):
        return find_board_videos([source], board, on_image)[0]
    files = list_images(source)
    board = checked_board([read_image(file) for file in files[:SPEC_CHECK_IMAGES]], board)
    views, rejected = [], []
    size: tuple[int, int] | None = None
    with closing(mapped_for(board)(partial(_look, board=board), files)) as looked:
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


def find_board_videos(
    sources: Sequence[str], board: BoardSpec, on_image: Callable[[int, int], None] = lambda done, total: None
) -> list[CameraViews]:
    """Find the board in videos of one or more cameras, in the sharp and still frames that show a new view.

    A frame is kept for all cameras with a sharp board if the view is new for one of them; views of frames that
    belong together have one name.

    Args:
        on_image: called occasionally with the number of finished frames and of all frames (0: unknown).

    Raises:
        InputError: frames of different sizes, an unreadable video, or another board than specified.
    """
    total = frame_count(sources[:1]) or 0
    sizes: list[tuple[int, int]] = []
    guides: list[CaptureGuide] = []
    checked: list[ByteArray] | None = []  # frames for the check of the board; None after the check
    kept: list[list[tuple[str, BoardObservation]]] = [[] for _ in sources]
    for still in still_frames(frame_groups(sources)):
        images = [frame.pixels for frame in still.frames]
        here = [(image.shape[1], image.shape[0]) for image in images]
        sizes = sizes or here
        for frame, size, first in zip(still.frames, here, sizes, strict=True):
            require_same_size(frame.name, size, first)
        seen = [detect_board(image, board) for image in images]
        if checked is not None:
            checked += images
            if any(seen) or len(checked) >= VIDEO_CHECK_FRAMES:
                board, checked = checked_board(checked[-len(images) :], board), None
                seen = [detect_board(image, board) for image in images]
        guides = guides or [CaptureGuide(board.object_points, size) for size in sizes]
        name = f"frame {still.number}"
        judged = [
            guide.judge(None if view is None else _alone(name, view), partial(_before, still, k, board))
            for k, (guide, view) in enumerate(zip(guides, seen, strict=True))
        ]
        if any(judgment.kept for judgment in judged):
            for views, view, judgment in zip(kept, seen, judged, strict=True):
                if view is not None and judgment.reason in ("kept", "not new"):
                    views.append((name, view))
        on_image(still.number + 1, total)
    return [CameraViews(tuple(views), (), size, board) for views, size in zip(kept, sizes, strict=True)]


def _before(still: StillFrames, camera: int, board: BoardSpec) -> PairView | None:
    """The board in the previous frame."""
    if still.before is None:
        return None
    seen = detect_board(still.before[camera].pixels, board)
    return None if seen is None else _alone("before", seen)


def _alone(name: str, seen: BoardObservation) -> PairView:
    none = np.zeros(0, dtype=np.int64)
    return PairView(name, seen.ids, seen.image_points, none, np.zeros((0, 2)), seen.noise_px)


def _look(file: Path, board: BoardSpec) -> tuple[tuple[int, int], BoardObservation | None]:
    """(width, height) of an image, and the board in it."""
    image = read_image(file)
    return (image.shape[1], image.shape[0]), detect_board(image, board)
