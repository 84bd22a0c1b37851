"""Calibration boards in pictures: chessboard corners by two detectors, ChArUco corners."""

from __future__ import annotations

from collections import Counter
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

    A board given too small is found inside the true one without complaint, so the squares are
    followed beyond the corners found; where none was found, neighbouring sizes are tried.
    """
    if board.kind != "chessboard":
        return None
    greys = [np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8) for image in images]
    columns, rows = board.inner_corners
    grown: list[tuple[int, int]] = []
    for grey in greys:
        corners = _find_chessboard(grey, (columns, rows))
        if corners is not None:
            more_columns, more_rows = _squares_beyond(grey, corners.reshape(rows, columns, 2))
            grown.append((columns + more_columns, rows + more_rows))
    if grown:
        size = Counter(grown).most_common(1)[0][0]
        return None if size == (columns, rows) else _resized(board, size)
    near = [(columns + dc, rows + dr) for dc in range(2, -3, -1) for dr in range(2, -3, -1)]
    # Larger sizes first: a smaller board hides in a larger one, never the other way round.
    for size in sorted(near, key=lambda s: -s[0] * s[1]):
        if min(size) >= 3 and any(_find_chessboard(grey, size, thorough=False) is not None for grey in greys):
            return _resized(board, size)
    return None


def _resized(board: BoardSpec, size: tuple[int, int]) -> BoardSpec:
    return BoardSpec(board.kind, size[0], size[1], board.square_mm)


def _squares_beyond(grey: ByteArray, grid: FloatArray) -> tuple[int, int]:
    """How many more columns and rows of inner corners lie around the (R,C,2) grid found."""
    beyond = [0, 0]
    for axis in (0, 1):
        for side in (False, True):
            lines = grid if axis == 0 else grid.transpose(1, 0, 2)
            lines = lines[::-1] if side else lines
            while beyond[1 - axis] < 8:
                # The next line of corners, where the last three lead to (equal steps, slowly changing).
                following = 3 * lines[0] - 3 * lines[1] + lines[2]
                if not _are_saddles(grey, following, lines[0], lines[1]):
                    break
                beyond[1 - axis] += 1
                lines = np.concatenate([following[None], lines])
    return beyond[0], beyond[1]


def _are_saddles(grey: ByteArray, points: FloatArray, near: FloatArray, nearer: FloatArray) -> bool:
    """Do four squares meet at most of ``points``, as they do at the corners of the line before?"""

    def saddle(at: FloatArray, step: FloatArray) -> FloatArray:
        along = np.gradient(at, axis=0)
        quadrants = [at + 0.3 * (u * along + v * step) for u, v in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
        maps = np.array(quadrants, dtype=np.float32)
        a, b, c, d = cv2.remap(
            grey, maps[:, :, 0], maps[:, :, 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        ).astype(np.float64)
        # Opposite quadrants alike, neighbours unlike.
        return np.asarray((a + c - b - d) / 2 - np.maximum(np.abs(a - c), np.abs(b - d)) * np.sign(a + c - b - d) / 2)

    height, width = grey.shape
    if ((points < 2) | (points > np.array([width, height]) - 3)).any():
        return False
    known = saddle(near, near - nearer)
    here = saddle(points, points - near)
    alternating = np.sign(here[1:]) == -np.sign(here[:-1])
    strong = np.abs(here) > 0.4 * np.median(np.abs(known))
    return bool(strong.mean() > 0.8 and alternating.mean() > 0.8)


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


def _find_chessboard(grey: ByteArray, size: tuple[int, int], thorough: bool = True) -> FloatArray | None:
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE
    if thorough:
        flags |= cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    found, corners = cv2.findChessboardCornersSB(grey, size, flags=flags)
    if not found or corners is None:
        return None
    return np.asarray(corners, dtype=np.float64).reshape(-1, 2)


def _fused(grey: ByteArray, corners: FloatArray, size: tuple[int, int]) -> FloatArray:
    """Mean of the SB corners and of gradient-based ones whose window follows the local square size.

    The two err differently (SB on blur and lighting, gradients on noise); their mean is better than
    either on most real sets (docs/decisions/0005-board-corners.md).
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
