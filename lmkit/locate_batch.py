"""Poses of many stereo pairs or single pictures in a steady stream: files on all cores, films frame by frame."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from lmkit.arrays import ByteArray
from lmkit.detect.landmarks import detect_landmarks
from lmkit.detect.options import DetectOptions
from lmkit.errors import InputError
from lmkit.formats.images import read_image
from lmkit.formats.sources import Frame, are_moving, frames, list_pairs, list_pictures, paired_frames
from lmkit.locate.rig import LocateOptions, locate_camera, locate_rig
from lmkit.model.estimate import PoseEstimate
from lmkit.model.landmark import family_named
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.observation import LandmarkObservation
from lmkit.model.stereo_rig import StereoRig
from lmkit.workers import map_in_processes

# Below this the processes' start costs more than they bring.
WORTH_PROCESSES = 4


@dataclass(frozen=True, eq=False)
class Located:
    """One moment.

    Attributes:
        left, right: names of the pictures; right is None of a single picture.
        estimate: the pose, or None where a picture could not be read.
        seen: landmarks of the left and of the right picture.
        image: the left picture, of films and cameras alone (files can be read again).
        error: why there is no estimate.
    """

    left: str
    right: str | None
    estimate: PoseEstimate | None
    seen: tuple[tuple[LandmarkObservation, ...], ...] = ()
    image: ByteArray | None = None
    error: InputError | None = None


def locate_in_sources(
    left: str, right: str | None, rig: StereoRig, landmarks: LandmarkMap, options: LocateOptions | None = None
) -> Iterator[Located]:
    """Every pair of two files, folders, globs, films or cameras, or every picture where right is None, in order.

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
        yield from map_in_processes(work, jobs) if len(jobs) >= WORTH_PROCESSES else map(work, jobs)
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
                moment.append(Frame(name, read_image(Path(name))))
    except InputError as error:
        return Located(left, right, None, error=error)
    located = _locate_frames(moment, rig, landmarks, options)
    return Located(left, right, located.estimate, located.seen, None, located.error)


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
    return Located(left, right, estimate, tuple(seen), moment[0].image)
