"""`lmkit.calibrate` and `lmkit.locate`."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import TYPE_CHECKING

from lmkit.api.arguments import ImageLike, PathLike, as_map, as_rig
from lmkit.api.detecting import Detector
from lmkit.model.detections import Detections

if TYPE_CHECKING:
    from lmkit.calibration.stereo import StereoCalibration
    from lmkit.geometry.stereo_rig import StereoRig
    from lmkit.localization.absolute_pose import LocateOptions
    from lmkit.model.board import BoardSpec
    from lmkit.model.estimate import PoseEstimate
    from lmkit.model.landmark_map import LandmarkMap


def calibrate(
    left: PathLike,
    right: PathLike,
    board: str | BoardSpec,
    *,
    model: str = "auto",
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> StereoCalibration:
    """Calibrate a stereo camera from pairs of images of a board.

    Args:
        left, right: folders or globs of images, paired by sorted name.
        board: such as ``"chessboard:9x6:25mm"`` (inner corners).
        model: ``"pinhole"``, ``"rational"``, ``"fisheye"``, or ``"auto"``.
        progress: called with the number of pairs done, and of how many.

    Raises:
        InputError: no pairs, another board, or pairs that do not agree.

    Examples:
        >>> import lmkit
        >>> result = lmkit.calibrate("boards/left", "boards/right", "chessboard:9x6:25mm")
        >>> 0.05 < result.rig.baseline_m < 0.5
        True
    """
    from lmkit.calibration.stereo import calibrate_stereo
    from lmkit.io.image_sources import list_pairs
    from lmkit.model.board import BoardSpec
    from lmkit.pipelines.board_views import find_board_pairs

    spec = BoardSpec.parse(board) if isinstance(board, str) else board
    pairs = find_board_pairs(list_pairs(os.fspath(left), os.fspath(right)), spec, progress)
    return calibrate_stereo(pairs.views, pairs.board, pairs.image_size, model, pairs.rejected)


def locate(
    left: ImageLike | Detections,
    right: ImageLike | Detections | None = None,
    *,
    rig: StereoRig | PathLike,
    landmarks: LandmarkMap | PathLike,
    profile: str = "balanced",
    options: LocateOptions | None = None,
) -> PoseEstimate:
    """Locate the rig in the map by a stereo pair, or by the left camera's image alone.

    Args:
        left, right: images, (H,W,3) BGR or paths, or detections made before.
        rig: the calibrated rig, or its file.
        landmarks: the landmark map, or its file.
        profile: of the detector; see `Detector`.
        options: thresholds of localization, a prior on the pose.

    Raises:
        InputError: an image is not of the rig's size, or cannot be read.

    Examples:
        >>> import lmkit
        >>> estimate = lmkit.locate("left.png", "right.png", rig="rig.yaml", landmarks="map.yaml")
        >>> str(estimate.status)
        'ok'
        >>> estimate.sigma_m < 0.02
        True
    """
    from lmkit.localization.absolute_pose import locate_camera, locate_rig
    from lmkit.localization.base_pose import with_base
    from lmkit.localization.contradiction import with_cause

    cameras, hung = as_rig(rig), as_map(landmarks)
    families = hung.families
    seen = []
    for image, camera in ((left, cameras.left), (right, cameras.right)):
        if image is None:
            continue
        if not isinstance(image, Detections):
            image = Detector(families, camera=camera, profile=profile).detect(image)
        seen.append(image)
    if len(seen) == 1:
        estimate = locate_camera(seen[0], cameras.left, hung, options)
    else:
        estimate = locate_rig(seen[0], seen[1], cameras, hung, options)
    others = seen[1] if len(seen) > 1 else ()
    return with_base(with_cause(estimate, seen[0], others, cameras, hung), cameras)
