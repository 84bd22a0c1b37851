"""`lmkit calibrate --check`: does a rig file still hold?"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from lmkit.cli.output import ProgressBars, print_json, print_line
from lmkit.errors import NegativeAnswer

if TYPE_CHECKING:
    from lmkit.model.board import BoardSpec


def check_images(rig: Path, left: str, right: str, spec: BoardSpec | None, family: str, as_json: bool) -> None:
    """Compare a rig with new images, of a board or of landmarks."""
    from lmkit.calibration.rig_check import check_dict, check_lines, check_rig
    from lmkit.geometry.rig import as_stereo
    from lmkit.io.any_rig import read_any_rig
    from lmkit.io.image_groups import list_pairs
    from lmkit.model.families import family_named
    from lmkit.pipelines.board_views import find_board_pairs
    from lmkit.pipelines.landmark_views import find_landmark_pairs

    old, files = as_stereo(read_any_rig(rig), "--check"), list_pairs(left, right)
    with ProgressBars() as bars:
        on_pair = bars.counter("finding corners")
        if spec is None:
            points, views = find_landmark_pairs(files, old, family_named(family), on_pair)
            checked = check_rig(old, points, views, lenses=False)
        else:
            found = find_board_pairs(files, spec, on_pair)
            old.left.require_size(f"an image such as {files[0][0]}", found.image_size)
            old.right.require_size(f"an image such as {files[0][1]}", found.right_size)
            checked = check_rig(old, found.board.object_points, found.views)
    if as_json:
        print_json(check_dict(checked))
    else:
        print_line(f"{rig}: {checked.sentence}")
        for line in check_lines(checked):
            print_line(line)
    if checked.state != "true":
        raise NegativeAnswer("no_longer_true", f"{rig} is no longer valid", "recalibrate")
