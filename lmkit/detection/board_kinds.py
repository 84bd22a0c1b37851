"""Recognition of the board or pattern in images that do not show the expected calibration board."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import cv2
import numpy as np

from lmkit.arrays import ByteArray
from lmkit.model.board import KALIBR_BORDER

MIN_MARKERS = 4  # in the median image
MIN_CIRCLES = 20
MOST_UNLIKE = 0.5  # of the sizes of most circles, relative to the median
_LONGER_SIDE = 1200
_DICTIONARIES = ("DICT_4X4_1000", "DICT_5X5_1000", "DICT_6X6_1000", "DICT_7X7_1000", "DICT_ARUCO_ORIGINAL")


def shown_instead(images: Sequence[ByteArray], expected: str = "") -> tuple[str, str] | None:
    """Kind of board that most of the images show, and advice; None if it is not recognized.

    Args:
        images: (H,W,3) BGR, 8 bit.
        expected: dictionary of the board that was given; its markers are of that board, of which too little is seen.
    """
    grays = [_small(image) for image in images]
    if _median(_tags(gray) for gray in grays) >= MIN_MARKERS:
        return "an AprilGrid", "give --board aprilgrid:6x6:22mm:0.3 (tags, side, gap over side)"
    cells = expected.rpartition("_")[0]
    for name in (name for name in _DICTIONARIES if name.rpartition("_")[0] != cells):
        if _median(_markers(gray, name, 1) for gray in grays) >= MIN_MARKERS:
            return (
                f"ArUco markers ({name})",
                "give --board charuco:8x6:30mm:22mm:DICTIONARY (squares, square, marker)",
            )
    if _median(max(_circles(gray), _circles(255 - gray)) for gray in grays) >= MIN_CIRCLES:
        return "a grid of circles", "which is not read: print lmkit board chessboard:9x6:30mm or a ChArUco board"
    return None


def _small(image: ByteArray) -> ByteArray:
    scale = min(1.0, _LONGER_SIDE / max(image.shape[:2]))
    gray = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    return np.asarray(cv2.resize(gray, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _median(counts: Iterable[int]) -> float:
    return float(np.median(list(counts)))


def _tags(gray: ByteArray) -> int:
    return _markers(gray, "DICT_APRILTAG_36h11", KALIBR_BORDER)


def _markers(gray: ByteArray, name: str, border: int) -> int:
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = border
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    ids = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(gray)[1]
    return 0 if ids is None else len(np.unique(ids))


def _circles(gray: ByteArray) -> int:
    """Number of dark discs of like sizes."""
    sizes = np.array([point.size for point in cv2.SimpleBlobDetector.create(_blobs()).detect(gray)])
    if not len(sizes):
        return 0
    return int((np.abs(sizes / np.median(sizes) - 1) < MOST_UNLIKE).sum())


def _blobs() -> cv2.SimpleBlobDetector.Params:
    parameters = cv2.SimpleBlobDetector.Params()
    parameters.filterByCircularity, parameters.minCircularity = True, 0.85
    parameters.filterByArea, parameters.minArea, parameters.maxArea = True, 30.0, 20000.0
    return parameters
