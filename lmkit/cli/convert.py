"""`lmkit convert`: rig and map files of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lmkit.cli import map_options, options
from lmkit.cli.map_options import read_map_file
from lmkit.cli.output import print_line, warn, warn_all
from lmkit.errors import InputError

if TYPE_CHECKING:
    from lmkit.model.landmark_map import LandmarkMap

MAP_KINDS = ("map", "wpilib", "tagslam")


def run(
    sources: Annotated[
        list[Path],
        typer.Argument(
            help="Rig (lmkit, OpenCV, Kalibr, or ROS camera_info: a folder, or the left and the right file), "
            "map (lmkit, WPILib, TagSLAM and others) or TUM trajectory."
        ),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="File to write. For a stereo pair with --to ros, a folder.")
    ],
    to: Annotated[
        str,
        typer.Option(
            "--to",
            metavar="FORMAT",
            help="Output format: lmkit, opencv, ros or kalibr (rig); map, wpilib or tagslam (map); bag (poses).",
        ),
    ],
    marker_family: map_options.MarkerFamily = None,
    marker_size: map_options.MarkerSize = None,
    force: options.Force = False,
) -> None:
    """Convert rigs, maps and trajectories. Formats: OpenCV, ROS, Kalibr; WPILib, TagSLAM; ROS bag."""
    from lmkit.geometry.rig import Rig, as_stereo
    from lmkit.io.any_rig import KINDS, read_any_rig, read_rig_pair
    from lmkit.io.files import check_writable, write_file, write_files
    from lmkit.io.kalibr import rig_to_camchain
    from lmkit.io.opencv_rig import camera_to_opencv_yaml, rig_to_opencv_yaml
    from lmkit.io.rig import rig_to_yaml
    from lmkit.io.ros_camera_info import FILES, rig_to_camera_info, rig_to_camera_infos

    source = sources[0]
    if len(sources) > (2 if to in KINDS else 1):
        hint = "give one file; for camera_info files of ROS, the left and the right file"
        raise InputError("extra_files", f"{' '.join(map(str, sources))}: one file is converted at a time", hint)
    if to == "bag":
        from lmkit.io.bags import poses_to_bag
        from lmkit.io.trajectory import read_trajectory

        poses_to_bag(output, read_trajectory(source))
        print_line(f"wrote {output}")
        return
    if to in MAP_KINDS:
        check_writable(output, force)
        write_file(output, _map_text(read_map_file(source, marker_family, marker_size), to), force)
        print_line(f"wrote {output}")
        return
    if marker_family is not None or marker_size is not None:
        raise InputError("not_together", f"--family and --size are for maps, not for --to {to}", "leave them out")
    if to not in KINDS:
        raise InputError("bad_kind", f"--to {to} is unknown", f"choose {', '.join((*KINDS, *MAP_KINDS, 'bag'))}")
    _require_no_map(source, to)
    read = read_any_rig(source) if len(sources) == 1 else read_rig_pair(*sources)
    texts: dict[Path, str]
    remarks: list[str] = []
    if isinstance(read, Rig) and len(read.cameras) == 1 and to in ("ros", "opencv"):
        texts = {output: rig_to_camera_info(read) if to == "ros" else camera_to_opencv_yaml(read.left)}
    elif to == "ros":
        texts = dict(zip((output / name for name in FILES), rig_to_camera_infos(as_stereo(read, to)), strict=True))
    elif to == "kalibr":
        text, lens, error_px = rig_to_camchain(read)
        if error_px > 0:
            remarks.append(
                f"Kalibr has no such lens model; the nearest one, {lens}, differs by up to {error_px:.3f} px"
            )
        texts = {output: text}
    else:
        texts = {output: rig_to_opencv_yaml(as_stereo(read, to)) if to == "opencv" else rig_to_yaml(read)}
    if read.T_base_left is not None and to != "lmkit":
        remarks.append(f"{to} files cannot contain T_base_left; it is omitted")
    write_files(texts, force)
    warn_all(remarks)
    for path in texts:
        print_line(f"wrote {path}")


def _require_no_map(source: Path, to: str) -> None:
    """Refuse a map if a rig is to be written.

    Raises:
        InputError: the file is a map.
    """
    from lmkit.io.document_head import head_of
    from lmkit.io.documents import read_text
    from lmkit.io.map_kinds import program_of_map

    if not source.is_file():
        return
    text = read_text(source, "file")
    if program := program_of_map(text, head_of(text)):
        message = f"{source} is a map of {program}, and --to {to} writes a rig"
        raise InputError("bad_kind", message, f"give --to {', '.join(MAP_KINDS[:-1])} or {MAP_KINDS[-1]}")


def _map_text(landmarks: LandmarkMap, to: str) -> str:
    from lmkit.io.external_maps import has_correlations, map_to_tagslam, map_to_wpilib
    from lmkit.io.landmark_map import map_to_yaml

    if to == "map":
        return map_to_yaml(landmarks)
    families = landmarks.families
    if len(families) > 1:
        message = f"the map has landmarks of {', '.join(families)}; files of {to} name no family"
        raise InputError("several_families", message, "leave the landmarks of one family in the map")
    if not "".join(families).startswith("tag"):
        warn(f"files of {to} name no family, and their readers expect AprilTags: say that these are {families[0]}")
    if to == "tagslam":
        if has_correlations(landmarks):
            warn("TagSLAM reads standard deviations along each tag's own axes; correlations between them are omitted")
        return map_to_tagslam(landmarks)
    far = [max(0.0, *(float(m.T_map_landmark.t[axis]) for m in landmarks)) for axis in (0, 1)]
    warn("a field layout contains neither sizes nor covariances; they are omitted")
    return map_to_wpilib(landmarks, (far[0], far[1]))
