"""`lmkit locate`: the pose of the camera, or of the robot, in the map."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lmkit.cli import map_options, options, scan_options
from lmkit.cli.map_options import read_map_file
from lmkit.cli.output import check_outputs, print_json, print_line, progress, require_no, warn, write_outputs
from lmkit.errors import InputError, NegativeAnswer
from lmkit.units import counted


def run(
    images: Annotated[
        list[str] | None,
        typer.Argument(help="Images of each camera: file, folder, glob, video, split:VIDEO or camera:0."),
    ] = None,
    rig: options.OptionalRigFile = None,
    landmark_map: options.OptionalMapFile = None,
    marker_family: map_options.MarkerFamily = None,
    marker_size: map_options.MarkerSize = None,
    mono: Annotated[
        str | None, typer.Option("--mono", help="Image, folder, glob or video of the first (left) camera alone.")
    ] = None,
    readings: options.ReadingsFile = None,
    range_sigma: Annotated[
        str | None, typer.Option("--range-sigma", help="Standard deviation of ranges: a length, or a percentage.")
    ] = None,
    bearing_sigma: Annotated[
        float | None, typer.Option("--bearing-sigma", help="Standard deviation of bearings, degrees.")
    ] = None,
    time_offset: Annotated[
        float, typer.Option("--time-offset", help="Seconds by which the clock of the readings is ahead.")
    ] = 0.0,
    scans: scan_options.ScansFile = None,
    scan_topic: scan_options.ScanTopic = None,
    scanner: scan_options.Scanner = None,
    near: scan_options.Near = None,
    bright: scan_options.Bright = None,
    frame: Annotated[
        str | None,
        typer.Option(
            "--frame", help="Frame to locate: camera (the first) or base. Default: base if the rig has one."
        ),
    ] = None,
    heading: Annotated[
        str | None,
        typer.Option("--heading", help="Prior on the viewing direction, such as 90+-3; degrees from x toward y."),
    ] = None,
    planar: Annotated[
        str | None,
        typer.Option("--planar", help="Prior of a level floor: camera height and downward tilt, such as 0.42m,10."),
    ] = None,
    hz: options.Hz = None,
    tum: options.TumOutput = None,
    csv: options.CsvOutput = None,
    plan: options.PlanOutput = None,
    annotate: Annotated[
        Path | None,
        typer.Option("--annotate", help="Folder for annotated images, or an annotated video, of the first camera."),
    ] = None,
    jobs: options.Jobs = None,
    as_json: options.Json = False,
    force: options.Force = False,
) -> None:
    """Locate the camera, or the robot, in the map."""
    from lmkit.cli.locate_sources import require_frame, require_sources, source_groups, warn_of_clocks
    from lmkit.cli.parsing import parse_prior, require_rate
    from lmkit.io.any_rig import read_any_rig
    from lmkit.io.image_sources import frame_count
    from lmkit.localization.absolute_pose import LocateOptions
    from lmkit.pipelines.locate_images import locate_in_sources, located_dict, located_line, with_times
    from lmkit.pipelines.locate_results import LocateResults

    for_readings: dict[str, object] = {"--bearing-sigma": bearing_sigma, "--time-offset": time_offset or None}
    for_scans: dict[str, object] = {
        "--scan-topic": scan_topic,
        "--scanner": scanner,
        "--near": near,
        "--bright": bright,
    }
    for_images = {
        "images": images or None, "--rig": rig, "--mono": mono, "--frame": frame, "--heading": heading,
        "--planar": planar, "--hz": hz, "--tum": tum, "--csv": csv, "--plan": plan, "--annotate": annotate,
    }  # fmt: skip
    if readings is not None or scans is not None:
        name = "--scans" if readings is None else "--readings"
        require_no(name, for_images)
        require_no(name, for_readings if readings is None else for_scans | {"--scans": scans})
        if landmark_map is None:
            raise InputError("no_map", f"{name} needs a map", "add --map MAP")
        from lmkit.cli.locate_readings import locate_readings, locate_scans

        landmarks = read_map_file(landmark_map, marker_family, marker_size)
        if readings is not None:
            locate_readings(readings, landmarks, as_json, range_sigma, bearing_sigma, time_offset)
        elif scans is not None:
            settings = scan_options.scan_settings(scanner, near, bright, range_sigma)
            locate_scans(scans, scan_topic, landmarks, settings, as_json)
        return
    require_no("images", for_readings | {"--range-sigma": range_sigma})
    require_no("images", for_scans)
    require_sources(images or [], mono)
    if rig is None or landmark_map is None:
        raise InputError("no_rig_or_map", "locate needs a rig and a map", "give --rig rig.yaml --map map.yaml")
    if frame not in (None, "camera", "base"):
        raise InputError("bad_frame", f"--frame {frame} is unknown", "choose camera or base")
    choices = LocateOptions(prior=parse_prior(heading, planar))
    require_rate(hz)
    check_outputs((tum, csv, plan), force)
    cameras, landmarks = read_any_rig(rig), read_map_file(landmark_map, marker_family, marker_size)
    frame = frame or ("camera" if cameras.T_base_left is None else "base")
    require_frame(frame, cameras, rig)
    groups = source_groups(images or [], mono, cameras)
    warn_of_clocks(groups, cameras)
    failed = []
    answers = (answer for sources in groups for answer in locate_in_sources(sources, cameras, landmarks, choices))
    located = with_times(answers, hz)
    with LocateResults(cameras, landmarks, frame, annotate, force) as results:
        for frame_result in progress(located, frame_count([sources[0] for sources in groups]), "locating"):
            results.add(frame_result)
            if frame_result.error is not None:
                failed.append(frame_result.error)
            if as_json:
                print_json(located_dict(frame_result, cameras, frame))
            elif frame_result.error is None:
                print_line(located_line(frame_result, cameras, frame))
            elif len(results.answers) > 1:
                warn(str(frame_result.error))
    if tum is not None and not results.timed:
        warn("the images have no times: the trajectory has frame numbers in place of seconds; give --hz")
    if results.contradicted_prior is not None:
        warn(results.contradicted_prior)
    if len(failed) < len(results.answers):
        for path in write_outputs(results.files(tum, csv, plan), force):
            warn(f"wrote {path}")
    if failed:
        more = f" (and {len(failed) - 1} more)" if len(failed) > 1 else ""
        raise InputError(failed[0].code, failed[0].message + more, failed[0].hint)
    if results.located and results.contradicted_map is not None:
        warn(results.contradicted_map)
    if results.located == 0:
        raise NegativeAnswer("not_located", f"no pose from {counted(len(results.answers), 'frame')}", results.advice)
