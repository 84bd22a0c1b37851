"""Page 4, guided calibration from cameras, films or folders of pairs, until a given depth error.

Runs as a job, ``python -m lmkit.web.guided TASK``: states go to stderr as lines of progress, pairs to a folder.
A line on standard input ends the guidance with the pairs kept so far.
"""

from __future__ import annotations

import base64
import json
import sys
import threading
import time
from collections.abc import Callable
from io import FileIO, RawIOBase
from pathlib import Path
from typing import Any

import numpy as np

import lmkit as lm
from lmkit.calibration.stereo import calibrate_stereo
from lmkit.detection.boards import detect_board
from lmkit.errors import InputError
from lmkit.io.files import write_file
from lmkit.io.image_groups import SPLIT, frame_groups
from lmkit.io.image_sources import are_moving, frame_count
from lmkit.pipelines.board_absence import explain_absence
from lmkit.pipelines.capture_board import Looked, look_at_frames
from lmkit.visualization.overlay import encode_png
from lmkit.web.jobs import PROGRESS
from lmkit.web.tasks import run_task

LEAST_PAIRS = 6  # with fewer pairs there is no calibration
ENOUGH_PAIRS = 10  # with fewer pairs the stated error is too small for some rigs, and no pair is held out
THUMB_PX = 300
LEAST_APART_S = 0.25  # between states without new pairs
EXPLAIN_EVERY_S = 2.0


def guide(
    task: dict[str, Any], tell: Callable[[dict[str, Any]], None], is_asked_to_end: Callable[[], bool] = lambda: False
) -> dict[str, Any]:
    """Keep pairs until the calibration's part of the depth error at the given distance is small enough.

    It also ends with the source, or on request.

    Args:
        task: ``cameras``, ``board``, ``folder``, ``at_m``, ``until_m``.
        tell: called with every state.

    Returns:
        The last state.

    Raises:
        InputError: a source that cannot be read, another board, or too few pairs.
    """
    cameras, board = task["cameras"], lm.BoardSpec.parse(task["board"])
    sources = [f"{SPLIT}{cameras[0]}"] if len(cameras) == 1 else cameras
    pairs = ((frames[0], frames[1]) for frames in frame_groups(sources))
    state: dict[str, Any] = {"step": "looking", "kept": 0, "depth": [], "curve": [], "reached": False}
    state |= {"until_m": task["until_m"], "at_m": task["at_m"], "total": frame_count(cameras[:1])}
    sent_s, explained = 0.0, _Explained(board)
    for looked in look_at_frames(pairs, board, are_moving(cameras[0]), until_complete=False):
        state |= {"done": looked.done, "words": looked.judgment.words, "reason": looked.judgment.reason}
        state["ghost"] = _ghost(looked)
        if looked.judgment.kept:
            _save(looked, Path(task["folder"]))
            state |= _learned(looked, state)
            tell(state | {"image": _thumb(looked)})
        else:
            if looked.judgment.reason == "no board":
                state["words"] = explained.why(looked)
            if time.monotonic() - sent_s > LEAST_APART_S:
                sent_s = time.monotonic()
                tell(state | {"image": _thumb(looked)})
        if state["reached"] or is_asked_to_end():
            break
    if state["kept"] < LEAST_PAIRS:
        raise InputError(
            "too_few_pairs",
            f"{state['kept']} pairs with the board were kept, {LEAST_PAIRS} are needed",
            "show the whole board to both cameras, sharp, at other places and tilts",
        )
    return state | {"step": "calibrating"}


def _save(looked: Looked, folder: Path) -> None:
    name = looked.found.corners.views[-1].name
    for side, image in (("left", looked.left), ("right", looked.right)):
        write_file(folder / side / f"{name}.png", encode_png(image))


def _learned(looked: Looked, state: dict[str, Any]) -> dict[str, Any]:
    """New values of ``state`` from the kept pairs."""
    seen = looked.found.corners
    news: dict[str, Any] = {"kept": len(seen.views), "coverage": [cells.tolist() for cells in looked.coverage.cells]}
    news["advice"] = list(looked.coverage.advice)[:4]
    if len(seen.views) < LEAST_PAIRS:
        return news
    try:
        result = calibrate_stereo(seen.views, seen.board, seen.image_size, "pinhole", right_size=seen.right_size)
    except InputError as error:
        return news | {"words": error.message}
    depth = [{"at_m": e.depth_m, "error_m": e.calibration_m, "total_m": e.total_m} for e in result.depth_errors]
    here = next((e["error_m"] for e in depth if e["at_m"] == state["at_m"]), None)
    reached = here is not None and here <= state["until_m"] and len(seen.views) >= ENOUGH_PAIRS
    news |= {"depth": depth, "held_out_px": result.held_out_epipolar_px, "reached": reached}
    return news | {"curve": [*state["curve"], [len(seen.views), here]]}


class _Explained:
    """Reason why no board is found, updated every few seconds."""

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
    """Outline of the wanted view of the board, as shares of both images side by side."""
    if looked.ghost is None:
        return None
    side, outline = looked.ghost
    height, width = looked.left.shape[:2]
    return [[(side + x / width) / 2, y / height] for x, y in outline.tolist()]


def _thumb(looked: Looked) -> str:
    """Both images side by side, reduced, as a data URL."""
    import cv2

    from lmkit.visualization.overlay import encode_jpeg, side_by_side

    both = side_by_side(looked.left, looked.right)
    factor = 2 * THUMB_PX / both.shape[1]
    small = np.asarray(cv2.resize(both, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    return f"data:image/jpeg;base64,{base64.b64encode(encode_jpeg(small, 70)).decode()}"


def _tell(state: dict[str, Any]) -> None:
    sys.stderr.write(f"{PROGRESS}{json.dumps(state)}\n")
    sys.stderr.flush()


def guide_until_asked(task: dict[str, Any]) -> None:
    """Guide until the error is reached, the source ends, or a line comes on standard input."""
    asked = threading.Event()

    def listen(wishes: RawIOBase) -> None:
        if wishes.readline():
            asked.set()

    # Unbuffered: at exit, Python cannot abandon a thread that waits in a buffered reader.
    with FileIO(sys.stdin.fileno(), closefd=False) as wishes:
        threading.Thread(target=listen, args=(wishes,), daemon=True).start()
        _tell(guide(task, _tell, asked.is_set))


if __name__ == "__main__":
    sys.exit(run_task(guide_until_asked))
