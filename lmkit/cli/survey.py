"""`lmkit survey`: the landmark map from a recording."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lmkit.cli import map_options, options
from lmkit.cli.map_options import read_mounted_map
from lmkit.cli.output import check_outputs, image_kind, print_json, print_line, require_no, warn_all, write_outputs
from lmkit.errors import InputError
from lmkit.units import parse_length_mm, parse_sigma

if TYPE_CHECKING:
    from lmkit.cli.recording_options import RecordingOptions


def run(
    images: options.Images = None,
    output: Annotated[Path, typer.Option("-o", "--output", help="Map file to write.")] = Path("map.yaml"),
    rig: options.OptionalRigFile = None,
    detections: options.DetectionsFile = None,
    readings: options.ReadingsFile = None,
    size: options.Size = "180mm",
    known: map_options.KnownMap = None,
    known_sigma: map_options.KnownSigma = None,
    keep_doubtful: map_options.KeepDoubtful = False,
    wall: Annotated[
        list[str] | None,
        typer.Option("--wall", metavar="CODES", help="Codes on one flat wall, such as 12,44,137; repeatable."),
    ] = None,
    same_height: Annotated[
        list[str] | None,
        typer.Option("--same-height", metavar="CODES", help="Codes at the same height, such as 12,44; repeatable."),
    ] = None,
    wall_sigma: Annotated[
        str | None,
        typer.Option("--wall-sigma", help="Standard deviation from the wall or height. Default: 5mm,1deg."),
    ] = None,
    odometry: options.OdometryFile = None,
    gyro: options.GyroFile = None,
    wheel_track: options.WheelTrack = None,
    hz: options.Hz = None,
    family: options.Family = "lm8",
    tum: options.TumOutput = None,
    plan: options.PlanOutput = None,
    report: options.ReportOutput = None,
    rerun: options.RerunOutput = None,
    save_detections: Annotated[
        Path | None, typer.Option("--save-detections", help="CSV file of detections to write, for --detections.")
    ] = None,
    jobs: options.Jobs = None,
    as_json: options.Json = False,
    force: options.Force = False,
) -> None:
    """Build the landmark map from a recording."""
    from lmkit.cli.recording_options import RecordingOptions

    source = RecordingOptions(images or [], detections, readings, odometry, gyro, wheel_track, hz)
    if readings is not None:
        for_images = {
            "--rig": rig, "--known": known, "--known-sigma": known_sigma, "--wall": wall or None,
            "--same-height": same_height or None, "--wall-sigma": wall_sigma, "--plan": plan, "--report": report,
            "--rerun": rerun, "--save-detections": save_detections, "--keep-doubtful": keep_doubtful or None,
        }  # fmt: skip
        require_no("--readings", for_images)
        source.check()
        _survey_readings(source, size, family, output, tum, force, as_json)
        return
    from lmkit.api.recordings import motion_of, survey
    from lmkit.cli.parsing import parse_constraints
    from lmkit.cli.survey_recordings import are_recordings, survey_readings, survey_several
    from lmkit.geometry.rig import mounted_cameras
    from lmkit.geometry.rig_plausibility import rig_warnings
    from lmkit.io.any_rig import read_any_rig
    from lmkit.io.landmark_map import map_to_yaml
    from lmkit.io.recording_tables import detections_to_csv
    from lmkit.io.trajectory import poses_to_tum
    from lmkit.mapping.survey_results import base_poses, survey_lines
    from lmkit.reports.recording import draw_survey, survey_report
    from lmkit.reports.rerun import require_rerun, survey_recording

    if rig is None:
        survey_readings(source.images, size, family.split(","), {"map": output, "tum": tum}, force, as_json)
        return
    size_m, cameras = parse_length_mm(size, "--size") / 1000, read_any_rig(rig)
    source = source.in_folder(cameras)
    source.check()
    check_outputs((output, tum, save_detections, report, rerun, plan), force)
    if known is None and known_sigma is not None:
        raise InputError("no_known", "--known-sigma needs known landmarks", "add --known MAP")
    families = family.split(",")
    constraints = parse_constraints(wall or [], same_height or [], wall_sigma, families)
    hint = "give a length and an angle, such as 50mm,3deg"
    sigma = None if known_sigma is None else parse_sigma(known_sigma, "--known-sigma", hint)
    if rerun is not None:
        require_rerun()
    anchors = None if known is None else read_mounted_map(known)
    if are_recordings(source.images, cameras):
        refused = {
            "--odometry": odometry, "--gyro": gyro, "--wheel-track": wheel_track, "--plan": plan, "--report": report,
            "--rerun": rerun, "--save-detections": save_detections,
        }  # fmt: skip
        require_no("several recordings", refused)
        outputs = {"map": output, "tum": tum}
        survey_several(
            source.images, cameras, size_m, anchors, sigma, constraints, keep_doubtful, families, hz, outputs,
            force, as_json,
        )  # fmt: skip
        return
    recording = source.read(cameras, families)
    names = [camera.name for camera in mounted_cameras(cameras)]
    # Written first: detection takes longest, and the survey itself may fail.
    write_outputs({save_detections: detections_to_csv(recording.frames, names)}, force)
    result = survey(
        recording, cameras, size=size_m, known=anchors, known_sigma=sigma, constraints=constraints,
        keep_doubtful=keep_doubtful,
    )  # fmt: skip
    warn_all(result.warnings, rig_warnings(cameras, "the rig"))
    poses = base_poses(result.bundle, cameras)
    write_outputs({output: map_to_yaml(result.landmarks), tum: poses_to_tum(poses)}, force)
    if plan is not None:
        write_outputs({plan: draw_survey(result, image_kind(plan))}, force)
    if report is not None:
        write_outputs({report: survey_report(result, motion_of(recording), result.warnings)}, force)
    if rerun is not None:
        write_outputs({rerun: survey_recording(result, cameras, recording.frames)}, force)
    if as_json:
        print_json({"map": str(output), **result.to_dict()})
        return
    for line in survey_lines(result, len(recording.frames), output):
        print_line(line)


def _survey_readings(
    source: RecordingOptions, size: str, family: str, output: Path, tum: Path | None, force: bool, as_json: bool
) -> None:
    from lmkit.io.landmark_map import map_to_yaml
    from lmkit.io.trajectory import poses_to_tum
    from lmkit.mapping.range_bearing_survey import planar_map_dict, planar_map_lines, survey_readings
    from lmkit.model.recording import Odometry
    from lmkit.pipelines.recording_checks import require_plausible_recording

    check_outputs((output, tum), force)
    size_m = parse_length_mm(size, "--size") / 1000
    recording = source.read(None, family.split(","))
    odometry, count = recording.odometry, len(recording.readings)
    assert isinstance(odometry, Odometry)
    require_plausible_recording(recording)
    landmarks, drive = survey_readings(recording.readings, odometry, recording.gyro, size_m)
    poses = zip(drive.times_s.tolist(), drive.poses, strict=True)
    write_outputs({output: map_to_yaml(landmarks), tum: poses_to_tum(poses)}, force)
    if as_json:
        print_json(planar_map_dict(landmarks, count, output))
        return
    for line in planar_map_lines(landmarks, count, output):
        print_line(line)
