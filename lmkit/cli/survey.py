"""`lmkit survey`: where the landmarks hang, from a drive."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lmkit.cli.output import check_outputs, picture_kind, print_json, print_line, require_no, warn
from lmkit.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from lmkit.geometry.pose import Pose
    from lmkit.geometry.stereo_rig import StereoRig
    from lmkit.mapping.bundle_adjustment import Anchor, Bundle
    from lmkit.mapping.survey import Survey
    from lmkit.model.landmark_id import LandmarkId
    from lmkit.model.landmark_map import LandmarkMap
    from lmkit.model.recording import Gyro, Odometry, StereoFrame

_KNOWN_HINT = "give a length and an angle, such as 50mm,3deg"


def run(
    left: Annotated[str | None, typer.Argument(help="Folder or glob of left pictures.")] = None,
    right: Annotated[str | None, typer.Argument(help="Right pictures, paired by sorted name.")] = None,
    output: Annotated[Path, typer.Option("-o", "--output", help="Map file to write.")] = Path("map.yaml"),
    rig: Annotated[Path | None, typer.Option("--rig", help="Rig file.")] = None,
    detections: Annotated[
        Path | None, typer.Option("--detections", help="CSV of what was seen, not pictures.")
    ] = None,
    readings: Annotated[
        Path | None, typer.Option("--readings", help="CSV of ranges and bearings, not pictures: a map in the plane.")
    ] = None,
    size: Annotated[str, typer.Option("--size", help="Side of the landmarks, outer edge of the border.")] = "180mm",
    known: Annotated[
        Path | None, typer.Option("--known", help="Map of landmarks whose poses are known, such as one anchor.")
    ] = None,
    known_sigma: Annotated[
        str | None,
        typer.Option("--known-sigma", help="How well: 50mm,3deg as measured by hand. Default: as the file says."),
    ] = None,
    wall: Annotated[
        list[str] | None, typer.Option("--wall", help="Codes that hang on one flat wall, as 12,44,137; repeatable.")
    ] = None,
    same_height: Annotated[
        list[str] | None, typer.Option("--same-height", help="Codes that hang equally high, as 12,44; repeatable.")
    ] = None,
    wall_sigma: Annotated[
        str | None,
        typer.Option("--wall-sigma", help="How flat the walls are, and how alike the heights. Default: 5mm,1deg."),
    ] = None,
    odometry: Annotated[
        Path | None, typer.Option("--odometry", help="CSV of the robot's wheels, or poses (.tum) of visual odometry.")
    ] = None,
    gyro: Annotated[Path | None, typer.Option("--gyro", help="CSV of its gyro.")] = None,
    wheel_track: Annotated[str | None, typer.Option("--wheel-track", help="Distance of the wheels.")] = None,
    hz: Annotated[float | None, typer.Option("--hz", help="Pairs a second, where names hold no times.")] = None,
    family: Annotated[str, typer.Option("--family", help="Families to look for, as in lm8,lm4.")] = "lm8",
    tum: Annotated[Path | None, typer.Option("--tum", help="Trajectory of the drive to write (TUM).")] = None,
    plan: Annotated[Path | None, typer.Option("--plan", help="Plan of map and drive (.png or .svg).")] = None,
    report: Annotated[Path | None, typer.Option("--report", help="Report to write (.html).")] = None,
    rerun: Annotated[
        Path | None, typer.Option("--rerun", help="Recording for the Rerun viewer to write (.rrd; extra viewer).")
    ] = None,
    save_detections: Annotated[
        Path | None, typer.Option("--save-detections", help="CSV of what was seen, to survey again without pictures.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite files.")] = False,
) -> None:
    """Build the landmark map from a drive."""
    from lmkit.cli.parsing import parse_constraints
    from lmkit.cli.recording_options import motion_of, read_any_odometry, read_moments, read_wheels
    from lmkit.io.any_rig import read_any_rig
    from lmkit.io.external_maps import read_any_map
    from lmkit.io.files import write_file
    from lmkit.io.landmark_map import map_to_yaml
    from lmkit.io.recording_tables import detections_to_csv
    from lmkit.io.trajectory import poses_to_tum
    from lmkit.mapping.next_view import advise
    from lmkit.mapping.survey import landmark_sizes, survey_dict, survey_frames, survey_warnings
    from lmkit.reports.recording import draw_drive, survey_report
    from lmkit.reports.rerun import require_rerun, survey_recording
    from lmkit.units import parse_length_mm

    if readings is not None:
        for_pictures = {
            "LEFT": left, "--rig": rig, "--detections": detections, "--known": known, "--known-sigma": known_sigma,
            "--wall": wall or None, "--same-height": same_height or None, "--wall-sigma": wall_sigma,
            "--hz": hz, "--save-detections": save_detections, "--plan": plan, "--report": report, "--rerun": rerun,
        }  # fmt: skip
        require_no("--readings", for_pictures)
        _survey_readings(
            readings, read_wheels(odometry, gyro, wheel_track), size, family, output, tum, force, as_json
        )
        return
    if rig is None:
        raise InputError("no_rig", "survey needs a rig", "give --rig rig.yaml")
    check_outputs((output, tum, save_detections, report, rerun), plan, force)
    if known is None and known_sigma is not None:
        raise InputError("no_known", "--known-sigma needs --known beside it", "give --known MAP")
    ties = parse_constraints(wall or [], same_height or [], wall_sigma, family.split(","))
    if rerun is not None:
        require_rerun()
    size_m = parse_length_mm(size, "--size") / 1000
    cameras = read_any_rig(rig)
    anchors = {} if known is None else _anchors(read_any_map(known), known_sigma)
    motion = motion_of(read_any_odometry(odometry, gyro, wheel_track))
    moments = read_moments(left, right, detections, cameras, family, hz)
    if save_detections is not None:
        write_file(save_detections, detections_to_csv(moments), force)
    sizes = landmark_sizes(moments, size_m, anchors)
    result = survey_frames(moments, cameras, sizes, anchors, motion, ties)
    warnings = survey_warnings(result, motion, ties, advise(result, cameras))
    for text in warnings:
        warn(text)
    write_file(output, map_to_yaml(result.landmarks), force)
    if tum is not None:
        write_file(tum, poses_to_tum(_base_poses(result.bundle, cameras)), force)
    if plan is not None:
        bundle = result.bundle
        looking, sure = bundle.left_poses(), [True] * len(bundle.times_s)
        drawn = draw_drive(bundle.landmarks, bundle.times_s, looking, bundle.covariances, sure, picture_kind(plan))
        write_file(plan, drawn, force)
    if report is not None:
        write_file(report, survey_report(result, motion, warnings), force)
    if rerun is not None:
        write_file(rerun, survey_recording(result, cameras, moments), force)
    if as_json:
        print_json(survey_dict(result, moments, motion, output))
    else:
        _tell(result, moments, output)


def _survey_readings(
    readings: Path,
    wheels: tuple[Odometry, Gyro | None] | None,
    size: str,
    family: str,
    output: Path,
    tum: Path | None,
    force: bool,
    as_json: bool,
) -> None:
    from lmkit.io.files import write_file
    from lmkit.io.landmark_map import map_to_yaml
    from lmkit.io.readings import read_readings
    from lmkit.io.trajectory import poses_to_tum
    from lmkit.mapping.range_bearing_survey import survey_readings
    from lmkit.units import parse_length_mm

    if wheels is None:
        raise InputError("no_odometry", "readings are joined by odometry", "give --odometry FILE.csv")
    check_outputs((output, tum), None, force)
    moments = sorted(read_readings(readings, family.split(",")).items())
    landmarks, drive = survey_readings(moments, *wheels, parse_length_mm(size, "--size") / 1000)
    write_file(output, map_to_yaml(landmarks), force)
    if tum is not None:
        write_file(tum, poses_to_tum(zip(drive.times_s.tolist(), drive.poses, strict=True)), force)
    entries = []
    for m in landmarks:
        assert m.covariance is not None
        sigma_m = math.sqrt(m.covariance[0, 0] + m.covariance[1, 1])
        entries.append({"code": m.code, "position": m.T_map_landmark.t.tolist(), "sigma_m": sigma_m})
    if as_json:
        print_json({"map": str(output), "landmarks": entries, "moments": len(moments)})
        return
    for entry in entries:
        x, y, _ = entry["position"]
        print_line(f"{entry['code']:4d} {x:8.3f} {y:8.3f}   +- {1000 * entry['sigma_m']:.0f} mm")
    print_line(f"{len(entries)} landmarks in the plane, {len(moments)} moments -> {output}")


def _base_poses(bundle: Bundle, rig: StereoRig) -> Iterator[tuple[float, Pose]]:
    """Of the robot's base where the rig names one, else of the left camera."""
    for time_s, pose in zip(bundle.times_s.tolist(), bundle.left_poses(), strict=True):
        yield time_s, pose if rig.T_base_left is None else pose @ rig.T_base_left.inverse()


def _anchors(landmarks: LandmarkMap, sigma: str | None) -> dict[LandmarkId, Anchor]:
    from dataclasses import replace

    import numpy as np

    from lmkit.mapping.bundle_adjustment import Anchor
    from lmkit.units import parse_sigma

    covariance = None
    if sigma is not None:
        metres, radians = parse_sigma(sigma, "--known-sigma", _KNOWN_HINT)
        covariance = np.diag([metres**2] * 3 + [radians**2] * 3)
    return {
        m.id: Anchor(replace(m, covariance=None), m.covariance if covariance is None else covariance)
        for m in landmarks
    }


def _tell(result: Survey, moments: list[StereoFrame], output: Path) -> None:
    import numpy as np

    from lmkit.mapping.survey import deviations

    bundle = result.bundle
    print_line("landmark   x m      y m      z m      +- mm   +- deg  sightings  misfit")
    for m in sorted(bundle.landmarks, key=lambda m: m.id):
        mine = bundle.of == bundle.ids.index(m.id)
        place, turn = deviations(m)
        x, y, z = m.T_map_landmark.t
        misfit = float(np.median(bundle.misfits[mine])) if mine.any() else math.nan
        print_line(
            f"{m.id!s:8} {x:8.3f} {y:8.3f} {z:8.3f} {1000 * place:9.1f} {math.degrees(turn):8.2f} {mine.sum():8d}"
            f" {misfit:9.2f}"
        )
    print_line(
        f"{len(bundle.landmarks)} landmarks, {len(result.rows)} of {len(moments)} moments, "
        f"{result.dropped} sightings left out, {bundle.rms_px:.2f} px -> {output}"
    )
