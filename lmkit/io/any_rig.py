"""Rig files of lmkit, OpenCV, ROS and Kalibr, recognized by their content."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

from lmkit.errors import InputError, InputWarning, warn_caller
from lmkit.geometry.rig import AnyRig
from lmkit.geometry.rig_plausibility import require_plausible, rig_warnings
from lmkit.geometry.stereo_rig import StereoRig
from lmkit.io.calibration_names import names_a_camera
from lmkit.io.document_head import DocumentHead, head_of
from lmkit.io.documents import is_folder, read_text
from lmkit.io.map_kinds import program_of_map
from lmkit.io.rig import read_rig
from lmkit.io.single_cameras import is_single_camera, read_single_camera

RigKind = TypeVar("RigKind", bound=AnyRig)

# Keys that only camera_info has.
ROS_KEYS = frozenset({"distortion_model", "camera_model", "rectification_matrix", "projection_matrix"})
# Keys of other files about cameras: the kind of file, and the file to give instead.
_NO_RIGS = {
    "relative_config_imucam": ("settings of OpenVINS", "give its kalibr_imucam_chain.yaml"),
    "cam0_calib": ("settings of VINS", "give the file that cam0_calib names"),
    "value0": ("Basalt's calibration, which is not read", "give the camchain YAML of Kalibr"),
    "BoardSize_Width": ("settings of OpenCV's calibration sample", "give the file that it writes"),
    "Settings": ("settings of OpenCV's calibration sample", "give the file that it writes"),
}
_BY_HAND = "of other tools, copy image_size, K and distortion into a lmkit-rig/1 (docs/formats.md)"
KINDS = ("lmkit", "opencv", "ros", "kalibr")


def read_any_rig(path: Path) -> AnyRig:
    """A rig from a file, or from a folder with ROS's left.yaml and right.yaml.

    Raises:
        InputError: not readable, not a valid rig file, or an implausible baseline.

    Warns:
        InputWarning: unusual values, such as a right camera to the left of the left one.
    """
    return _plausible(_read(path), str(path))


def read_rig_pair(left: Path, right: Path) -> StereoRig:
    """A rig from ROS's two camera_info files, whatever their names.

    Raises:
        InputError: not readable, not valid, or not a stereo pair.

    Warns:
        InputWarning: as `read_any_rig`.
    """
    from lmkit.io.ros_camera_info import read_camera_infos

    return _plausible(read_camera_infos(left, right), f"{left} and {right}")


def _plausible(rig: RigKind, name: str) -> RigKind:
    require_plausible(rig, name)
    for sentence in rig_warnings(rig, name):
        warn_caller(InputWarning(sentence))
    return rig


def _read(path: Path) -> AnyRig:
    if is_folder(path):
        from lmkit.io.ros_camera_info import FILES, read_camera_infos

        for name in FILES:
            if not (path / name).exists():
                hint = (
                    f"give the rig file itself, or a folder with {' and '.join(FILES)} of ROS (camera_info); "
                    "files of other names: lmkit convert LEFT RIGHT --to lmkit -o rig.yaml"
                )
                raise InputError("is_folder", f"{path} is a folder without {name}", hint)
        return read_camera_infos(path / FILES[0], path / FILES[1])
    text = read_text(path, "rig file")
    head = head_of(text)
    if head.format.startswith("lmkit-"):
        return read_rig(path)
    if "cam0" in head.keys:
        from lmkit.io.kalibr import read_camchain

        return read_camchain(path)
    for key, (what, instead) in _NO_RIGS.items():
        if key in head.keys or (text.lstrip().startswith("<") and f"<{key}>" in text):
            raise InputError("not_a_rig", f"{path}: {what}", instead)
    if is_single_camera(head.keys):
        return read_single_camera(path, text)
    if head.keys & ROS_KEYS and head.keys & {"camera_matrix", "K", "k"}:
        from lmkit.io.ros_camera_info import read_camera_info

        return read_camera_info(path)
    if any(key.startswith(("Camera.", "Camera1.")) for key in head.keys):
        raise _orb_slam(path)
    if text.lstrip().startswith(("%YAML", "<?xml", "<opencv_storage")) or names_a_camera(head.keys):
        from lmkit.io.opencv_rig import read_opencv_rig

        return read_opencv_rig(path)
    if not head.format:
        raise _unknown(path, text, head)
    return read_rig(path)


def _unknown(path: Path, text: str, head: DocumentHead) -> InputError:
    """Error for a file that is not a rig of a known kind; names the kind of file that it resembles."""
    kinds = f"lmkit, OpenCV, ROS (camera_info), Kalibr or PhotonVision; {_BY_HAND}"
    if "Camera-system parameters" in text[:2000]:
        return InputError(
            "not_a_rig", f"{path}: Kalibr's report", "give the camchain YAML that Kalibr writes into the same folder"
        )
    if text.lstrip().startswith("# oST version"):
        return InputError("not_a_rig", f"{path}: camera_calibration's INI file", "give ost.yaml from the same folder")
    if program := program_of_map(text, head):
        return InputError("not_a_rig", f"{path}: a map of {program}, not a rig", f"give a rig of {kinds}")
    keys = head.keys
    if "target_type" in keys:
        return InputError("not_a_rig", f"{path}: a calibration target of Kalibr, not a rig", f"give a rig of {kinds}")
    what = f"its keys are {', '.join(sorted(keys)[:6])}" if keys else "it is neither YAML, JSON nor XML"
    return InputError("not_a_rig", f"{path}: not a rig that is known: {what}", f"give a rig of {kinds}")


def _orb_slam(path: Path) -> InputError:
    return InputError(
        "not_a_rig", f"{path}: settings of ORB-SLAM, which are not read", "give the calibration they came from"
    )
