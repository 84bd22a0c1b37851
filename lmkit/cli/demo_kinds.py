"""`lmkit demo --drive`, `--navigate`, `--rig` and `--run`: run and print the errors."""

from __future__ import annotations

from pathlib import Path

from lmkit.cli.output import ProgressBars, print_line
from lmkit.errors import InputError, NegativeAnswer


def show_drive(folder: Path, seed: int, landmarks: int) -> None:
    """Survey the first half of a recording, track the second."""
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


def show_rig(folder: Path, seed: int, landmarks: int) -> None:
    """Place five cameras by driving, then locate and track with them."""
    from lmkit.demos.five_cameras import run_rig_demo

    print_line("simulated corners (0.15 px), wheels and gyro; five cameras without overlap, poses found by driving:")
    for line in run_rig_demo(folder, seed, landmarks).table:
        print_line(line)
    print_line(f"see {folder / 'plan.png'}, {folder / 'rig.yaml'}, {folder / 'trajectory.tum'}")


def show_live(folder: Path, seconds: float, seed: int) -> None:
    """Run the live loop."""
    from lmkit.demos.live_run import run_live_demo

    if not 2 <= seconds <= 180:
        raise InputError(
            "out_of_range", f"--seconds {seconds:g} is outside 2 to 180", "give 2 to 180; longer: lmkit run sim:"
        )
    print_line(f"rendering {seconds:g} seconds of images ...")
    r = run_live_demo(folder, seconds, seed)
    if r is None:
        raise NegativeAnswer("not_located", "no pose was published", "give more seconds, or another --seed")
    print_line(
        "simulated robot, two cameras of 640x480, six landmarks, wheels and gyro; images rendered before,"
        " lenses known to 0.06 px:"
    )
    print_line(f"steps         {r.steps}, {r.step_hz:.1f} a second")
    print_line(f"poses         {r.poses}, {r.rate_hz:.1f} a second from the first, {r.after_s:.1f} s after the start")
    print_line(f"latency       {r.latency_ms[0]:.0f} ms (50 %), {r.latency_ms[1]:.0f} ms (95 %)")
    print_line(f"processor     {r.cpu_ms:.1f} ms a step, decoding the images included")
    print_line(f"position      {r.error_mm[0]:.1f} mm (root mean square), {r.error_mm[1]:.1f} mm (largest)")
    print_line(f"heading       {r.error_deg:.2f} deg (root mean square)")
    print_line(
        f"NEES / 3      {r.nees:.2f}; 1 if stated and true errors agree, less if errors are smaller than stated"
    )
    print_line(f"see {folder / 'plan.png'}")


def show_navigate(folder: Path, seed: int, from_images: bool) -> None:
    """Plan where to mount landmarks, then navigate with them."""
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
