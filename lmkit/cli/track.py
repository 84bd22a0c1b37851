"""`lmkit track`: the robot through the map."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lmkit.cli.output import check_outputs, picture_kind, print_json, print_line, require_no, warn
from lmkit.errors import InputError, NegativeAnswer

if TYPE_CHECKING:
    pass


def run(
    left: Annotated[str | None, typer.Argument(help="Folder or glob of left pictures.")] = None,
    right: Annotated[str | None, typer.Argument(help="Right pictures, paired by sorted name.")] = None,
    landmark_map: Annotated[Path | None, typer.Option("--map", help="Map file.")] = None,
    rig: Annotated[Path | None, typer.Option("--rig", help="Rig file, for pictures.")] = None,
    readings: Annotated[Path | None, typer.Option("--readings", help="CSV of ranges and bearings.")] = None,
    detections: Annotated[
        Path | None, typer.Option("--detections", help="CSV of what was seen, not pictures.")
    ] = None,
    odometry: Annotated[
        Path | None, typer.Option("--odometry", help="CSV of the robot's wheels, or poses (.tum) of visual odometry.")
    ] = None,
    gyro: Annotated[Path | None, typer.Option("--gyro", help="CSV of its gyro.")] = None,
    wheel_track: Annotated[str | None, typer.Option("--wheel-track", help="Distance of the wheels.")] = None,
    live: Annotated[
        bool, typer.Option("--live", help="As while driving: every pose from what was known by then.")
    ] = False,
    hz: Annotated[float | None, typer.Option("--hz", help="Pairs a second, where names hold no times.")] = None,
    tum: Annotated[Path | None, typer.Option("--tum", help="Trajectory of sure poses to write (TUM).")] = None,
    csv: Annotated[Path | None, typer.Option("--csv", help="Poses with standard deviations to write (CSV).")] = None,
    plan: Annotated[Path | None, typer.Option("--plan", help="Plan of the drive (.png or .svg).")] = None,
    report: Annotated[Path | None, typer.Option("--report", help="Report to write (.html).")] = None,
    rerun: Annotated[
        Path | None, typer.Option("--rerun", help="Recording for the Rerun viewer to write (.rrd; extra viewer).")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object a line.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite files.")] = False,
) -> None:
    """Follow the robot through the map, by landmarks, wheels and gyro."""
    from lmkit.cli.recording_options import motion_of, read_any_odometry, read_moments, read_wheels
    from lmkit.io.any_rig import read_any_rig
    from lmkit.io.external_maps import read_any_map
    from lmkit.io.files import write_file
    from lmkit.io.readings import read_readings
    from lmkit.io.trajectory import poses_to_tum
    from lmkit.model.pose_status import PoseStatus
    from lmkit.model.tracked_trajectory import tracked_csv, tracked_dict
    from lmkit.model.trajectory import Trajectory
    from lmkit.reports.recording import draw_drive, track_report
    from lmkit.reports.rerun import require_rerun, track_recording
    from lmkit.tracking.batch import track_pictures, track_readings
    from lmkit.tracking.online import track_live, track_pictures_live, track_poses_live

    if landmark_map is None:
        raise InputError("no_map", "track needs a map", "give --map map.yaml")
    check_outputs((tum, csv, report, rerun), plan, force)
    if rerun is not None:
        require_rerun()
    landmarks = read_any_map(landmark_map)
    cameras, moments = None, []
    if readings is not None:
        require_no("--readings", {"LEFT": left, "--rig": rig, "--detections": detections, "--hz": hz})
        wheels = read_wheels(odometry, gyro, wheel_track)
        if wheels is None:
            raise InputError(
                "no_odometry", "readings are followed by odometry", "give --odometry, or use lmkit locate --readings"
            )
        seen = read_readings(readings, landmarks.families)
        work = track_live if live else track_readings
        drive = work(sorted(seen.items()), wheels[0], wheels[1], landmarks)
    else:
        if rig is None:
            raise InputError("no_rig", "pictures need a rig", "give --rig rig.yaml")
        if live and odometry is None:
            raise InputError("no_odometry", "--live needs odometry", "give --odometry, or use lmkit locate")
        cameras = read_any_rig(rig)
        own = read_any_odometry(odometry, gyro, wheel_track)
        families = ",".join(landmarks.families)
        moments = read_moments(left, right, detections, cameras, families, hz)
        if not live or own is None:
            drive = track_pictures(moments, cameras, landmarks, motion_of(own))
        elif isinstance(own, Trajectory):
            drive = track_poses_live(moments, cameras, landmarks, own)
        else:
            drive = track_pictures_live(moments, cameras, landmarks, *own)
    sure = [
        (t, p)
        for t, p, status in zip(drive.times_s, drive.poses, drive.statuses, strict=True)
        if status == PoseStatus.OK
    ]
    if not sure:
        raise NegativeAnswer(
            "not_tracked", "no moment has a sure pose", "check that landmarks of the map are in view"
        )
    for text in drive.remarks:
        warn(text)
    if tum is not None:
        write_file(tum, poses_to_tum(sure), force)
    if csv is not None:
        write_file(csv, tracked_csv(drive), force)
    if plan is not None:
        looking = [drive.looking(k) for k in range(len(drive.poses))]
        known = [status == PoseStatus.OK for status in drive.statuses]
        drawn = draw_drive(landmarks, drive.times_s, looking, drive.covariances, known, picture_kind(plan))
        write_file(plan, drawn, force)
    if report is not None:
        write_file(report, track_report(drive, landmarks), force)
    if rerun is not None:
        write_file(rerun, track_recording(drive, landmarks, cameras, moments), force)
    if as_json:
        for k in range(len(drive.times_s)):
            print_json(tracked_dict(drive, k))
        return
    counts = ", ".join(f"{n} {status}" for status, n in Counter(drive.statuses).items())
    wrong = ", ".join(f"{name} {value:.4g}" for name, value in drive.parameters.items())
    print_line(f"{len(drive.times_s)} moments: {counts}")
    if wrong:
        print_line(f"odometry: {wrong}")
