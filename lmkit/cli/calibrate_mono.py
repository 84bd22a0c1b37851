"""`lmkit calibrate IMAGES`: one camera from images or a video of a board."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from lmkit.cli.output import ProgressBars, print_json, print_line, write_outputs

if TYPE_CHECKING:
    from lmkit.calibration.sanity_checks import Declared
    from lmkit.model.board import BoardSpec


def calibrate_images(
    source: str, spec: BoardSpec, model: str, declared: Declared, output: Path | None, as_json: bool, force: bool
) -> None:
    """Calibrate one camera and write its rig file."""
    from lmkit.calibration.mono import calibrate_camera, camera_lines
    from lmkit.io.rig import rig_to_yaml
    from lmkit.pipelines.camera_views import find_board_images

    with ProgressBars() as bars:
        found = find_board_images(source, spec, bars.counter("finding the board"))
    result = calibrate_camera(found.views, found.board, found.image_size, model, found.rejected, declared)
    written = write_outputs({output: rig_to_yaml(result.rig)}, force)
    if as_json:
        print_json(result.to_dict())
        return
    for line in (*camera_lines(result), *(f"wrote                  {path}" for path in written)):
        print_line(line)
