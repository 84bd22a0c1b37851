"""`lmkit survey`: where the landmarks hang, from a drive."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lmkit.cli.common import check_outputs, picture_kind, print_json, print_line, require_no, warn
from lmkit.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from lmkit.model.drive import Gyro, Odometry, StereoMoment
    from lmkit.model.landmark_map import LandmarkMap
    from lmkit.model.pose import Pose
    from lmkit.model.stereo_rig import StereoRig
    from lmkit.motion import Motion
    from lmkit.survey.bundle import Anchor, Bundle
    from lmkit.survey.survey import Survey
    from lmkit.survey.ties import Tie

WALL_SIGMA = "5mm,1deg"
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
        Path | None, typer.Option("--rerun", help="Recording for the Rerun viewer to write (.rrd; lmkit[viewer]).")
    ] = None,
    save_detections: Annotated[
        Path | None, typer.Option("--save-detections", help="CSV of what was seen, to survey again without pictures.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite files.")] = False,
) -> None:
    """Build the landmark map from a drive."""
    from lmkit.cli.drive_options import motion_of, read_any_odometry, read_moments, read_wheels
    from lmkit.drive_recording import require_rerun, survey_recording
    from lmkit.drive_report import draw_drive, survey_report
    from lmkit.formats.any_rig import read_any_rig
    from lmkit.formats.drive_tables import detections_to_csv
    from lmkit.formats.files import write_file
    from lmkit.formats.foreign_maps import read_any_map
    from lmkit.formats.landmark_map import map_to_yaml
    from lmkit.formats.trajectory import poses_to_tum
    from lmkit.plan.next_view import advise
    from lmkit.survey.survey import survey_drive
    from lmkit.units import parse_length_mm

    if readings is not None:
        for_pictures = {
            "LEFT": left, "--rig": rig, "--detections": detections, "--known": known, "--known-sigma": known_sigma,
            "--wall": wall or None, "--same-height": same_height or None, "--wall-sigma": wall_sigma,
            "--hz": hz, "--save-detections": save_detections, "--plan": plan, "--report": report, "--rerun": rerun,
        }  # fmt: skip
        require_no("--readings", for_pictures)
        _survey_readings(readings, read_wheels(odometry, gyro, wheel_track), size, output, tum, force, as_json)
        return
    if rig is None:
        raise InputError("no_rig", "survey needs a rig", "give --rig rig.yaml")
    check_outputs((output, tum, save_detections, report, rerun), plan, force)
    if known is None and known_sigma is not None:
        raise InputError("no_known", "--known-sigma needs --known beside it", "give --known MAP")
    ties = _ties(wall or [], same_height or [], wall_sigma)
    if rerun is not None:
        require_rerun()
    size_m = parse_length_mm(size, "--size") / 1000
    cameras = read_any_rig(rig)
    anchors = {} if known is None else _anchors(read_any_map(known), known_sigma)
    motion = motion_of(read_any_odometry(odometry, gyro, wheel_track))
    moments = read_moments(left, right, detections, cameras, family, hz)
    if save_detections is not None:
        write_file(save_detections, detections_to_csv(moments), force)
    sizes = _sizes(moments, size_m, anchors)
    result = survey_drive(moments, cameras, sizes, anchors, motion, ties)
    warnings = _warnings(result, motion, ties, advise(result, cameras))
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
        print_json(_summary(result, moments, motion, output))
    else:
        _tell(result, moments, output)


def _survey_readings(
    readings: Path,
    wheels: tuple[Odometry, Gyro | None] | None,
    size: str,
    output: Path,
    tum: Path | None,
    force: bool,
    as_json: bool,
) -> None:
    from lmkit.formats.files import write_file
    from lmkit.formats.landmark_map import map_to_yaml
    from lmkit.formats.readings import read_readings
    from lmkit.formats.trajectory import poses_to_tum
    from lmkit.track.drive import survey_readings
    from lmkit.units import parse_length_mm

    if wheels is None:
        raise InputError("no_odometry", "readings are joined by odometry", "give --odometry FILE.csv")
    check_outputs((output, tum), None, force)
    moments = sorted(read_readings(readings).items())
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


def _anchors(landmarks: LandmarkMap, sigma: str | None) -> dict[tuple[str, int], Anchor]:
    from dataclasses import replace

    import numpy as np

    from lmkit.survey.bundle import Anchor

    covariance = None
    if sigma is not None:
        metres, radians = _spread(sigma, "--known-sigma", _KNOWN_HINT)
        covariance = np.diag([metres**2] * 3 + [radians**2] * 3)
    return {
        (m.family, m.code): Anchor(replace(m, covariance=None), m.covariance if covariance is None else covariance)
        for m in landmarks
    }


def _spread(text: str, name: str, hint: str) -> tuple[float, float]:
    """Metres and rad of a length and an angle."""
    from lmkit.units import parse_length_mm

    length, _, angle = text.partition(",")
    try:
        degrees = float(angle.strip().removesuffix("deg"))
    except ValueError:
        raise InputError("bad_sigma", f"{name} {text} has no angle", hint) from None
    metres = parse_length_mm(length.strip(), name) / 1000
    if not (metres > 0 and 0 < degrees < 180):
        raise InputError("bad_sigma", f"{name} {text} is not positive", hint)
    return metres, math.radians(degrees)


def _ties(walls: list[str], heights: list[str], sigma: str | None) -> list[Tie]:
    from lmkit.survey.ties import Tie

    if sigma is not None and not walls and not heights:
        raise InputError("no_wall", "--wall-sigma needs --wall or --same-height beside it", "give --wall 12,44,137")
    spread = _spread(sigma or WALL_SIGMA, "--wall-sigma", f"give a length and an angle, such as {WALL_SIGMA}")
    ties = []
    for kind, name, texts in (("wall", "--wall", walls), ("height", "--same-height", heights)):
        for text in texts:
            words = [word.strip() for word in text.split(",")]
            codes = tuple(dict.fromkeys(int(word) for word in words if word.isdigit()))
            if len(codes) < 2 or len(codes) < len(words):
                raise InputError(
                    "bad_codes", f"{name} {text} does not list two codes or more", f"write {name} 12,44,137"
                )
            ties.append(Tie(kind, codes, *spread))
    return ties


def _sizes(
    moments: list[StereoMoment], size_m: float, anchors: dict[tuple[str, int], Anchor]
) -> dict[tuple[str, int], float]:
    sizes = {(o.family, o.code): size_m for moment in moments for o in (*moment.left, *moment.right)}
    sizes.update({key: anchor.landmark.size_m for key, anchor in anchors.items()})
    return sizes


def _warnings(result: Survey, motion: Motion | None, ties: list[Tie], advice: dict[int, str]) -> list[str]:
    from lmkit.motion import describe_odometry

    texts = [str(odd) for odd in result.odd]
    doubt = None if motion is None else describe_odometry(motion, result.bundle.parameters)
    if doubt is not None:
        texts.append(doubt)
    for from_s, to_s, metres in result.bundle.jumps:
        texts.append(
            f"between {from_s:.2f} and {to_s:.2f} s the rig leaps by {metres:.2f} m: it slid or was carried, or a "
            "landmark seen there was moved, or is placed by the wrong one of its two poses; look from another side"
        )
    for code in result.ambiguous:
        texts.append(
            f"{code} may as well hang turned: it was seen from one side and from afar; look from another side"
        )
    for code, tie, metres in result.astray:
        texts.append(
            f"{code} is {1000 * metres:.0f} mm off the {tie} that it is declared to share; check it in the room"
        )
    mapped = {m.code for m in result.bundle.landmarks}
    for tie in ties:
        missing = [str(code) for code in tie.codes if code not in mapped]
        if missing:
            texts.append(f"of the {tie} that was declared, {', '.join(missing)} did not come into the map")
    for code in result.unplaced:
        texts.append(
            f"{code} is not placed: its sightings are too few, or do not agree; drive past it again, and nearer"
        )
    for code, place, turn in result.weak:
        known = f"{code} is known to {1000 * place:.0f} mm and {math.degrees(turn):.1f} deg only"
        texts.append(f"{known}: {advice[code]}" if code in advice else known)
    return texts


def _tell(result: Survey, moments: list[StereoMoment], output: Path) -> None:
    from lmkit.survey.survey import deviations

    bundle = result.bundle
    print_line("code   x m      y m      z m      +- mm   +- deg  sightings  misfit")
    for m in sorted(bundle.landmarks, key=lambda m: m.code):
        mine = bundle.codes == m.code
        place, turn = deviations(m)
        x, y, z = m.T_map_landmark.t
        misfit = float(sorted(bundle.misfits[mine])[int(mine.sum()) // 2]) if mine.any() else math.nan
        print_line(
            f"{m.code:4d} {x:8.3f} {y:8.3f} {z:8.3f} {1000 * place:9.1f} {math.degrees(turn):8.2f} {mine.sum():8d}"
            f" {misfit:9.2f}"
        )
    print_line(
        f"{len(bundle.landmarks)} landmarks, {len(result.rows)} of {len(moments)} moments, "
        f"{result.dropped} sightings left out, {bundle.rms_px:.2f} px -> {output}"
    )


def _summary(result: Survey, moments: list[StereoMoment], motion: Motion | None, output: Path) -> dict[str, Any]:
    from lmkit.survey.survey import deviations

    bundle = result.bundle
    entries = []
    for m in bundle.landmarks:
        place, turn = deviations(m)
        entries.append(
            {
                "code": m.code,
                "position": m.T_map_landmark.t.tolist(),
                "quaternion": m.T_map_landmark.quaternion_xyzw.tolist(),
                "sigma_m": place,
                "sigma_rad": turn,
                "sightings": int((bundle.codes == m.code).sum()),
            }
        )
    return {
        "map": str(output),
        "landmarks": entries,
        "moments": len(moments),
        "located": len(result.rows),
        "dropped": result.dropped,
        "reprojection_error_px": bundle.rms_px if math.isfinite(bundle.rms_px) else None,
        "odd": [
            {"code": o.code, "off": o.off, "of": o.sightings, "from_s": o.from_s, "to_s": o.to_s} for o in result.odd
        ],
        "jumps": [{"from_s": a, "to_s": b, "metres": m} for a, b, m in result.bundle.jumps],
        "weak": [code for code, _, _ in result.weak],
        "unplaced": list(result.unplaced),
        "ambiguous": list(result.ambiguous),
        "astray": [{"code": code, "of": str(tie), "metres": metres} for code, tie, metres in result.astray],
        "odometry": {} if motion is None else dict(zip(motion.names, bundle.parameters.tolist(), strict=True)),
    }
