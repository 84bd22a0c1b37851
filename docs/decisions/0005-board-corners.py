"""Held-out row error with SB corners, gradient corners, and their mean, on real stereo sets.

python docs/decisions/0005-board-corners.py ../shared/data/stereo
"""

import json
import sys
from pathlib import Path

import lmkit.detect.boards as boards
from lmkit.board_pairs import _look
from lmkit.calibrate.stereo import calibrate_stereo
from lmkit.model.board import BoardSpec
from lmkit.model.observation import PairView

fused = boards._fused
WAYS = {
    "SB": lambda grey, corners, size: corners,
    "gradient": lambda grey, corners, size: 2 * fused(grey, corners, size) - corners,
    "mean": fused,
}


def held_out(root: Path, board: BoardSpec) -> float | None:
    views = []
    for left, right in zip(sorted((root / "left").iterdir()), sorted((root / "right").iterdir()), strict=True):
        (size, seen_left), (_, seen_right) = _look(left, board), _look(right, board)
        if seen_left is not None and seen_right is not None:
            seen_right = boards.same_orientation(seen_left, seen_right)
            views.append(
                PairView(left.stem, seen_left.ids, seen_left.image_points, seen_right.ids, seen_right.image_points)
            )
    return calibrate_stereo(views, board, size).held_out_epipolar_px


if __name__ == "__main__":
    print("| set | " + " | ".join(WAYS) + " |")
    print("|---|" + "---|" * len(WAYS))
    for name in ("opencv_bouguet", "aliyasin", "stereopi"):
        root = Path(sys.argv[1]) / name
        meta = json.loads((root / "board.json").read_text())
        columns, rows = meta["inner_corners"]
        board = BoardSpec("chessboard", columns, rows, meta["square_mm"])
        row = []
        for way in WAYS.values():
            boards._fused = way
            row.append(f"{held_out(root, board):.4f}")
        print(f"| {name} | " + " | ".join(row) + " |", flush=True)
