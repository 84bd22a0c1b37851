"""Images and frame given to `lmkit locate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from lmkit.cli.output import warn
from lmkit.errors import InputError

if TYPE_CHECKING:
    from lmkit.geometry.rig import AnyRig


def require_sources(images: list[str], mono: str | None) -> None:
    """Refuse missing images, and more than one source with --mono.

    Raises:
        InputError: no images, or too many sources.
    """
    if mono is not None and mono.startswith("-"):
        found = images[0] if images else "IMAGE"
        raise InputError("no_images", f"--mono takes a value, and {mono} follows", f"give --mono {found}")
    if mono is not None and images:
        problem = f"--mono takes one value, and {' '.join(images)} follows"
        raise InputError("extra_files", problem, "quote a glob, such as --mono 'images/*.jpg', or give a folder")
    if mono is None and not images:
        raise InputError("no_images", "locate needs images", "give one per camera, or --mono IMAGE")


def source_groups(images: list[str], mono: str | None, rig: AnyRig) -> list[list[str]]:
    """Sources that belong together: one per camera; with a rig of one camera every source is separate."""
    from lmkit.geometry.rig import mounted_cameras
    from lmkit.io.image_groups import require_image_of_each

    if mono is not None:
        return [[mono]]
    names = [camera.name for camera in mounted_cameras(rig)]
    if len(names) == 1:
        if len(images) == 2:  # as for a stereo pair
            warn(
                f"the rig has one camera ({names[0]}): {images[0]} and {images[1]} are two frames of it; "
                "for the left and right image of one frame give the rig of both cameras"
            )
        return [[source] for source in images]
    require_image_of_each(names, images, "; --mono for the first camera alone")
    return [images]


def require_frame(frame: str, rig: AnyRig, path: Path) -> None:
    """Refuse the base's pose from a rig file without a base.

    Raises:
        InputError: it has none.
    """
    if frame == "base" and rig.T_base_left is None:
        raise InputError("no_base", f"{path} has no T_base_left", "add it to the rig file, or give --frame camera")


def warn_of_clocks(groups: list[list[str]], rig: AnyRig) -> None:
    """Warn that single images of unsynchronized cameras locate only a stationary rig."""
    from lmkit.geometry.rig import mounted_cameras
    from lmkit.mapping.carried_cameras import TOGETHER_S

    late = [c for c in mounted_cameras(rig) if abs(c.time_offset_s) >= TOGETHER_S]
    if late and any(len(sources) > 1 for sources in groups):
        offsets = ", ".join(f"{camera.name} {1000 * camera.time_offset_s:+.1f} ms" for camera in late)
        warn(
            f"the cameras do not expose together ({offsets}): poses hold where the rig stands still; "
            "of a moving one, `lmkit track` takes every exposure at its time"
        )
