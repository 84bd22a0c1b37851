"""The pose of one frame of a rig from its images, with a second search at predicted places of undetected landmarks.

A single small landmark determines a camera's position to some centimeters.  Often others are in view, but their
margins are too low for acceptance.  With a pose, a reading of the expected code at the expected place is accepted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from lmkit.arrays import ByteArray
from lmkit.detection.acceptance import EAGER
from lmkit.detection.config import DetectOptions
from lmkit.detection.detector import detect_landmarks
from lmkit.geometry.rig import AnyRig, mounted_cameras
from lmkit.localization.absolute_pose import LocateOptions, locate_camera, locate_rig
from lmkit.localization.contradicted_prior import without_contradicted_prior
from lmkit.localization.contradiction import with_cause
from lmkit.localization.expected_landmarks import Expected, ExpectedLandmarks, is_wholly_inside
from lmkit.model.estimate import PoseEstimate
from lmkit.model.landmark_id import LandmarkId
from lmkit.model.landmark_map import LandmarkMap
from lmkit.model.observation import Detection
from lmkit.model.pose_status import PoseStatus

SURE_M = 0.005  # with a smaller standard deviation, more landmarks gain little
MOST_WINDOWS = 6  # per image

Seen = Sequence[Sequence[Detection]]


@dataclass(frozen=True)
class FrameImage:
    """Pixels of one image and the options of its detection."""

    pixels: ByteArray
    options: DetectOptions


def locate_frame(
    images: Sequence[FrameImage | None], seen: Seen, rig: AnyRig, landmarks: LandmarkMap, options: LocateOptions
) -> tuple[PoseEstimate, Seen]:
    """The estimate of one frame, and the detections of the frame.

    Args:
        images: of all cameras, or of the first one; None for a camera with detections only.
        seen: detections in them.
    """
    estimate = _estimate(seen, rig, landmarks, options)
    more = _with_expected(images, seen, estimate, rig, landmarks)
    if more is not None:
        again = _estimate(more, rig, landmarks, options)
        if again.status == PoseStatus.OK or again.status == estimate.status:
            estimate, seen = again, more
    return with_cause(estimate, seen, rig, landmarks), seen


def _estimate(seen: Seen, rig: AnyRig, landmarks: LandmarkMap, options: LocateOptions) -> PoseEstimate:
    models = [camera.model for camera in mounted_cameras(rig)]
    if len(seen) < len(models):
        locate = partial(locate_camera, seen[0], models[0], landmarks)
    else:
        locate = partial(locate_rig, seen, rig, landmarks)
    return without_contradicted_prior(options, locate)


def _with_expected(
    images: Sequence[FrameImage | None], seen: Seen, estimate: PoseEstimate, rig: AnyRig, landmarks: LandmarkMap
) -> Seen | None:
    """Detections, with new ones at places predicted from a pose; None without new ones."""
    sigma, T = estimate.sigma_m, estimate.T_map_camera
    if T is None or sigma is None or sigma < SURE_M:
        return None
    expected = ExpectedLandmarks(rig, landmarks)
    more: list[Sequence[Detection]] = []
    for index, (image, found) in enumerate(zip(images, seen, strict=True)):
        known = {d.id for d in found}
        places, _ = expected.in_camera(index, T)
        more.append(found if image is None else [*found, *_found_at(image, places, known)])
    return more if any(len(a) > len(b) for a, b in zip(more, seen, strict=True)) else None


def _found_at(image: FrameImage, places: Expected, known: set[LandmarkId]) -> list[Detection]:
    """Readings around expected places with the lowest acceptance limit, without known ones."""
    width, height = image.pixels.shape[1], image.pixels.shape[0]
    missing = {i: quad for i, quad in places.items() if i not in known and is_wholly_inside(quad, (width, height))}
    near = list(missing.values())[:MOST_WINDOWS]
    if not near:
        return []
    options = replace(image.options, rule=EAGER)
    return [d for d in detect_landmarks(image.pixels, options, np.array(near)) if d.id in missing]
