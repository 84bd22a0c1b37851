"""`lmkit demo`: all steps from print to pose, without hardware."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lmkit.cli import options
from lmkit.cli.output import ProgressBars, print_line
from lmkit.errors import InputError, NegativeAnswer

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
        bool, typer.Option("--navigate", help="Instead: plan where to mount landmarks, then navigate by them.")
    ] = False,
    live: Annotated[
        bool, typer.Option("--run", help="Instead: the live loop for 20 seconds, against the truth.")
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
    from lmkit.demos.calibrate_and_locate import run_demo
    from lmkit.io.files import check_writable

    if output.is_dir() and any(output.iterdir()) and not force:
        raise InputError("file_exists", f"folder {output} is not empty", "add --force, or choose another with -o")
    check_writable(output / "errors.csv", force)
    if drive + navigate + live > 1:
        raise InputError("not_together", "--drive, --navigate and --run cannot be combined", "give one of them")
    if images and not navigate:
        raise InputError("no_navigate", "--images needs --navigate", "add --navigate")
    if live:
        _live(output, seconds, seed)
        return
    if drive:
        _drive(output, seed, landmarks)
        return
    if navigate:
        _navigate(output, seed, images)
        return
    with ProgressBars() as bars:
        result = run_demo(output, seed, pairs, boards, landmarks, bars.update)
    _print(result, output)


def _drive(folder: Path, seed: int, landmarks: int) -> None:
    from lmkit.demos.survey_and_track import run_drive_demo

    e = run_drive_demo(folder, seed, landmarks)
    print_line("simulated corners, wheels and gyro; root mean square errors:")
    print_line(f"survey   {e.landmarks} landmarks{'':17s}{e.map_mm:8.1f} mm  {e.map_deg:5.2f} deg")
    print_line(f"track    stereo, after recording     {e.smooth_mm:8.1f} mm  {e.smooth_deg:5.2f} deg")
    if e.live_mm is None:
        print_line("track    ranges and bearings, live: not located, too few landmarks at once")
    else:
        print_line(f"track    ranges and bearings, live   {e.live_mm:8.1f} mm  {e.live_deg:5.2f} deg")
    print_line(f"wheels and gyro alone end {e.wheels_mm:.0f} mm off")
    print_line(f"see {folder / 'plan.png'}, {folder / 'map.yaml'}, {folder / 'trajectory.tum'}")


def _live(folder: Path, seconds: float, seed: int) -> None:
    from lmkit.demos.live_run import run_live_demo

    if not 2 <= seconds <= 3600:
        raise InputError("out_of_range", f"--seconds {seconds:g} is outside 2 to 3600", "give 2 to 3600")
    r = run_live_demo(folder, seconds, seed)
    if r is None:
        raise NegativeAnswer("not_located", "no pose was published", "give more seconds, or another --seed")
    print_line(
        "simulated robot, two cameras of 640x480, six landmarks, wheels and gyro; images rendered beside the loop:"
    )
    print_line(f"poses         {r.poses} in {r.steps} steps, {r.rate_hz:.1f} a second")
    print_line(f"latency       {r.latency_ms[0]:.0f} ms (50 %), {r.latency_ms[1]:.0f} ms (95 %)")
    print_line(f"processor     {r.cpu_ms:.1f} ms a step, rendering included")
    print_line(f"position      {r.error_mm[0]:.1f} mm (root mean square), {r.error_mm[1]:.1f} mm (largest)")
    print_line(f"heading       {r.error_deg:.2f} deg (root mean square)")
    print_line(
        f"NEES / 3      {r.nees:.2f}; 1 if stated and true errors agree, less if errors are smaller than stated"
    )
    print_line(f"see {folder / 'plan.png'}")


def _navigate(folder: Path, seed: int, from_images: bool) -> None:
    from lmkit.demos.navigate import run_navigate_demo

    with ProgressBars() as bars:
        answer = run_navigate_demo(folder, seed, from_images, bars.update)
    print_line(f"{answer.landmarks} landmarks placed; the requirement holds on {answer.share:.0%} of the floor")
    print_line(f"simulated robot, {'images' if from_images else 'corners'}, wheels and gyro:")
    for leg in answer.legs:
        end = f"{leg.off_mm:5.1f} mm and {leg.off_deg:4.2f} deg from the goal" if leg.status == "arrived" else leg.why
        print_line(f"{leg.name:18s} {leg.status:8s} {leg.way_m:5.1f} m, {leg.seconds:3.0f} s: {end}")
    print_line(f"the true position was inside the 95 % ellipse {answer.inside:.0%} of the time")
    print_line(
        f"simulated images at {answer.images} places on the route: located {answer.located}, "
        + ("" if answer.image_error_mm is None else f"median error {answer.image_error_mm:.1f} mm")
    )
    names = ("plan.png", "strip.jpg", "coverage.png", "landmarks.pdf", "map.yaml", "believed.tum")
    print_line(f"see {', '.join(str(folder / name) for name in names)}")


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
