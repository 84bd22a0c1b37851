"""`lmkit evaluate`: an estimated trajectory against the true one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lmkit.cli import options
from lmkit.cli.output import check_outputs, print_json, print_line, write_outputs
from lmkit.errors import InputError


def run(
    truth: Annotated[Path, typer.Argument(help="True trajectory: TUM, EuRoC or TUM-VI CSV, or KITTI poses.")],
    estimate: Annotated[Path, typer.Argument(help="Estimated trajectory, in one of the same formats.")],
    align: Annotated[
        str,
        typer.Option(
            "--align", help="Alignment to the truth: none, rigid (rotation and shift) or scale (rigid with scale)."
        ),
    ] = "none",
    delta: Annotated[
        int, typer.Option("--delta", help="Relative errors are taken between poses this many apart.")
    ] = 1,
    max_apart: Annotated[
        float, typer.Option("--max-apart", help="Largest time difference of matching poses, seconds.")
    ] = 0.01,
    time_offset: Annotated[
        float, typer.Option("--time-offset", help="Seconds to add to the times of the estimate.")
    ] = 0.0,
    report: options.ReportOutput = None,
    as_json: options.Json = False,
    force: options.Force = False,
) -> None:
    """Compute the errors of a trajectory, as evo does. Absolute, relative and heading errors."""
    from lmkit.evaluation.trajectory_error import compare_trajectories, error_lines
    from lmkit.io.trajectory import read_two_trajectories

    if not abs(time_offset) < 1e12:
        raise InputError("bad_option", f"--time-offset {time_offset:g} is out of range", "give seconds")
    check_outputs((report,), force)
    true, found = read_two_trajectories(truth, estimate)
    error = compare_trajectories(true, found.shifted(time_offset), align, delta, max_apart)
    if report is not None:
        from lmkit.reports.trajectory_error import evaluation_report

        write_outputs({report: evaluation_report(error, (truth.name, estimate.name))}, force)
    if as_json:
        print_json(error.to_dict())
        return
    for line in error_lines(error):
        print_line(line)
    if align == "scale":
        print_line(f"scale                  {error.scale:.6f}")
