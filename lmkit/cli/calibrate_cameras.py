"""`lmkit calibrate`: one camera from images or a video of a board, or three and more cameras from images."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from lmkit.cli.calibrate_pairs import written_lines
from lmkit.cli.output import ProgressBars, print_json, print_line, write_outputs

if TYPE_CHECKING:
    from lmkit.calibration.sanity_checks import Declared
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
    """Calibrate one camera, or three and more, and write the rig file and the report."""
    from lmkit.calibration.mono import camera_lines
    from lmkit.calibration.several_cameras import rig_lines
    from lmkit.io.rig import rig_to_yaml
    from lmkit.pipelines.rig_views import calibrate_source, calibrate_sources
    from lmkit.reports.rig_calibration import rig_calibration_report, rig_calibration_summary

    with ProgressBars() as bars:
        counter = bars.counter("finding the board")
        if len(sources) > 1:
            result = calibrate_sources(sources, spec, model, counter)
        else:
            result = calibrate_source(sources[0], spec, model, declared, counter)
    alone = result.cameras[0] if len(sources) == 1 else None
    _, summary, _ = rig_calibration_summary(result)
    made = "" if report is None else rig_calibration_report(result, spec)
    written = write_outputs({output: rig_to_yaml(result.rig), report: made}, force)
    if as_json:
        print_json((alone or result).to_dict())
        return
    print_line(f"result                 {summary}")
    for line in camera_lines(alone) if alone else rig_lines(result):
        print_line(line)
    for line in written_lines(written, output):
        print_line(line)
