"""Page 4, guided calibration: a film or a folder of pairs as the camera, until a stated depth error.

Runs as a job, ``python -m lmkit.web.guided TASK``: states go to stderr as lines of progress, pairs to a folder.
"""

from __future__ import annotations

import base64
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import lmkit as lm
from lmkit.detection.boards import detect_board
from lmkit.errors import InputError
from lmkit.pipelines.board_absence import explain_absence
from lmkit.pipelines.capture_board import Looked, look_at_frames
from lmkit.web.jobs import PROGRESS
from lmkit.web.tasks import run_task

LEAST_PAIRS = 6  # before them a calibration says nothing
THUMB_PX = 300
LEAST_APART_S = 0.25  # of states without news
EXPLAIN_EVERY_S = 2.0


def guide(task: dict[str, Any], tell: Callable[[dict[str, Any]], None]) -> dict[str, Any]:
    """Keep pairs until the depth error at the stated distance is reached, or the source ends; the last state.

    Args:
        task: ``cameras``, ``board``, ``folder``, ``at_m``, ``until_m``.
        tell: is given every state.

    Raises:
        InputError: a source that cannot be read, another board, or too few pairs.
    """
    from lmkit.calibration.stereo import calibrate_stereo
    from lmkit.io.files import write_file
    from lmkit.io.image_groups import SPLIT, frame_groups
    from lmkit.io.image_sources import are_moving
    from lmkit.visualization.overlay import encode_png

    cameras, board = task["cameras"], lm.BoardSpec.parse(task["board"])
    sources = [f"{SPLIT}{cameras[0]}"] if len(cameras) == 1 else cameras
    pairs = ((frames[0], frames[1]) for frames in frame_groups(sources))
    state: dict[str, Any] = {"step": "looking", "kept": 0, "depth": [], "curve": [], "reached": False}
    state |= {"until_m": task["until_m"], "at_m": task["at_m"]}
    sent_s, explained = 0.0, _Explained(board)
    for count, looked in enumerate(look_at_frames(pairs, board, are_moving(cameras[0]), until_complete=False), 1):
        state |= {"done": count, "total": None, "words": looked.judgment.words, "reason": looked.judgment.reason}
        state["ghost"] = _ghost(looked)
        if not looked.judgment.kept:
            if looked.judgment.reason == "no board":
                state["words"] = explained.why(looked)
            if time.monotonic() - sent_s > LEAST_APART_S:
                sent_s = time.monotonic()
                tell(state | {"image": _thumb(looked)})
            continue
        views = looked.found.corners.views
        for side, image in (("left", looked.left), ("right", looked.right)):
            write_file(Path(task["folder"]) / side / f"{views[-1].name}.png", encode_png(image))
        state |= {"kept": len(views), "coverage": [cells.tolist() for cells in looked.coverage.cells]}
        state["advice"] = list(looked.coverage.advice)[:4]
        if len(views) >= LEAST_PAIRS:
            try:
                seen = looked.found.corners
                result = calibrate_stereo(views, seen.board, seen.image_size, "pinhole", right_size=seen.right_size)
            except InputError as error:
                state["words"] = error.message
            else:
                state["depth"] = [{"at_m": e.depth_m, "error_m": e.total_m} for e in result.depth_errors]
                state["held_out_px"] = result.held_out_epipolar_px
                here = next((e.total_m for e in result.depth_errors if e.depth_m == task["at_m"]), None)
                state["curve"] = [*state["curve"], [len(views), here]]
                state["reached"] = here is not None and here <= task["until_m"]
        tell(state | {"image": _thumb(looked)})
        if state["reached"]:
            break
    if state["kept"] < LEAST_PAIRS:
        raise InputError(
            "too_few_pairs",
            f"{state['kept']} pairs with the board were kept, {LEAST_PAIRS} are needed",
            "show the whole board to both cameras, sharp, at other places and tilts",
        )
    return state | {"step": "calibrating"}


class _Explained:
    """Why no board is found, looked into every few seconds."""

    def __init__(self, board: lm.BoardSpec) -> None:
        self._board, self._at_s, self._words = board, float("-inf"), ""

    def why(self, looked: Looked) -> str:
        """One sentence about the newest pair, or about an earlier one."""
        if time.monotonic() - self._at_s > EXPLAIN_EVERY_S:
            self._at_s = time.monotonic()
            in_left = detect_board(looked.left, self._board) is not None
            side, image = ("right", looked.right) if in_left else ("left", looked.left)
            self._words = f"{side} camera: {explain_absence(image, self._board)}"
        return self._words


def _ghost(looked: Looked) -> list[list[float]] | None:
    """Outline of the board where it is wanted next, as shares of both images side by side."""
    if looked.ghost is None:
        return None
    side, outline = looked.ghost
    height, width = looked.left.shape[:2]
    return [[(side + x / width) / 2, y / height] for x, y in outline.tolist()]


def _thumb(looked: Looked) -> str:
    """Both images side by side, small, as a data address."""
    import cv2

    from lmkit.visualization.overlay import encode_jpeg, side_by_side

    both = side_by_side(looked.left, looked.right)
    factor = 2 * THUMB_PX / both.shape[1]
    small = np.asarray(cv2.resize(both, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    return f"data:image/jpeg;base64,{base64.b64encode(encode_jpeg(small, 70)).decode()}"


def _tell(state: dict[str, Any]) -> None:
    sys.stderr.write(f"{PROGRESS}{json.dumps(state)}\n")
    sys.stderr.flush()


if __name__ == "__main__":
    sys.exit(run_task(lambda task: _tell(guide(task, _tell))))
