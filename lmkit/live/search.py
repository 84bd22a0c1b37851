"""Search for landmarks in live images: whole images until located, then windows around their predicted places.

If the windows of all cameras have no landmarks, the rig is elsewhere or they are hidden: whole images are searched.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lmkit.arrays import ByteArray
from lmkit.detection.config import PROFILES, DetectOptions
from lmkit.detection.detector import detect_landmarks
from lmkit.geometry.pose import Pose
from lmkit.geometry.rig import AnyRig, mounted_cameras
from lmkit.live.state import CameraView
from lmkit.localization.expected_landmarks import ExpectedLandmarks, is_wholly_inside
from lmkit.model.families import family_named
from lmkit.model.landmark_map import LandmarkMap

MOST_WINDOWS = 10


class Search:
    """Finds landmarks of the map's families in the images of every camera.

    Args:
        profile: of the detector; the latency budget may choose another for a step.
    """

    def __init__(self, rig: AnyRig, landmarks: LandmarkMap, expected: ExpectedLandmarks) -> None:
        self._cameras = mounted_cameras(rig)
        self._expected = expected
        families = tuple(family_named(name) for name in landmarks.families)
        self._options = {
            name: [DetectOptions(families, config, camera=c.model) for c in self._cameras]
            for name, config in PROFILES.items()
        }

    def views(
        self,
        images: Sequence[ByteArray | None],
        stamps_s: Sequence[float],
        poses: Sequence[Pose] | None,
        whole: frozenset[int],
        profile: str,
    ) -> tuple[CameraView, ...]:
        """Detections of every camera.

        Args:
            poses: T_map_left at the exposure of every camera, predicted; None: whole images are searched.
            whole: cameras whose whole image is always searched.
        """
        views = []
        for k, (image, stamp, camera) in enumerate(zip(images, stamps_s, self._cameras, strict=True)):
            if image is None:
                views.append(CameraView(camera.name, None, stamp))
                continue
            options = self._options[profile][k]
            if poses is None or k in whole:
                found = detect_landmarks(image, options)
                views.append(CameraView(camera.name, image, stamp, tuple(found), search="whole"))
                continue
            expected, _ = self._expected.in_camera(k, poses[k])
            size = camera.model.image_size
            near = [quad for quad in expected.values() if is_wholly_inside(quad, size)][:MOST_WINDOWS]
            found = detect_landmarks(image, options, np.array(near)) if near else []
            views.append(CameraView(camera.name, image, stamp, tuple(found), expected, "near"))
        return tuple(views)

    def again(self, views: Sequence[CameraView], profile: str) -> tuple[CameraView, ...]:
        """The views, after a search of whole images for cameras without detections in their windows."""
        return tuple(
            replace(view, detections=tuple(detect_landmarks(view.image, options)), expected={}, search="whole")
            if view.search == "near" and view.image is not None and not view.detections
            else view
            for view, options in zip(views, self._options[profile], strict=True)
        )
