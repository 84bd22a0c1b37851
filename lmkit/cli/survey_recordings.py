"""`lmkit survey` of several recordings of one place: one map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from lmkit.cli.output import check_outputs, print_json, print_line, progress, warn, write_outputs
from lmkit.errors import InputError
from lmkit.units import parse_length_mm

if TYPE_CHECKING:
    from lmkit.geometry.rig import AnyRig
    from lmkit.mapping.wall_constraints import LandmarkConstraint
    from lmkit.model.landmark_map import LandmarkMap


def are_recordings(sources: Sequence[str], rig: AnyRig) -> bool:
    """Whether the sources are two or more recording folders, not the images of each camera.

    Raises:
        InputError: some are, and others are not.
    """
    from lmkit.geometry.rig import mounted_cameras
    from lmkit.pipelines.recording_folder import is_recording_folder

    names = [camera.name for camera in mounted_cameras(rig)]
    others = [source for source in sources if not is_recording_folder(Path(source), names)]
    if others and len(others) < len(sources):
        raise InputError(
            "no_recording",
            f"{others[0]} contains no recording, unlike the other folders",
            f"put detections.csv into it, or a folder or video of each camera ({', '.join(names)})",
        )
    return len(sources) > 1 and not others


def survey_several(
    folders: Sequence[str],
    rig: AnyRig,
    size_m: float,
    known: LandmarkMap | None,
    known_sigma: tuple[float, float] | None,
    constraints: Sequence[LandmarkConstraint],
    keep_doubtful: bool,
    families: Sequence[str],
    hz: float | None,
    outputs: Mapping[str, Path | None],
    force: bool,
    as_json: bool,
) -> None:
    """Read the folders, survey them together, write and print.

    Args:
        outputs: ``map`` and ``tum``: path of the map, and path from which the name of each trajectory follows.
    """
    from lmkit.api.recordings import survey_recordings
    from lmkit.io.landmark_map import map_to_yaml
    from lmkit.io.trajectory import poses_to_tum
    from lmkit.mapping.joint_survey import joint_lines
    from lmkit.mapping.survey_results import base_poses
    from lmkit.pipelines.recording_folder import read_recording_folder

    folders = given_once(folders)
    names = recording_names(folders)
    output, tum = outputs["map"], outputs["tum"]
    tums = {name: None if tum is None else tum.with_stem(f"{tum.stem}-{name.replace('/', '-')}") for name in names}
    check_outputs((output, *tums.values()), force)
    read = progress(zip(names, folders, strict=True), len(names), "reading recordings")
    recordings = {name: read_recording_folder(Path(folder), rig, families, hz) for name, folder in read}
    result = survey_recordings(
        recordings,
        rig,
        size=size_m,
        known=known,
        known_sigma=known_sigma,
        constraints=constraints,
        keep_doubtful=keep_doubtful,
    )
    for text in result.warnings:
        warn(text)
    write_outputs({output: map_to_yaml(result.landmarks)}, force)
    for name, survey in zip(result.names, result.surveys, strict=True):
        write_outputs({tums[name]: poses_to_tum(base_poses(survey.bundle, rig))}, force)
    if as_json:
        print_json({"map": str(output), **result.to_dict()})
        return
    for line in joint_lines(result):
        print_line(line)
    print_line(f"{len(result.landmarks)} landmarks from {len(result.names)} of {len(names)} recordings -> {output}")


def survey_readings(
    folders: Sequence[str],
    size: str,
    families: Sequence[str],
    outputs: Mapping[str, Path | None],
    force: bool,
    as_json: bool,
) -> None:
    """Read folders of readings, survey them together in the plane, write and print.

    Args:
        outputs: see :func:`survey_several`.

    Raises:
        InputError: the sources are not folders of readings, so that a rig is needed.
    """
    from lmkit.io.landmark_map import map_to_yaml
    from lmkit.io.trajectory import poses_to_tum
    from lmkit.mapping.range_bearing_survey import planar_map_dict, planar_map_lines
    from lmkit.mapping.several_readings import survey_readings_together
    from lmkit.pipelines.recording_checks import require_plausible_recording
    from lmkit.pipelines.recording_folder import has_readings, open_recording_folder

    if not folders or not all(has_readings(Path(folder)) for folder in folders):
        raise InputError("no_rig", "survey needs a rig", "give --rig rig.yaml, or folders with readings.csv")
    folders = given_once(folders)
    names, output, tum = recording_names(folders), outputs["map"], outputs["tum"]
    tums = {name: None if tum is None else tum.with_stem(f"{tum.stem}-{name.replace('/', '-')}") for name in names}
    check_outputs((output, *tums.values()), force)
    read = zip(names, folders, strict=True)
    recordings = {name: open_recording_folder(Path(folder), None, families).read() for name, folder in read}
    for recording in recordings.values():
        require_plausible_recording(recording)
    result = survey_readings_together(recordings, parse_length_mm(size, "--size") / 1000)
    for name in result.left_out:
        warn(f"{name} is left out: it shares too few landmarks with the other recordings, or they do not agree")
    written = {output: map_to_yaml(result.landmarks)}
    for name, drive in result.drives.items():
        written[tums[name]] = poses_to_tum(zip(drive.times_s.tolist(), drive.poses, strict=True))
    write_outputs(written, force)
    count = sum(len(recording.readings) for name, recording in recordings.items() if name in result.drives)
    assert output is not None
    if as_json:
        print_json({**planar_map_dict(result.landmarks, count, output), "left_out": list(result.left_out)})
        return
    for line in planar_map_lines(result.landmarks, count, output):
        print_line(line)


def given_once(folders: Sequence[str]) -> list[str]:
    """The folders without repeated ones, with a warning about these."""
    kept: dict[Path, str] = {}
    for folder in folders:
        if (place := Path(folder).resolve()) in kept:
            warn(f"{folder} is given more than once: its recording counts once")
        kept.setdefault(place, folder)
    return list(kept.values())


def recording_names(folders: Sequence[str]) -> list[str]:
    """Names of recordings: the last part of their paths, or the whole path if two names are equal."""
    last = [Path(folder).name for folder in folders]
    return last if len(set(last)) == len(last) else [str(Path(folder)) for folder in folders]
