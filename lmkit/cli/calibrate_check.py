"""`lmkit calibrate --check`: is a rig file still true?"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from lmkit.cli.output import print_json, print_line, progress_counter
from lmkit.errors import NegativeAnswer

if TYPE_CHECKING:
    from lmkit.model.board import BoardSpec


def check_pictures(rig: Path, left: str, right: str, spec: BoardSpec | None, as_json: bool) -> None:
    """Compare a rig with new pictures."""
    from lmkit.calibration.rig_check import check_dict, check_rig
    from lmkit.io.any_rig import read_any_rig
    from lmkit.io.image_sources import list_pairs
    from lmkit.pipelines.board_views import find_board_pairs
    from lmkit.pipelines.landmark_views import find_landmark_pairs

    old, files = read_any_rig(rig), list_pairs(left, right)
    on_pair = progress_counter(len(files), "finding corners")
    if spec is None:
        points, views = find_landmark_pairs(files, old, on_pair=on_pair)
        checked = check_rig(old, points, views, lenses=False)
    else:
        found = find_board_pairs(files, spec, on_pair)
        old.left.require_size(f"a picture such as {files[0][0]}", found.image_size)
        checked = check_rig(old, found.board.object_points, found.views)
    if as_json:
        print_json(check_dict(checked))
    else:
        print_line(f"{rig}: {checked.sentence}")
        for name, old_px, new_px in (
            ("row error", checked.epipolar_px, checked.moved_epipolar_px),
            ("reprojection error", checked.reprojection_px, checked.moved_reprojection_px),
        ):
            print_line(f"{name:<22} {old_px:.3f} px in this rig, {new_px:.3f} px with the eyes fitted anew")
        odd = f", {len(checked.odd)} fit no rig ({', '.join(checked.odd)})" if checked.odd else ""
        print_line(f"views                  {len(checked.used)} used{odd}")
    if checked.verdict != "true":
        raise NegativeAnswer("no_longer_true", f"{rig} is no longer true", "calibrate anew")
