"""What `lmkit survey` and `lmkit track` write alike: plans of a drive."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from lmkit.errors import InputError

if TYPE_CHECKING:
    from lmkit.arrays import FloatArray
    from lmkit.model.landmark_map import LandmarkMap
    from lmkit.model.pose import Pose

MOST_DRAWN = 60  # poses of a plan
PLAN_KINDS = ("png", "svg")


def check_outputs(paths: Sequence[Path | None], plan: Path | None, force: bool) -> None:
    """Refuse what cannot be written before the work begins.

    Raises:
        InputError: a file exists, its folder cannot be written to, or the plan is of an unknown kind.
    """
    from lmkit.formats.files import check_writable

    for path in (*paths, plan):
        if path is not None:
            check_writable(path, force)
    if plan is not None and _kind(plan) not in PLAN_KINDS:
        raise InputError("bad_suffix", f"cannot write {plan}: unknown kind", "name it .png or .svg")


def draw_drive(
    path: Path,
    landmarks: LandmarkMap,
    times_s: FloatArray,
    looking: Sequence[Pose],
    covariances: FloatArray,
    sure: Sequence[bool],
) -> bytes:
    """The map and some of the poses from above, for a file of that name.

    Args:
        looking: (N) poses of a camera that looks where the robot does.
        covariances: (N,6,6) of them.
    """
    from lmkit.room_plan import Found, draw_plan

    found = [
        Found(f"{times_s[k]:.1f} s", looking[k], covariances[k][:2, :2], sure[k])
        for k in range(0, len(times_s), 1 + len(times_s) // MOST_DRAWN)
    ]
    return draw_plan(landmarks, found, kind=_kind(path))


def _kind(path: Path) -> str:
    return path.suffix.lower().lstrip(".")
