"""`lmkit calibrate --check`: is a rig file still true?"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from lmkit.cli.common import print_json, print_line, progress_counter
from lmkit.errors import NegativeAnswer

if TYPE_CHECKING:
    from lmkit.calibrate.check import RigCheck
    from lmkit.model.board import BoardSpec


def check_pictures(rig: Path, left: str, right: str, spec: BoardSpec | None, as_json: bool) -> None:
    """Compare a rig with new pictures."""
    from lmkit.board_pairs import find_board_pairs
    from lmkit.calibrate.check import check_rig
    from lmkit.formats.any_rig import read_any_rig
    from lmkit.formats.sources import list_pairs
    from lmkit.landmark_pairs import find_landmark_pairs

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


def check_dict(checked: RigCheck) -> dict[str, Any]:
    """The answer as docs/formats.md has it."""
    return {
        "verdict": checked.verdict,
        "sentence": checked.sentence,
        "epipolar_px": checked.epipolar_px,
        "reprojection_px": checked.reprojection_px,
        "refitted_epipolar_px": checked.moved_epipolar_px,
        "refitted_reprojection_px": checked.moved_reprojection_px,
        "turn_deg": checked.turn_deg.tolist(),
        "turn_sigma_deg": checked.turn_sigma_deg.tolist(),
        "shift_mm": checked.shift_mm.tolist(),
        "shift_sigma_mm": checked.shift_sigma_mm.tolist(),
        "focal_change": None if checked.focal_change is None else list(checked.focal_change),
        "views_used": list(checked.used),
        "views_odd": list(checked.odd),
    }
