"""`lmkit calibrate --base` and `--clocks`: places of cameras on the robot, and offsets of their clocks."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lmkit.cli.calibrate_pairs import written_lines
from lmkit.cli.map_options import read_mounted_map
from lmkit.cli.output import print_json, print_line, require_no, write_outputs
from lmkit.errors import InputError

if TYPE_CHECKING:
    from lmkit.geometry.rig import AnyRig
    from lmkit.model.landmark_map import LandmarkMap

Base = Annotated[
    Path | None,
    typer.Option("--base", help="Recording folder with odometry: computes the poses of the cameras on the robot."),
]
Clocks = Annotated[
    Path | None,
    typer.Option("--clocks", help="Recording folder with odometry: computes the time offsets of the cameras."),
]
RigToMount = Annotated[Path | None, typer.Option("--rig", help="With --base or --clocks: rig file of the cameras.")]
Height = Annotated[
    str | None,
    typer.Option(
        "--height", help="With --base: height of the first camera above the origin of the base, such as 0.42m."
    ),
]


def by_driving(
    base: Path | None,
    clocks: Path | None,
    rig: Path | None,
    landmark_map: Path | None,
    height: str | None,
    family: str,
    output: Path | None,
    as_json: bool,
    force: bool,
) -> None:
    """Places of the cameras, or the offsets of their clocks, from a recording in a mapped room."""
    if base is not None:
        require_no("--base", {"--clocks": clocks})
        calibrate_base(base, rig, landmark_map, height, family, output, as_json, force)
    elif clocks is not None:
        require_no("--clocks", {"--height": height})
        calibrate_clocks(clocks, rig, landmark_map, family, output, as_json, force)


def calibrate_base(
    folder: Path,
    rig: Path | None,
    landmark_map: Path | None,
    height: str | None,
    family: str,
    output: Path | None,
    as_json: bool,
    force: bool,
) -> None:
    """Find the cameras' poses on the robot from a recording in a mapped room; write the rig and print the result.

    Raises:
        InputError: rig or map is missing, or the recording does not determine the poses.
    """
    from dataclasses import replace

    from lmkit.api.cameras import calibrate_base as find
    from lmkit.cli.parsing import parse_meters
    from lmkit.geometry.pose import Pose
    from lmkit.mapping.base_mounting_results import mounting_lines
    from lmkit.pipelines.recording_folder import read_recording_folder

    height_m = None if height is None else parse_meters(height, "--height")
    cameras, landmarks = _rig_and_map("--base", rig, landmark_map)
    # The pose is unknown; any pose suffices to read wheel odometry.
    anywhere = replace(cameras, T_base_left=Pose.identity("base", "left"))
    recording = read_recording_folder(folder, anywhere, landmarks.families or (family,))
    found = find(recording, cameras, landmarks, height=height_m)
    _write(found.rig, output, force, found.to_dict() if as_json else mounting_lines(found))


def calibrate_clocks(
    folder: Path,
    rig: Path | None,
    landmark_map: Path | None,
    family: str,
    output: Path | None,
    as_json: bool,
    force: bool,
) -> None:
    """Find the time offsets of the cameras from a recording in a mapped room; write the rig and print the result.

    Raises:
        InputError: rig or map is missing, or a camera saw nothing of the map.
    """
    from lmkit.api.cameras import calibrate_clocks as find
    from lmkit.pipelines.recording_folder import read_recording_folder

    cameras, landmarks = _rig_and_map("--clocks", rig, landmark_map)
    found = find(read_recording_folder(folder, cameras, landmarks.families or (family,)), cameras, landmarks)
    _write(found.rig, output, force, found.to_dict() if as_json else found.lines())


def _rig_and_map(option: str, rig: Path | None, landmark_map: Path | None) -> tuple[AnyRig, LandmarkMap]:
    from lmkit.io.any_rig import read_any_rig

    if rig is None or landmark_map is None:
        raise InputError("no_rig_or_map", f"{option} needs a rig and a map", "give --rig rig.yaml --map map.yaml")
    return read_any_rig(rig), read_mounted_map(landmark_map)


def _write(rig: AnyRig, output: Path | None, force: bool, answer: dict[str, Any] | list[str]) -> None:
    """Write the rig, and print the result: JSON, or lines of text."""
    from lmkit.io.rig import rig_to_yaml

    written = write_outputs({output: rig_to_yaml(rig)}, force)
    if isinstance(answer, dict):
        print_json(answer)
        return
    for line in (*answer, *written_lines(written, output)):
        print_line(line)
