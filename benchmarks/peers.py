"""lmkit and its peers behind one function: from an image to (code, corners).

Corners are (4,2), top left first, then clockwise, pixel centers at whole numbers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

Found = list[tuple[int, np.ndarray]]


@dataclass(frozen=True)
class Reader:
    """One detector and the markers it reads.

    Attributes:
        marker: ``lm8``, ``tag36h11`` or ``aruco4x4``.
        make: builds the detector; called once.
    """

    marker: str
    make: Callable[[], Callable[[np.ndarray], Found]]


def with_lmkit() -> Callable[[np.ndarray], Found]:
    from lmkit.detection.detector import detect_landmarks

    return lambda image: [(d.code, d.corners) for d in detect_landmarks(image)]


def with_apriltag() -> Callable[[np.ndarray], Found]:
    import pupil_apriltags

    detector = pupil_apriltags.Detector(families="tag36h11", quad_decimate=1.0, nthreads=1)
    detector.tag_families.clear()  # it would free them before the detector that still reads them

    def detect(image: np.ndarray) -> Found:
        found = detector.detect(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))
        # Its corners start top right and run against the clock; its pixel centers lie at halves.
        return [
            (d.tag_id, d.corners[[1, 0, 3, 2]] - 0.5) for d in found if d.hamming <= 1 and d.decision_margin >= 20
        ]

    return detect


def with_aruco() -> Callable[[np.ndarray], Found]:
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_250)
    detector = cv2.aruco.ArucoDetector(dictionary, parameters)

    def detect(image: np.ndarray) -> Found:
        corners, codes, _ = detector.detectMarkers(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))
        return [] if codes is None else [(int(i), c[0]) for i, c in zip(codes.ravel(), corners, strict=True)]

    return detect


def with_locus() -> Callable[[np.ndarray], Found]:
    import locus

    detector = locus.Detector(profile="standard", families=[locus.TagFamily.AprilTag36h11], threads=1)

    def detect(image: np.ndarray) -> Found:
        found = detector.detect(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))
        # Its pixel centers lie at halves.
        return [(int(i), c - 0.5) for i, c in zip(found.ids, found.corners, strict=True)]

    return detect


READERS = {
    "lmkit": Reader("lm8", with_lmkit),
    "AprilTag 3": Reader("tag36h11", with_apriltag),
    "ArUco 4x4": Reader("aruco4x4", with_aruco),
    "locus-tag": Reader("tag36h11", with_locus),
}


def wilson(hits: int, n: int) -> tuple[float, float]:
    """95 % interval of a rate."""
    z = 1.96
    center = (hits + z * z / 2) / (n + z * z)
    half = z * np.sqrt(hits * (n - hits) / n + z * z / 4) / (n + z * z)
    return center - half, center + half
