"""Held-out row error with each localizer of board corners alone, and with all of them weighed, on real stereo sets.

python docs/decisions/0005-board-corners.py ../shared/data/stereo
"""

import json
import sys
from pathlib import Path

import lmkit.detection.board_corners as corners
import lmkit.detection.boards as boards
from lmkit.calibration.stereo import calibrate_stereo
from lmkit.model.board import BoardSpec
from lmkit.pipelines.board_views import _look, pair_view


def only(localize):
    """A refinement by one localizer."""

    def refine(gray, found, board_points, square, clear=0.5):
        side = corners._smallest_side(found, board_points, square)
        refined = localize(gray, found, min(clear, 1.0) * side)
        return refined, corners.corner_noise(refined, board_points)

    return refine


METHODS = {
    "SB": only(lambda gray, found, side: found),
    "gradient": only(
        lambda gray, found, side: corners._by_gradients(
            gray, found, corners._half_window(corners.GRADIENT_WINDOW / 0.5 * side)
        )
    ),
    "saddle": only(
        lambda gray, found, side: corners._by_saddles(
            gray, found, corners._half_window(corners.SADDLE_WINDOW / 0.5 * side)
        )
    ),
    "weighed": corners.refine_corners,
}


def held_out(root: Path, board: BoardSpec) -> float | None:
    views = []
    for left, right in zip(sorted((root / "left").iterdir()), sorted((root / "right").iterdir()), strict=True):
        (size, seen_left), (_, seen_right) = _look(left, board), _look(right, board)
        view = pair_view(left.stem, seen_left, seen_right, board)
        if not isinstance(view, str):
            views.append(view)
    return calibrate_stereo(views, board, size, "pinhole").held_out_epipolar_px


if __name__ == "__main__":
    print("| set | " + " | ".join(METHODS) + " |")
    print("|---|" + "---|" * len(METHODS))
    for name in ("opencv_bouguet", "aliyasin", "stereopi"):
        root = Path(sys.argv[1]) / name
        meta = json.loads((root / "board.json").read_text())
        columns, rows = meta["inner_corners"]
        board = BoardSpec("chessboard", columns, rows, meta["square_mm"])
        row = []
        for way in METHODS.values():
            boards.refine_corners = way
            row.append(f"{held_out(root, board):.4f}")
        print(f"| {name} | " + " | ".join(row) + " |", flush=True)
