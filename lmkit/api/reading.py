"""`lmkit.read_*` and `lmkit.write_*`: files in and out."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from lmkit.api.arguments import Families, PathLike, as_meters, as_path, as_rate, as_rig, family_names, require_type

if TYPE_CHECKING:
    from lmkit.arrays import ByteArray
    from lmkit.geometry.rig import AnyRig
    from lmkit.model.landmark_map import LandmarkMap
    from lmkit.model.recording import Recording
    from lmkit.model.tracked_trajectory import TrackedTrajectory
    from lmkit.model.trajectory import Trajectory


def read_image(path: PathLike) -> ByteArray:
    """Read an image file.

    Args:
        path: PNG, JPEG, TIFF, BMP, WebP or PNM file.

    Returns:
        (H,W,3) BGR, 8 bit, as OpenCV has it.

    Raises:
        InputError: no such file, or not an image.

    Examples:
        >>> import lmkit
        >>> lmkit.read_image("left.png").shape
        (480, 640, 3)
    """
    from lmkit.io.images import read_image

    return read_image(as_path(path))


def read_rig(path: PathLike) -> AnyRig:
    """Read a calibrated camera rig: of lmkit, OpenCV, ROS or Kalibr.

    Args:
        path: file, or the folder with ROS's left.yaml and right.yaml.

    Raises:
        InputError: not readable, or not a rig.

    Examples:
        >>> import lmkit
        >>> rig = lmkit.read_rig("rig.yaml")
        >>> rig.left.image_size
        (640, 480)
    """
    from lmkit.io.any_rig import read_any_rig

    return read_any_rig(as_path(path))


def read_map(path: PathLike, *, family: str | None = None, size: float | str | None = None) -> LandmarkMap:
    """Read a landmark map: of lmkit or of another program (docs/formats.md lists them).

    Args:
        path: YAML, JSON or text file.
        family: family of the markers, if the file does not state it, such as ``"tag16h5"``.
        size: size of the markers, if the file does not state it: meters, or text with a unit.

    Raises:
        InputError: not readable, not a map, or a map that states another family or size.

    Examples:
        >>> import lmkit
        >>> landmarks = lmkit.read_map("map.yaml")
        >>> len(landmarks)
        14
    """
    from lmkit.io.external_maps import read_any_map
    from lmkit.io.marker_maps import MarkerDefaults

    return read_any_map(as_path(path), MarkerDefaults(family, None if size is None else as_meters(size, "size")))


def read_trajectory(path: PathLike) -> Trajectory:
    """Read a trajectory in TUM's format: ``time x y z qx qy qz qw`` a line, seconds and meters.

    Args:
        path: text file; the CSV of EuRoC and TUM-VI (nanoseconds, quaternion w first by its header) is read, too.

    Raises:
        InputError: not readable, a line that is no pose, or times that do not increase; names the line.

    Examples:
        >>> import lmkit
        >>> lmkit.read_trajectory("truth.tum").positions.shape[1]
        3
    """
    from lmkit.io.trajectory import read_trajectory

    return read_trajectory(as_path(path))


def read_recording(
    *images: PathLike,
    rig: AnyRig | PathLike | None = None,
    detections: PathLike | None = None,
    readings: PathLike | None = None,
    odometry: PathLike | None = None,
    gyro: PathLike | None = None,
    wheel_track: float | str | None = None,
    families: Families = "lm8",
    hz: float | None = None,
) -> Recording:
    """Read a recording: images of all cameras, or saved detections, or range and bearing readings, and odometry.

    Args:
        images: one folder, glob or video per camera of ``rig``, grouped by sorted name.
        rig: the rig, or its file; needed for images, and for detections unless they are of a stereo pair.
        detections: CSV of detections, in place of images.
        readings: CSV of ranges and bearings, in place of images.
        odometry: CSV of wheel odometry, or TUM poses of visual odometry.
        gyro: CSV of the yaw rate.
        wheel_track: distance between the wheels, meters or text with a unit.
        families: landmark families to detect in images; for detections and readings, the families of bare codes: any
            kind of marker.
        hz: frames per second, if file names contain no times.

    Raises:
        InputError: not readable, or arguments that cannot be combined.

    Examples:
        >>> import lmkit
        >>> lmkit.read_recording(detections="detections.csv", odometry="odometry.csv", gyro="gyro.csv")
        Recording(... frames, ... s, wheel odometry, gyro)
    """
    from lmkit.pipelines.detect_recording import open_recording

    return open_recording(
        [os.fspath(as_path(source, "images")) for source in images],
        rig=None if rig is None else as_rig(rig),
        detections=None if detections is None else as_path(detections),
        readings=None if readings is None else as_path(readings),
        odometry=None if odometry is None else as_path(odometry),
        gyro=None if gyro is None else as_path(gyro),
        wheel_track_m=None if wheel_track is None else as_meters(wheel_track, "wheel_track"),
        families=family_names(families, detected=bool(images)),
        hz=as_rate(hz),
    ).read()


def write_rig(rig: AnyRig, path: PathLike, *, overwrite: bool = False) -> None:
    """Write a rig file (YAML, format ``lmkit-rig/1``), whole or not at all.

    Args:
        rig: the calibrated rig.
        path: the file to write.
        overwrite: replace an existing file.

    Raises:
        InputError: the file exists, or cannot be written.

    Examples:
        >>> import lmkit
        >>> lmkit.write_rig(lmkit.read_rig("rig.yaml"), "copy.yaml")
    """
    from lmkit.geometry.rig import Rig
    from lmkit.geometry.stereo_rig import StereoRig
    from lmkit.io.files import write_file
    from lmkit.io.rig import rig_to_yaml

    require_type(rig, (Rig, StereoRig), "rig", "give a rig, such as lmkit.read_rig(...)")
    write_file(as_path(path), rig_to_yaml(rig), overwrite)


def write_map(landmarks: LandmarkMap, path: PathLike, *, overwrite: bool = False) -> None:
    """Write a landmark map (YAML, format ``lmkit-map/1``), whole or not at all.

    Args:
        landmarks: the map.
        path: the file to write.
        overwrite: replace an existing file.

    Raises:
        InputError: the file exists, or cannot be written; a family or code does not exist.

    Examples:
        >>> import lmkit
        >>> lmkit.write_map(lmkit.read_map("map.yaml"), "copy_of_map.yaml")
    """
    from lmkit.io.files import write_file
    from lmkit.io.landmark_map import map_to_yaml, require_readable
    from lmkit.model.landmark_map import LandmarkMap

    require_type(landmarks, LandmarkMap, "landmarks", "give a map, such as that of lmkit.survey(...).landmarks")
    require_readable(landmarks)
    write_file(as_path(path), map_to_yaml(landmarks), overwrite)


def write_trajectory(trajectory: Trajectory | TrackedTrajectory, path: PathLike, *, overwrite: bool = False) -> None:
    """Write a trajectory.

    Args:
        trajectory: poses with times.
        path: the file to write.  ``.csv`` of a tracked trajectory: every frame, with status and standard deviations
            (docs/formats.md).  Any other name: TUM's format; of a tracked trajectory, the poses with status ``ok``.
        overwrite: replace an existing file.

    Raises:
        InputError: the file exists, or cannot be written.

    Examples:
        >>> import lmkit
        >>> lmkit.write_trajectory(lmkit.read_trajectory("truth.tum"), "copy.tum")
    """
    from lmkit.io.files import write_file
    from lmkit.io.trajectory import poses_to_tum
    from lmkit.model.tracked_trajectory import TrackedTrajectory, tracked_csv
    from lmkit.model.trajectory import Trajectory

    file, hint = as_path(path), "give a trajectory, such as the result of lmkit.track"
    require_type(trajectory, (Trajectory, TrackedTrajectory), "trajectory", hint)
    if isinstance(trajectory, Trajectory):
        poses = [(float(t), trajectory.pose(k, "map", "base")) for k, t in enumerate(trajectory.times_s)]
    elif file.suffix.lower() == ".csv":
        write_file(file, tracked_csv(trajectory), overwrite)
        return
    else:
        poses = trajectory.sure
    write_file(file, poses_to_tum(poses), overwrite)
