"""`lmkit.Detector`, `lmkit.detect` and `lmkit.draw`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from lmkit.api.arguments import (
    GRAY,
    Families,
    ImageLike,
    ImageWarning,
    PathLike,
    as_families,
    as_image,
    as_map,
    as_rig,
    require_type,
)
from lmkit.arrays import ByteArray, FloatArray
from lmkit.errors import InputError, warn_caller
from lmkit.geometry.camera import CameraModel
from lmkit.model.detections import Detections

if TYPE_CHECKING:
    from lmkit.detection.config import DetectOptions, DetectorConfig
    from lmkit.geometry.rig import AnyRig
    from lmkit.model.estimate import PoseEstimate
    from lmkit.model.landmark_map import LandmarkMap
    from lmkit.model.observation import Detection

MOST_ENLARGED = 16
COLORS_EVERY = 32  # empty images, of which one is searched again for swapped colors


class Detector:
    """Finds landmarks in images with fixed settings; warns once about images without color or with swapped channels.

    Args:
        families: names such as ``"lm8"``, ``"lm8,lm4"``, or a list of them.
        camera: the calibrated camera of the images; its distortion is then used instead of an estimate.
        profile: ``"accurate"``, ``"balanced"``, ``"fast"`` or a :class:`DetectorConfig`.
        strictness: ``"strict"`` (fewer wrong codes), ``"default"`` or ``"eager"`` (more small landmarks).
        inverted_tags: also read AprilTags and ArUco markers in white on black.

    Examples:
        >>> import lmkit
        >>> detector = lmkit.Detector(families="lm8", profile="fast")
        >>> detector.detect(lmkit.read_image("left.png"))[0].id
        LandmarkId('lm8', ...)
    """

    def __init__(
        self,
        families: Families = "lm8",
        *,
        camera: CameraModel | None = None,
        profile: str | DetectorConfig = "balanced",
        strictness: str = "default",
        inverted_tags: bool = False,
    ) -> None:
        if camera is not None:
            hint = "give a CameraModel, such as lmkit.read_rig(...).left"
            require_type(camera, CameraModel, "camera", hint)
        options = detect_options(families, camera, profile, strictness)
        self.options = replace(options, inverted_tags=inverted_tags)
        self._silent = not options.ring_families  # nothing more is to be said of colors
        self._empty = 0

    def detect(self, image: ImageLike, near: Sequence[Detection] | FloatArray | None = None) -> Detections:
        """Detections of one image, largest first.

        Args:
            image: (H,W,3) BGR, 8 bit, (H,W) gray, 8 or 16 bit, or the path of an image file.
            near: where landmarks are expected: detections of the last image, or (N,4,2) corners in pixels.  Only
                windows around them are searched, whatever the image's size.

        Raises:
            InputError: not such an image, or not of the camera's size.
        """
        from lmkit.detection.detector import detect_landmarks

        pixels = as_image(image)
        corners = None if near is None else _corners_of(near)
        found = detect_landmarks(pixels, self.options, corners)
        if not self._silent:
            colored = {family.name for family in self.options.ring_families}
            if any(detection.id.family in colored for detection in found):
                self._silent = True
            elif not found and near is None:
                self._empty += 1
                # The first images, then fewer: each of these is searched twice.
                if self._empty & (self._empty - 1) == 0 or self._empty % COLORS_EVERY == 0:
                    self._silent = _warn_of_colors(pixels, self.options)
        return Detections(found, (pixels.shape[1], pixels.shape[0]))


def detect(
    image: ImageLike,
    families: Families = "lm8",
    *,
    camera: CameraModel | None = None,
    profile: str | DetectorConfig = "balanced",
    strictness: str = "default",
) -> Detections:
    """Detect the landmarks of one image.

    Args:
        image: (H,W,3) BGR, 8 bit, or the path of an image file.
        families, camera, profile, strictness: settings of the `Detector`, which is faster for many images.

    Returns:
        Detections, largest first.

    Raises:
        InputError: not such an image, or not of the camera's size.

    Examples:
        >>> import lmkit
        >>> detections = lmkit.detect("left.png")
        >>> detections.corners.shape[1:]
        (4, 2)
    """
    return Detector(families, camera=camera, profile=profile, strictness=strictness).detect(image)


def _corners_of(near: Sequence[Detection] | FloatArray) -> FloatArray:
    """(N,4,2) corners."""
    hint = "give a list of detections, or an array (N,4,2) of corners in pixels"
    if not isinstance(near, np.ndarray | Sequence) or isinstance(near, str):
        raise InputError("bad_prediction", f"near is of type {type(near).__name__}", hint)
    corners = near if isinstance(near, np.ndarray) else [getattr(one, "corners", one) for one in near]
    try:
        found = np.asarray(corners, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError("bad_prediction", "near contains values that are not detections", hint) from None
    if found.size and found.shape[1:] != (4, 2):
        raise InputError("bad_prediction", f"near has the shape {found.shape}", hint)
    if not np.isfinite(found).all():
        raise InputError("bad_prediction", "near contains corners that are not finite", "leave those landmarks out")
    return found.reshape(-1, 4, 2)


def detect_options(
    families: Families, camera: CameraModel | None, profile: str | DetectorConfig, strictness: str = "default"
) -> DetectOptions:
    """Options of the detector.

    Raises:
        InputError: an unknown family, profile or strictness.
    """
    from lmkit.detection.acceptance import STRICTNESSES
    from lmkit.detection.config import PROFILES, DetectOptions, DetectorConfig

    config = profile if isinstance(profile, DetectorConfig) else None
    if isinstance(profile, str):
        config = PROFILES.get(profile)
    if config is None:
        raise InputError("bad_profile", f"profile {profile!r} is unknown", f"choose {', '.join(PROFILES)}")
    if not isinstance(strictness, str) or strictness not in STRICTNESSES:
        known = ", ".join(STRICTNESSES)
        raise InputError("bad_strictness", f"strictness {strictness!r} is unknown", f"choose {known}")
    return DetectOptions(as_families(families), config, STRICTNESSES[strictness], camera=camera)


def draw(
    image: ImageLike,
    detections: Sequence[Detection] = (),
    estimate: PoseEstimate | None = None,
    *,
    rig: AnyRig | PathLike | None = None,
    landmarks: LandmarkMap | PathLike | None = None,
    enlarge: int = 1,
) -> ByteArray:
    """Draw detections, and the estimated pose, on an image.

    Args:
        image: (H,W,3) BGR, 8 bit, or a path; it is not changed.
        detections: of this image.
        estimate: pose of the rig, written into the image.
        rig, landmarks: with both, or their files, the map's landmarks are drawn where the estimate puts them in the
            left image.
        enlarge: factor of the output's size, a whole number, for small images.

    Returns:
        (H * enlarge, W * enlarge, 3) BGR.

    Raises:
        InputError: not an image, an argument of another type, or a map that cannot be drawn since rig, landmarks and
            estimate are not all given.

    Examples:
        >>> import lmkit
        >>> image = lmkit.read_image("left.png")
        >>> lmkit.draw(image, lmkit.detect(image)).shape == image.shape
        True
    """
    from lmkit.visualization.overlay import draw_estimate, draw_landmarks, draw_located

    pixels = as_image(image)
    _require_drawable(detections, estimate, enlarge)
    if (rig is not None or landmarks is not None) and (rig is None or landmarks is None or estimate is None):
        given = (("estimate", estimate), ("rig", rig), ("landmarks", landmarks))
        missing = " and ".join(name for name, value in given if value is None)
        hint = "give estimate, rig and landmarks together, or leave rig and landmarks out"
        raise InputError("not_together", f"the map cannot be drawn without {missing}", hint)
    if estimate is None:
        return draw_landmarks(pixels, detections, enlarge)
    if rig is None or landmarks is None:
        canvas = draw_landmarks(pixels, detections, enlarge)
        draw_estimate(canvas, estimate)
        return canvas
    return draw_located(pixels, detections, as_rig(rig).left, estimate, as_map(landmarks), enlarge)


def _require_drawable(detections: Sequence[Detection], estimate: PoseEstimate | None, enlarge: int) -> None:
    from lmkit.model.estimate import PoseEstimate
    from lmkit.model.observation import Detection

    require_type(detections, Sequence, "detections", "give the detections of lmkit.detect; the estimate comes third")
    for one in detections:
        require_type(one, Detection, "detections", "give a list of detections, as lmkit.detect returns it")
    if estimate is not None:
        require_type(estimate, PoseEstimate, "estimate", "give the result of lmkit.locate")
    if not isinstance(enlarge, int | np.integer) or not 1 <= enlarge <= MOST_ENLARGED:
        hint = f"give a whole number from 1 to {MOST_ENLARGED}"
        raise InputError("out_of_range", f"enlarge {enlarge!r} is not a factor of the image's size", hint)


def _warn_of_colors(image: ByteArray, options: DetectOptions) -> bool:
    """Warn where an image without detections is gray, or has detections once red and blue are swapped."""
    from lmkit.detection.detector import detect_landmarks
    from lmkit.detection.windows import is_colorless

    if is_colorless(image):
        warn_caller(ImageWarning(GRAY))
        return True
    if detect_landmarks(np.ascontiguousarray(image[:, :, ::-1]), options):
        text = "landmarks are found once red and blue are swapped: give BGR, such as image[:, :, ::-1] of RGB"
        warn_caller(ImageWarning(text))
        return True
    return False
