"""`lmkit locate`: where the camera stands."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lmkit.cli.output import print_json, print_line, progress, require_no, warn
from lmkit.errors import InputError, NegativeAnswer

if TYPE_CHECKING:
    from lmkit.geometry.stereo_rig import StereoRig
    from lmkit.localization.pose_prior import PosePrior
    from lmkit.model.estimate import PoseEstimate


def run(
    left: Annotated[str | None, typer.Argument(help="Left picture, folder or glob.")] = None,
    right: Annotated[str | None, typer.Argument(help="Right picture, folder or glob, paired by sorted name.")] = None,
    rig: Annotated[Path | None, typer.Option("--rig", help="Rig file.")] = None,
    landmark_map: Annotated[Path | None, typer.Option("--map", help="Map file.")] = None,
    mono: Annotated[str | None, typer.Option("--mono", help="Pictures of the left camera alone.")] = None,
    readings: Annotated[
        Path | None, typer.Option("--readings", help="CSV of ranges and bearings instead of pictures.")
    ] = None,
    range_sigma: Annotated[
        str | None,
        typer.Option("--range-sigma", help="Scatter of the readings' ranges: 0.1m, or 3% of the range."),
    ] = None,
    bearing_sigma: Annotated[
        float | None, typer.Option("--bearing-sigma", help="Scatter of the readings' bearings, degrees.")
    ] = None,
    time_offset: Annotated[
        float, typer.Option("--time-offset", help="Seconds that the readings' clock is ahead.")
    ] = 0.0,
    frame: Annotated[
        str | None, typer.Option("--frame", help="camera (left) or base; base where the rig names one.")
    ] = None,
    heading: Annotated[
        str | None,
        typer.Option("--heading", help="Where the camera looks, as a gyro has it: 90+-3, degrees from x to y."),
    ] = None,
    planar: Annotated[
        str | None,
        typer.Option("--planar", help="A robot on a level floor: its camera's height, and tilt downwards: 0.42m,10."),
    ] = None,
    tum: Annotated[Path | None, typer.Option("--tum", help="Trajectory to write (TUM).")] = None,
    csv: Annotated[Path | None, typer.Option("--csv", help="Poses with standard deviations to write (CSV).")] = None,
    plan: Annotated[
        Path | None, typer.Option("--plan", help="Plan with poses and ellipses to write (.png or .svg).")
    ] = None,
    annotate: Annotated[
        Path | None, typer.Option("--annotate", help="Folder for pictures with axes and the map drawn in.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object a line.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite files.")] = False,
) -> None:
    """Find the pose of the camera (or the robot) from landmarks of a map."""
    from lmkit.cli.locate_results import Results
    from lmkit.io.any_rig import read_any_rig
    from lmkit.io.external_maps import read_any_map
    from lmkit.localization.absolute_pose import LocateOptions
    from lmkit.model.pose_status import PoseStatus
    from lmkit.pipelines.locate_images import estimate_dict, locate_in_sources

    for_readings = {
        "--range-sigma": range_sigma, "--bearing-sigma": bearing_sigma, "--time-offset": time_offset or None,
    }  # fmt: skip
    for_pictures = {
        "LEFT": left, "--rig": rig, "--mono": mono, "--frame": frame, "--heading": heading, "--planar": planar,
        "--tum": tum, "--csv": csv, "--plan": plan, "--annotate": annotate,
    }  # fmt: skip
    if readings is not None:
        require_no("--readings", for_pictures)
        if landmark_map is None:
            raise InputError("no_map", "--readings needs a map", "give --readings FILE.csv --map MAP")
        from lmkit.cli.locate_readings import locate_readings

        locate_readings(readings, read_any_map(landmark_map), as_json, range_sigma, bearing_sigma, time_offset)
        return
    require_no("pictures", for_readings)
    if rig is None or landmark_map is None:
        raise InputError("no_rig_or_map", "locate needs a rig and a map", "give --rig rig.yaml --map map.yaml")
    if (mono is None) == (left is None or right is None):
        raise InputError("no_pictures", "locate needs LEFT and RIGHT, or --mono", "see lmkit locate --help")
    if frame not in (None, "camera", "base"):
        raise InputError("bad_frame", f"--frame {frame} is unknown", "choose camera or base")
    cameras, landmarks = read_any_rig(rig), read_any_map(landmark_map)
    if frame is None:
        frame = "camera" if cameras.T_base_left is None else "base"
    if frame == "base" and cameras.T_base_left is None:
        raise InputError("no_base", f"{rig} has no T_base_left", "add it to the rig file, or use --frame camera")
    results = Results(tum, csv, plan, annotate, frame, cameras, landmarks, force)
    options = LocateOptions(prior=_prior(heading, planar))
    located, exchanged, failed, total = 0, 0, [], 0
    moments = locate_in_sources(mono or str(left), None if mono else right, cameras, landmarks, options)
    for moment in progress(moments, None, "locating"):
        total += 1
        if moment.estimate is None:
            assert moment.error is not None
            failed.append(moment.error)
            if as_json:
                print_json({"left": moment.left, "right": moment.right, "error": moment.error.as_dict()})
            elif total > 1:
                warn(str(moment.error))
            continue
        located += moment.estimate.T_map_camera is not None
        exchanged += moment.estimate.status == PoseStatus.SWAPPED
        results.add(total - 1, moment)
        if as_json:
            print_json(estimate_dict(moment.estimate, cameras, moment.left, moment.right, frame))
        else:
            print_line(f"{Path(moment.left).name}: {_sentence(moment.estimate, cameras, frame)}")
    for path in results.write():
        warn(f"wrote {path}")
    if failed:
        more = f" (and {len(failed) - 1} more)" if len(failed) > 1 else ""
        raise InputError(failed[0].code, failed[0].message + more, failed[0].hint)
    if located == 0:
        raise NegativeAnswer(
            "not_located",
            f"no pose from {total} pictures",
            "exchange LEFT and RIGHT" if exchanged else "check that landmarks of the map are in view",
        )


def _prior(heading: str | None, planar: str | None) -> PosePrior | None:
    """What --heading and --planar say."""
    from lmkit.localization.pose_prior import PosePrior
    from lmkit.units import parse_length_mm

    if heading is None and planar is None:
        return None
    prior = PosePrior()
    if heading is not None:
        match = re.fullmatch(r"\s*(-?\d+(?:\.\d+)?)\s*(?:(?:\+-|±)\s*(\d+(?:\.\d+)?))?\s*", heading)
        if match is None or (match[2] and float(match[2]) <= 0):
            raise InputError(
                "bad_heading", f"--heading {heading!r} is no heading", "write degrees, such as 90 or 90+-3"
            )
        sigma = prior.heading_sigma if match[2] is None else math.radians(float(match[2]))
        prior = replace(prior, heading_rad=math.radians(float(match[1])), heading_sigma=sigma)
    if planar is not None:
        height, _, tilt = planar.partition(",")
        try:
            down = math.radians(float(tilt or 0))
            if not abs(down) < math.pi / 2:
                raise ValueError
        except ValueError:
            raise InputError(
                "bad_planar", f"--planar {planar!r}: {tilt!r} is no tilt", "write such as 0.42m,10"
            ) from None
        prior = replace(
            prior,
            height_m=parse_length_mm(height, "height of --planar") / 1000,
            down=(0.0, math.cos(down), math.sin(down)),
        )
    return prior


def _sentence(estimate: PoseEstimate, rig: StereoRig, frame: str) -> str:
    from lmkit.model.landmark_id import ids_text
    from lmkit.pipelines.locate_images import estimate_dict

    answer = estimate_dict(estimate, rig, "-", None, frame)
    if answer["position"] is None:
        outliers = f", codes {ids_text(estimate.outliers)}" if estimate.outliers else ""
        return f"{estimate.status}{outliers}"
    x, y, z = answer["position"]
    sigma = [answer["covariance"][k][k] ** 0.5 * 1000 for k in range(3)]
    codes = ids_text(estimate.inliers)
    off = f", not explained: {ids_text(estimate.outliers)}" if estimate.outliers else ""
    return (
        f"{estimate.status}, x {x:.3f} y {y:.3f} z {z:.3f} m "
        f"(± {sigma[0]:.1f} {sigma[1]:.1f} {sigma[2]:.1f} mm), codes {codes}{off}"
    )
