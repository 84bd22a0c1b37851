"""`lmkit demo`: all steps from print to pose, without hardware."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lmkit.cli import options
from lmkit.cli.output import ProgressBars, print_line
from lmkit.errors import InputError

if TYPE_CHECKING:
    from lmkit.demos.calibrate_and_locate import DemoResult


def run(
    output: options.OutputFolder = Path("lmkit-demo"),
    seed: options.Seed = 7,
    pairs: Annotated[int, typer.Option("--pairs", help="Number of stereo pairs to locate.")] = 8,
    boards: Annotated[int, typer.Option("--boards", help="Number of stereo pairs of the calibration board.")] = 12,
    landmarks: Annotated[int, typer.Option("--landmarks", help="Number of landmarks on the walls.")] = 14,
    drive: Annotated[
        bool, typer.Option("--drive", help="Instead: survey the first half of a recording, track the second.")
    ] = False,
    navigate: Annotated[
        bool, typer.Option("--navigate", help="Instead: plan where to mount landmarks, then navigate with them.")
    ] = False,
    rig: Annotated[
        bool, typer.Option("--rig", help="Instead: find the poses of five cameras by driving, then track the robot.")
    ] = False,
    live: Annotated[
        bool, typer.Option("--run", help="Instead: run live for 20 seconds and compare the poses with the truth.")
    ] = False,
    seconds: Annotated[float, typer.Option("--seconds", help="With --run: duration, seconds.")] = 20.0,
    images: Annotated[
        bool,
        typer.Option(
            "--images",
            "--pictures",
            help="With --navigate: detect in rendered images, not simulated corners (minutes).",
        ),
    ] = False,
    jobs: options.Jobs = None,
    force: options.Force = False,
) -> None:
    """Run all steps in a simulated room. Print, photograph, calibrate, locate, compare with the truth."""
    for name, value, low in (("--pairs", pairs, 1), ("--boards", boards, 5), ("--landmarks", landmarks, 1)):
        if not low <= value <= 64:
            raise InputError("out_of_range", f"{name} {value} is outside {low} to 64", f"give {low} to 64")
    if seed < 0:
        raise InputError("out_of_range", f"--seed {seed} is negative", "give 0 or more")
    from lmkit.cli.demo_kinds import show_drive, show_live, show_navigate, show_rig
    from lmkit.demos.calibrate_and_locate import run_demo
    from lmkit.io.files import check_writable

    if output.is_dir() and any(output.iterdir()) and not force:
        raise InputError("file_exists", f"folder {output} is not empty", "add --force, or choose another with -o")
    check_writable(output / "errors.csv", force)
    if drive + navigate + rig + live > 1:
        raise InputError(
            "not_together", "--drive, --navigate, --rig and --run cannot be combined", "give one of them"
        )
    if images and not navigate:
        raise InputError("no_navigate", "--images needs --navigate", "add --navigate")
    if live:
        show_live(output, seconds, seed)
        return
    if rig:
        show_rig(output, seed, landmarks)
        return
    if drive:
        show_drive(output, seed, landmarks)
        return
    if navigate:
        show_navigate(output, seed, images)
        return
    with ProgressBars() as bars:
        result = run_demo(output, seed, pairs, boards, landmarks, bars.update)
    _print(result, output)


def _print(result: DemoResult, folder: Path) -> None:
    calibration = result.calibration
    held = calibration.held_out_epipolar_px
    print_line(
        f"calibrated from {len(calibration.used)} pairs: held-out row error "
        f"{'unknown' if held is None else f'{held:.3f} px'}, baseline off by {result.baseline_error_mm:+.3f} mm"
    )
    print_line("")
    print_line("pair  status         landmarks  position mm  heading deg  rotation deg")
    for s in result.stations:
        numbers = ["-" if v is None else f"{v:.3f}" for v in (s.position_mm, s.heading_deg, s.rotation_deg)]
        print_line(
            f"{s.pair}  {s.status:13s}  {len(s.ids):9d}  {numbers[0]:>11s}  {numbers[1]:>11s}  {numbers[2]:>12s}"
        )
    found = sorted(s.position_mm for s in result.stations if s.position_mm is not None)
    if found:
        print_line("")
        print_line(
            f"located {len(found)} of {len(result.stations)} (simulated images): "
            f"median position error {found[len(found) // 2]:.2f} mm, largest {found[-1]:.2f} mm"
        )
    print_line(
        f"see {folder / 'plan.png'}, {folder / 'overlays'}, {folder / 'calibration.html'}, {folder / 'prints'}"
    )
