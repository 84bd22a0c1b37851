"""`lmkit calibrate`: a stereo camera from pictures of a board."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lmkit.cli.common import BOARD_HELP, print_json, print_line, progress
from lmkit.errors import InputError

if TYPE_CHECKING:
    from lmkit.calibrate.stereo import StereoCalibration

REPORT_PICTURES = 6


def run(
    left: Annotated[str, typer.Argument(help="Folder or glob of left pictures.")],
    right: Annotated[str, typer.Argument(help="Folder or glob of right pictures, paired by sorted name.")],
    board: Annotated[str, typer.Option("--board", help=BOARD_HELP)],
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Rig file to write (YAML).")] = None,
    report: Annotated[Path | None, typer.Option("--report", help="HTML report to write.")] = None,
    model: Annotated[
        str, typer.Option("--model", help="pinhole, rational, fisheye; auto: which does best on unseen pairs.")
    ] = "auto",
    as_json: Annotated[bool, typer.Option("--json", help="The result as one JSON object.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite files.")] = False,
) -> None:
    """Calibrate a stereo camera from pairs of pictures of a board."""
    from lmkit.board_pairs import find_board_pairs
    from lmkit.calibrate.stereo import MODELS, calibrate_stereo
    from lmkit.formats.files import check_writable, write_file
    from lmkit.formats.rig import rig_to_yaml
    from lmkit.formats.sources import list_pictures
    from lmkit.model.board import BoardSpec

    spec = BoardSpec.parse(board)
    if model not in MODELS:
        raise InputError("bad_model", f"--model {model} is unknown", f"choose {', '.join(MODELS)}")
    for path in (output, report):
        if path is not None:
            check_writable(path, force)
    left_files, right_files = list_pictures(left), list_pictures(right)
    ticks = progress(iter(lambda: 0, 1), len(left_files), "finding the board")

    def on_pair(done: int, total: int) -> None:
        next(ticks, None)

    pairs = find_board_pairs(left_files, right_files, spec, on_pair)
    result = calibrate_stereo(pairs.views, pairs.board, pairs.image_size, model, pairs.rejected)
    if output is not None:
        write_file(output, rig_to_yaml(result.rig), force)
    if report is not None:
        from lmkit.calibrate.report import calibration_report
        from lmkit.formats.images import read_image

        step = max(1, len(result.used) // REPORT_PICTURES)
        names = [view.name for view in result.used[::step][:REPORT_PICTURES]]
        pictures = {n: (read_image(pairs.files[n][0]), read_image(pairs.files[n][1])) for n in names}
        write_file(report, calibration_report(result, str(spec), pictures), force)
    if as_json:
        print_json(calibration_dict(result))
    else:
        _print(result, output, report)


def calibration_dict(result: StereoCalibration) -> dict[str, Any]:
    """The result as docs/formats.md has it."""
    return {
        "rms_px": result.rms_px,
        "rms_left_px": result.rms_left_px,
        "rms_right_px": result.rms_right_px,
        "held_out_epipolar_px": result.held_out_epipolar_px,
        "baseline_m": result.rig.baseline_m,
        "baseline_sigma_m": result.baseline_sigma_m,
        "pairs_used": [view.name for view in result.used],
        "pairs_rejected": [{"pair": name, "reason": reason} for name, reason in result.rejected],
        "warnings": [{"code": w.code, "message": w.message, "pairs": list(w.pairs)} for w in result.warnings],
        "model": result.rig.left.model,
    }


def _print(result: StereoCalibration, output: Path | None, report: Path | None) -> None:
    held = result.held_out_epipolar_px
    print_line(f"pairs used             {len(result.used)}, rejected {len(result.rejected)}")
    print_line(f"held-out row error     {'unknown' if held is None else f'{held:.3f} px'}")
    print_line(
        f"reprojection error     {result.rms_px:.3f} px "
        f"(left {result.rms_left_px:.3f}, right {result.rms_right_px:.3f})"
    )
    print_line(f"baseline               {result.rig.baseline_m * 1e3:.3f} ± {result.baseline_sigma_m * 1e3:.3f} mm")
    for name, reason in result.rejected:
        print_line(f"rejected               {name}: {reason}")
    for warning in result.warnings:
        names = f" ({', '.join(warning.pairs)})" if warning.pairs else ""
        print_line(f"warning                {warning.message}{names}")
    for path in (output, report):
        if path is not None:
            print_line(f"wrote                  {path}")
