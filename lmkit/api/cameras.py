"""`lmkit.calibrate`, `lmkit.calibrate_base`, `lmkit.calibrate_clocks` and `lmkit.locate`."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from lmkit.api.arguments import (
    ImageLike,
    PathLike,
    as_image,
    as_map,
    as_meters,
    as_path,
    as_recording,
    as_rig,
    require_type,
)
from lmkit.api.detecting import Detector
from lmkit.errors import InputError
from lmkit.model.detections import Detections
from lmkit.model.observation import Detection
from lmkit.model.recording import Odometry

if TYPE_CHECKING:
    from lmkit.calibration.mono import CameraCalibration
    from lmkit.calibration.several_cameras import RigCalibration
    from lmkit.calibration.stereo import StereoCalibration
    from lmkit.geometry.camera import CameraModel
    from lmkit.geometry.rig import AnyRig
    from lmkit.localization.absolute_pose import LocateOptions
    from lmkit.mapping.base_mounting import BaseMounting
    from lmkit.mapping.clock_offsets import ClockOffsets
    from lmkit.model.board import BoardSpec
    from lmkit.model.estimate import PoseEstimate
    from lmkit.model.landmark_map import LandmarkMap
    from lmkit.model.recording import Recording
    from lmkit.pipelines.look_again import FrameImage

Seen = Detections | list[Detection] | tuple[Detection, ...]  # in the image of one camera


def calibrate(
    left: PathLike | Sequence[PathLike],
    right: PathLike | None = None,
    board: str | BoardSpec = "",
    *,
    model: str = "auto",
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> StereoCalibration | CameraCalibration | RigCalibration:
    """Calibrate one camera from images of a board, a stereo camera from pairs of images, or a rig of several cameras.

    Args:
        left: folder or glob of images; of one camera also a video; of three and more cameras a list of folders.
        right: the right camera's images, paired by sorted name; None for one camera.
        board: such as ``"chessboard:9x6:25mm"`` (inner corners).
        model: ``"pinhole"``, ``"rational"``, ``"fisheye"``, or ``"auto"``; ``"fisheye,pinhole"`` for unequal lenses.
        progress: called with the number of images or pairs done, and their total number.

    Raises:
        InputError: no pairs, another board, or pairs that do not agree.

    Examples:
        >>> import lmkit
        >>> result = lmkit.calibrate("boards/left", "boards/right", "chessboard:9x6:25mm")
        >>> result
        StereoCalibration(pinhole, ... pairs, ... px, held out ... px, baseline ... ± ... mm, ...)
        >>> 0.05 < result.rig.baseline_m < 0.5
        True
    """
    from lmkit.calibration.mono import calibrate_camera
    from lmkit.calibration.stereo import calibrate_stereo
    from lmkit.io.image_groups import list_pairs
    from lmkit.model.board import BoardSpec
    from lmkit.pipelines.board_views import find_board_pairs
    from lmkit.pipelines.camera_views import find_board_images
    from lmkit.pipelines.rig_views import calibrate_sources

    spec = BoardSpec.parse(board) if isinstance(board, str) else board
    require_type(spec, BoardSpec, "board", 'give text such as "chessboard:9x6:25mm"')
    require_type(model, str, "model", 'give "pinhole", "rational", "fisheye" or "auto"')
    if not callable(progress):
        raise InputError(
            "wrong_type", "progress is not a function", "give a function of two numbers, or leave it out"
        )
    require_type(left, (str, os.PathLike, Sequence), "left", "give a folder or glob of images, or a list of folders")
    if not isinstance(left, (str, os.PathLike)):
        sources = [os.fspath(as_path(source, "left")) for source in left]
        if len(sources) < 3 or right is not None:
            hint = "give one or two cameras as left and right, and three or more as one list"
            raise InputError("wrong_camera_count", f"a list of {len(sources)} cameras' images is no rig", hint)
        return calibrate_sources(sources, spec, model, progress)
    if right is not None:
        as_path(right, "right")
    if right is None:
        found = find_board_images(os.fspath(left), spec, progress)
        return calibrate_camera(found.views, found.board, found.image_size, model, found.rejected)
    pairs = find_board_pairs(list_pairs(os.fspath(left), os.fspath(right)), spec, progress)
    return calibrate_stereo(
        pairs.views, pairs.board, pairs.image_size, model, pairs.rejected, right_size=pairs.right_size
    )


def calibrate_base(
    recording: Recording,
    rig: AnyRig | PathLike,
    landmarks: LandmarkMap | PathLike,
    *,
    height: float | str | None = None,
) -> BaseMounting:
    """Compute the pose of every camera on the robot, from a recording with wheel odometry in a mapped room.

    Args:
        recording: frames of the cameras, and wheel odometry.
        rig: the cameras, or their file; only the baseline of a stereo pair is used of their poses.
        landmarks: the landmark map, or its file.
        height: of the first camera above the base's origin, meters or text with a unit; None: the base lies at z = 0.

    Returns:
        The rig with its poses, and for each camera the covariance and the quantities that are not determined.

    Raises:
        InputError: a camera sees too little of the map, or the robot stands still.

    Examples:
        >>> import lmkit
        >>> recording = lmkit.read_recording(detections="detections.csv", odometry="odometry.csv", gyro="gyro.csv")
        >>> found = lmkit.calibrate_base(recording, "rig.yaml", "map.yaml")
        >>> found
        BaseMounting(left at x ... y ... z ... m, ... px, ... outliers)
        >>> found.to_dict()["cameras"][0]["name"]
        'left'
    """
    from lmkit.mapping.base_mounting import find_base_mounting
    from lmkit.odometry.wheel_odometry import MotionModel
    from lmkit.pipelines.recording_checks import require_plausible_recording

    cameras = as_rig(rig)
    recording = as_recording(recording, cameras)
    if not recording.frames:
        raise InputError("no_frames", "the recording has no frames", "give images or detections")
    if not isinstance(recording.odometry, Odometry):
        raise InputError(
            "no_odometry", "camera poses on the robot need wheel odometry", "read the recording with odometry"
        )
    require_plausible_recording(recording)
    height_m = None if height is None else as_meters(height, "height")
    motion = MotionModel(recording.odometry, recording.gyro)
    return find_base_mounting(recording.frames, cameras, as_map(landmarks), motion, height_m)


def calibrate_clocks(recording: Recording, rig: AnyRig | PathLike, landmarks: LandmarkMap | PathLike) -> ClockOffsets:
    """Estimate the time offset of every camera: exposure time minus time stamp, on the first camera's clock.

    Args:
        recording: frames of the cameras, and odometry; the robot drives and turns.
        rig: the calibrated cameras, or their file; time offsets in it are not used.
        landmarks: the landmark map, or its file.

    Returns:
        The rig with its time offsets, and the standard deviation of each.

    Raises:
        InputError: only one camera, a camera that sees no landmark of the map, or no odometry.

    Examples:
        >>> import lmkit
        >>> recording = lmkit.read_recording(detections="detections.csv", odometry="odometry.csv", gyro="gyro.csv")
        >>> found = lmkit.calibrate_clocks(recording, "rig.yaml", "map.yaml")
        >>> found
        ClockOffsets(right ... ± ... ms, ... px)
    """
    from lmkit.api.recordings import motion_of
    from lmkit.mapping.clock_offsets import find_clock_offsets
    from lmkit.pipelines.recording_checks import require_plausible_recording

    cameras = as_rig(rig)
    recording = as_recording(recording, cameras)
    motion = motion_of(recording)
    if not recording.frames:
        raise InputError("no_frames", "the recording has no frames", "give images or detections")
    if motion is None:
        raise InputError("no_odometry", "clock offsets need odometry", "read the recording with odometry")
    require_plausible_recording(recording)
    return find_clock_offsets(recording.frames, cameras, as_map(landmarks), motion)


def locate(
    *images: ImageLike | Seen,
    rig: AnyRig | PathLike,
    landmarks: LandmarkMap | PathLike,
    profile: str = "balanced",
    options: LocateOptions | None = None,
) -> PoseEstimate:
    """Locate the rig in the map from one image per camera, or from the first (left) camera's image alone.

    Args:
        images: (H,W,3) BGR or paths, or detections made before; one per camera, in the order of the rig.
        rig: the calibrated rig, or its file.
        landmarks: the landmark map, or its file.
        profile: of the detector; see `Detector`.
        options: thresholds of localization, a prior on the pose.

    Raises:
        InputError: the number of images is wrong, or an image has another size than in the rig, or cannot be read.

    Examples:
        >>> import lmkit
        >>> estimate = lmkit.locate("left.png", "right.png", rig="rig.yaml", landmarks="map.yaml")
        >>> str(estimate.status)
        'ok'
        >>> estimate.sigma_m < 0.02
        True
    """
    from lmkit.geometry.rig import mounted_cameras
    from lmkit.localization.absolute_pose import LocateOptions
    from lmkit.localization.base_pose import with_base
    from lmkit.pipelines.look_again import locate_frame

    cameras, mapped = as_rig(rig), as_map(landmarks)
    if options is not None:
        require_type(options, LocateOptions, "options", "give lmkit.localization.absolute_pose.LocateOptions(...)")
    models = [camera.model for camera in mounted_cameras(cameras)]
    if len(images) not in (1, len(models)):
        raise InputError(
            "wrong_image_count",
            f"{len(images)} images for a rig of {len(models)} cameras",
            "give one image per camera, in the order of the rig, or the first camera's alone",
        )
    if not len(mapped):
        raise InputError("empty_map", "the map has no landmarks", "survey the place, or give another map")
    seen, pixels = [], []
    for number, (image, camera) in enumerate(zip(images, models, strict=False), start=1):
        found, shown = _detections(image, number, camera, mapped, profile)
        seen.append(found)
        pixels.append(shown)
    estimate, _ = locate_frame(pixels, seen, cameras, mapped, options or LocateOptions())
    return with_base(estimate, cameras)


def _detections(
    image: ImageLike | Seen, number: int, camera: CameraModel, landmarks: LandmarkMap, profile: str
) -> tuple[Sequence[Detection], FrameImage | None]:
    """Detections in the image of camera ``number`` of a rig, counted from 1, and the image, if it is given."""
    from lmkit.pipelines.look_again import FrameImage

    if isinstance(image, Detections):
        if image.image_size is not None:
            camera.require_size(f"the image of detections {number}", image.image_size)
        return image, None
    if not isinstance(image, list | tuple):
        detector = Detector(landmarks.families, camera=camera, profile=profile)
        shown = FrameImage(as_image(image), detector.options)
        return detector.detect(shown.pixels), shown
    for one in image:
        require_type(one, Detection, f"detections {number}", "give detections of lmkit.detect, an image, or its path")
    return image, None
