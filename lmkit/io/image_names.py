"""Names of image files: their order, the times in them, and which images of several cameras belong together."""

from __future__ import annotations

import re
from collections.abc import Callable, Hashable, Sequence
from pathlib import Path

import numpy as np

from lmkit.units import NANOSECONDS_FROM

MOST_APART_S = 0.02  # between the stamps of cameras that are triggered together
LEAST_SHARE = 0.5  # least share of images with partners; counters of two cameras may overlap by chance
_NUMBER = re.compile(r"(\d+\.\d+|\d+)")
_SECONDS = re.compile(r"(\d{9,}\.\d+|\d+\.\d+)$")
_INTEGER = re.compile(r"(?<![\d.])\d{18,19}$")
_CAMERA = re.compile(r"(?<![a-z])(?:left|right|[lr]|cam(?:era)?[ _-]?\d+(?=[ _.-]))(?![a-z])", re.IGNORECASE)


def time_of(name: str) -> float | None:
    """Seconds of a file name that ends in a decimal number of them, or in integer nanoseconds since 1970.

    Examples:
        >>> time_of("left/1403636579763555584.png"), time_of("frame-12.25.png"), time_of("frame12.png")
        (1403636579.7635555, 12.25, None)
    """
    stem = Path(name).stem
    whole = _INTEGER.search(stem)
    if whole is not None and int(whole.group()) >= NANOSECONDS_FROM:
        return int(whole.group()) / 1e9
    found = _SECONDS.search(stem)
    return float(found[1]) if found else None


def in_order(files: Sequence[Path]) -> list[Path]:
    """Files by name, numbers in names by their value: 2.png before 10.png."""
    return sorted(files, key=_order)


def matched(lists: Sequence[Sequence[Path]]) -> list[tuple[Path, ...]] | None:
    """Groups of one file per camera with matching names; None if the names do not match.

    Names match if they are equal, equal except for the camera's name (left, right, l, r, cam0), or end in
    nearby times.  Most of the files must match.
    """
    keys: tuple[Callable[[Path], Hashable], ...] = (lambda path: path.stem, _without_camera)
    for key in keys:
        groups = _by_key([{key(path): path for path in files} for files in lists])
        if _tell(groups, lists):
            return groups
    groups = _by_time(lists)
    return groups if _tell(groups, lists) else None


def _order(path: Path) -> list[tuple[int, float, str]]:
    parts = _NUMBER.split(path.name)
    keys = [(0, 0.0, part) if k % 2 == 0 else (1, float(part), part) for k, part in enumerate(parts)]
    return [*((1, 0.0, folder) for folder in path.parent.parts), (0, 0.0, ""), *keys]


def _without_camera(path: Path) -> Hashable:
    return re.sub(r"[\W_]+", "", _CAMERA.sub("", path.stem)).lower() or None


def _tell(groups: Sequence[tuple[Path, ...]], lists: Sequence[Sequence[Path]]) -> bool:
    return len(groups) > 0 and len(groups) >= LEAST_SHARE * max(len(files) for files in lists)


def _by_key(named: Sequence[dict[Hashable, Path]]) -> list[tuple[Path, ...]]:
    """Groups with the same key, in the order of the first camera."""
    common = [key for key in named[0] if key is not None and all(key in others for others in named[1:])]
    return [tuple(files[key] for files in named) for key in common]


def _by_time(lists: Sequence[Sequence[Path]]) -> list[tuple[Path, ...]]:
    """Groups of nearest times, each file in one group at most."""
    stamps = [[time_of(path.name) for path in files] for files in lists]
    if any(time is None for times in stamps for time in times):
        return []
    times = [np.array(some, dtype=np.float64) for some in stamps]
    steps = np.concatenate([np.abs(np.diff(np.sort(some))) for some in times])
    apart = min(MOST_APART_S, float(np.median(steps)) / 2 if len(steps) else MOST_APART_S)
    groups = []
    for k, time in enumerate(times[0]):
        nearest = [int(np.argmin(np.abs(others - time))) for others in times[1:]]
        partners = list(zip(nearest, times[1:], strict=True))
        mutual = all(int(np.argmin(np.abs(times[0] - others[j]))) == k for j, others in partners)
        if mutual and all(abs(others[j] - time) <= apart for j, others in partners):
            groups.append((lists[0][k], *(files[j] for j, files in zip(nearest, lists[1:], strict=True))))
    return groups
