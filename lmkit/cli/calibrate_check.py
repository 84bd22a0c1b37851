"""`lmkit calibrate --check`: whether a rig file is still valid."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from lmkit.cli.output import ProgressBars, print_json, print_line
from lmkit.errors import InputError, NegativeAnswer

if TYPE_CHECKING:
    from lmkit.calibration.rig_check import RigCheck
    from lmkit.geometry.stereo_rig import StereoRig
    from lmkit.model.board import BoardSpec


def check_images(rig: Path, left: str, right: str | None, spec: BoardSpec | None, family: str, as_json: bool) -> None:
    """Compare a rig with new images, of a board or of landmarks; without RIGHT, LEFT shows both side by side."""
    from lmkit.calibration.rig_check import check_rig
    from lmkit.geometry.rig import as_stereo
    from lmkit.io.any_rig import read_any_rig
    from lmkit.io.image_groups import list_pairs
    from lmkit.io.image_sources import are_moving
    from lmkit.model.families import family_named
    from lmkit.pipelines.board_views import find_board_pairs
    from lmkit.pipelines.landmark_views import find_landmark_pairs

    old = as_stereo(read_any_rig(rig), "--check")
    if right is None or are_moving(left) or are_moving(right):
        _answer(rig, _check_videos(old, left, right, spec), as_json)
        return
    files = list_pairs(left, right)
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
    _answer(rig, checked, as_json)


def _check_videos(old: StereoRig, left: str, right: str | None, spec: BoardSpec | None) -> RigCheck:
    """Compare with a board in two videos, or in images that show both cameras side by side.

    Raises:
        InputError: no board is named; landmarks are searched in images only.
    """
    from lmkit.calibration.rig_check import check_rig
    from lmkit.cli.calibrate_capture import capture_pairs

    if spec is None:
        raise InputError(
            "no_board",
            "--check of videos and side-by-side images needs a board",
            "add --board, or give folders of images to check by landmarks",
        )
    seen = capture_pairs(left, right, right is None, spec, None, True).corners
    if seen.views:
        old.left.require_size(left, seen.image_size)
        old.right.require_size(right or left, seen.right_size or seen.image_size)
    return check_rig(old, seen.board.object_points, seen.views)


def _answer(rig: Path, checked: RigCheck, as_json: bool) -> None:
    from lmkit.calibration.rig_check import check_dict, check_lines

    if as_json:
        print_json(check_dict(checked))
    else:
        print_line(f"{rig}: {checked.sentence}")
        for line in check_lines(checked):
            print_line(line)
    if checked.state != "true":
        raise NegativeAnswer("no_longer_true", f"{rig} is no longer valid", "recalibrate")
