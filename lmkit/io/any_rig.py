"""Rigs in whatever form they come: lmkit's own, OpenCV's, ROS's or Kalibr's, recognized by their content."""

from __future__ import annotations

import warnings
from pathlib import Path

from lmkit.errors import InputWarning
from lmkit.geometry.rig import AnyRig
from lmkit.geometry.rig_plausibility import require_plausible, rig_warnings
from lmkit.io.document_head import head_of
from lmkit.io.documents import is_folder, read_text
from lmkit.io.rig import read_rig
from lmkit.io.ros_camera_info import FILES

# Keys that only camera_info has, and keys that only files of OpenCV have.
ROS_KEYS = frozenset({"distortion_model", "camera_model", "rectification_matrix", "projection_matrix"})
OPENCV_KEYS = frozenset({"M1", "K1", "cameraMatrix1", "cameraMatrixL", "camera_matrix_left", "camera_matrix"})
KINDS = ("lmkit", "opencv", "ros", "kalibr")


def read_any_rig(path: Path) -> AnyRig:
    """A rig from a file, or from a folder with ROS's left.yaml and right.yaml.

    Raises:
        InputError: not readable, or no such kind of file is valid; a baseline that no camera has.

    Warns:
        InputWarning: what is possible, but seldom meant, such as a right camera left of the left one.
    """
    rig = _read(path)
    require_plausible(rig, str(path))
    for sentence in rig_warnings(rig, str(path)):
        warnings.warn(InputWarning(sentence), stacklevel=2)
    return rig


def _read(path: Path) -> AnyRig:
    if is_folder(path):
        from lmkit.io.ros_camera_info import read_camera_infos

        return read_camera_infos(path / FILES[0], path / FILES[1])
    text = read_text(path, "rig file")
    head = head_of(text)
    if head.format.startswith("lmkit-"):
        return read_rig(path)
    if "cam0" in head.keys:
        from lmkit.io.kalibr import read_camchain

        return read_camchain(path)
    if head.keys & ROS_KEYS and head.keys & {"camera_matrix", "K", "k"}:
        from lmkit.io.ros_camera_info import read_camera_info

        return read_camera_info(path)
    if text.lstrip().startswith(("%YAML", "<?xml", "<opencv_storage")) or head.keys & OPENCV_KEYS:
        from lmkit.io.opencv_rig import read_opencv_rig

        return read_opencv_rig(path)
    return read_rig(path)
