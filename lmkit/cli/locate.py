"""`lmkit locate`: where the camera stands."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lmkit.cli.common import print_json, print_line, progress, warn
from lmkit.errors import InputError, NegativeAnswer

if TYPE_CHECKING:
    from lmkit.model.estimate import PoseEstimate
    from lmkit.model.stereo_rig import StereoRig

_TIME = re.compile(r"(\d{9,}\.\d+|\d+\.\d+)$")


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
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object a line.")] = False,
) -> None:
    """Find the pose of the camera (or the robot) from landmarks of a map."""
    from lmkit.detect.landmarks import detect_landmarks
    from lmkit.detect.options import DetectOptions
    from lmkit.formats.any_rig import read_any_rig
    from lmkit.formats.images import read_image
    from lmkit.formats.landmark_map import read_map
    from lmkit.formats.sources import list_pictures
    from lmkit.locate.rig import locate_camera, locate_rig
    from lmkit.model.landmark import family_named

    if readings is not None:
        if landmark_map is None or any(given is not None for given in (left, right, rig, mono, frame)):
            raise InputError(
                "readings_alone", "--readings goes with --map alone", "give --readings FILE.csv --map MAP"
            )
        from lmkit.cli.locate_readings import locate_readings

        locate_readings(readings, read_map(landmark_map), as_json, range_sigma, bearing_sigma, time_offset)
        return
    if rig is None or landmark_map is None:
        raise InputError("no_rig_or_map", "locate needs a rig and a map", "give --rig rig.yaml --map map.yaml")
    if (mono is None) == (left is None or right is None):
        raise InputError("no_pictures", "locate needs LEFT and RIGHT, or --mono", "see lmkit locate --help")
    if frame not in (None, "camera", "base"):
        raise InputError("bad_frame", f"--frame {frame} is unknown", "choose camera or base")
    cameras, landmarks = read_any_rig(rig), read_map(landmark_map)
    families = tuple(dict.fromkeys(family_named(landmark.family) for landmark in landmarks))
    if frame is None:
        frame = "camera" if cameras.T_base_left is None else "base"
    if frame == "base" and cameras.T_base_left is None:
        raise InputError("no_base", f"{rig} has no T_base_left", "add it to the rig file, or use --frame camera")

    lefts = list_pictures(mono if mono is not None else str(left))
    rights: list[Path | None] = [None] * len(lefts)
    if mono is None:
        rights = list(list_pictures(str(right)))
    if len(lefts) != len(rights):
        raise InputError("unpaired", f"{len(lefts)} left and {len(rights)} right pictures", "give as many of both")

    located, failed = 0, []
    for left_file, right_file in progress(zip(lefts, rights, strict=True), len(lefts), "locating"):
        try:
            pictures = [read_image(p) for p in (left_file, right_file) if p is not None]
            for path, image, camera in zip(
                (left_file, right_file), pictures, (cameras.left, cameras.right), strict=False
            ):
                if (image.shape[1], image.shape[0]) != camera.image_size:
                    raise InputError(
                        "sizes_differ",
                        f"{path} is {image.shape[1]} x {image.shape[0]} pixels, the rig's camera "
                        f"{camera.image_size[0]} x {camera.image_size[1]}",
                        "give pictures as they were calibrated",
                    )
        except InputError as error:
            failed.append(error)
            if as_json:
                print_json({"left": str(left_file), "right": _name(right_file), "error": error.as_dict()})
            elif len(lefts) > 1:
                warn(str(error))
            continue
        eyes = (cameras.left, cameras.right)
        seen = [
            detect_landmarks(image, DetectOptions(families, camera=eye))
            for image, eye in zip(pictures, eyes, strict=False)
        ]
        if mono is None:
            estimate = locate_rig(seen[0], seen[1], cameras, landmarks)
        else:
            estimate = locate_camera(seen[0], cameras.left, landmarks)
        located += estimate.T_map_camera is not None
        if as_json:
            print_json(estimate_dict(estimate, cameras, left_file, right_file, frame))
        else:
            print_line(f"{left_file.name}: {_sentence(estimate, cameras, frame)}")
    if failed:
        more = f" (and {len(failed) - 1} more)" if len(failed) > 1 else ""
        raise InputError(failed[0].code, failed[0].message + more, failed[0].hint)
    if located == 0:
        raise NegativeAnswer(
            "not_located",
            f"no pose from {len(lefts)} pictures",
            "check that landmarks of the map are in view",
        )


def estimate_dict(
    estimate: PoseEstimate, rig: StereoRig, left: Path, right: Path | None, frame: str
) -> dict[str, Any]:
    """One answer as docs/formats.md has it."""
    from lmkit.locate.rig import covariance_at_base
    from lmkit.model.pose import Pose

    def at(pose: Pose) -> Pose:
        if frame == "camera" or rig.T_base_left is None:
            return pose
        T_left_base = rig.T_base_left.inverse()
        return pose @ Pose("camera", "base", T_left_base.R, T_left_base.t)

    time = _TIME.search(left.stem)
    result: dict[str, Any] = {
        "left": str(left),
        "right": _name(right),
        "time_s": float(time[1]) if time else None,
        "status": estimate.status,
        "position": None,
        "quaternion": None,
        "covariance": None,
        "codes": list(estimate.inlier_codes),
        "outlier_codes": list(estimate.outlier_codes),
        "alternatives": [
            {
                "position": at(pose).t.tolist(),
                "quaternion": at(pose).quaternion_xyzw.tolist(),
                "log_likelihood_ratio": ratio,
            }
            for pose, ratio in estimate.alternatives
        ],
        "reprojection_error_px": estimate.reprojection_error_px,
    }
    if estimate.T_map_camera is not None:
        pose = at(estimate.T_map_camera)
        covariance = estimate.covariance
        if frame == "base" and rig.T_base_left is not None:
            T_left_base = rig.T_base_left.inverse()
            covariance = covariance_at_base(estimate, Pose("camera", "base", T_left_base.R, T_left_base.t))
        result["position"] = pose.t.tolist()
        result["quaternion"] = pose.quaternion_xyzw.tolist()
        result["covariance"] = None if covariance is None else covariance.tolist()
    return result


def _sentence(estimate: PoseEstimate, rig: StereoRig, frame: str) -> str:
    answer = estimate_dict(estimate, rig, Path("-"), None, frame)
    if answer["position"] is None:
        outliers = f", codes {', '.join(map(str, estimate.outlier_codes))}" if estimate.outlier_codes else ""
        return f"{estimate.status}{outliers}"
    x, y, z = answer["position"]
    sigma = [answer["covariance"][k][k] ** 0.5 * 1000 for k in range(3)]
    codes = ", ".join(map(str, estimate.inlier_codes))
    off = f", not explained: {', '.join(map(str, estimate.outlier_codes))}" if estimate.outlier_codes else ""
    return (
        f"{estimate.status}, x {x:.3f} y {y:.3f} z {z:.3f} m "
        f"(± {sigma[0]:.1f} {sigma[1]:.1f} {sigma[2]:.1f} mm), codes {codes}{off}"
    )


def _name(path: Path | None) -> str | None:
    return None if path is None else str(path)
