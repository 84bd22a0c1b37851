"""`lmkit calibrate`: one camera, a stereo pair or more cameras from images of a board; checks; guided capture."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lmkit.cli import base_options, options
from lmkit.cli.output import (
    BOARD_HELP,
    ProgressBars,
    check_outputs,
    print_json,
    print_line,
    require_no,
    write_outputs,
)
from lmkit.errors import InputError

REPORT_IMAGES = 6


def run(
    images: Annotated[
        list[str] | None,
        typer.Argument(
            help="Images: one folder, glob or video per camera, split:VIDEO of two, or camera:0 with --capture."
        ),
    ] = None,
    board: Annotated[str | None, typer.Option("--board", help=BOARD_HELP)] = None,
    measured: options.MeasuredPattern = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Rig file to write (YAML).")] = None,
    report: options.ReportOutput = None,
    model: Annotated[
        str,
        typer.Option(
            "--model",
            help="pinhole, rational, fisheye, radtan (Kalibr's) or auto (by held-out error); or LEFT,RIGHT.",
        ),
    ] = "auto",
    baseline: Annotated[
        str | None,
        typer.Option("--baseline", help="Nominal baseline, such as 120mm; the result is checked against it."),
    ] = None,
    fov: Annotated[
        float | None,
        typer.Option("--fov", help="Nominal horizontal field of view, degrees; the result is checked against it."),
    ] = None,
    intrinsics: options.Intrinsics = None,
    intrinsics_sigma: options.IntrinsicsSigma = None,
    save_corners: Annotated[
        Path | None,
        typer.Option("--save-corners", help="File of detected corners to write, for a later run with --corners."),
    ] = None,
    corners: Annotated[
        Path | None, typer.Option("--corners", help="File of saved corners, instead of images and --board.")
    ] = None,
    check: Annotated[
        Path | None,
        typer.Option("--check", help="Rig file to check against the images, by landmarks or by --board."),
    ] = None,
    family: options.OneFamily = "lm8",
    capture: Annotated[
        bool,
        typer.Option(
            "--capture", help="Guided capture from cameras: suggests the next view, keeps sharp and new pairs."
        ),
    ] = False,
    side_by_side: Annotated[
        bool, typer.Option("--side-by-side", help="With --capture: one source delivers both images side by side.")
    ] = False,
    save_pairs: Annotated[
        Path | None, typer.Option("--save-pairs", help="With --capture: folder for the pairs that are kept.")
    ] = None,
    base: base_options.Base = None,
    clocks: base_options.Clocks = None,
    rig: base_options.RigToMount = None,
    landmark_map: options.OptionalMapFile = None,
    height: base_options.Height = None,
    jobs: options.Jobs = None,
    as_json: options.Json = False,
    force: options.Force = False,
) -> None:
    """Calibrate cameras from images of a board."""
    from lmkit.calibration.initialization import models_by_camera
    from lmkit.calibration.stereo import calibrate_stereo, calibration_lines
    from lmkit.cli.calibrate_pairs import both_sources, find_pairs, saved_corners, without_split, written_lines
    from lmkit.cli.known_lenses import parse_declared
    from lmkit.cli.parsing import parse_board
    from lmkit.io.board_corners import corners_to_json
    from lmkit.io.image_sources import are_moving
    from lmkit.io.rig import rig_to_yaml
    from lmkit.parallel import require_address_space
    from lmkit.reports.calibration import calibration_report, calibration_summary

    if not capture and (side_by_side or save_pairs is not None):
        raise InputError("only_capture", "--side-by-side and --save-pairs need --capture", "add --capture")
    require_address_space("calibration")
    sources, side_by_side = without_split(images or [], side_by_side)
    as_pairs = capture or side_by_side
    models_by_camera(model, 1 if len(sources) == 1 and not as_pairs else max(2, len(sources)))
    declared, (left, right) = parse_declared(baseline, fov, intrinsics, intrinsics_sigma), (*sources, None, None)[:2]
    check_outputs((output, report, save_corners), force)
    if base is not None or clocks is not None:
        for_board = {"images": images, "--board": board, "--report": report, "--check": check, "--corners": corners}
        require_no("--base" if clocks is None else "--clocks", {**for_board, "--capture": capture or None})
        base_options.by_driving(base, clocks, rig, landmark_map, height, family, output, as_json, force)
        return
    require_no("calibration without --base", {"--rig": rig, "--map": landmark_map, "--height": height})
    if check is not None:
        from lmkit.cli.calibrate_check import check_images

        for_calibration = {
            "-o": output, "--report": report, "--corners": corners, "--capture": capture or None,
            "--baseline": baseline, "--fov": fov, "--save-corners": save_corners, "--intrinsics": intrinsics or None,
        }  # fmt: skip
        require_no("--check", for_calibration)
        spec = None if board is None and measured is None else parse_board(board, measured)  # None: landmarks
        one, other = (sources[0], None) if side_by_side else both_sources(left, right)
        check_images(check, one, other, spec, family, as_json)
        return
    if corners is not None:
        found_elsewhere = {"images": images, "--board": board, "--measured": measured, "--capture": capture or None}
        require_no("--corners", found_elsewhere)
        found = saved_corners(corners)
    elif len(sources) not in (0, 2) and not as_pairs:
        from lmkit.cli.calibrate_cameras import calibrate_cameras

        for_pairs = {
            "--baseline": baseline, "--save-corners": save_corners, "--intrinsics": intrinsics or None,
        }  # fmt: skip
        require_no(f"images of {len(sources)} camera(s)", for_pairs)
        calibrate_cameras(sources, parse_board(board, measured), model, declared, output, report, as_json, force)
        return
    elif as_pairs or (left is not None and are_moving(left)):
        from lmkit.cli.calibrate_capture import capture_pairs

        found = capture_pairs(left, right, side_by_side, parse_board(board, measured), save_pairs, as_json)
    else:
        found = find_pairs(*both_sources(left, right), parse_board(board, measured))
    seen = found.corners
    written = write_outputs({save_corners: corners_to_json(seen)}, force)  # first: the calibration may fail
    with ProgressBars() as bars:
        fitting = bars.counter("fitting lenses and rig")
        result = calibrate_stereo(
            seen.views, seen.board, seen.image_size, model, seen.rejected, declared, fitting, seen.right_size
        )
    written += write_outputs({output: rig_to_yaml(result.rig)}, force)
    if report is not None:
        shown = found.some_images([view.name for view in result.used], REPORT_IMAGES)
        written += write_outputs({report: calibration_report(result, seen.board, shown)}, force)
    if as_json:
        print_json(result.to_dict())
        return
    print_line(f"result                 {calibration_summary(result)[1]}")
    for line in (*calibration_lines(result), *written_lines(written, output)):
        print_line(line)
