"""`lmkit track`: the robot's trajectory through a known map."""

from __future__ import annotations

from typing import Annotated

import typer

from lmkit.cli import map_options, options, scan_options
from lmkit.cli.map_options import read_map_file
from lmkit.cli.output import check_outputs, image_kind, print_json, print_line, require_no, warn_all, write_outputs
from lmkit.errors import InputError, NegativeAnswer


def run(
    images: options.Images = None,
    landmark_map: options.OptionalMapFile = None,
    marker_family: map_options.MarkerFamily = None,
    marker_size: map_options.MarkerSize = None,
    rig: options.OptionalRigFile = None,
    readings: options.ReadingsFile = None,
    detections: options.DetectionsFile = None,
    odometry: options.OdometryFile = None,
    gyro: options.GyroFile = None,
    wheel_track: options.WheelTrack = None,
    live: Annotated[
        bool, typer.Option("--live", help="Causal filtering: each pose uses only data up to its time.")
    ] = False,
    hz: options.Hz = None,
    scans: scan_options.ScansFile = None,
    scan_topic: scan_options.ScanTopic = None,
    scanner: scan_options.Scanner = None,
    near: scan_options.Near = None,
    bright: scan_options.Bright = None,
    range_sigma: scan_options.ScanSigma = None,
    tum: options.TumOutput = None,
    csv: options.CsvOutput = None,
    plan: options.PlanOutput = None,
    report: options.ReportOutput = None,
    rerun: options.RerunOutput = None,
    jobs: options.Jobs = None,
    as_json: options.Json = False,
    force: options.Force = False,
) -> None:
    """Track the robot through a known map. Odometry and gyro are used if given."""
    from lmkit.api.recordings import track
    from lmkit.cli.recording_options import RecordingOptions
    from lmkit.geometry.rig_plausibility import rig_warnings
    from lmkit.io.any_rig import read_any_rig
    from lmkit.io.trajectory import poses_to_tum
    from lmkit.model.tracked_trajectory import tracked_csv, tracked_lines
    from lmkit.reports.recording import draw_tracked, track_report
    from lmkit.reports.rerun import require_rerun, track_recording

    if landmark_map is None:
        raise InputError("no_map", "track needs a map", "give --map map.yaml")
    for_scans = {
        "--scan-topic": scan_topic, "--scanner": scanner, "--near": near, "--bright": bright,
        "--range-sigma": range_sigma,
    }  # fmt: skip
    cameras = None
    source = RecordingOptions(images or [], detections, readings, odometry, gyro, wheel_track, hz)
    if scans is not None:
        others = {"images": images or None, "--detections": detections, "--readings": readings}
        require_no("--scans", {**others, "--rig": rig, "--hz": hz})
    else:
        require_no("recordings without --scans", for_scans)
        if readings is not None:
            require_no("--readings", {"--rig": rig})
        elif rig is None:
            raise InputError("no_rig", "images and detections need a rig", "give --rig rig.yaml")
        else:
            cameras = read_any_rig(rig)
            source = source.in_folder(cameras)
        source.check()
    if live and source.odometry is None:
        raise InputError("no_odometry", "--live needs odometry", "add --odometry FILE, or use lmkit locate")
    check_outputs((tum, csv, report, rerun, plan), force)
    if rerun is not None:
        require_rerun()
    landmarks = read_map_file(landmark_map, marker_family, marker_size)
    recording = None if scans is not None else source.read(cameras, landmarks.families)
    if recording is not None:
        drive = track(recording, cameras, landmarks, live=live)
    elif scans is not None:
        settings = scan_options.scan_settings(scanner, near, bright, range_sigma)
        drive = scan_options.track_scan_file(
            scans, scan_topic, settings, landmarks, odometry, gyro, wheel_track, live
        )
    if not drive.sure:
        why = "check that landmarks of the map are in view"
        raise NegativeAnswer(
            "not_tracked", "no frame was located reliably", drive.remarks[0] if drive.remarks else why
        )
    warn_all(drive.remarks, () if cameras is None else rig_warnings(cameras, "the rig"))
    write_outputs({tum: poses_to_tum(drive.sure), csv: tracked_csv(drive)}, force)
    if plan is not None:
        write_outputs({plan: draw_tracked(drive, landmarks, image_kind(plan))}, force)
    if report is not None:
        write_outputs({report: track_report(drive, landmarks)}, force)
    if rerun is not None:
        frames = () if recording is None else recording.frames
        write_outputs({rerun: track_recording(drive, landmarks, cameras, frames)}, force)
    if as_json:
        for k in range(len(drive)):
            print_json(drive.to_dict(k))
        return
    for line in tracked_lines(drive):
        print_line(line)
