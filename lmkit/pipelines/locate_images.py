"""Poses of many frames of a rig in a steady stream: files on all cores, videos frame by frame."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from lmkit.arrays import ByteArray
from lmkit.detection.config import DetectOptions
from lmkit.detection.detector import detect_landmarks
from lmkit.errors import InputError
from lmkit.geometry.rig import AnyRig, mounted_cameras
from lmkit.io.image_groups import are_files, frame_groups, image_count, list_groups, require_image_of_each
from lmkit.io.image_names import time_of
from lmkit.io.image_sources import Frame
from lmkit.io.images import read_image
from lmkit.localization.absolute_pose import LocateOptions
from lmkit.localization.base_pose import with_base
from lmkit.model.estimate import PoseEstimate
from lmkit.model.families import family_named
from lmkit.model.landmark_id import ids_text
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.observation import Detection
from lmkit.parallel import map_in_processes
from lmkit.pipelines.detect_images import quoted_cell
from lmkit.pipelines.look_again import FrameImage, locate_frame


@dataclass(frozen=True, eq=False)
class Located:
    """One frame.

    Attributes:
        names: of the images, in the order of the rig's cameras.
        estimate: the pose, or None if an image could not be read.
        seen: landmarks of every image.
        image: the first image, only for videos and cameras (files can be read again).
        error: reason why there is no estimate.
        time_s: time in the video, or the time that the first file's name ends in.
    """

    names: tuple[str, ...]
    estimate: PoseEstimate | None
    seen: tuple[tuple[Detection, ...], ...] = ()
    image: ByteArray | None = None
    error: InputError | None = None
    time_s: float | None = None

    @property
    def left(self) -> str:
        """Name of the first image."""
        return self.names[0]


def with_times(frames: Iterable[Located], hz: float | None) -> Iterator[Located]:
    """The frames; with ``hz``, frames without a time get their number divided by ``hz``."""
    for number, frame in enumerate(frames):
        yield frame if hz is None or frame.time_s is not None else replace(frame, time_s=number / hz)


def locate_in_sources(
    sources: Sequence[str], rig: AnyRig, landmarks: LandmarkMap, options: LocateOptions | None = None
) -> Iterator[Located]:
    """Every frame of the files, folders, globs, videos or cameras, in order.

    Args:
        sources: one per camera of the rig, or one alone: the first (left) camera's.

    Raises:
        InputError: the sources do not go together, or are not as many as the rig has cameras.
    """
    if image_count(sources) != 1:
        require_image_of_each([camera.name for camera in mounted_cameras(rig)], sources)
    options = options or LocateOptions()
    if are_files(sources):
        work = partial(_locate_files, rig=rig, landmarks=landmarks, options=options)
        yield from map_in_processes(work, [tuple(map(str, files)) for files in list_groups(sources)])
        return
    for frames in frame_groups(sources):
        yield _locate_frames(frames, rig, landmarks, options)


def _locate_files(names: tuple[str, ...], rig: AnyRig, landmarks: LandmarkMap, options: LocateOptions) -> Located:
    try:
        frames = [Frame(name, read_image(Path(name)), None, time_of(name)) for name in names]
    except InputError as error:
        return Located(names, None, error=error)
    return replace(_locate_frames(frames, rig, landmarks, options), image=None)


def _locate_frames(frames: Sequence[Frame], rig: AnyRig, landmarks: LandmarkMap, options: LocateOptions) -> Located:
    names = tuple(frame.name for frame in frames)
    families = tuple(dict.fromkeys(family_named(landmark.family) for landmark in landmarks))
    models = [camera.model for camera in mounted_cameras(rig)]
    images, found = [], []
    try:
        for frame, model in zip(frames, models, strict=False):
            model.require_size(frame.name, (frame.pixels.shape[1], frame.pixels.shape[0]))
            images.append(FrameImage(frame.pixels, DetectOptions(families, camera=model)))
            found.append(tuple(detect_landmarks(frame.pixels, images[-1].options)))
    except InputError as error:
        return Located(names, None, error=error)
    estimate, seen = locate_frame(images, found, rig, landmarks, options)
    return Located(names, estimate, tuple(map(tuple, seen)), frames[0].image, time_s=frames[0].time_s)


def located_dict(located: Located, rig: AnyRig, frame: str) -> dict[str, Any]:
    """The JSON result of one frame (docs/formats.md).

    Args:
        frame: ``camera`` (the first one) or ``base``, whose pose is written.
    """
    right = located.names[1] if len(located.names) == 2 else None
    names = {"left": located.left, "right": right, "images": list(located.names)}
    if located.estimate is None:
        assert located.error is not None
        return {**names, "error": located.error.as_dict()}
    return {**names, "time_s": located.time_s, **with_base(located.estimate, rig).to_dict(frame)}


def located_line(located: Located, rig: AnyRig, frame: str) -> str:
    """The result of one frame as a line of text."""
    assert located.estimate is not None
    estimate, name = located.estimate, Path(located.left).name
    answer = located_dict(located, rig, frame)
    outliers = f", outliers {ids_text(estimate.outliers)}" if estimate.outliers else ""
    if estimate.outlier_cameras:
        outliers += f", outlier cameras {', '.join(estimate.outlier_cameras)}"
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
