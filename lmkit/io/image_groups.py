"""Images of several cameras, frame by frame: folders, globs, videos or cameras in step, or one image split in two."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from lmkit.errors import InputError, InputWarning, warn_caller
from lmkit.io.image_names import matched
from lmkit.io.image_sources import (
    CAMERA,
    VIDEO_SUFFIXES,
    Frame,
    camera_number,
    file_frame,
    frames,
    list_images,
)
from lmkit.io.video_groups import video_groups

SPLIT = "split:"


def require_image_of_each(cameras: Sequence[str], sources: Sequence[str], hint: str = "") -> None:
    """Require one source per camera.

    Args:
        cameras: names of the rig's cameras, in order.
        hint: advice in the error.

    Raises:
        InputError: there are more or fewer.
    """
    count = image_count(sources)
    if count != len(cameras):
        raise InputError(
            "wrong_image_count",
            f"{count} source{'s' * (count != 1)} of images for a rig of {len(cameras)} ({', '.join(cameras)})",
            f"give one image, folder or video per camera, in this order{hint}",
        )


def image_count(sources: Sequence[str]) -> int:
    """Number of cameras of the sources: ``split:SOURCE`` gives two, every other source one."""
    return sum(2 if source.startswith(SPLIT) else 1 for source in sources)


def are_files(sources: Sequence[str]) -> bool:
    """Whether all sources are image files, which worker processes can read, and not videos or cameras."""
    return all(
        not source.startswith((SPLIT, CAMERA)) and source != "-" and Path(source).suffix.lower() not in VIDEO_SUFFIXES
        for source in sources
    )


def list_groups(sources: Sequence[str]) -> list[tuple[Path, ...]]:
    """The image files of one or more folders or globs, grouped by name if the names match, else in order.

    Raises:
        InputError: there are none; names do not match, and the cameras have different numbers of images; one file
            belongs to two cameras.

    Warns:
        InputWarning: images without a partner are left out.
    """
    lists = [list_images(source) for source in sources]
    counts = [len(files) for files in lists]
    groups = matched(lists) if len(lists) > 1 and max(counts) > 1 else None
    if groups is not None:
        _name_left_out(lists, groups)
    elif len(set(counts)) == 1:
        groups = list(zip(*lists, strict=True))
    else:
        if len(counts) == 2:
            text = f"{counts[0]} left and {counts[1]} right images do not make pairs"
        else:
            text = f"the cameras have {', '.join(map(str, counts))} images"
        raise InputError("unpaired", text, "give folders or globs with as many images each, with matching names")
    for files in groups:
        if len({file.resolve() for file in files}) < len(files):
            hint = "give each camera its own folder"
            raise InputError("same_images", f"{files[-1]} is given as the image of two cameras", hint)
    return groups


def _name_left_out(lists: Sequence[Sequence[Path]], groups: Sequence[tuple[Path, ...]]) -> None:
    used = {file for files in groups for file in files}
    alone = [file for files in lists for file in files if file not in used]
    if alone:
        names = ", ".join(map(str, alone[:3])) + (", ..." if len(alone) > 3 else "")
        warn_caller(InputWarning(f"images without a partner are left out: {len(alone)} ({names})"))


def list_pairs(left: str, right: str) -> list[tuple[Path, Path]]:
    """The image files of two folders or globs, paired as in `list_groups`.

    Raises:
        InputError: there are none, different numbers on both sides, or the same files on both.
    """
    return [(files[0], files[1]) for files in list_groups([left, right])]


def frame_groups(sources: Sequence[str]) -> Iterator[tuple[Frame, ...]]:
    """The images of all cameras, frame by frame.

    Args:
        sources: cameras (``camera:0``), videos, folders or globs, all of one kind; or one ``split:SOURCE`` whose
            images show the left and the right camera side by side.

    Raises:
        InputError: the sources do not go together, or a camera or video cannot be read.
    """
    if any(source.startswith(SPLIT) for source in sources):
        if len(sources) > 1:
            raise InputError("unpaired", "split: gives the images of both cameras", "give it as the only source")
        yield from _halves(sources[0].removeprefix(SPLIT))
        return
    if len(sources) == 1:
        yield from ((frame,) for frame in frames(list(sources)))
        return
    live = [source.startswith(CAMERA) for source in sources]
    videos = [Path(source).suffix.lower() in VIDEO_SUFFIXES for source in sources]
    if all(live):
        yield from _camera_groups(sources)
    elif any(live) or any(videos) != all(videos):
        names = " and ".join(sources)
        raise InputError("unpaired", f"{names} are different kinds of source", "give sources of the same kind")
    elif all(videos):
        yield from video_groups(sources)
    else:
        for files in list_groups(sources):
            yield tuple(file_frame(file) for file in files)


def _halves(source: str) -> Iterator[tuple[Frame, Frame]]:
    for frame in frames([source]):
        image = frame.pixels
        half = image.shape[1] // 2
        yield (
            Frame(frame.name, image[:, :half], None, frame.time_s),
            Frame(frame.name, image[:, half : 2 * half], None, frame.time_s),
        )


def _camera_groups(sources: Sequence[str]) -> Iterator[tuple[Frame, ...]]:
    """Frames of several cameras, grabbed at once and decoded afterwards."""
    import cv2

    cameras = []
    try:
        for source in sources:
            camera = cv2.VideoCapture(camera_number(source))
            # Buffer one frame; otherwise slow processing reads increasingly stale frames.
            camera.set(cv2.CAP_PROP_BUFFERSIZE, 1)
            cameras.append(camera)
            if not camera.isOpened():
                raise InputError(
                    "bad_camera",
                    f"{source}: no such camera, or it is in use",
                    "check the number, such as camera:0, and close other programs",
                )
        count = 0
        # Grab from every camera, even if the first one fails, so that they stay synchronized.
        while min([camera.grab() for camera in cameras]):
            images = [np.asarray(camera.retrieve()[1], dtype=np.uint8) for camera in cameras]
            yield tuple(Frame(f"frame#{count}", image) for image in images)
            count += 1
    finally:
        for camera in cameras:
            camera.release()
