"""What both eyes see on a drive: pictures in, landmarks with their times out, on all cores."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

from lmkit.detection.config import DetectOptions
from lmkit.detection.detector import detect_landmarks
from lmkit.errors import InputError
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.io.image_sources import list_pairs, time_of
from lmkit.io.images import read_image
from lmkit.model.landmark import LandmarkFamily
from lmkit.model.recording import StereoFrame
from lmkit.parallel import map_in_processes


def see_drive(
    left: str, right: str, rig: StereoRig, families: Sequence[LandmarkFamily], hz: float | None
) -> Iterator[StereoFrame]:
    """Every pair of two folders or globs, in the order of their names.

    Args:
        hz: pairs a second; None: the names end in seconds.

    Raises:
        InputError: the sources make no pairs, a picture cannot be read, or times are missing or do not increase.
    """
    pairs = list_pairs(left, right)
    times: list[float] = []
    for k, (a, _) in enumerate(pairs):
        time = k / hz if hz else time_of(a.name)
        if time is None:
            raise InputError("no_times", f"{a} does not say when it was taken", "say how many pairs a second: --hz 5")
        if times and time <= times[-1]:
            raise InputError("time_not_increasing", f"{a}: time does not increase", "name pictures in their order")
        times.append(time)
    work = partial(_see, rig=rig, families=tuple(families))
    yield from map_in_processes(work, [(time, str(a), str(b)) for time, (a, b) in zip(times, pairs, strict=True)])


def _see(job: tuple[float, str, str], rig: StereoRig, families: tuple[LandmarkFamily, ...]) -> StereoFrame:
    time_s, *names = job
    seen = []
    for name, camera in zip(names, (rig.left, rig.right), strict=True):
        picture = read_image(Path(name))
        camera.require_size(name, (picture.shape[1], picture.shape[0]))
        seen.append(tuple(detect_landmarks(picture, DetectOptions(families, camera=camera))))
    return StereoFrame(time_s, seen[0], seen[1], Path(names[0]).stem)
