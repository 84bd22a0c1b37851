"""`lmkit calibrate`: one camera from images or a video of a board, or three and more cameras from images."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from lmkit.cli.output import ProgressBars, print_json, print_line, write_outputs

if TYPE_CHECKING:
    from lmkit.calibration.mono import CameraCalibration
    from lmkit.calibration.sanity_checks import Declared
    from lmkit.calibration.several_cameras import RigCalibration
    from lmkit.model.board import BoardSpec


def calibrate_cameras(
    sources: Sequence[str],
    spec: BoardSpec,
    model: str,
    declared: Declared,
    output: Path | None,
    report: Path | None,
    as_json: bool,
    force: bool,
) -> None:
    """Calibrate one camera, or three and more, and write the rig file and the report (of three and more)."""
    from lmkit.calibration.mono import calibrate_camera, camera_lines
    from lmkit.calibration.several_cameras import rig_lines
    from lmkit.io.rig import rig_to_yaml
    from lmkit.pipelines.camera_views import find_board_images
    from lmkit.pipelines.rig_views import calibrate_sources
    from lmkit.reports.rig_calibration import rig_calibration_report, rig_calibration_summary

    result: CameraCalibration | RigCalibration
    with ProgressBars() as bars:
        counter = bars.counter("finding the board")
        if len(sources) > 1:
            result = calibrate_sources(sources, spec, model, counter)
            _, summary, reason = rig_calibration_summary(result)
            lines = [f"result: {summary} {reason}", *rig_lines(result)]
            made = None if report is None else rig_calibration_report(result, spec)
        else:
            found = find_board_images(sources[0], spec, counter)
            result = calibrate_camera(found.views, found.board, found.image_size, model, found.rejected, declared)
            lines, made = camera_lines(result), None
    written = write_outputs({output: rig_to_yaml(result.rig), report: made or ""}, force)
    if as_json:
        print_json(result.to_dict())
        return
    for line in (*lines, *(f"wrote                  {path}" for path in written)):
        print_line(line)
