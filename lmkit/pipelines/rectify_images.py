"""Stereo pairs of files, rectified and written."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from lmkit.geometry.rectification import rectification, rectified_rig, rectify_pair, with_lines_across
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.io.files import check_writable, write_file
from lmkit.io.image_groups import are_files, frame_groups, list_groups
from lmkit.io.opencv_rig import rig_to_opencv_yaml
from lmkit.io.rig import rig_to_yaml
from lmkit.io.ros_camera_info import FILES, rig_to_camera_infos
from lmkit.visualization.overlay import encode_png


def rectified_calibration(rig: StereoRig, folder: Path) -> dict[Path, str]:
    """Calibration of the rectified images by file: lmkit's rig, OpenCV's with P1, P2 and Q, and ROS camera_info."""
    flat = rectified_rig(rig)
    infos = dict(zip((folder / "camera_info" / name for name in FILES), rig_to_camera_infos(flat), strict=True))
    return {folder / "rig.yaml": rig_to_yaml(flat), folder / "opencv.yml": rig_to_opencv_yaml(flat), **infos}


def rectify_frames(
    sources: Sequence[str], rig: StereoRig, folder: Path, lines: bool, overwrite: bool
) -> Iterator[tuple[Path, ...]]:
    """Rectify and write pair after pair; yields the files of each pair.

    Args:
        sources: two images, folders, globs or videos, or one ``split:SOURCE``.
        lines: write both images side by side with horizontal lines.

    Raises:
        InputError: the sources do not go together, an image is not of the rig's size, or a file exists or cannot be
            written.
    """
    if are_files(sources):
        for files in list_groups(sources):
            for path in _targets([str(file) for file in files], folder, lines):
                check_writable(path, overwrite)
    for frames in frame_groups(sources):
        targets = _targets([frame.name for frame in frames], folder, lines)
        images = [frame.pixels for frame in frames]
        for frame, image, camera in zip(frames, images, (rig.left, rig.right), strict=True):
            camera.require_size(frame.name, (image.shape[1], image.shape[0]))
        rectified = rectify_pair(rig, images[0], images[1])
        drawn = (with_lines_across(*rectified, rectification(rig).along),) if lines else rectified
        for path, image in zip(targets, drawn, strict=True):
            write_file(path, encode_png(image), overwrite)
        yield targets


def _targets(names: Sequence[str], folder: Path, lines: bool) -> tuple[Path, ...]:
    """Output files of a pair: left and right, or one file with both side by side."""
    left, right = (_stem(name) for name in names)
    if lines:
        return (folder / f"{left}_lines.png",)
    return folder / f"{left}_left.png", folder / f"{right}_right.png"


def _stem(name: str) -> str:
    """``03`` of ``left/03.jpg``; ``drive_000012`` of ``drive.mp4#12``."""
    path, _, number = name.partition("#")
    return f"{Path(path).stem}_{int(number):06d}" if number.isdecimal() else Path(name).stem
