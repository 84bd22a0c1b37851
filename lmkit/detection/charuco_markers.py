"""ChArUco boards by lmkit's own reader of square markers, which reads smaller and dimmer ones than OpenCV's."""

from __future__ import annotations

import cv2
import numpy as np

from lmkit.arrays import BoolArray, ByteArray, FloatArray, IntArray
from lmkit.detection.config import ACCURATE, DetectOptions
from lmkit.detection.detector import detect_landmarks
from lmkit.geometry.homography import transform_points
from lmkit.model.board import BoardSpec
from lmkit.model.charuco import charuco_board
from lmkit.model.square_marker import SQUARE_FAMILIES, TURNED_BY_OPENCV

LEAST_MARKERS = 3
BESIDE = 0.75  # squares from a corner to the middles of the two markers beside it, 0.71, and some more
NEARBY = 2.3  # squares: at larger distances the lens distortion matters
AGREEING = 0.3  # of a marker's side, between a marker and its place predicted from the others


def corners_by_markers(image: ByteArray, board: BoardSpec) -> tuple[IntArray, FloatArray]:
    """Numbers (N,) and pixels (N,2) of the inner corners of (H,W,3) BGR whose two markers are read."""
    nothing = np.zeros(0, np.int64), np.zeros((0, 2))
    layout = charuco_board(board)
    family = next(f for f in SQUARE_FAMILIES.values() if f"DICT_{f.dictionary}".upper() == board.dictionary)
    turned = TURNED_BY_OPENCV if family.is_apriltag else 0
    # Meters on the board, x right and y down from its corner.
    markers = np.roll(np.asarray(layout.getObjPoints(), np.float64)[:, :, :2], turned, axis=1)
    read = np.full(len(markers), False)
    seen = np.zeros(markers.shape)
    for marker in detect_landmarks(image, DetectOptions((family,), config=ACCURATE)):
        place = marker.code - board.first_code
        if 0 <= place < len(markers):
            # A code read twice is once something else.
            read[place], seen[place] = not seen[place].any(), marker.corners
    read &= _agreeing(markers, seen, read)
    if read.sum() < LEAST_MARKERS:
        return nothing
    inner = np.asarray(layout.getChessboardCorners(), np.float64)[:, :2]
    apart = np.linalg.norm(inner[:, None] - markers.mean(axis=1)[None], axis=2) / (board.square_mm / 1000)
    numbers = np.flatnonzero(((apart < BESIDE) & read).sum(axis=1) == 2)
    corners = []
    for number in numbers.tolist():
        near = (apart[number] < NEARBY) & read
        H, _ = cv2.findHomography(markers[near].reshape(-1, 2), seen[near].reshape(-1, 2), 0)
        corners.append(transform_points(np.asarray(H, np.float64), inner[number : number + 1])[0])
    return (numbers, np.array(corners)) if corners else nothing


def _agreeing(markers: FloatArray, seen: FloatArray, read: BoolArray) -> BoolArray:
    """(N,) markers at the places predicted from most of the others."""
    agree = np.full(len(markers), False)
    if read.sum() < LEAST_MARKERS:
        return agree
    side = float(np.linalg.norm(np.diff(seen[read], axis=1), axis=2).mean())
    H, _ = cv2.findHomography(markers[read].reshape(-1, 2), seen[read].reshape(-1, 2), cv2.RANSAC, AGREEING * side)
    if H is None:
        return agree
    there = transform_points(np.asarray(H, np.float64), markers.reshape(-1, 2)).reshape(seen.shape)
    return np.asarray(np.linalg.norm(there - seen, axis=2).max(axis=1) < 2 * AGREEING * side)
