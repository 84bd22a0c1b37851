"""Stereo pairs of files, rectified and written."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from lmkit.geometry.rectification import rectification, rectified_rig, rectify_pair, with_lines_across
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.io.files import check_writable, write_file
from lmkit.io.images import read_image
from lmkit.io.opencv_rig import rig_to_opencv_yaml
from lmkit.io.rig import rig_to_yaml
from lmkit.io.ros_camera_info import FILES, rig_to_camera_infos
from lmkit.visualization.overlay import encode_png


def rectified_names(pairs: Sequence[tuple[Path, Path]], folder: Path, lines: bool) -> list[tuple[Path, ...]]:
    """The files that `rectify_files` writes for every pair: left and right, or one with both side by side."""
    if lines:
        return [(folder / f"{left.stem}_lines.png",) for left, _ in pairs]
    return [(folder / f"{left.stem}_left.png", folder / f"{right.stem}_right.png") for left, right in pairs]


def rectified_calibration(rig: StereoRig, folder: Path) -> dict[Path, str]:
    """Calibration of the rectified images by file: lmkit's rig, OpenCV's with P1, P2 and Q, and ROS camera_info."""
    flat = rectified_rig(rig)
    infos = dict(zip((folder / "camera_info" / name for name in FILES), rig_to_camera_infos(flat), strict=True))
    return {folder / "rig.yaml": rig_to_yaml(flat), folder / "opencv.yml": rig_to_opencv_yaml(flat), **infos}


def rectify_files(
    pairs: Sequence[tuple[Path, Path]], rig: StereoRig, folder: Path, lines: bool, overwrite: bool
) -> Iterator[tuple[Path, ...]]:
    """Rectify and write pair after pair; the files of each.

    Args:
        lines: both images side by side with lines across.

    Raises:
        InputError: an image is not of the rig's size, or a file exists or cannot be written.
    """
    names = rectified_names(pairs, folder, lines)
    for path in (path for both in names for path in both):
        check_writable(path, overwrite)
    for files, targets in zip(pairs, names, strict=True):
        images = [read_image(file) for file in files]
        for file, image, camera in zip(files, images, (rig.left, rig.right), strict=True):
            camera.require_size(str(file), (image.shape[1], image.shape[0]))
        rectified = rectify_pair(rig, images[0], images[1])
        drawn = (with_lines_across(*rectified, rectification(rig).along),) if lines else rectified
        for path, image in zip(targets, drawn, strict=True):
            write_file(path, encode_png(image), overwrite)
        yield targets
