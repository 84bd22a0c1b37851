"""Poses of many stereo pairs or single images in a steady stream: files on all cores, videos frame by frame."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from lmkit.arrays import ByteArray
from lmkit.detection.config import DetectOptions
from lmkit.detection.detector import detect_landmarks
from lmkit.errors import InputError
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.io.image_sources import Frame, are_moving, frames, list_pairs, list_pictures, paired_frames, time_of
from lmkit.io.images import read_image
from lmkit.localization.absolute_pose import LocateOptions, locate_camera, locate_rig
from lmkit.localization.base_pose import with_base
from lmkit.localization.contradiction import with_cause
from lmkit.model.estimate import PoseEstimate
from lmkit.model.landmark import family_named
from lmkit.model.landmark_id import ids_text
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.observation import Detection
from lmkit.parallel import map_in_processes
from lmkit.pipelines.detect_images import quoted_cell


@dataclass(frozen=True, eq=False)
class Located:
    """One frame.

    Attributes:
        left, right: names of the images; right is None of a single image.
        estimate: the pose, or None where an image could not be read.
        seen: landmarks of the left and of the right image.
        image: the left image, of videos and cameras alone (files can be read again).
        error: why there is no estimate.
        time_s: time in the video, or the time that the left file's name ends in.
    """

    left: str
    right: str | None
    estimate: PoseEstimate | None
    seen: tuple[tuple[Detection, ...], ...] = ()
    image: ByteArray | None = None
    error: InputError | None = None
    time_s: float | None = None


def locate_in_sources(
    left: str, right: str | None, rig: StereoRig, landmarks: LandmarkMap, options: LocateOptions | None = None
) -> Iterator[Located]:
    """Every pair of two files, folders, globs, videos or cameras, or every image where right is None, in order.

    Raises:
        InputError: the sources make no pairs.
    """
    work = partial(_locate_files, rig=rig, landmarks=landmarks, options=options or LocateOptions())
    if not are_moving(left):
        jobs: Sequence[tuple[str, str | None]]
        if right is None:
            jobs = [(str(file), None) for file in list_pictures(left)]
        else:
            jobs = [(str(a), str(b)) for a, b in list_pairs(left, right)]
        yield from map_in_processes(work, jobs)
        return
    if right is None:
        moments: Iterator[tuple[Frame, ...]] = ((frame,) for frame in frames([left]))
    else:
        moments = iter(paired_frames(left, right))
    for moment in moments:
        yield _locate_frames(moment, rig, landmarks, options or LocateOptions())


def _locate_files(
    names: tuple[str, str | None], rig: StereoRig, landmarks: LandmarkMap, options: LocateOptions
) -> Located:
    left, right = names
    moment = []
    try:
        for name in names:
            if name is not None:
                moment.append(Frame(name, read_image(Path(name)), None, time_of(name)))
    except InputError as error:
        return Located(left, right, None, error=error)
    located = _locate_frames(moment, rig, landmarks, options)
    return replace(located, image=None)


def _locate_frames(
    moment: Sequence[Frame], rig: StereoRig, landmarks: LandmarkMap, options: LocateOptions
) -> Located:
    left, right = moment[0].name, moment[1].name if len(moment) > 1 else None
    families = tuple(dict.fromkeys(family_named(landmark.family) for landmark in landmarks))
    seen = []
    try:
        for frame, camera in zip(moment, (rig.left, rig.right), strict=False):
            camera.require_size(frame.name, (frame.picture.shape[1], frame.picture.shape[0]))
            seen.append(tuple(detect_landmarks(frame.picture, DetectOptions(families, camera=camera))))
    except InputError as error:
        return Located(left, right, None, error=error)
    if right is None:
        estimate = locate_camera(seen[0], rig.left, landmarks, options)
    else:
        estimate = locate_rig(seen[0], seen[1], rig, landmarks, options)
    estimate = with_cause(estimate, seen[0], seen[1] if right is not None else (), rig, landmarks)
    return Located(left, right, estimate, tuple(seen), moment[0].image, time_s=moment[0].time_s)


def located_dict(located: Located, rig: StereoRig, frame: str) -> dict[str, Any]:
    """One answer as docs/formats.md has it.

    Args:
        frame: ``camera`` (the left one) or ``base``: whose pose is given.
    """
    if located.estimate is None:
        assert located.error is not None
        return {"left": located.left, "right": located.right, "error": located.error.as_dict()}
    answer = with_base(located.estimate, rig).to_dict(frame)
    return {"left": located.left, "right": located.right, "time_s": located.time_s, **answer}


def located_line(located: Located, rig: StereoRig, frame: str) -> str:
    """One answer as a line of text."""
    assert located.estimate is not None
    estimate, name = located.estimate, Path(located.left).name
    answer = located_dict(located, rig, frame)
    outliers = f", outliers {ids_text(estimate.outliers)}" if estimate.outliers else ""
    if answer["position"] is None:
        return f"{name}: {estimate.status}{outliers}"
    x, y, z = answer["position"]
    sigma = [answer["covariance"][k][k] ** 0.5 * 1000 for k in range(3)]
    return (
        f"{name}: {estimate.status}, x {x:.3f} y {y:.3f} z {z:.3f} m "
        f"(± {sigma[0]:.1f} {sigma[1]:.1f} {sigma[2]:.1f} mm), codes {ids_text(estimate.inliers)}{outliers}"
    )


LOCATED_COLUMNS = (
    "left,time_s,status,x_m,y_m,z_m,qx,qy,qz,qw,"
    "sigma_x_m,sigma_y_m,sigma_z_m,sigma_rx_rad,sigma_ry_rad,sigma_rz_rad,codes"
)


def located_row(answer: dict[str, Any]) -> str:
    """A line of a CSV table with `LOCATED_COLUMNS`.

    Args:
        answer: from `located_dict`.
    """
    numbers: list[object] = [""] * 13
    if answer["position"] is not None and answer["covariance"] is not None:
        sigmas = [answer["covariance"][k][k] ** 0.5 for k in range(6)]
        numbers = [f"{v:.9g}" for v in (*answer["position"], *answer["quaternion"], *sigmas)]
    time_s = "" if answer["time_s"] is None else answer["time_s"]
    codes = " ".join(map(str, answer["codes"]))
    return ",".join(map(str, [quoted_cell(answer["left"]), time_s, answer["status"], *numbers, codes]))
