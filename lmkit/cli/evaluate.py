"""`lmkit evaluate`: an estimated trajectory against the true one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lmkit.cli.output import print_json, print_line
from lmkit.errors import InputError

if TYPE_CHECKING:
    pass


def run(
    truth: Annotated[Path, typer.Argument(help="True trajectory (TUM: time x y z qx qy qz qw).")],
    estimate: Annotated[Path, typer.Argument(help="Estimated trajectory (TUM).")],
    align: Annotated[
        str,
        typer.Option("--align", help="none, rigid (turned and shifted onto the truth) or scale (stretched, too)."),
    ] = "none",
    delta: Annotated[int, typer.Option("--delta", help="Relative errors are of the motion over so many poses.")] = 1,
    max_apart: Annotated[
        float, typer.Option("--max-apart", help="Seconds by which times that belong together may differ.")
    ] = 0.01,
    as_json: Annotated[bool, typer.Option("--json", help="The result as one JSON object.")] = False,
) -> None:
    """Absolute and relative errors of a trajectory, as evo has them; heading and the source paper's percent."""
    from lmkit.evaluation.trajectory_error import ALIGNMENTS, compare_trajectories, error_dict
    from lmkit.io.trajectory import read_trajectory

    if align not in ALIGNMENTS:
        raise InputError("bad_align", f"--align {align} is unknown", f"choose {', '.join(ALIGNMENTS)}")
    if delta < 1 or not max_apart >= 0:
        raise InputError(
            "bad_option", "--delta must be 1 or more, --max-apart 0 or more", "see lmkit evaluate --help"
        )
    error = compare_trajectories(read_trajectory(truth), read_trajectory(estimate), align, delta, max_apart)
    if as_json:
        print_json(error_dict(error))
        return
    print_line(f"poses compared         {error.pairs}, {error.missing} of the truth's without an estimate")
    rows = (
        ("position, mm", error.position_m, 1000.0),
        ("rotation, deg", error.rotation_deg, 1.0),
        ("heading, deg", error.heading_deg, 1.0),
        ("relative position, mm", error.relative_position_m, 1000.0),
        ("relative rotation, deg", error.relative_rotation_deg, 1.0),
    )
    print_line(f"{'':<22} {'rmse':>9} {'mean':>9} {'median':>9} {'95 %':>9} {'largest':>9}")
    for name, spread, unit in rows:
        if spread is not None:
            figures = (spread.rmse, spread.mean, spread.median, spread.p95, spread.max)
            print_line(f"{name:<22} " + " ".join(f"{unit * v:9.3f}" for v in figures))
    if error.percent is not None:
        print_line(
            f"percentage error       {error.percent:.3f} % of the distance from the start (the source paper's)"
        )
    if align == "scale":
        print_line(f"scale                  {error.scale:.6f}")
