"""By how much pairs disagree more than their corners promise: the factor on standard deviations, set by set.

python docs/decisions/0008-calibration-covariance.py ../shared/data/stereo
"""

import json
import sys
from pathlib import Path

import lmkit.calibration.bundle_adjustment as problem
from lmkit.calibration.stereo import calibrate_stereo
from lmkit.io.image_groups import list_pairs
from lmkit.model.board import BoardSpec
from lmkit.pipelines.board_views import find_board_pairs

factors: list[float] = []
scatter = problem.scatter_between_pairs


def watched(*arguments):
    found = scatter(*arguments)
    factors.append(float(found.min()) ** 0.5)  # the median's, which none goes below
    return found


if __name__ == "__main__":
    problem.scatter_between_pairs = watched
    print("| set | model | factor |")
    print("|---|---|---|")
    for name, model in (
        ("opencv_bouguet", "pinhole"),
        ("aliyasin", "pinhole"),
        ("stereopi", "pinhole"),
        ("sourishg_fisheye", "fisheye"),
    ):
        root = Path(sys.argv[1]) / name
        meta = json.loads((root / "board.json").read_text())
        columns, rows = meta["inner_corners"]
        board = BoardSpec("chessboard", columns, rows, meta["square_mm"])
        found = find_board_pairs(list_pairs(str(root / "left"), str(root / "right")), board)
        factors.clear()
        held_out_from = len(calibrate_stereo(found.views, board, found.image_size, model).used)
        # Fits of all pairs come first: without the bow, with it, and again where pairs were left out.
        print(f"| {name}, {held_out_from} pairs | {model} | {factors[1]:.2f} |", flush=True)
