"""Calibration boards in pictures: chessboard corners by two detectors, ChArUco corners."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from lmkit.arrays import ByteArray, FloatArray
from lmkit.model.board import BoardSpec
from lmkit.model.charuco import charuco_board
from lmkit.model.observation import BoardObservation

MIN_CHARUCO_CORNERS = 6
_SUBPIX = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 60, 1e-4)


def detect_board(image: ByteArray, board: BoardSpec) -> BoardObservation | None:
    """The board in one picture, or None.

    Args:
        image: (H,W,3) BGR, 8 bit.
    """
    grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
    if board.kind == "charuco":
        return _detect_charuco(grey, board)
    corners = _find_chessboard(grey, board.inner_corners)
    if corners is None:
        return None
    return BoardObservation(np.arange(len(corners)), _fused(grey, corners, board.inner_corners))


def likelier_board(images: Sequence[ByteArray], board: BoardSpec) -> BoardSpec | None:
    """Another chessboard size that fits the pictures better than ``board``, or None.

    A board given too small is found inside the true one without complaint, so larger ones are
    tried where it was found, and neighbouring sizes where it was not.
    """
    if board.kind != "chessboard" or not images:
        return None
    columns, rows = board.inner_corners
    greys = [np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8) for image in images]
    sizes = [
        (columns + dc, rows + dr)
        for dc in range(3, -4, -1)
        for dr in range(3, -4, -1)
        if (dc, dr) != (0, 0) and min(columns + dc, rows + dr) >= 3
    ]
    found_here = sum(_find_chessboard(grey, (columns, rows)) is not None for grey in greys)
    if 2 * found_here > len(greys):
        sizes = [(c, r) for c, r in sizes if c >= columns and r >= rows]
    # Larger sizes come first: a smaller board hides in a larger one, never the other way round.
    for size in sorted(sizes, key=lambda s: -s[0] * s[1]):
        first_found = _find_chessboard(greys[0], size) is not None
        if first_found and 2 * sum(_find_chessboard(g, size) is not None for g in greys) > len(greys):
            return BoardSpec(board.kind, size[0], size[1], board.square_mm)
    return None


def same_orientation(left: BoardObservation, right: BoardObservation) -> BoardObservation:
    """``right`` with its corners in the order of ``left``.

    A chessboard looks alike when turned by half; the cameras of a rig see it the same way up, so
    the order in which its first and last corner lie in the pictures decides.
    """
    direction_left = left.image_points[-1] - left.image_points[0]
    direction_right = right.image_points[-1] - right.image_points[0]
    if float(direction_left @ direction_right) >= 0:
        return right
    return BoardObservation(right.ids, right.image_points[::-1].copy())


def _find_chessboard(grey: ByteArray, size: tuple[int, int]) -> FloatArray | None:
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    found, corners = cv2.findChessboardCornersSB(grey, size, flags=flags)
    if not found or corners is None:
        return None
    return np.asarray(corners, dtype=np.float64).reshape(-1, 2)


def _fused(grey: ByteArray, corners: FloatArray, size: tuple[int, int]) -> FloatArray:
    """Mean of the SB corners and of gradient-based ones whose window follows the local square size.

    The two err differently (SB on blur and lighting, gradients on noise); their mean is better than
    either on every real set at hand (docs/decisions/0005-board-corners.md).
    """
    grid = corners.reshape(size[1], size[0], 2)
    across = np.linalg.norm(np.diff(grid, axis=1), axis=2).min()
    down = np.linalg.norm(np.diff(grid, axis=0), axis=2).min()
    half = int(np.clip(0.35 * min(across, down), 2, 15))
    refined = corners.astype(np.float32).reshape(-1, 1, 2).copy()
    cv2.cornerSubPix(grey, refined, (half, half), (-1, -1), _SUBPIX)
    other = refined.reshape(-1, 2).astype(np.float64)
    # Where they differ by much, one of them has slipped; SB does so less.
    apart = np.linalg.norm(other - corners, axis=1, keepdims=True)
    return np.where(apart < 0.1 * half + 0.5, (corners + other) / 2, corners)


def _detect_charuco(grey: ByteArray, board: BoardSpec) -> BoardObservation | None:
    cv_board = charuco_board(board)
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    detector = cv2.aruco.CharucoDetector(cv_board, cv2.aruco.CharucoParameters(), parameters)
    corners, ids, _, _ = detector.detectBoard(grey)
    if ids is None or len(ids) < MIN_CHARUCO_CORNERS:
        return None
    points = np.asarray(corners, dtype=np.float64).reshape(-1, 2)
    numbers = np.asarray(ids, dtype=np.int64).ravel()
    # Corners on one line give no pose.
    plane = board.object_points[numbers, :2]
    if np.linalg.matrix_rank(plane - plane.mean(axis=0), tol=1e-6) < 2:
        return None
    return BoardObservation(numbers, points)
