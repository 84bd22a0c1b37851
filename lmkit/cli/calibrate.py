"""`lmkit calibrate`: a stereo camera from pictures of a board; whether it still holds; what to photograph next."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lmkit.cli.output import BOARD_HELP, print_json, print_line, progress_counter, require_no
from lmkit.errors import InputError

if TYPE_CHECKING:
    from lmkit.calibration.sanity_checks import Declared
    from lmkit.calibration.stereo import StereoCalibration
    from lmkit.model.board import BoardSpec
    from lmkit.pipelines.capture_board import Found

REPORT_PICTURES = 6
_CAPTURE_ONLY = "--side-by-side and --save-pairs go with --capture"


def run(
    left: Annotated[
        str | None, typer.Argument(help="Folder or glob of left pictures; --capture: also a video or camera:0.")
    ] = None,
    right: Annotated[
        str | None, typer.Argument(help="The same of the right eye; pictures are paired by sorted name.")
    ] = None,
    board: Annotated[str | None, typer.Option("--board", help=BOARD_HELP)] = None,
    measured: Annotated[
        str | None,
        typer.Option("--measured", help="What the print measures, outer edge to outer edge, such as 249.1x174.4mm."),
    ] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Rig file to write (YAML).")] = None,
    report: Annotated[Path | None, typer.Option("--report", help="HTML report to write.")] = None,
    model: Annotated[
        str, typer.Option("--model", help="pinhole, rational, fisheye; auto: which does best on unseen pairs.")
    ] = "auto",
    baseline: Annotated[
        str | None, typer.Option("--baseline", help="Distance of the eyes as built, such as 120mm, to check against.")
    ] = None,
    fov: Annotated[
        float | None, typer.Option("--fov", help="Horizontal field of view as declared, degrees, to check against.")
    ] = None,
    save_corners: Annotated[
        Path | None, typer.Option("--save-corners", help="File for the corners found, to repeat without pictures.")
    ] = None,
    corners: Annotated[
        Path | None, typer.Option("--corners", help="Corners saved before, instead of LEFT, RIGHT and --board.")
    ] = None,
    check: Annotated[
        Path | None,
        typer.Option(
            "--check", help="Is this rig file still true for LEFT and RIGHT? Without --board: by landmarks."
        ),
    ] = None,
    capture: Annotated[
        bool, typer.Option("--capture", help="Say which view to show next; keep pairs that are sharp, new and still.")
    ] = False,
    side_by_side: Annotated[
        bool, typer.Option("--side-by-side", help="--capture: every picture of LEFT shows both eyes.")
    ] = False,
    save_pairs: Annotated[
        Path | None, typer.Option("--save-pairs", help="--capture: folder for the pairs kept.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="The result as one JSON object.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite files.")] = False,
) -> None:
    """Calibrate a stereo camera from pairs of pictures of a board."""
    from lmkit.calibration.stereo import MODELS
    from lmkit.io.files import check_writable

    if model not in MODELS:
        raise InputError("bad_model", f"--model {model} is unknown", f"choose {', '.join(MODELS)}")
    if not capture and (side_by_side or save_pairs is not None):
        raise InputError("only_capture", _CAPTURE_ONLY, "add --capture")
    declared = _declared(baseline, fov)
    for path in (output, report, save_corners):
        if path is not None:
            check_writable(path, force)
    if check is not None:
        require_no(
            "--check",
            {"-o": output, "--report": report, "--corners": corners, "--capture": capture or None,
             "--baseline": baseline, "--fov": fov, "--save-corners": save_corners},
        )  # fmt: skip
        from lmkit.cli.calibrate_check import check_pictures

        # Without a board it is landmarks that are looked for; a measure alone belongs to nothing.
        spec = None if board is None and measured is None else _spec(board, measured)
        check_pictures(check, *_both(left, right), spec, as_json)
        return
    if corners is not None:
        require_no(
            "--corners", {"LEFT": left, "--board": board, "--measured": measured, "--capture": capture or None}
        )
        from lmkit.io.board_corners import read_corners
        from lmkit.pipelines.capture_board import Found

        found = Found(read_corners(corners), {})
    elif capture:
        from lmkit.cli.calibrate_capture import capture_pairs

        found = capture_pairs(left, right, side_by_side, _spec(board, measured), save_pairs, as_json)
    else:
        found = _look(*_both(left, right), _spec(board, measured))
    _calibrate(found, model, declared, output, report, save_corners, as_json, force)


def _spec(board: str | None, measured: str | None) -> BoardSpec:
    from lmkit.model.board import BoardSpec
    from lmkit.units import parse_size_mm

    if board is None:
        raise InputError("no_board", "which board do the pictures show?", f"give --board {BOARD_HELP}")
    spec = BoardSpec.parse(board)
    return spec if measured is None else spec.measured(*parse_size_mm(measured, "--measured"))


def _declared(baseline: str | None, fov: float | None) -> Declared:
    from lmkit.calibration.sanity_checks import Declared
    from lmkit.units import parse_length_mm

    if fov is not None and not 0 < fov < 360:
        raise InputError("bad_fov", f"--fov {fov:g} is no angle of view", "give degrees across, such as 69")
    return Declared(None if baseline is None else parse_length_mm(baseline, "--baseline") / 1000, fov)


def _both(left: str | None, right: str | None) -> tuple[str, str]:
    if left is None or right is None:
        raise InputError("no_pictures", "calibrate needs LEFT and RIGHT pictures", "see lmkit calibrate --help")
    return left, right


def _look(left: str, right: str, spec: BoardSpec) -> Found:
    """Find the board in pairs of files."""
    from lmkit.io.board_corners import SavedCorners
    from lmkit.io.image_sources import list_pairs
    from lmkit.pipelines.board_views import find_board_pairs
    from lmkit.pipelines.capture_board import Found

    files = list_pairs(left, right)
    pairs = find_board_pairs(files, spec, progress_counter(len(files), "finding the board"))
    return Found(SavedCorners(pairs.board, pairs.image_size, pairs.views, pairs.rejected), pairs.files)


def _calibrate(
    found: Found,
    model: str,
    declared: Declared,
    output: Path | None,
    report: Path | None,
    save_corners: Path | None,
    as_json: bool,
    force: bool,
) -> None:
    from lmkit.calibration.stereo import calibrate_stereo, calibration_dict
    from lmkit.io.board_corners import corners_to_json
    from lmkit.io.files import write_file
    from lmkit.io.rig import rig_to_yaml

    seen = found.corners
    if save_corners is not None:
        write_file(save_corners, corners_to_json(seen), force)
    result = calibrate_stereo(seen.views, seen.board, seen.image_size, model, seen.rejected, declared)
    if output is not None:
        write_file(output, rig_to_yaml(result.rig), force)
    if report is not None:
        from lmkit.reports.calibration import calibration_report

        names = [view.name for view in result.used if view.name in found.pictures]
        step = max(1, len(names) // REPORT_PICTURES)
        pictures = {name: found.picture(name) for name in names[::step][:REPORT_PICTURES]}
        write_file(report, calibration_report(result, seen.board, pictures), force)
    if as_json:
        print_json(calibration_dict(result))
    else:
        _print(result, [path for path in (output, report, save_corners) if path is not None])


def _print(result: StereoCalibration, written: list[Path]) -> None:
    held = result.held_out_epipolar_px
    print_line(f"pairs used             {len(result.used)}, rejected {len(result.rejected)}")
    print_line(f"held-out row error     {'unknown' if held is None else f'{held:.3f} px'}")
    print_line(
        f"reprojection error     {result.rms_px:.3f} px "
        f"(left {result.rms_left_px:.3f}, right {result.rms_right_px:.3f})"
    )
    print_line(f"camera model           {result.rig.left.model}")
    print_line(f"baseline               {result.rig.baseline_m * 1e3:.3f} ± {result.baseline_sigma_m * 1e3:.3f} mm")
    depths = ", ".join(f"{e.total_m * 1e3:.1f} mm at {e.depth_m:g} m" for e in result.depth_errors)
    print_line(f"depth to expect        ± {depths}")
    for name, reason in result.rejected:
        print_line(f"rejected               {name}: {reason}")
    for warning in result.warnings:
        names = f" ({', '.join(warning.pairs)})" if warning.pairs else ""
        print_line(f"warning                {warning.message}{names}")
    for view in result.coverage.advice:
        print_line(f"take next              {view}")
    for path in written:
        print_line(f"wrote                  {path}")
