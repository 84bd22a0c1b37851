"""Corner files (JSON): detected corners of a board, to repeat a calibration without the images."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, ValidationError

from lmkit.arrays import FloatArray, IntArray
from lmkit.errors import InputError
from lmkit.io.document_models import Document
from lmkit.io.documents import read_text
from lmkit.io.field_problems import first_problem
from lmkit.model.board import BoardSpec
from lmkit.model.observation import PairView

CORNERS: Literal["lmkit-corners/1"] = "lmkit-corners/1"
Counted = Annotated[int, Field(ge=0)]
_HINT = "write it with lmkit calibrate --save-corners"


class _Side(Document):
    noise_px: float | None = None
    ids: tuple[Counted, ...]
    points: tuple[tuple[float, float], ...]


class _Pair(Document):
    pair: str
    left: _Side
    right: _Side


class _Rejected(Document):
    pair: str
    reason: str


class _CornersFile(Document):
    format: Literal["lmkit-corners/1"] = CORNERS
    board: str
    measured_mm: tuple[float, float] | None = None
    image_size: tuple[Annotated[int, Field(gt=0)], Annotated[int, Field(gt=0)]]
    right_image_size: tuple[Annotated[int, Field(gt=0)], Annotated[int, Field(gt=0)]] | None = None
    pairs: tuple[_Pair, ...]
    rejected: tuple[_Rejected, ...] = ()


@dataclass(frozen=True)
class SavedCorners:
    """The content of a corner file; see :class:`lmkit.pipelines.board_views.BoardPairs`."""

    board: BoardSpec
    image_size: tuple[int, int]
    views: tuple[PairView, ...]
    rejected: tuple[tuple[str, str], ...]
    right_size: tuple[int, int] | None = None  # None: the left camera's


def corners_to_json(saved: SavedCorners) -> str:
    """The text of a corner file, one pair a line."""

    def side(ids: IntArray, points: FloatArray, noise: float | None) -> dict[str, object]:
        known = noise if noise is not None and np.isfinite(noise) else None
        return {"noise_px": known, "ids": ids.tolist(), "points": points.tolist()}

    lines = [
        json.dumps(
            {
                "pair": v.name,
                "left": side(v.ids_left, v.left, v.noise_left),
                "right": side(v.ids_right, v.right, v.noise_right),
            }
        )
        for v in saved.views
    ]
    head = {"format": CORNERS, "board": str(saved.board), "image_size": list(saved.image_size)}
    if saved.board.stretch != (1.0, 1.0):
        head["measured_mm"] = [s * p for s, p in zip(saved.board.stretch, saved.board.pattern_mm, strict=True)]
    if saved.right_size not in (None, saved.image_size):
        head["right_image_size"] = list(saved.right_size or ())
    start = json.dumps(head)[:-1]
    rejected = json.dumps([{"pair": name, "reason": reason} for name, reason in saved.rejected])
    return f'{start}, "pairs": [\n' + ",\n".join(lines) + f'\n], "rejected": {rejected}}}\n'


def read_corners(path: Path) -> SavedCorners:
    """The corners of a file.

    Raises:
        InputError: not readable or not valid; names the key.
    """
    try:
        data = _CornersFile.model_validate_json(read_text(path, "corner file"))
    except ValidationError as error:
        where, problem = first_problem(error)
        raise InputError("bad_corners", f"{path}: {where}: {problem}", _HINT) from None
    board = BoardSpec.parse(data.board)
    if data.measured_mm is not None:
        board = board.measured(*data.measured_mm)
    count = len(board.object_points)
    views = tuple(_view(path, k, pair, count) for k, pair in enumerate(data.pairs))
    rejected = tuple((r.pair, r.reason) for r in data.rejected)
    return SavedCorners(board, data.image_size, views, rejected, data.right_image_size)


def _view(path: Path, k: int, pair: _Pair, count: int) -> PairView:
    for name, side in (("left", pair.left), ("right", pair.right)):
        good = len(side.ids) == len(side.points) == len(set(side.ids)) and all(i < count for i in side.ids)
        if not good:
            where = f"pairs[{k}].{name}"
            raise InputError(
                "bad_corners", f"{path}: {where}: its ids and points are not corners of the board", _HINT
            )
    return PairView(
        pair.pair,
        np.array(pair.left.ids, dtype=np.int64),
        np.array(pair.left.points, dtype=np.float64).reshape(-1, 2),
        np.array(pair.right.ids, dtype=np.int64),
        np.array(pair.right.points, dtype=np.float64).reshape(-1, 2),
        pair.left.noise_px,
        pair.right.noise_px,
    )
